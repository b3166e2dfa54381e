"""exporter.sbet: records against cases worked out by hand, numbers to the last bit where nothing is computed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from exporter_tables import START_NS, drive

from recon.errors import NothingToExport
from recon.manifest import RunInfo
from recon.numerics.rotation import from_euler
from recon.parameters import NoParams
from recon.tables import matrix, vector, with_meta
from recon_exporters import sbet as module

WEEK_S = 604_800.0


def export(folder: Path, trajectory: pa.Table) -> tuple[np.ndarray, str]:
    """The records, (n, 17), and the text beside them."""
    paths = module.sbet(trajectory=trajectory, folder=folder, about=RunInfo("a\nrun"), params=NoParams())
    assert paths == [folder / "sbet_trajectory.out", folder / "sbet_trajectory.txt"]
    return np.fromfile(paths[0], dtype="<f8").reshape(-1, 17), paths[1].read_text(encoding="utf-8")


def one(**groups: Any) -> pa.Table:
    return drive([0.0], **groups)


def test_the_record_keeps_the_rules_of_its_role():
    (record,) = module.declare_exporters()
    assert record.faults() == []


def test_a_record_is_136_bytes(tmp_path):
    export(tmp_path, drive(np.arange(7)))
    assert (tmp_path / "sbet_trajectory.out").stat().st_size == 7 * 136


def test_places_heights_and_velocities_are_those_of_the_trajectory(tmp_path):
    """Degrees and radians are one multiplication apart, so places agree to two roundings."""
    rng = np.random.default_rng(4)
    table = drive(np.arange(50.0), height=rng.normal(size=50), vel=rng.normal(size=(50, 3)))
    records, _ = export(tmp_path, table)
    assert np.array_equal(records[:, 3], vector(table, "height"))
    assert np.array_equal(records[:, 4:7], matrix(table, "vel"))
    for column, name in ((1, "lat"), (2, "lon")):
        assert np.allclose(np.degrees(records[:, column]), vector(table, name), rtol=4e-16, atol=0.0)
    assert np.array_equal(records[:, 10], np.zeros(50))


@pytest.mark.parametrize(
    ("yaw_pitch_roll", "expected"),
    [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 90.0)),  # pointing east is a heading of 90 deg
        ((90.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((-90.0, 0.0, 0.0), (0.0, 0.0, 180.0)),
        ((90.0, -20.0, 0.0), (0.0, 20.0, 0.0)),  # ISO 8855: positive pitch is nose down; SBET: nose up
        ((90.0, 0.0, 10.0), (10.0, 0.0, 0.0)),  # right side down in both
    ],
)
def test_attitudes_are_roll_right_pitch_up_heading_from_north(tmp_path, yaw_pitch_roll, expected):
    """A few roundings of angles up to pi; a heading may come out a rounding below 360 deg."""
    q = from_euler(*np.radians(yaw_pitch_roll))
    records, _ = export(tmp_path, one(q=np.array([q])))
    difference = np.degrees(records[0, 7:10]) - expected
    assert np.abs((difference + 180.0) % 360.0 - 180.0).max() < 1e-12


def test_accelerations_and_rates_are_forward_right_down(tmp_path):
    table = one(accel=np.array([[1.0, 2.0, 3.0]]), gyro=np.array([[0.1, 0.2, 0.3]]))
    records, _ = export(tmp_path, table)
    assert records[0, 11:].tolist() == [1.0, -2.0, -3.0, 0.1, -0.2, -0.3]


def test_what_is_not_known_is_nan(tmp_path):
    records, _ = export(tmp_path, one())
    assert np.isnan(records[0, 11:]).all()


def test_times_count_from_the_gps_week(tmp_path):
    """2024-05-01 is a Wednesday: three days and 8 h after the week began on Sunday; GPS is 18 s ahead of UTC."""
    records, text = export(tmp_path, drive([0.0, 0.01]))
    assert np.abs(records[:, 0] - (3 * 86_400 + 8 * 3600 + 18 + np.array([0.0, 0.01]))).max() < 1e-9
    assert "GPS time, made from UTC" in text


def test_times_go_on_where_a_week_ends(tmp_path):
    to_week_end = 4 * 86_400 - 8 * 3600 - 18
    records, _ = export(tmp_path, drive([to_week_end - 1.0, to_week_end, to_week_end + 1.0]))
    assert np.abs(records[:, 0] - (WEEK_S + np.array([-1.0, 0.0, 1.0]))).max() < 1e-9


def test_times_rise_evenly_over_a_leap_second(tmp_path):
    """2016-12-31T23:59:60 was one; the seconds before it, 17 s, hold for the whole drive."""
    eve_s = 1_483_228_799.0 - START_NS / 1e9
    records, _ = export(tmp_path, drive(eve_s + np.arange(3)))
    assert np.diff(records[:, 0]).tolist() == [1.0, 1.0]
    assert records[0, 0] == 16.0  # a second before a Saturday ends, 17 s later, in the week that begins then


def test_times_of_another_scale_are_taken_as_they_are(tmp_path):
    records, text = export(tmp_path, with_meta(drive([0.0]), time_scale="GPS"))
    assert records[0, 0] == 3 * 86_400 + 8 * 3600
    assert "those of the log, GPS" in text


def test_rows_without_a_place_or_an_attitude_are_left_out_and_counted(tmp_path):
    lat = np.array([44.0, np.nan, 44.2, 44.3])
    q = np.tile((1.0, 0, 0, 0), (4, 1))
    q[2, 0] = np.nan
    records, text = export(tmp_path, drive([0, 1, 2, 3], lat=lat, q=q))
    assert np.degrees(records[:, 1]).round(9).tolist() == [44.0, 44.3]
    assert text.startswith("a run: 2 of 4 rows")


def test_the_text_names_the_datum_and_a_clock_that_was_not_set(tmp_path):
    _, text = export(tmp_path, with_meta(drive([0.0], datum="mean_sea_level"), clock="relative"))
    assert "above mean sea level, which SBET does not expect" in text
    assert "the clock was not set" in text


def test_a_trajectory_without_places_is_refused(tmp_path):
    with pytest.raises(NothingToExport, match="latitude, longitude, height and attitude, which SBET needs"):
        export(tmp_path, drive([0, 1], lat=np.full(2, np.nan)))
    assert list(tmp_path.iterdir()) == []
