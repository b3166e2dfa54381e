from __future__ import annotations

from typing import Any

import crash_pulses as pulses
import numpy as np
import pytest

from recon.numerics.channel_class import channel_class
from recon.rows import warnings_of
from recon.tables import matrix
from recon_filters.cfc import CfcParams, cfc, declare_filters


def warned(rate_hz: float, **params: Any) -> list[str]:
    t_s = pulses.times(rate_hz, 2.0)
    return warnings_of(cfc(imu=pulses.imu_of(t_s, pulses.at_rest(t_s)), params=CfcParams(**params))["metrics"])


def test_it_is_the_filter_of_the_standards_on_every_axis() -> None:
    t_s = pulses.times(2000.0, 12.0)
    accel = pulses.noisy(pulses.crash(t_s, (-10.0, 3.0)))
    found = matrix(cfc(imu=pulses.imu_of(t_s, accel), params=CfcParams(channel_class=180))["imu"], "accel")
    np.testing.assert_array_equal(found, channel_class(accel, 180, 2000.0))


@pytest.mark.parametrize(("cfc_class", "least"), [(60, 600), (180, 1800), (600, 6000), (1000, 10_000)])
def test_sampling_below_ten_times_the_class_warns(cfc_class: Any, least: int) -> None:
    assert warned(float(least), channel_class=cfc_class) == []
    (text,) = warned(0.9 * least, channel_class=cfc_class)
    assert f"CFC {cfc_class} wants {least} samples per second" in text


def test_irregular_samples_warn() -> None:
    t_s = pulses.times(1000.0, 2.0)
    t_s[500:] += 0.0008
    found = cfc(imu=pulses.imu_of(t_s, pulses.at_rest(t_s)), params=CfcParams())
    assert "not regular" in warnings_of(found["metrics"])[0]


def test_a_gap_is_not_filtered_across() -> None:
    t_s = pulses.times(1000.0, 4.0)
    accel = pulses.noisy(pulses.at_rest(t_s))
    kept = (t_s < 1.0) | (t_s > 3.0)
    found = matrix(cfc(imu=pulses.imu_of(t_s[kept], accel[kept]), params=CfcParams())["imu"], "accel")
    np.testing.assert_array_equal(found[:1000], channel_class(accel[:1000], 60, 1000.0))


def test_the_gyro_is_left_alone_where_asked() -> None:
    t_s = pulses.times(1000.0, 2.0)
    turn = pulses.noisy(np.zeros((len(t_s), 3)))
    found = cfc(imu=pulses.imu_of(t_s, pulses.at_rest(t_s), turn), params=CfcParams(gyro=False))["imu"]
    np.testing.assert_array_equal(matrix(found, "gyro"), turn)


def test_the_declaration_has_no_fault() -> None:
    assert [stage.faults() for stage in declare_filters()] == [[]]
