"""Measurement files of ASAM (.mf4, .mdf, .dat), by asammdf. Which channel is what, the user's mapping tells.

    - use: reader.mf4
      params:
        channels:
          imu:
            axes: FLU
            accel: {columns: [AccX, AccY, AccZ], unit: m/s^2}
            gyro: {columns: [RateX, RateY, RateZ], unit: deg/s}
          wheel:
            speed: {column: VehicleSpeed, unit: km/h}

A channel whose name stands in several groups is named with the number of its group, "AccX@3". Each group keeps its own
raster: of a stream whose channels are of several groups, a row is null where only the others have one. Without a
mapping the channels are listed.

Times are those of a group's master channel, in s after the start of the measurement, which the file gives in ns. Where
it gives local time without a zone, `zone` tells it; without, the streams say that their time scale is local.

Reference: ASAM MDF 4.1, Measurement Data Format.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from traceback import walk_tb
from typing import Any, Final

import numpy as np

from recon.errors import NothingUsable, PluginError, ReadFailed
from recon.extras import needs
from recon.hookspecs import hookimpl
from recon.numerics.axes import turn
from recon.parameters import Params, setting
from recon.problems import did_you_mean
from recon.rows import Metric, metrics, warning
from recon.schema import STREAMS, Change, Schema, spread
from recon.stages import EVERYTHING, Reader, Schemas, Sniff, Wanted
from recon.tables import Array, Streams, with_meta
from recon.units import convert
from recon_readers._arrays import NS, interleave
from recon_readers._csv_mapping import Accel, Gnss, Vector
from recon_readers._mf4_channels import Channels, Stream
from recon_readers._sensing import described, doubts, plausible, rising
from recon_readers._time_order import Times

_MAGIC: Final = (b"MDF     ", b"UnFinMF ")
_LOCAL, _OFFSET_VALID = 1, 2
"""Flags of the start time: it is local time; its zone is told."""
_MOST_LISTED: Final = 40
_ZONE: Final = r"|[+-]\d\d:[0-5]\d"


class Mf4Params(Params):
    """What the file does not tell."""

    channels: Channels | None = setting(None, doc="Which channel is what, by stream; without it channels are listed.")
    zone: str = setting("", doc="Zone of a start that is local time, such as +01:00.", pattern=f"^({_ZONE})$")

    @property
    def zone_ns(self) -> int | None:
        """Local time minus UTC, ns; None where it is not told."""
        found = re.fullmatch(r"([+-])(\d\d):(\d\d)", self.zone)
        if not found:
            return None
        return int(f"{found[1]}1") * (60 * int(found[2]) + int(found[3])) * 60 * NS


def read(path: Path, params: Mf4Params, wanted: Wanted = EVERYTHING) -> Streams:
    """The streams of the mapping, each channel at the times of its group.

    Raises ReadFailed, NothingUsable without a mapping, PluginError where asammdf is not installed.
    """
    with needs("reader.mf4", "asammdf", extra="mf4"):
        from asammdf import MDF
    try:
        with path.open("rb") as opened, MDF(opened) as file:
            return _streams(path, file, params, wanted)
    except (OSError, ReadFailed, PluginError):
        raise
    except Exception as error:  # it raises what it likes at damaged bytes
        _disarm(error)
        what = f"asammdf cannot read it ({type(error).__name__})"
        raise ReadFailed(path, what, hint="check that it is whole: copy it again, or repair it") from error


def _disarm(error: Exception) -> None:
    """Mark what asammdf left half made as closed: its destructor would print a traceback."""
    for frame, _ in walk_tb(error.__traceback__):
        made: Any = frame.f_locals.get("self")
        if hasattr(made, "_closed"):
            made._closed = True
            if getattr(made, "_tempfile", None) is not None:
                made._tempfile.close()


def _streams(path: Path, file: Any, params: Mf4Params, wanted: Wanted) -> Streams:
    if params.channels is None:
        hint = "say which is what with --set reader.mf4.channels=@MAPPING.yaml; its channels are\n  "
        listed = "\n  ".join(_listed(file))
        raise NothingUsable(path, "what its channels mean only a mapping tells", hint=f"{hint}{listed}")
    start_ns, facts, learnt = _start(file, params)
    made = {}
    for mapping in params.channels.streams():
        groups = [group for group in mapping.sources if wanted.of(mapping.stream, _names(mapping, group))]
        if not groups:
            continue
        parts = {name: part for group in groups for name, part in _group(path, file, mapping, group, learnt).items()}
        kept = {name: _once(start_ns + t_ns, values, name, learnt) for name, (t_ns, values) in parts.items()}
        t_ns, columns = interleave(kept)
        columns, told = plausible(path, mapping.stream, columns)
        made[mapping.stream] = with_meta(described(mapping.stream, t_ns, columns), **facts, **_facts(mapping))
        learnt += told
    if not any(table.num_rows for table in made.values()):
        raise NothingUsable(path, "none of the channels that are wanted holds a row", hint="correct the mapping")
    return {**made, "metrics": metrics([*learnt, *doubts(made)])}


def _start(file: Any, params: Mf4Params) -> tuple[int, dict[str, str], list[Metric]]:
    """Start of the measurement, ns since 1970; facts of the clock."""
    start_ns = int(getattr(file.header, "abs_time", 0) or int(file.header.start_time.timestamp()) * NS)
    flags = int(getattr(file.header, "time_flags", _LOCAL))
    scale, learnt = "UTC", []
    if flags & _LOCAL and not flags & _OFFSET_VALID:
        zone = params.zone_ns
        if zone is None:
            scale = "local"
            text = "the start of the measurement is local time of a zone that the file does not tell"
            learnt.append(warning(f"{text}: give --set reader.mf4.zone=+01:00"))
        start_ns -= zone or 0
    facts = {"format": "MDF", "clock": "absolute" if start_ns > 0 else "relative", "time_scale": scale}
    return start_ns, facts, learnt


def _listed(file: Any) -> list[str]:
    """Groups with their rows and channels."""
    found = []
    for number, group in enumerate(file.groups):
        names = [f"{channel.name} [{getattr(channel, 'unit', '') or '-'}]" for channel in group.channels]
        more = f" and {len(names) - _MOST_LISTED} more" if len(names) > _MOST_LISTED else ""
        rows = group.channel_group.cycles_nr
        found.append(f"group {number}, {rows:,} rows: {', '.join(names[:_MOST_LISTED])}{more}")
    return found or ["none"]


def _names(mapping: Stream, group: str) -> tuple[str, ...]:
    return spread(group, STREAMS[mapping.stream].names)


def _group(path: Path, file: Any, mapping: Stream, group: str, learnt: list[Metric]) -> dict[str, tuple[Times, Array]]:
    """Times after the start, ns, and values in the stream's unit, by column."""
    source = mapping.sources[group]
    names = _names(mapping, group)
    unit = STREAMS[mapping.stream][names[0]].unit
    axes, signs = turn(mapping.axes_of(group)) if mapping.axes_of(group) else ((0, 1, 2), (1.0, 1.0, 1.0))
    if not isinstance(source, Vector):
        axes, signs = (0,), (1.0,)
    elif group.endswith("std"):
        signs = (1.0, 1.0, 1.0)
    down = isinstance(source, Accel) and source.at_rest == "down"
    found, told = {}, []
    for name, index, sign in zip(names, axes, signs, strict=True):
        t_ns, values, label = _channel(path, file, source.references[index])
        for number in source.invalid:
            values = np.where(values == number, np.nan, values)
        values = np.asarray(convert(values * source.scale, source.unit or unit or "1", unit or "1"))
        found[name] = t_ns, values * (-sign if down else sign)
        told.append(label)
    learnt.append(Metric(f"channel_{group}", method=mapping.stream, note=f"{', '.join(told)}, taken for {source.unit}"))
    return found


