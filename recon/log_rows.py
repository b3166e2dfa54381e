"""Rows of the log that a number of a run is about, in the time of its events, and the lines that hold them.

They are found by the reader itself, which reads the log again; its lines where the reader knows lines.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from recon import api
from recon import manifest as manifests
from recon.errors import DataError
from recon.parameters import bind
from recon.pipeline import Pipeline
from recon.plan import Plan, PlannedStep
from recon.problems import Where, shortened
from recon.recording import Recording
from recon.registry import Registry
from recon.schema import APPENDED
from recon.stages import Delegation, Reader
from recon.tables import time_ns
from recon.yaml_nodes import Node

_LONGEST_LINE: Final = 120
_MOST_EVENTS: Final = 12
_TRIP: Final = re.compile(r"\btrip (\d+)")


@dataclass(frozen=True)
class Rows:
    """Rows of the log in one stretch of time.

    about : the event; rows : first and last of the stream as the reader gives it, from 1; lines : of the file, from 1,
    None where the reader knows none; texts : those lines
    """

    about: str
    start: str
    end: str
    stream: str
    file: str
    rows: tuple[int, int]
    of: int
    lines: tuple[int, int] | None
    texts: tuple[str, ...]


def rows_behind(
    run: api.Run,
    plan: Plan,
    chain: Sequence[PlannedStep],
    row: Mapping[str, Any],
    inputs: Sequence[Path],
    registry: Registry,
) -> Iterator[Rows]:
    """Rows of each input in the time of each event that the number is about. Raises DataError without the log."""
    source = chain[-1]
    if not isinstance(source.stage, Reader):
        raise DataError(f"the data were made by {source.id}: there is no log")
    needed = {stream for step in chain for stream in step.inputs.values()}
    paths = _same_log(run.manifest, inputs)
    reading = Pipeline(plan.pipeline.name, (source.step,))
    for path in paths:
        read = api.execute(reading, path, None, [], registry=registry).recording
        for about, start, end in _times(run, row, read):
            for stream in (name for name in read if name in needed and name not in APPENDED):
                found = _stretch(read, stream, about, (start, end), path, source, registry)
                if found is not None:
                    yield found


def _same_log(manifest: Mapping[str, Any], inputs: Sequence[Path]) -> list[Path]:
    """The files that the run read. Raises DataError where they are gone or have changed."""
    paths = [Path(path) for path in inputs or manifest["environment"].get("inputs", ())]
    told = manifest["inputs"]
    if len(paths) != len(told):
        raise DataError("the log is not known", "name it with --input")
    for entry, path in zip(told, paths, strict=True):
        if not path.exists() or manifests.describe_input(path) | {"name": entry["name"]} != entry:
            raise DataError(f"{path} is no longer there, or not what the run read", "name the log with --input")
    return paths


def _times(run: api.Run, row: Mapping[str, Any], read: Recording) -> Iterator[tuple[str, int, int]]:
    """What the number is about, in ns since 1970: the events that its step or its name tells, else the whole log."""
    found = []
    if run.events is not None:
        starts, ends = time_ns(run.events), time_ns(run.events, "end_time")
        kinds = run.events["kind"].to_pylist()
        told = f"{row['step']} {row['name']} {row.get('note') or ''}"
        chosen = [index for index, kind in enumerate(kinds) if kind and kind in told]
        chosen = _narrowed(run.events, chosen, row)
        found = [(kinds[index], int(starts[index]), int(ends[index])) for index in chosen]
    if found:
        yield from found[:_MOST_EVENTS]
    elif span := read.span_ns():
        yield "the whole log", *span


def _narrowed(events: pa.Table, chosen: list[int], row: Mapping[str, Any]) -> list[int]:
    """Of several trips the one that the note tells; of several crashes the severest by what the step itself found."""
    kinds = events["kind"].to_pylist()
    trip = _TRIP.search(row.get("note") or "")
    if trip:
        trips = [index for index in chosen if kinds[index] == "trip"]
        return trips[int(trip[1]) - 1 : int(trip[1])] or chosen
    starts, steps, sizes = time_ns(events), events["step"].to_pylist(), events["value"].to_pylist()
    own = [index for index, step in enumerate(steps) if step == row["step"] and sizes[index] is not None]
    here = [index for index in chosen if steps[index] != row["step"] and own]
    if not here:
        return chosen
    severest = max(own, key=lambda index: sizes[index])
    return [index for index in here if starts[index] == starts[severest]] or chosen


def _stretch(
    read: Recording,
    stream: str,
    about: str,
    span: tuple[int, int],
    path: Path,
    source: PlannedStep,
    registry: Registry,
) -> Rows | None:
    t_ns = time_ns(read[stream])
    first, behind = (int(i) for i in (np.searchsorted(t_ns, span[0]), np.searchsorted(t_ns, span[1], "right")))
    if first == behind:
        return None
    ends = t_ns[[first, behind - 1]]
    lines = _lines(read, stream, ends, path, source, registry)
    return Rows(
        about=about,
        start=f"{np.datetime64(span[0], 'ns')}Z",
        end=f"{np.datetime64(span[1], 'ns')}Z",
        stream=stream,
        file=path.name,
        rows=(first + 1, behind),
        of=len(t_ns),
        lines=lines,
        texts=tuple(_texts(path, lines)) if lines else (),
    )


def _lines(
    read: Recording, stream: str, t_ns: Any, path: Path, source: PlannedStep, registry: Registry
) -> tuple[int, int] | None:
    """Lines of the file that hold rows of these two times; None where the reader does not tell."""
    stage, params = source.stage, source.params
    if isinstance(params, Delegation):
        rows = read["metrics"].to_pylist() if "metrics" in read else []
        key = next((str(row["method"]) for row in rows if row["name"] == "reader"), "")
        if key not in registry:
            return None
        stage = registry.get(key)
        bound, _ = bind(stage.params, Node.of(params.readers.get(key, {}), Where(key)), key)
        if bound is None:
            return None
        params = bound
    if not isinstance(stage, Reader) or stage.lines is None:
        return None
    found = [int(line) for line in stage.lines(path, params, stream, t_ns)]
    return (found[0], found[1]) if all(found) else None


def _texts(path: Path, lines: tuple[int, int]) -> Iterator[str]:
    """The first and the last line, as far as they can be shown."""
    wanted = sorted(set(lines))
    text = path.read_bytes().replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"\0" in text:
        return
    parts = text.split(b"\n")
    for number in wanted:
        yield shortened(" ".join(parts[number - 1].decode(errors="replace").split()), _LONGEST_LINE)
