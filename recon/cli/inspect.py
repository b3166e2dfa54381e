"""`recon inspect`: what is in a log or in a result."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from recon.cli import _console as console
from recon.cli._columns import column_rows
from recon.cli._options import AsJson, Blocked, FirstPartyOnly, Settings, overrides_of, registry_of
from recon.cli._results import warning_lines

if TYPE_CHECKING:
    import pyarrow as pa

    from recon.api import Run
    from recon.registry import Registry

_NO_MAPPING: Final = ", but nothing in it looks like columns of times and measurements"
_HEAD: Final = 100
"""Bytes by which a seal is known."""
GAP: Final = 3.0
"""A step in time above this many times the median one is a gap."""


def inspect(
    paths: Annotated[
        list[Path], typer.Argument(metavar="PATH", help="A log, several of one drive, a result, or a sealed one.")
    ],
    settings: Settings = None,
    blocked: Blocked = None,
    first_party_only: FirstPartyOnly = False,
    as_json: AsJson = False,
) -> None:
    """Show what is in a log or in a result, or for a text that no reader knows, propose a mapping.

    Example: recon inspect drive.txt
    """
    from recon import api
    from recon.errors import UnknownFormat
    from recon.manifest import is_there
    from recon.pipeline import Pipeline

    registry = registry_of(blocked, first_party_only)
    if len(paths) == 1 and _is_sealed(paths[0]):
        _tell_sealed(paths[0], as_json=as_json)
        return
    if len(paths) == 1 and is_there(paths[0]):
        found = api.open(paths[0])
    else:
        reading = Pipeline.of("inspect", "reader.auto")
        try:
            found = api.execute(reading, paths, None, overrides_of(settings), registry=registry)
        except UnknownFormat as error:
            proposed = _proposed(paths, registry)
            if not proposed:
                raise UnknownFormat(error.path, error.what, hint=_without_proposal(error.hint)) from error
            if as_json:
                console.write_json({"paths": [str(path) for path in paths], "proposed": proposed})
            else:
                console.write("\n\n".join(proposed.values()))
            return
    told = _described(found, [str(path) for path in paths])
    if as_json:
        console.write_json(told)
    else:
        console.write(_as_text(told))


def _is_sealed(path: Path) -> bool:
    from recon import evidence

    try:
        with path.open("rb") as file:
            return evidence.is_seal(file.read(_HEAD))
    except (OSError, ValueError):  # whatever it is, no seal: a reader says what is wrong with it
        return False


def _tell_sealed(path: Path, *, as_json: bool) -> None:
    """What is in a seal, and what can be done with it. Raises Difference where a byte is not as it was sealed."""
    from recon import evidence

    with evidence.unsealed(path) as (sealed, inputs):
        told = _described(sealed, [str(path)])
        told["sealed"] = {"recon": sealed.manifest["recon"], "log": [log.name for log in inputs]}
        if as_json:
            console.write_json(told)
        else:
            console.write(_as_text(told))


def _proposed(paths: list[Path], registry: Registry) -> dict[str, str]:
    """What readers propose for files that no reader knows, by reader. Raises PluginError."""
    from recon.stages import Reader

    found = {}
    for key in registry.names(Reader.role):
        reader = registry.get(key)
        proposal = reader.propose(paths) if isinstance(reader, Reader) and reader.propose else None
        if proposal:
            found[key] = proposal
    return found


def _without_proposal(hint: str) -> str:
    """What readers say of a file, without that of a mapping that this command proposes: it was tried."""
    lines = [line.partition(": 'recon inspect ") for line in hint.split("\n")]
    return "\n".join(before + (_NO_MAPPING if promise else "") for before, promise, _ in lines)


def _described(found: Run, paths: list[str]) -> dict[str, Any]:
    """A recording as JSON data; a log's also holds `learnt`, what the reader found out and assumed."""
    told: dict[str, Any] = {"paths": paths}
    if found.folder is not None:
        told["pipeline"] = found.manifest["pipeline"]["name"]
    elif found.metrics is not None:
        told["learnt"] = found.metrics.to_pylist()
    shown = {name: table for name, table in found.recording.items() if name != "metrics" or found.folder}
    zero_ns = _beginning(shown)
    return {**told, "warnings": found.warnings, "streams": {name: _stream(shown[name], zero_ns) for name in shown}}


def _beginning(streams: Mapping[str, pa.Table]) -> int | None:
    """First time in ns of a log whose clock was never set, None of one that tells dates."""
    from recon.tables import meta, time_ns

    timed = [table for table in streams.values() if table.num_rows and "time" in table.column_names]
    if not any(meta(table).get("clock") == "relative" for table in timed):
        return None
    return min(int(time_ns(table).min()) for table in timed)


def _stream(table: pa.Table, zero_ns: int | None) -> dict[str, Any]:
    from recon.tables import meta, schema_of

    columns = [
        {
            "name": column.name,
            "type": str(column.type),
            "unit": column.unit,
            "frame": column.frame,
            "quantity": column.quantity,
            "nulls": table[column.name].null_count,
        }
        for column in schema_of(table).columns
    ]
    return {"rows": table.num_rows, **_times(table, zero_ns), "facts": meta(table), "columns": columns}


