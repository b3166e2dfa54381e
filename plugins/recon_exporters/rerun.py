"""The run as one Rerun file (.rrd): a map, a moving body in space, plots, events and camera pictures on one clock.

    world/...     3D in the local frame: paths, fixes, a box with its axes (ISO 8855) at every row, the sensor's axes
    map/...       the same on the Earth; the viewer asks a tile server for the ground where it is online
    plots/...     over time: speed, accelerations, turn rate, attitude, height, sigmas, residuals in sigmas
    sensors/...   over time: every number of imu, mag, baro and wheel; angles in degrees
    events/...    a lane for each kind; events_as_text: all that is known of each
    camera/...    pictures of a stream `frames` that lie beside the log
    about         the pipeline, its inputs and its warnings

The file brings its own layout. The clock of all is `time`. Plotted values, latitudes, longitudes and times are exact;
positions in space and quaternions are of single precision, as Rerun defines them. Lines have a point every 0.1 s;
everything else has every row unless `rate` says otherwise. Two events of a kind that overlap are one in its lane, and
one without a length is 1/500 of the run there, so that it can be seen.

Streams count with their number: trajectory_2 is a second trajectory, under the name that its fact `run` gives. That is
how several runs come into one file.

References
    Rerun, .rrd of rerun-sdk 0.41; ISO 8855:2011, 5.2.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import pyarrow as pa

from recon.errors import NothingToExport
from recon.extras import needs
from recon.hookspecs import hookimpl
from recon.manifest import RunInfo
from recon.parameters import Params, quantity
from recon.schema import APPENDED
from recon.stages import Exporter
from recon.tables import select_rows, time_ns
from recon_exporters._tracks import due


class RerunParams(Params):
    """How finely the run is drawn."""

    rate: float | None = quantity(
        None, "Hz", ge=1e-6, le=1e6, doc="Most rows in a second of each stream; none for every row."
    )


def rerun(*, streams: Mapping[str, pa.Table], folder: Path, about: RunInfo, params: RerunParams) -> list[Path]:
    """Write `folder/run.rrd`; its path.

    Raises NothingToExport where no stream has a row, PluginError where rerun-sdk is not installed.
    """
    thinned = {name: _thinned(name, table, params.rate) for name, table in streams.items()}
    if not any(table.num_rows for name, table in thinned.items() if name not in APPENDED):
        raise NothingToExport("no stream has a row: there is nothing to draw")
    with needs("exporter.rerun", "rerun-sdk", extra="rerun"):
        from recon_exporters._rerun_file import write
    path = folder / "run.rrd"
    write(path, thinned, about)
    return [path]


def _thinned(name: str, table: pa.Table, rate: float | None) -> pa.Table:
    if rate is None or name in (*APPENDED, "residuals") or "time" not in table.column_names:
        return table
    return select_rows(table, due(time_ns(table), rate))


@hookimpl
def declare_exporters() -> Iterable[Exporter]:
    """The exporter of Rerun files."""
    yield Exporter(
        name="rerun",
        summary="Everything on one clock for the Rerun viewer: map, moving body, plots, events, pictures.",
        params=RerunParams,
        run=rerun,
        every_stream=True,
        repeats=False,  # identities of rows are drawn anew
        references=("Rerun .rrd, rerun-sdk 0.41", "ISO 8855:2011"),
    )
