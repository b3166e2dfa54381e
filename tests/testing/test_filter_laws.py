"""Every law of filters fails for a filter that is wrong in that one way."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from broken_laws import broken

from recon import IMU, SAME, Filter, matrix, replace, time_ns, times
from recon.testing.laws import filters


def filter_of(change, **declared):
    """A filter that puts a function to the table of imu."""
    return Filter(
        name="work",
        summary="Some work.",
        run=lambda imu, params: {"imu": change(imu)},
        reads={"imu": IMU.need("accel")},
        writes={"imu": SAME},
        **declared,
    )


def smooth(imu):
    accel = matrix(imu, "accel")
    return replace(imu, accel=np.vstack([accel[:1], (accel[1:] + accel[:-1]) / 2.0]))


def late(imu: pa.Table) -> pa.Table:
    return imu.set_column(0, imu.schema.field("time"), times(time_ns(imu) + 1_000_000))


def test_a_filter_that_is_what_it_declares_breaks_no_law():
    assert broken(filters, filter_of(smooth, linear=True, unit_gain=True)) == {}
    assert broken(filters, filter_of(lambda imu: imu.slice(10, 100), linear=True, unit_gain=True)) == {}


def test_a_filter_that_declares_nothing_may_clip():
    assert broken(filters, filter_of(lambda imu: replace(imu, accel=matrix(imu, "accel").clip(-1.0, 1.0)))) == {}


def test_a_new_time_breaks_the_law_of_times():
    ((name, message),) = broken(filters, filter_of(late)).items()
    assert name == "row_times_are_those_of_the_input"
    assert "'imu' came back with 6550 rows at times that were not in it" in message
    assert "declares resamples=True" in message


def test_a_row_after_the_last_breaks_the_law_of_those_that_resample():
    assert broken(filters, filter_of(lambda imu: imu, resamples=True)) == {}
    assert broken(filters, filter_of(late, resamples=True)) == {
        "row_times_lie_within_the_input": "1 rows of 'imu' lie outside of the time of what was read"
    }


def test_a_gain_breaks_the_law_of_constants():
    louder = filter_of(lambda imu: replace(imu, accel=1.01 * matrix(imu, "accel")), linear=True, unit_gain=True)
    ((name, message),) = broken(filters, louder).items()
    assert name == "a_constant_passes_unchanged"
    assert "a constant imu.accel_x of" in message
    assert "its record declares unit_gain" in message


@pytest.mark.parametrize("wrong", [lambda y: y.clip(-50.0, 50.0), np.abs, lambda y: np.where(abs(y) < 0.1, 0.0, y)])
def test_a_threshold_or_a_lost_sign_breaks_the_law_of_scales(wrong):
    ((name, message),) = broken(
        filters, filter_of(lambda imu: replace(imu, accel=wrong(matrix(imu, "accel"))), linear=True)
    ).items()
    assert name == "a_scaled_input_gives_a_scaled_result"
    assert "times the input did not give" in message
    assert "its record declares linear" in message
