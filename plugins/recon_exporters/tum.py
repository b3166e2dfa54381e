"""The trajectory as a TUM file: for tools that compare trajectories, such as evo and rpg_trajectory_evaluation.

    timestamp tx ty tz qx qy qz qw

timestamp   seconds since 1970 with all nanoseconds, UTC unless the stream's time_scale says otherwise
tx ty tz    m, in the world axes that `axes` names; a number reads back to the same double
qx .. qw    body to world, scalar LAST

Lines that begin with # say which trajectory it is, which axes, and which rows were kept.

References
    Sturm et al. (2012), "A benchmark for the evaluation of RGB-D SLAM systems", IROS; file formats of its data set.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pyarrow as pa

from recon.hookspecs import hookimpl
from recon.manifest import RunInfo
from recon.stages import Exporter
from recon_exporters._poses import AXES_IN_WORDS, READS, PoseParams, poses_of, write_numbers
from recon_exporters._text_columns import fixed_point
from recon_exporters._tracks import rows_kept


def tum(*, trajectory: pa.Table, folder: Path, about: RunInfo, params: PoseParams) -> list[Path]:
    """Write `folder/trajectory.tum`; its path. Raises NothingToExport where no row has a position and an attitude."""
    poses = poses_of(trajectory, params)
    name = " ".join(about.name.split())
    path = folder / "trajectory.tum"
    with path.open("wb") as file:
        file.write(f"# {name}: {len(poses.t_ns)} of {trajectory.num_rows} rows, {rows_kept(params.rate)}\n".encode())
        file.write(f"# axes {params.axes}: {AXES_IN_WORDS[params.axes]}\n".encode())
        file.write(b"# timestamp tx ty tz qx qy qz qw\n")
        qw, qx, qy, qz = poses.q.T
        write_numbers(file, [fixed_point(pa.array(poses.t_ns), 9), *poses.position.T, qx, qy, qz, qw])
    return [path]


@hookimpl
def declare_exporters() -> Iterable[Exporter]:
    """The exporter of TUM files."""
    yield Exporter(
        name="tum",
        summary="The trajectory as a TUM file, scalar part last, for tools that compare trajectories.",
        params=PoseParams,
        run=tum,
        reads=READS,
        references=("Sturm et al. 2012",),
    )
