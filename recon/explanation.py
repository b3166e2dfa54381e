"""From a number back to the log: which steps made it, of what, and which rows of which file it is about.

    told = explain(recon.open("drive-crash"), "delta_v_long_max")
    told.links[0].use, told.rows[0].file, told.rows[0].lines

The walk goes up the plan: from the step that gave the number to the steps that last wrote a stream that it reads, and
on to the reader. Rows of the log are those in the time of the events that the number is about (recon.log_rows). A step
may use rows outside of that time, as a smoother uses the whole drive.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import takewhile
from pathlib import Path
from typing import Any

from recon import api
from recon.check import check
from recon.errors import DataError, ReconError
from recon.log_rows import Rows, rows_behind
from recon.pipeline import Pipeline
from recon.plan import Plan, PlannedStep
from recon.problems import did_you_mean, shortened
from recon.registry import Registry
from recon.rows import WARNING
from recon.schema import APPENDED
from recon.stages import Delegation, Exporter


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
        rows = tuple(rows_behind(run, plan, chain, row, inputs, registry))
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
    above = takewhile(lambda part: part["id"] != step.id, manifest["steps"])
    there = {*APPENDED, *(stream for part in above for stream in part["rows"])}
    resolved = step.resolved()
    params = step.params.as_text()
    if isinstance(step.params, Delegation):
        params = {r["method"]: json.loads(r["note"]) for r in report["metrics"] if r["name"] == "reader_parameters"}
    return Link(
        id=step.id,
        use=step.stage.key,
        version=step.stage.version,
        distribution=f"{resolved['distribution']} {resolved['distribution_version']}".strip(),
        params=params,
        reads=tuple(dict.fromkeys(stream for stream in step.inputs.values() if stream in there)),
        writes=dict(report["rows"]),
        learnt=tuple(row for row in report["metrics"] if row["name"] != WARNING),
    )
