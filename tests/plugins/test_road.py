"""analyzer.road: roughness of roads that shake as a sine, and potholes at known places."""

from __future__ import annotations

import numpy as np
import pytest
from handling_drives import START_NS, bumpy, gentle, told

from recon import Event, events, matrix, time_ns
from recon.numerics.handling import of_neighbours
from recon_analyzers.road import RoadParams, analyze_road


def analyzed(trajectory, happened=None, **params):
    return analyze_road(trajectory=trajectory, events=happened, params=RoadParams(**params))


@pytest.mark.parametrize("frequency", [5.0, 12.0, 20.0])
def test_roughness_is_the_root_mean_square_of_what_shakes(frequency):
    """A sine of 2 m/s^2: 2 / sqrt(2). Four means for 20 Hz pass sinc^4(0.2275 f / 20), 1 / sqrt(2) at the edge; what
    the four for 0.5 Hz pass, sinc^4(0.2275 f / 0.5), is taken off."""
    streams = analyzed(bumpy(2.0, frequency))
    gain = np.sinc(frequency * 0.22751 / 20.0) ** 4 * (1.0 - np.sinc(frequency * 0.22751 / 0.5) ** 4)
    inner = streams["road"]["roughness"].to_numpy()[1:-1]
    assert inner == pytest.approx(np.full(len(inner), 2.0 / np.sqrt(2.0) * gain), rel=0.01)


def test_a_row_without_acceleration_takes_nothing_off_its_neighbours():
    t_ns = START_NS + np.arange(100) * 10_000_000
    values = np.where(np.arange(100) == 50, np.nan, 3.0)
    found = of_neighbours(t_ns, values, 20.0, 1.0)
    assert np.isnan(found[50])
    assert np.delete(found, 50) == pytest.approx(np.full(99, 3.0))


@pytest.mark.parametrize("frequency", [0.02, 0.05])
def test_hills_are_no_roughness(frequency):
    """A tenth and less of the lower edge: of a sine f the high-pass leaves (pi f w)^2 / 3, under 1 % at 0.05 Hz."""
    streams = analyzed(bumpy(1.0, frequency))
    assert told(streams)["roughness_median"]["value"] < 0.02


def test_stretches_are_a_hundred_metres_with_speed_and_place():
    made = bumpy(1.0, 5.0, speed=20.0)
    road = analyzed(made)["road"]
    assert road.num_rows == 12
    assert road["distance"].to_pylist() == [100.0 * number for number in range(12)]
    assert road["length"].to_numpy() == pytest.approx(np.full(12, 100.0), abs=0.5)
    assert road["speed"].to_numpy() == pytest.approx(np.full(12, 20.0))
    assert matrix(road, "pos")[:, 0] == pytest.approx(100.0 * np.arange(12), abs=0.3)
    assert road["lat"].null_count == 0


def test_roughness_at_80_is_scaled_by_the_root_of_the_speed():
    rows = analyzed(bumpy(1.0, 5.0, speed=20.0))["road"].to_pylist()
    assert rows[3]["roughness_80"] == pytest.approx(rows[3]["roughness"] * np.sqrt(80.0 / 3.6 / 20.0))


def test_potholes_are_found_where_they_are():
    made = bumpy(0.2, 5.0, speed=20.0, hits=(10.0, 31.0))
    streams = analyzed(made)
    holes = streams["potholes"]
    assert ((time_ns(holes) - START_NS) * 1e-9).tolist() == pytest.approx([10.0, 31.0], abs=0.15)
    assert matrix(holes, "pos")[:, 0] == pytest.approx([200.0, 620.0], abs=3.0)
    assert [row["kind"] for row in streams["events"].to_pylist()] == ["pothole"] * 2
    assert told(streams)["potholes"]["value"] == 2.0


def test_a_road_that_is_rough_throughout_has_no_potholes():
    assert told(analyzed(bumpy(6.0, 5.0)))["potholes"]["value"] == 0.0


def test_a_smooth_road_has_neither():
    found = told(analyzed(gentle()))
    assert found["roughness_median"]["value"] == pytest.approx(0.0, abs=1e-9)
    assert found["potholes"]["value"] == 0.0


def test_slow_stretches_are_left_out():
    streams = analyzed(bumpy(2.0, 5.0, speed=3.0))
    assert streams["road"].num_rows == 0
    assert streams["potholes"].num_rows == 0


def test_rows_around_a_crash_are_left_out():
    made = bumpy(0.2, 5.0, speed=20.0, hits=(31.0,))
    crash = events([Event(START_NS + 30_000_000_000, START_NS + 31_000_000_000, "crash")])
    assert analyzed(made, crash)["potholes"].num_rows == 0


def test_without_accelerations_or_too_slow_there_is_a_warning():
    made = bumpy(2.0, 5.0)
    for other in (made.drop_columns([f"accel_{axis}" for axis in "xyz"]), made.take(list(range(0, 6000, 5)))):
        streams = analyzed(other)
        assert streams["road"].num_rows == 0
        assert "no roughness" in streams["metrics"].to_pylist()[0]["note"]
