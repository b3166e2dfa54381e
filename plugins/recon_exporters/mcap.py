"""Everything in one MCAP file for viewers: Foxglove, Lichtblick, Rerun open it as it is; and a layout for Foxglove.

    /tf                        FrameTransform   where `vehicle` is in `local`; /reference/tf, where `reference` is
    /trajectory/pose           PoseInFrame      the same as a pose; also /reference/pose
    /trajectory/odometry       Odometry         with velocity and angular rate, in the frame vehicle
    /trajectory/fix            LocationFix      for maps, with the sigmas of the position; also /reference/fix
    /gnss/fix                  LocationFix      raw GNSS, each receiver on its own
    /scene                     SceneUpdate      a box for the car, its way, the fixes; the same of the reference
    /trajectory/place          LocationFix      ten in a second of the same, for a map that holds them all
    /trajectory/way            GeoJSON          the way as lines for maps; also /reference/way
    /trajectory/motion         JSON             speed, accelerations, attitude, ..., with bands of two sigma, for plots
    /events/states             JSON             what lasts, for lanes
    /events/spans, /log        Event, Log       what happened; warnings at the start
    /imu, /trajectory, ...     JSON             every stream with all columns that hold no lists, units in the schema

    attachment manifest.json   what made the run, without its block `environment`
    metadata recon.units       the unit of each column
    metadata recon.clock       later_s, where a clock of no date began before its zero, as that of a crash test does: so
                               many s later all times are here, as MCAP knows none before 1970

`vehicle` is x forward, y left, z up; `local` is East, North, Up about the anchor of the trajectory. Streams with
another anchor are brought there by latitude, longitude and height; without these they are not in space. A further
trajectory (trajectory_2) is written as the reference is. Altitudes are as in the stream, above the height_datum that
the channel's metadata name.

References
    MCAP specification, version 0 (mcap.dev/spec); Foxglove message schemas, docs.foxglove.dev.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import compute

from recon import __version__
from recon.crash_summary import severest_impact
from recon.errors import DataError
from recon.hookspecs import hookimpl
from recon.manifest import RunInfo
from recon.parameters import NoParams
from recon.placing import about_anchor, anchor_of
from recon.recording import Recording
from recon.schema import unnumbered
from recon.stages import Exporter
from recon.storage.json_text import to_json
from recon.tables import Array, meta, replace, schema_of, select_rows, time_ns
from recon_exporters._mcap_file import Attachment, Channel, write_file
from recon_exporters._mcap_foxglove import (
    event_channel,
    frame_of,
    location_channel,
    log_channel,
    place_channel,
    pose_channels,
    way_channel,
)
from recon_exporters._mcap_json import json_channel
from recon_exporters._mcap_layout import layout
from recon_exporters._mcap_plots import motion_channels, state_channel
from recon_exporters._mcap_scene import scene_channel
from recon_exporters._mcap_tabs import Shown
from recon_exporters._panels import panels_of, sources_of
from recon_exporters._viewers import lanes


def mcap(*, streams: Mapping[str, pa.Table], folder: Path, about: RunInfo, params: NoParams) -> list[Path]:
    """Write `folder/recording.mcap` and `folder/foxglove_layout.json`; their paths.

    Raises DataError for dates before 1970, which MCAP does not know.
    """
    held, later_s = _after_1970(streams)
    span = Recording(held).span_ns() or (0, 0)
    ordered = {name: _in_order(table) for name, table in held.items()}
    manifest = {key: value for key, value in about.manifest.items() if key != "environment"}
    path, layout_path = folder / "recording.mcap", folder / "foxglove_layout.json"
    channels, shown = _for_viewers(ordered, about, span)
    channels += [json_channel(name, table, span[0]) for name, table in ordered.items()]
    write_file(
        path,
        channels,
        library=f"recon {__version__}",
        metadata={"recon.units": _units(streams), **({"recon.clock": {"later_s": f"{later_s}"}} if later_s else {})},
        attachments=[Attachment("manifest.json", "application/json", to_json(manifest, indent=1).encode())],
    )
    layout_path.write_bytes(f"{to_json(layout(shown), indent=1)}\n".encode())
    return [path, layout_path]


def _after_1970(streams: Mapping[str, pa.Table]) -> tuple[Mapping[str, pa.Table], int]:
    """The streams, and how many s later they are here: times of no date that begin before their zero are moved on."""
    first_ns, _ = Recording(streams).span_ns() or (0, 0)
    if first_ns >= 0:
        return streams, 0
    if not any(meta(table).get("clock") == "relative" for table in streams.values()):
        raise DataError("there are times before 1970, which MCAP cannot hold", "set the clock where the log is read")
    later_s = -(first_ns // 1_000_000_000)
    later = pa.scalar(later_s * 1_000_000_000, pa.duration("ns"))
    return {name: _moved(table, later) for name, table in streams.items()}, later_s


def _moved(table: pa.Table, later: pa.Scalar) -> pa.Table:
    """A table whose times, in every column, are later."""
    columns = [field.name for field in table.schema if pa.types.is_timestamp(field.type)]
    return replace(table, **{name: compute.add(table[name], later) for name in columns})


def _in_order(table: pa.Table) -> pa.Table:
    """The table with times that rise, as those of events, which several steps wrote, may not."""
    if "time" not in table.column_names:
        return table
    t_ns = time_ns(table)
    rises = not (t_ns[1:] < t_ns[:-1]).any()
    return table if rises else select_rows(table, np.argsort(t_ns, kind="stable"))


def _for_viewers(
    streams: Mapping[str, pa.Table], about: RunInfo, span_ns: tuple[int, int]
) -> tuple[list[Channel], Shown]:
    """The channels beside those of the streams, and what a layout may show."""
    sources, panels, events = sources_of(streams), panels_of(streams), streams.get("events")
    fixes = {name: table for name, table in streams.items() if unnumbered(name) == "gnss"}
    places = _places({**{source.stream: source.table for source in sources}, **fixes})
    spells, impact_ns = lanes(events, span_ns), severest_impact(events)
    found: list[Channel | None] = []
    for source in sources:
        found += [location_channel(f"/{source.stream}/fix", source.table, frame_of(source.stream))]
        found += [place_channel(f"/{source.stream}/place", source.table, frame_of(source.stream))]
        found += [way_channel(f"/{source.stream}/way", source.name, source.table)]
        found += pose_channels(source.stream, source.table, places[source.stream])
    found += [location_channel(f"/{name}/fix", table, name) for name, table in fixes.items()]
    found += motion_channels(panels, sources, impact_ns)
    found.append(scene_channel(sources, fixes, places))
    found.append(state_channel(spells, span_ns[0]))
    if events is not None:
        found.append(event_channel(events))
    found.append(log_channel(about.warnings, events, span_ns[0]))
    channels = [channel for channel in found if channel is not None]
    topics = frozenset(channel.topic for channel in channels if len(channel.t_ns))
    return channels, Shown(topics, streams, sources, panels, places, list(spells), span_ns[0], impact_ns)


def _places(tables: Mapping[str, pa.Table]) -> dict[str, Array]:
    """Where the rows of each stream are about the anchor of the first one: (n, 3) m, NaN where that is not known."""
    first = next(iter(tables.values()), None)
    datum = "" if first is None else str(meta(first).get("height_datum", ""))
    return {name: about_anchor(table, anchor_of(first), datum) for name, table in tables.items()}


def _units(streams: Mapping[str, pa.Table]) -> dict[str, str]:
    """The unit of each column that has one, by "stream.column"."""
    columns = [(name, column) for name, table in streams.items() for column in schema_of(table).columns]
    return {f"{name}.{column.name}": column.unit for name, column in columns if column.unit}


@hookimpl
def declare_exporters() -> Iterable[Exporter]:
    """The exporter of MCAP files for viewers."""
    yield Exporter(
        name="mcap",
        summary="Everything in one MCAP file that Foxglove, Lichtblick and Rerun show as it is.",
        run=mcap,
        every_stream=True,
        references=("MCAP specification, mcap.dev/spec", "Foxglove message schemas, docs.foxglove.dev"),
    )
