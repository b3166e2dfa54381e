from __future__ import annotations

import pytest

from recon.schema import APPENDED, METRICS, STREAMS, TIME_TYPE, by_step, unnumbered
from recon.units import parse_unit, si_unit


@pytest.mark.parametrize("stream", STREAMS)
def test_canonical_columns_are_in_si_or_degrees_of_latitude_and_longitude(stream):
    for column in STREAMS[stream].columns:
        if column.unit:
            assert column.unit == si_unit(column.unit) or column.name in ("lat", "lon")
            assert parse_unit(column.unit).scale == 1.0 or column.unit == "deg"


@pytest.mark.parametrize("stream", [name for name in STREAMS if name != "metrics"])
def test_every_stream_but_metrics_begins_with_the_time(stream):
    first = STREAMS[stream].columns[0]
    assert (first.name, first.type, first.optional) == ("time", TIME_TYPE, False)


@pytest.mark.parametrize("stream", APPENDED)
def test_an_appended_stream_is_kept_with_its_step_in_front(stream):
    assert by_step(stream).names == ("step", *STREAMS[stream].names)


def test_metrics_have_no_time():
    assert "time" not in METRICS


@pytest.mark.parametrize(
    ("stream", "name"), [("imu_2", "imu"), ("imu", "imu"), ("imu_x", "imu_x"), ("_2", "_2"), ("a_b_12", "a_b")]
)
def test_the_number_of_a_further_sensor_is_taken_off(stream, name):
    assert unnumbered(stream) == name
