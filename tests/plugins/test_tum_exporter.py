"""exporter.tum: numbers that read back to the last bit, and axes against cases worked out by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from exporter_tables import START_NS, drive

import recon
from recon.api import export as export_run
from recon.errors import NothingToExport
from recon.manifest import RunInfo
from recon.numerics.rotation import from_euler
from recon.tables import matrix
from recon_exporters import tum as module
from recon_exporters.tum import PoseParams

R = np.sqrt(0.5)


def export(folder: Path, trajectory, name="run", **params) -> Path:
    (path,) = module.tum(trajectory=trajectory, folder=folder, about=RunInfo(name), params=PoseParams(**params))
    assert path == folder / "trajectory.tum"
    return path


def rows_of(path: Path) -> list[list[str]]:
    return [line.split(" ") for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]


def random_drive(rows: int):
    rng = np.random.default_rng(5)
    position = rng.normal(size=(rows, 3)) * 10.0 ** rng.integers(-9, 7, size=(rows, 3))
    return drive(np.arange(rows) / 100, pos=position, q=from_euler(*rng.uniform(-1.5, 1.5, size=(3, rows))))


def test_the_record_keeps_the_rules_of_its_role():
    (record,) = module.declare_exporters()
    assert record.faults() == []


def test_positions_read_back_to_the_same_double(tmp_path):
    """100 000 rows are more than one block of the writer."""
    table = random_drive(100_000)
    read = np.loadtxt(export(tmp_path, table))
    assert np.array_equal(read[:, 1:4], matrix(table, "pos"))


def test_the_scalar_part_of_the_quaternion_is_last(tmp_path):
    """With no change of axes the product by the identity leaves every bit as it was."""
    table = random_drive(50)
    assert np.array_equal(np.loadtxt(export(tmp_path, table))[:, [7, 4, 5, 6]], matrix(table, "q"))


def test_times_have_all_their_nanoseconds(tmp_path):
    rows = rows_of(export(tmp_path, drive([0, 0.000000001, 1.5])))
    assert [row[0] for row in rows] == ["1714550400.000000000", "1714550400.000000001", "1714550401.500000000"]
    assert int(rows[1][0].replace(".", "")) == START_NS + 1


def test_times_before_1970_keep_their_sign(tmp_path):
    rows = rows_of(export(tmp_path, drive([-1_714_550_400.5, -1_714_550_399])))
    assert [row[0] for row in rows] == ["-0.500000000", "1.000000000"]


def test_a_line_holds_eight_numbers_and_nothing_else(tmp_path):
    text = export(tmp_path, random_drive(20)).read_text(encoding="utf-8")
    lines = [line for line in text.split("\n") if not line.startswith("#")]
    assert lines.pop() == ""
    assert {len([float(number) for number in line.split(" ")]) for line in lines} == {8}


NORTH = (R, 0.0, 0.0, R)
"""Scalar first: a level vehicle that points north, yaw 90 deg."""
NOSE_UP_EAST = tuple(from_euler(0.0, np.radians(-60.0), 0.0))
"""A vehicle that points east with its nose 60 deg up; positive pitch of ISO 8855 is down."""
S, C = np.sin(np.radians(30.0)), np.cos(np.radians(30.0))


@pytest.mark.parametrize(
    ("axes", "q", "position", "expected"),
    [
        # East 1, north 2, up 3; pointing north is a quarter turn to the left of east, seen from above.
        ("iso8855", NORTH, (1, 2, 3), (0, 0, R, R)),
        ("ros_rep103", NORTH, (1, 2, 3), (0, 0, R, R)),
        # Seen along z, which points down, the same quarter turn is to the other side.
        ("sae_j670", NORTH, (1, -2, -3), (0, 0, -R, R)),
        # x of the world is north already.
        ("ned", NORTH, (2, 1, -3), (0, 0, 0, 1)),
        # Nose up is a turn about -y where y points left, and about +y where y points right.
        ("iso8855", NOSE_UP_EAST, (1, 2, 3), (0, -S, 0, C)),
        ("ros_rep103", NOSE_UP_EAST, (1, 2, 3), (0, -S, 0, C)),
        ("sae_j670", NOSE_UP_EAST, (1, -2, -3), (0, S, 0, C)),
        # First a quarter turn to the right of north, about z, then nose up about the new y: k/2 (x) j/2 gives -i.
        ("ned", NOSE_UP_EAST, (2, 1, -3), (-R * S, R * S, R * C, R * C)),
    ],
)
def test_axes_are_those_of_the_convention(tmp_path, axes, q, position, expected):
    """A dozen roundings of numbers up to 1 are below 1e-15 each; a quaternion and its negative are one rotation."""
    (row,) = np.loadtxt(
        export(tmp_path, drive([0.0], pos=np.array([[1.0, 2, 3]]), q=np.array([q])), axes=axes), ndmin=2
    )
    assert row[1:4].tolist() == list(position)
    read = row[4:] * np.sign(row[7])
    assert np.abs(read - expected).max() < 1e-14


def test_rows_without_a_position_or_an_attitude_are_left_out(tmp_path):
    position, q = np.ones((4, 3)), np.tile((1.0, 0, 0, 0), (4, 1))
    position[1, 2], q[2, 0] = np.nan, np.nan
    path = export(tmp_path, drive([0, 1, 2, 3], pos=position, q=q))
    assert [row[0][-12:] for row in rows_of(path)] == ["00.000000000", "03.000000000"]
    assert "2 of 4 rows" in path.read_text(encoding="utf-8")


def test_the_head_says_what_the_file_holds_and_stays_one_comment(tmp_path):
    path = export(tmp_path, random_drive(1001), name="a\n1 2 3", rate=10.0, axes="ned")
    head = [line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("#")]
    assert head == [
        "# a 1 2 3: 101 of 1001 rows, at most 10 in a second",
        "# axes ned: world north, east, down; body forward, right, down",
        "# timestamp tx ty tz qx qy qz qw",
    ]
    assert len(rows_of(path)) == 101


def test_a_trajectory_without_poses_is_refused(tmp_path):
    with pytest.raises(NothingToExport, match="both a position and an attitude"):
        export(tmp_path, drive([0, 1], q=np.full((2, 4), np.nan)))
    assert list(tmp_path.iterdir()) == []


def test_a_log_without_gnss_has_poses_and_no_map(tmp_path, logs):
    """The crash log of the thesis: an IMU alone."""
    run = recon.run("thesis", logs / "physycom_crash" / "crash_01.txt", tmp_path / "run")
    (path,) = export_run(run, ["tum"])
    read = np.loadtxt(path)
    assert np.array_equal(read[:, 1:4], matrix(run.trajectory.table, "pos"))
    for name in ("geojson", "kml", "gpx"):
        with pytest.raises(NothingToExport, match="latitude and longitude, which a map needs"):
            export_run(run, [name])
        assert not (run.folder / "exports" / name).exists()
