"""Simulated drives as a camera in the vehicle sees them."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import map_drives
import numpy as np
import pyarrow as pa
from streets import CENTRE, FOCAL, OPTICAL, Poses, Street, film

from recon import Streams, matrix, time_ns
from recon.numerics.rotation import conjugate, from_euler, multiply, to_euler, to_matrix
from recon_integrators.visual_odometry import VisualOdometryParams, visual_odometry

MOUNT_BV = from_euler(0.05, 0.03, -0.04)
"""The camera in the vehicle: 3 deg to the left, 2 deg down."""


class Filmed(NamedTuple):
    """A drive, the camera's poses at the images, the images, and how the camera sits."""

    drive: Streams
    poses: Poses
    frames: pa.Table
    params: VisualOdometryParams

    def found(self) -> Streams:
        return visual_odometry(frames=self.frames, params=self.params)


def box_of(drive: Streams) -> np.ndarray:
    """(4,), sensor to vehicle."""
    numbers = map_drives.numbers(drive)
    return from_euler(*np.radians([numbers[f"true_mount_{angle}"] for angle in ("yaw", "pitch", "roll")]))


def filmed(drive: Streams, t_s: np.ndarray, folder: Path, **scene: object) -> Filmed:
    """The drive as a camera sees it at these times since its start."""
    reference, q_vs = drive["reference"], box_of(drive)
    q_sc = multiply(conjugate(q_vs), MOUNT_BV)
    at_ns = time_ns(reference)[0] + np.rint(t_s * 1e9).astype(np.int64)
    poses = Poses.along(reference, at_ns, q_vs, to_matrix(q_sc) @ OPTICAL)
    way_n = matrix(reference, "pos")
    street = Street(way_n, float(way_n[:, 2].min()) - 1.4)
    yaw, pitch, roll = (float(angle) for angle in to_euler(q_sc))
    params = VisualOdometryParams(folder=str(folder), focal=(FOCAL, FOCAL), centre=CENTRE, mounting=(roll, pitch, yaw))
    return Filmed(drive, poses, film(street, poses, folder, **scene), params)  # type: ignore[arg-type]
