"""exporter.kitti: matrices whose columns are the axes of the body, worked out by hand, and times beside them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from exporter_tables import drive

from recon.errors import NothingToExport
from recon.manifest import RunInfo
from recon.numerics.rotation import from_euler
from recon.tables import matrix
from recon_exporters import kitti as module
from recon_exporters.kitti import PoseParams

S, C = 0.5, np.sqrt(0.75)


def export(folder: Path, trajectory, **params) -> tuple[np.ndarray, list[str]]:
    """Poses (n, 3, 4) and the lines of the times."""
    paths = module.kitti(trajectory=trajectory, folder=folder, about=RunInfo("run"), params=PoseParams(**params))
    assert [path.name for path in paths] == ["poses.txt", "times.txt"]
    poses, times = (path.read_text(encoding="utf-8").splitlines() for path in paths)
    return np.array([line.split(" ") for line in poses], dtype=np.float64).reshape(-1, 3, 4), times


def test_the_record_keeps_the_rules_of_its_role():
    (record,) = module.declare_exporters()
    assert record.faults() == []


def test_a_line_is_the_upper_part_of_the_pose_row_by_row(tmp_path):
    """A quarter turn to the left takes forward (1, 0, 0) to (0, 1, 0)."""
    export(tmp_path, drive([0], pos=np.array([[7.0, 8.0, 9.5]]), q=from_euler(np.array([np.pi / 2]), 0.0, 0.0)))
    numbers = [float(text) for text in (tmp_path / "poses.txt").read_text(encoding="utf-8").split(" ")]
    assert np.abs(np.array(numbers) - (0, -1, 0, 7, 1, 0, 0, 8, 0, 0, 1, 9.5)).max() < 1e-15


def test_positions_read_back_to_the_same_double_and_rotations_are_rotations(tmp_path):
    """A matrix from a quaternion of unit length is orthonormal to a few roundings of 1.1e-16."""
    rng = np.random.default_rng(2)
    q = from_euler(*rng.uniform(-1.5, 1.5, size=(3, 5000)))
    table = drive(np.arange(5000) / 100, pos=rng.normal(size=(5000, 3)), q=q)
    poses, times = export(tmp_path, table)
    assert np.array_equal(poses[:, :, 3], matrix(table, "pos"))
    turn = poses[:, :, :3]
    assert np.abs(turn @ turn.transpose(0, 2, 1) - np.eye(3)).max() < 1e-14
    assert np.linalg.det(turn).min() > 0.9
    assert len(times) == 5000


NOSE_UP_NORTH = from_euler(np.array([np.pi / 2]), np.radians(-30.0), 0.0)
"""Pointing north, nose 30 deg up. East, north, up: forward (0, C, S), left (-1, 0, 0), roof (0, -S, C)."""
LEANING_EAST = from_euler(np.array([0.0]), 0.0, np.radians(30.0))
"""Pointing east, right side 30 deg down. Forward (1, 0, 0), left (0, C, S), roof (0, -S, C)."""


@pytest.mark.parametrize(
    ("axes", "q", "columns"),
    [
        ("iso8855", NOSE_UP_NORTH, ((0, C, S), (-1, 0, 0), (0, -S, C))),
        ("ros_rep103", NOSE_UP_NORTH, ((0, C, S), (-1, 0, 0), (0, -S, C))),
        # Forward, right, floor; in east, south, down.
        ("sae_j670", NOSE_UP_NORTH, ((0, -C, -S), (1, 0, 0), (0, -S, C))),
        # The same three; in north, east, down.
        ("ned", NOSE_UP_NORTH, ((C, 0, -S), (0, 1, 0), (S, 0, C))),
        ("iso8855", LEANING_EAST, ((1, 0, 0), (0, C, S), (0, -S, C))),
        ("ros_rep103", LEANING_EAST, ((1, 0, 0), (0, C, S), (0, -S, C))),
        ("sae_j670", LEANING_EAST, ((1, 0, 0), (0, C, S), (0, -S, C))),
        ("ned", LEANING_EAST, ((0, 1, 0), (-C, 0, S), (S, 0, C))),
    ],
)
def test_columns_are_the_axes_of_the_body_in_those_of_the_world(tmp_path, axes, q, columns):
    """Numbers up to 1, a dozen roundings each."""
    poses, _ = export(tmp_path, drive([0], q=q), axes=axes)
    assert np.abs(poses[0, :, :3].T - columns).max() < 1e-14


@pytest.mark.parametrize(
    ("axes", "place"),
    [("iso8855", (1, 2, 3)), ("ros_rep103", (1, 2, 3)), ("sae_j670", (1, -2, -3)), ("ned", (2, 1, -3))],
)
def test_positions_are_in_the_axes_of_the_world(tmp_path, axes, place):
    poses, _ = export(tmp_path, drive([0], pos=np.array([[1.0, 2.0, 3.0]])), axes=axes)
    assert tuple(poses[0, :, 3]) == place


def test_times_count_from_the_first_pose_that_is_written(tmp_path):
    q = np.tile((1.0, 0, 0, 0), (4, 1))
    q[0] = np.nan
    poses, times = export(tmp_path, drive([0, 0.25, 0.250000001, 10], q=q))
    assert len(poses) == 3
    assert times == ["0.000000000", "0.000000001", "9.750000000"]


def test_a_rate_thins_poses_and_times_alike(tmp_path):
    poses, times = export(tmp_path, drive(np.arange(101) / 100), rate=10.0)
    assert len(poses) == len(times) == 11
    assert times[1] == "0.100000000"


def test_a_trajectory_without_poses_is_refused(tmp_path):
    with pytest.raises(NothingToExport, match="both a position and an attitude"):
        export(tmp_path, drive([0, 1], pos=np.full((2, 3), np.nan)))
    assert list(tmp_path.iterdir()) == []
