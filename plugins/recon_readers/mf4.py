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

asammdf works in a process of its own, for some damaged files take it along.

Reference: ASAM MDF 4.1, Measurement Data Format.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from recon.declaration import Schemas
from recon.errors import NothingUsable
from recon.hookspecs import hookimpl
from recon.numerics.axes import turn
from recon.parameters import Params, setting
from recon.rows import Metric, metrics, warning
from recon.schema import STREAMS, Schema, spread
from recon.stages import EVERYTHING, Reader, Sniff, Wanted
from recon.tables import Array, Streams, with_meta
from recon.units import UnitError, convert, parse_unit
from recon.utc import zone_ns
from recon_readers._arrays import interleave
from recon_readers._csv_mapping import gnss_facts, schemas
from recon_readers._limits import MOST_FAULTY, possible
from recon_readers._mapping_parts import Accel, Vector
from recon_readers._mf4_channels import Channels, Stream
from recon_readers._sensing import doubts
from recon_readers._streams import described
from recon_readers._time_order import Times, rising

if TYPE_CHECKING:  # it starts processes, and what that needs takes its time
    from recon_readers._mf4_file import Measurement

_MAGIC: Final = (b"MDF     ", b"UnFinMF ")
_MOST_LISTED: Final = 40
_ZONE: Final = r"|[+-]\d\d:[0-5]\d"


class Mf4Params(Params):
    """What the file does not tell."""

    channels: Channels | None = setting(None, doc="Which channel is what, by stream; without it channels are listed.")
    zone: str = setting("", doc="Zone of a start that is local time, such as +01:00.", pattern=f"^({_ZONE})$")

    @property
    def zone_ns(self) -> int | None:
        """Local time minus UTC, ns; None where it is not told."""
        return zone_ns(self.zone) if self.zone else None


def read(path: Path, params: Mf4Params, wanted: Wanted = EVERYTHING) -> Streams:
    """The streams of the mapping, each channel at the times of its group.

    Raises ReadFailed, NothingUsable without a mapping, PluginError where asammdf is not installed.
    """
    mappings = list(params.channels.streams()) if params.channels is not None else []
    groups = {m.stream: [g for g in m.sources if wanted.of(m.stream, _names(m, g))] for m in mappings}
    references = {str(r): None for m in mappings for g in groups[m.stream] for r in m.sources[g].references}
    from recon_readers._mf4_file import measurement

    with measurement(path, list(references)) as file:
        if params.channels is None:
            hint = "say which is what with --set reader.mf4.channels=@MAPPING.yaml; its channels are\n  "
            listed = "\n  ".join(_listed(file))
            raise NothingUsable(path, "what its channels mean only a mapping tells", hint=f"{hint}{listed}")
        start_ns, facts, learnt = _start(file, params)
        made = {}
        for mapping in mappings:
            if not groups[mapping.stream]:
                continue
            parts = {
                n: part for group in groups[mapping.stream] for n, part in _group(file, mapping, group, learnt).items()
            }
            t_ns, columns = interleave(parts)
            for name, values in columns.items():
                columns[name], told = possible(path, mapping.stream, name, values, most=MOST_FAULTY)
                learnt += told
            table = described(STREAMS[mapping.stream], start_ns + t_ns, columns)
            made[mapping.stream] = with_meta(table, **facts, **_facts(mapping))
    if not any(table.num_rows for table in made.values()):
        raise NothingUsable(path, "none of the channels that are wanted holds a row", hint="correct the mapping")
    return {**made, "metrics": metrics([*learnt, *doubts(made)])}


def _start(file: Measurement, params: Mf4Params) -> tuple[int, dict[str, str], list[Metric]]:
    """Start of the measurement, ns since 1970; facts of the clock."""
    start_ns, scale, learnt = file.start_ns, "UTC", []
    if not file.closed:
        learnt.append(warning("the recorder did not close the file: what it holds is read as far as it goes"))
    if file.local:
        zone = params.zone_ns
        if zone is None:
            scale = "local"
            text = "the start of the measurement is local time of a zone that the file does not tell"
            learnt.append(warning(f"{text}: give --set reader.mf4.zone=+01:00"))
        start_ns -= zone or 0
    facts = {"format": "MDF", "clock": "absolute" if start_ns > 0 else "relative", "time_scale": scale}
    return start_ns, facts, learnt


def _listed(file: Measurement) -> list[str]:
    """Groups with their rows and channels."""
    found = []
    for number, (rows, channels) in enumerate(file.groups):
        names = [f"{name} [{unit}]" for name, unit in channels]
        more = f" and {len(names) - _MOST_LISTED} more" if len(names) > _MOST_LISTED else ""
        found.append(f"group {number}, {rows:,} rows: {', '.join(names[:_MOST_LISTED])}{more}")
    return found or ["none"]


def _names(mapping: Stream, group: str) -> tuple[str, ...]:
    return spread(group, STREAMS[mapping.stream].names)


def _group(file: Measurement, mapping: Stream, group: str, learnt: list[Metric]) -> dict[str, tuple[Times, Array]]:
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
    units: dict[str, str] = {}  # with the first channel of each
    for name, index, sign in zip(names, axes, signs, strict=True):
        signal = file.signal(str(source.references[index]))
        values = signal.values
        for number in source.invalid:
            values[values == number] = np.nan
        values = np.asarray(convert(values * source.scale, source.unit or unit or "1", unit or "1"))
        values *= -sign if down else sign
        rows, sorted_out = rising(signal.t_ns, name)
        learnt += sorted_out
        found[name] = signal.t_ns[rows], values[rows]
        told.append(signal.label)
        units.setdefault(signal.unit, signal.label)
    taken = source.unit or unit or "1"
    learnt.append(Metric(f"channel_{group}", method=mapping.stream, note=f"{', '.join(told)}, taken for {taken}"))
    if source.scale == 1.0:
        doubted = [label for given, label in units.items() if _is_other(given, taken)]
        learnt += [warning(f"{label}, where the mapping says {taken}: which of the two is right?") for label in doubted]
    return found


def _is_other(given: str, taken: str) -> bool:
    """Is it a unit that recon knows, and of another size than the one that it is taken for?"""
    try:
        known = parse_unit(given)
    except UnitError:
        return False
    other = parse_unit(taken)
    return known.dimension != other.dimension or not np.isclose(known.scale, other.scale, rtol=1e-6, atol=0.0)


def _facts(mapping: Stream) -> dict[str, str]:
    axes = mapping.axes_of("accel") if "accel" in mapping.sources else ""
    return {**({"axes": axes} if axes else {}), **gnss_facts(mapping, mapping.sources)}


def plan(inputs: Mapping[str, Schema], params: Mf4Params) -> Schemas:
    """The streams and columns of the mapping; all that there may be without one."""
    if params.channels is None:
        return {name: STREAMS[name].possible() for name in Channels.kinds}
    return schemas(params.channels.streams())


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
