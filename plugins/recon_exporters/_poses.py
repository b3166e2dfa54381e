"""Poses in the axes that a reader of the file expects: what TUM and KITTI files have in common.

    p = W p_n        q = W (x) q_nv (x) B*        W takes local to world axes, B vehicle to body axes

    axes        world: x, y, z          body: x, y, z             standard
    iso8855     east, north, up         forward, left, up         ISO 8855:2011; it leaves open where x of the world
                                                                  points: east, as in all of recon
    ros_rep103  east, north, up         forward, left, up         REP 103; the same numbers as iso8855
    sae_j670    east, south, down       forward, right, down      SAE J670_200801, z down: both axis systems of iso8855
                                                                  turned half around x, so yaw is that of ISO 8855 with
                                                                  the other sign: clockwise from east
    ned         north, east, down       forward, right, down      navigation and aerospace (ISO 1151-1): yaw is the
                                                                  heading, clockwise from north

The origin is that of the local frame in all of them. Rows without a position or an attitude are left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO, Final, Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.errors import NothingToExport
from recon.numerics.rotation import conjugate, from_matrix, multiply
from recon.parameters import Params, quantity, setting
from recon.schema import TRAJECTORY
from recon.tables import Array, matrix, time_ns
from recon_exporters._tracks import due

READS: Final = {"trajectory": TRAJECTORY.need("pos", "q")}

_SAME: Final = np.eye(3)
_HALF_AROUND_X: Final = np.diag((1.0, -1.0, -1.0))
_NORTH_EAST_DOWN: Final = np.array(((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)))
_AXES: Final = {
    "iso8855": (_SAME, _SAME),
    "ros_rep103": (_SAME, _SAME),
    "sae_j670": (_HALF_AROUND_X, _HALF_AROUND_X),
    "ned": (_NORTH_EAST_DOWN, _HALF_AROUND_X),
}
"""Matrices from local to world and from vehicle to body."""

AXES_IN_WORDS: Final[Mapping[str, str]] = {
    "iso8855": "world east, north, up; body forward, left, up",
    "ros_rep103": "world east, north, up; body forward, left, up",
    "sae_j670": "world east, south, down; body forward, right, down",
    "ned": "world north, east, down; body forward, right, down",
}


class PoseParams(Params):
    """Which axes, and how many rows."""

    axes: Literal["iso8855", "sae_j670", "ros_rep103", "ned"] = setting(
        "iso8855", doc="Axes of world and body: east-north-up and forward-left-up, or those of another convention."
    )
    rate: float | None = quantity(
        None, "Hz", ge=1e-6, le=1e6, doc="Most rows in a second that are written; none for every row."
    )


@dataclass(frozen=True)
class Poses:
    """Poses of the body in the world.

    t_ns : (n,) ns since 1970; position : (n, 3) m; q : (n, 4) scalar first, body to world
    """

    t_ns: NDArray[np.int64]
    position: Array
    q: Array


def poses_of(trajectory: pa.Table, params: PoseParams) -> Poses:
    """The poses in the axes chosen. Raises NothingToExport where no row has a position and an attitude."""
    position_n, q_nv = matrix(trajectory, "pos", gaps=True), matrix(trajectory, "q", gaps=True)
    known = np.flatnonzero(np.isfinite(position_n).all(axis=1) & np.isfinite(q_nv).all(axis=1))
    if not len(known):
        raise NothingToExport("no row of trajectory has both a position and an attitude")
    t_ns = time_ns(trajectory)[known]
    kept = due(t_ns, params.rate)
    rows = known[kept]
    world, body = _AXES[params.axes]
    q = multiply(multiply(from_matrix(world), q_nv[rows]), conjugate(from_matrix(body)))
    return Poses(t_ns[kept], position_n[rows] @ world.T, q)


def write_numbers(file: BinaryIO, columns: Sequence[Any]) -> None:
    """Columns, (n,) doubles or texts, as lines of values with a space between them."""
    from pyarrow.csv import WriteOptions, write_csv

    table = pa.table([pa.array(column) for column in columns], names=[str(number) for number in range(len(columns))])
    write_csv(table, file, WriteOptions(include_header=False, delimiter=" ", quoting_style="none"))