def _channel(path: Path, file: Any, reference: int | str) -> tuple[Times, Array, str]:
    """Times after the start, ns, numbers, and what the file says of a channel. Raises ReadFailed."""
    name, _, number = str(reference).rpartition("@") if re.search(r"@\d+$", str(reference)) else (reference, "", "")
    places = [place for place in file.whereis(str(name)) if not number or place[0] == int(number)]
    if not places:
        known = [channel.name for group in file.groups for channel in group.channels]
        hint = did_you_mean(str(name), known) or "without a mapping the channels are listed"
        raise ReadFailed(path, f"it has no channel '{reference}'", hint=hint)
    if len({group for group, _ in places}) > 1:
        groups = ", ".join(f"'{name}@{group}'" for group, _ in places)
        raise ReadFailed(path, f"several groups have a channel '{name}'", hint=f"write one of {groups}")
    signal = file.get(group=places[0][0], index=places[0][1])
    if signal.samples.dtype.kind not in "iufb" or signal.samples.ndim != 1:
        raise ReadFailed(path, f"the channel '{reference}' holds no single numbers", hint="choose another channel")
    values = signal.samples.astype(np.float64)
    seconds = np.asarray(signal.timestamps, dtype=np.float64)
    sane = np.isfinite(seconds) & (np.abs(seconds) < 1e8)
    t_ns = np.round(np.where(sane, seconds, 0.0) * NS).astype(np.int64)
    return t_ns[sane], values[sane], f"{name} [{signal.unit or '-'}] of group {places[0][0]}"


def _once(t_ns: Times, values: Array, name: str, learnt: list[Metric]) -> tuple[Times, Array]:
    rows, told = rising(t_ns, name)
    learnt += told
    return t_ns[rows], values[rows]


def _facts(mapping: Stream) -> dict[str, str]:
    facts = {"axes": mapping.axes_of("accel")} if "accel" in mapping.sources and mapping.axes_of("accel") else {}
    if isinstance(mapping, Gnss):
        if "height" in mapping.sources and mapping.height_datum:
            facts["height_datum"] = mapping.height_datum
        if "course" in mapping.sources:
            facts["heading_kind"] = "course_true" if mapping.north == "true" else "magnetic"
    return facts


def plan(inputs: Mapping[str, Schema], params: Mf4Params) -> Schemas:
    """The streams and columns of the mapping; all that there may be without one."""
    if params.channels is None:
        return {name: STREAMS[name].possible() for name in Channels.kinds}
    found = {}
    for mapping in params.channels.streams():
        schema = STREAMS[mapping.stream].only(*mapping.sources).possible()
        accel = mapping.sources.get("accel")
        if isinstance(accel, Accel) and accel.at_rest == "zero":
            schema = Change(quantities={"accel": "acceleration"}).apply(schema)
        found[mapping.stream] = schema
    return found


def sniff(path: Path, head: bytes) -> Sniff:
    """The first word of a file."""
    return Sniff(0.95, "measurement file of ASAM") if head.startswith(_MAGIC) else Sniff(0.0, "no MDF file")


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of measurement files."""
    yield Reader(
        name="mf4",
        summary="Measurement files MDF 3 and 4 of ASAM, by a mapping of their channels.",
        params=Mf4Params,
        run=read,
        sniff=sniff,
        selective=True,
        writes={name: STREAMS[name].possible() for name in Channels.kinds},
        plan=plan,
        references=("ASAM MDF 4.1, Measurement Data Format",),
    )