def _times(table: pa.Table, zero_ns: int | None) -> dict[str, Any]:
    """First and last time, s between them, Hz, gaps; rate and gaps only of streams whose time rises.

    Times are dates, or s since the beginning of the log, zero_ns, where its clock was never set.
    """
    import numpy as np

    from recon.numerics.signals import median_rate
    from recon.tables import time_ns

    if "time" not in table.column_names or not table.num_rows:
        return {}
    t_ns = time_ns(table)
    first, last = int(t_ns.min()), int(t_ns.max())
    told: dict[str, Any] = {"span_s": (last - first) * 1e-9}
    if zero_ns is None:
        told |= {"first": _iso(first), "last": _iso(last)}
    else:
        told |= {"first_s": (first - zero_ns) * 1e-9, "last_s": (last - zero_ns) * 1e-9}
    steps = np.diff(t_ns)
    if not len(steps) or steps.min() <= 0 or "kind" in table.column_names:
        return told
    gaps = steps[steps > GAP * np.median(steps)]
    told["rate_hz"] = median_rate(t_ns)
    told["gaps"] = {"count": len(gaps), "longest_s": float(gaps.max(initial=0) * 1e-9)}
    return told


def _iso(t_ns: int) -> str:
    import numpy as np

    return f"{np.datetime64(t_ns, 'ns')}Z"


def _as_text(told: dict[str, Any]) -> str:
    from recon.rows import WARNING

    lines = _head_lines(told)
    for name, stream in told["streams"].items():
        lines += ["", f"{name}: {_stream_line(stream)}"]
        lines += [f"  {key}: {_fact(value)}" for key, value in stream["facts"].items()]
        filled = [column for column in stream["columns"] if not stream["rows"] or column["nulls"] < stream["rows"]]
        lines.append(console.table(column_rows(filled)))
        empty = [column["name"] for column in stream["columns"] if column not in filled]
        if empty:
            lines.append(f"  without any value: {', '.join(empty)}")
    if told.get("learnt"):
        rows = dict.fromkeys(_learnt(row) for row in told["learnt"] if row["name"] != WARNING)
        lines += ["", "what the reader learnt and assumed", console.table([*rows])]
    return "\n".join([*lines, *[""] * bool(told["warnings"]), *warning_lines(told["warnings"])])


def _head_lines(told: dict[str, Any]) -> list[str]:
    """What it is; of a seal also what can be done with it."""
    head = ", ".join(told["paths"])
    if "sealed" not in told:
        return [f"{head}: result of pipeline '{told['pipeline']}'" if "pipeline" in told else head]
    of = ", ".join(told["sealed"]["log"]) or "a simulation"
    about = f"pipeline '{told['pipeline']}' over {of}, sealed with recon {told['sealed']['recon']}"
    uses = [
        (f"recon verify {head}", "runs it again and compares each number with what is sealed"),
        (f"recon explain {head} METRIC", "goes from a number back to the rows of the log"),
        (f"unzip {head}", "gives the log, the results as files, and a README that explains all"),
    ]
    return [f"{head}: {about}; every byte is as the list of hashes in it says", console.table(uses)]


def _fact(value: Any) -> str:
    """A fact of a stream in a line: numbers to 5 digits, latitudes to 1 mm, of a matrix its size; JSON has all."""
    from recon.rounding import rounded

    if isinstance(value, float):
        return rounded(value, digits=5)
    if isinstance(value, dict):
        return ", ".join(f"{key} {f'{one:.8f}' if key in ('lat', 'lon') else _fact(one)}" for key, one in value.items())
    if isinstance(value, list) and value and isinstance(value[0], list):
        return f"{len(value)} x {len(value[0])} numbers, which --json shows"
    return ", ".join(map(_fact, value)) if isinstance(value, list) else str(value)


def _stream_line(stream: dict[str, Any]) -> str:
    from recon.rounding import counted, milliseconds, rounded

    parts = [counted(stream["rows"], "row")]
    if "first" in stream:
        first, last = (milliseconds(stream[key]) for key in ("first", "last"))
        parts.append(f"{first} to {last[11:] if last[:10] == first[:10] else last} UTC ({stream['span_s']:.3f} s)")
    elif "first_s" in stream:
        parts.append(f"{stream['first_s']:.3f} s to {stream['last_s']:.3f} s since the log's beginning")
    if "rate_hz" in stream:
        gaps = stream["gaps"]
        longest = f", the longest {gaps['longest_s']:.3f} s" if gaps["count"] else ""
        parts += [
            f"{rounded(stream['rate_hz'])} Hz",
            f"{counted(gaps['count'], 'gap') if gaps['count'] else 'no gaps'}{longest}",
        ]
    return ", ".join(parts)


def _learnt(row: dict[str, Any]) -> tuple[str, ...]:
    from recon.learnt import legible
    from recon.rounding import rounded, with_unit

    row = legible(row)
    value = "" if row["value"] is None else with_unit(rounded(row["value"]), row["unit"])
    return ((row["name"] or "").replace("_", " "), value, row["method"] or "", row["note"] or "")
