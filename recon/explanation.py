"""From a number back to the log: which steps made it, of what, and which rows of which file it is about.

    told = explain(recon.open("drive-crash"), "delta_v_long_max")
    told.links[0].use, told.rows[0].file, told.rows[0].lines

The walk goes up the plan: from the step that gave the number to the steps that last wrote a stream that it reads, and
on to the reader. Rows of the log are those in the time of the events that the number is about, by the reader itself,
which reads the log again; its lines where the reader knows lines. A step may use rows outside of that time, as a
smoother uses the whole drive.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from recon import api
from recon import manifest as manifests
from recon.check import check
from recon.errors import DataError, ReconError
from recon.parameters import bind
from recon.pipeline import Pipeline
from recon.plan import Plan, PlannedStep
from recon.problems import Where, did_you_mean, shortened
from recon.recording import Recording
from recon.registry import Registry
from recon.rows import WARNING
from recon.schema import APPENDED
from recon.stages import Delegation, Exporter, Reader
from recon.tables import time_ns
from recon.yaml_nodes import Node

_LONGEST_LINE: Final = 120
_MOST_EVENTS: Final = 12
_TRIP: Final = re.compile(r"\btrip (\d+)")


@dataclass(frozen=True)
class Link:
    """A step on the way from the log to the number, the last one first.

    params : as YAML would hold them; reads and writes : rows by stream; learnt : its metrics
    """

    id: str
    use: str
    version: int
    distribution: str
    params: Mapping[str, Any]
    reads: tuple[str, ...]
    writes: Mapping[str, int]
    learnt: tuple[Mapping[str, Any], ...]


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


@dataclass(frozen=True)
class Explanation:
    """A number, the steps behind it, and the rows of the log that it is about; why rows are missing where they are."""

    step: str
    metric: Mapping[str, Any]
    links: tuple[Link, ...]
    rows: tuple[Rows, ...]
    inputs: tuple[Mapping[str, Any], ...]
    missing: str

    def as_data(self) -> dict[str, Any]:
        """As JSON holds it."""
        return asdict(self)


def explain(run: api.Run, metric: str, inputs: Sequence[Path] = (), *, registry: Registry | None = None) -> Explanation:
    """Walk from a number of a run back to the rows of its log.

    metric : its name, "STEP.NAME" where several steps have it, with its number behind where a step has several: "x 2"
    inputs : the log, where it is no longer where the run read it

    Raises DataError for a name that is not there, or stands for several numbers, ConfigError and PluginError where a
    stage of the run is not installed.
    """
    registry = registry or Registry.installed()
    row = _chosen(run, metric)
    plan, _ = check(Pipeline.from_text(run.manifest["pipeline"]["text"]), registry)
    chain = _chain(plan, run.manifest, row["step"])
    links = tuple(_link(step, run.manifest) for step in chain)
    rows: tuple[Rows, ...] = ()
    missing = ""
    try:
        rows = tuple(_rows(run, plan, chain, row, inputs, registry))
    except (ReconError, OSError) as error:
        missing = error.message if isinstance(error, ReconError) else str(error)
    return Explanation(row.pop("step"), row, links, rows, tuple(run.manifest["inputs"]), missing)


def _chosen(run: api.Run, wanted: str) -> dict[str, Any]:
    """The row of metrics of that name. Raises DataError."""
    rows = [row for row in (run.metrics.to_pylist() if run.metrics is not None else []) if row["name"] != WARNING]
    named: dict[str, list[dict[str, Any]]] = {}
    counts: dict[str, int] = {}
    for row in rows:
        full = f"{row['step']}.{row['name']}"
        counts[full] = counts.get(full, 0) + 1
        number = f" {counts[full]}" if counts[full] > 1 else ""
        named.setdefault(f"{full}{number}", []).append(row)
        named.setdefault(f"{row['name']}{number}", []).append(row)
    found = named.get(wanted, [])
    if not found:
        hint = (
            did_you_mean(wanted, named) or f"it has {shortened(', '.join(sorted({row['name'] for row in rows})), 400)}"
        )
        raise DataError(f"this run has no metric '{wanted}'", hint)
    if len(found) > 1:
        names = " or ".join(f"{row['step']}.{row['name']}" for row in found)
        raise DataError(f"{len(found)} steps have a metric '{wanted}'", f"write {names}")
    return found[0]


def _chain(plan: Plan, manifest: Mapping[str, Any], last: str) -> list[PlannedStep]:
    """The steps that a number rests on, from the one that gave it to the reader."""
    steps = [step for step in plan.steps if not isinstance(step.stage, Exporter)]
    wrote = {step["id"]: set(step["rows"]) for step in manifest["steps"]}
    ids = [step.id for step in steps]
    if last not in ids:
        raise DataError(f"the step '{last}' belongs to an earlier run, whose result this one read", "explain that run")
    needed: set[str] = set()
    chain: list[PlannedStep] = []
    for step in reversed(steps[: ids.index(last) + 1]):
        written = wrote.get(step.id, set())
        if chain and not (needed & written):
            continue
        needed -= {stream for stream in written if stream not in APPENDED}
        needed |= set(step.inputs.values())
        chain.append(step)
    return chain


def _link(step: PlannedStep, manifest: Mapping[str, Any]) -> Link:
    report: Mapping[str, Any] = next(
        (part for part in manifest["steps"] if part["id"] == step.id), {"rows": {}, "metrics": []}
    )
    resolved = step.resolved()
    params = step.params.as_text()
    if isinstance(step.params, Delegation):
        params = {r["method"]: r["note"] for r in report["metrics"] if r["name"] == "reader_parameters"}
    return Link(
        id=step.id,
        use=step.stage.key,
        version=step.stage.version,
        distribution=f"{resolved['distribution']} {resolved['distribution_version']}".strip(),
        params=params,
        reads=tuple(dict.fromkeys(step.inputs.values())),
        writes=dict(report["rows"]),
        learnt=tuple(row for row in report["metrics"] if row["name"] != WARNING),
    )


# --- rows of the log ------------------------------------------------------------------------------------------------


def _rows(
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
