"""The trajectory as KITTI pose files: for odometry benchmarks and the tools that read them.

    poses.txt    r11 r12 r13 tx r21 r22 r23 ty r31 r32 r33 tz    the upper three rows [R | t] of the pose, row by row
    times.txt    seconds since the first of these poses, a line for each line of poses.txt

R takes body to world axes, t is the position of the body in m; both in the axes that `axes` names. A number reads back
to the same double. The benchmark's own poses are those of its camera (x right, y down, z forward) relative to its first
image; these are those of the vehicle relative to the origin of the local frame, and tools that align trajectories or
compare relative poses read them alike.

References
    Geiger, Lenz, Urtasun (2012), "Are we ready for autonomous driving? The KITTI vision benchmark suite", CVPR;
    readme.txt of its odometry development kit.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pyarrow as pa

from recon.hookspecs import hookimpl
from recon.manifest import RunInfo
from recon.numerics.rotation import to_matrix
from recon.stages import Exporter
from recon_exporters._poses import READS, PoseParams, poses_of, write_numbers
from recon_exporters._text_columns import fixed_point


def kitti(*, trajectory: pa.Table, folder: Path, about: RunInfo, params: PoseParams) -> list[Path]:
    """Write `folder/poses.txt` and `folder/times.txt`; their paths.

    Raises NothingToExport where no row has a position and an attitude.
    """
    poses = poses_of(trajectory, params)
    upper = np.concatenate((to_matrix(poses.q), poses.position[:, :, None]), axis=2)
    since_first = fixed_point(pa.array(poses.t_ns - poses.t_ns[0]), 9)
    paths = [folder / "poses.txt", folder / "times.txt"]
    with paths[0].open("wb") as file:
        write_numbers(file, list(upper.reshape(-1, 12).T))
    with paths[1].open("wb") as file:
        write_numbers(file, [since_first])
    return paths


@hookimpl
def declare_exporters() -> Iterable[Exporter]:
    """The exporter of KITTI pose files."""
    yield Exporter(
        name="kitti",
        summary="The trajectory as 3x4 matrices with a file of times, as the KITTI odometry benchmark has them.",
        params=PoseParams,
        run=kitti,
        reads=READS,
        references=("Geiger et al. 2012",),
    )
