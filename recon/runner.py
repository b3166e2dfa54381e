"""A run: the tables follow the plan from top to bottom.

After every step what it returned is checked against the plan and stamped with types, units, frames and quantities.
Rows of `events` and `metrics` are appended with the step's id; any other stream replaces the one of its name.
Exporters are left to the caller: they need a folder, and a result that is already safe.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import pyarrow as pa

from recon.calling import call, checked, guarded
from recon.check import settled
from recon.errors import (
    ConfigError,
    ContractError,
    DataError,
    ReadFailed,
)
from recon.joining import combine
from recon.plan import Plan, PlannedStep
from recon.problems import Problem
from recon.recording import Recording
from recon.registry import Registry
from recon.rows import metrics, warnings_of
from recon.schema import APPENDED, by_step
from recon.stages import EVERYTHING, Exporter, Reader, Simulator, Wanted
from recon.storage.json_text import name_of
from recon.tables import Streams, append, build, conform, schema_of

Source: TypeAlias = Recording | Sequence[Path]
Progress: TypeAlias = Callable[[int, int, str], None]
"""Called as (steps done, steps in all, id of the step that begins)."""


def silent(done: int, total: int, step: str) -> None:
    """Progress that nobody sees."""


@dataclass(frozen=True)
class StepReport:
    """What one step did: rows by stream that it returned, its metrics, how long it took."""

    id: str
    rows: Mapping[str, int]
    metrics: Sequence[Mapping[str, Any]]
    seconds: float


@dataclass(frozen=True)
class Outcome:
    """A finished run: the recording at its end and what each step did."""

    recording: Recording
    reports: Sequence[StepReport]
    warnings: Sequence[str] = field(default_factory=list)


def run_pipeline(plan: Plan, source: Source, registry: Registry, progress: Progress = silent) -> Outcome:
    """Run all steps of a plan but its exporters.

    source : the files to read, or a recording that takes the place of the first step

    Raises ReadFailed, DataError, StageError, ContractError.
    """
    steps = [step for step in plan.steps if not isinstance(step.stage, Exporter)]
    reports: list[StepReport] = []
    refuse_source(plan, source)
    if isinstance(source, Recording):
        recording = _as_given(source)
    else:
        first, *steps = steps
        progress(0, len(steps) + 1, first.id)
        started = time.perf_counter()
        read = {step.step.inputs.get(port, port) for step in steps for port in step.stage.reads}
        recording, returned = _from_source(first, source, registry, plan.wanted(), read)
        reports.append(_report(first, returned, started))
    plan, problems = settled(plan, registry, recording.schemas())
    _refuse(problems, recording)
    total = len(plan.steps) + len(reports)
    for step in plan.steps:
        progress(len(reports), total, step.id)
        started = time.perf_counter()
        returned = call(step, recording)
        recording = _kept(recording, step, returned)
        reports.append(_report(step, returned, started))
    progress(total, total, "")
    return Outcome(recording, reports, warnings_of(recording.get("metrics")))


def refuse_source(plan: Plan, source: Source) -> None:
    """Raises DataError where the first step reads a file and is given none, or makes its data and is given one."""
    first = plan.steps[0] if plan.steps else None
    if isinstance(source, Recording) or first is None:
        return
    if isinstance(first.stage, Simulator) and source:
        raise DataError(f"step {first.id} makes its own data and reads no file", "leave the input away")
    if isinstance(first.stage, Reader) and not source:
        raise DataError(f"step {first.id} has no file to read", "name at least one input")


def _as_given(recording: Recording) -> Recording:
    """The recording, its streams checked. Raises DataError where time does not rise."""
    try:
        checked = {name: conform(t, schema_of(t), stream=name, step="given") for name, t in recording.items()}
    except ContractError as error:
        raise DataError(error.message.replace("step given: ", "the recording: ")) from error
    return Recording(checked, recording.meta)


def _from_source(
    step: PlannedStep, source: Sequence[Path], registry: Registry, wanted: Wanted, read: Collection[str]
) -> tuple[Recording, Streams]:
    if isinstance(step.stage, Simulator):
        nothing = Recording({})
        parts = [_kept(nothing, step, call(step, nothing))]
    else:
        parts = [read_one(step, path, registry, wanted) for path in source]
    recording, learnt = combine(parts, read)
    if learnt:
        rows = _marked(metrics(learnt), "metrics", step.id)
        recording = recording.updated({"metrics": append(recording.get("metrics"), rows)})
    if not any(table.num_rows for name, table in recording.items() if name not in APPENDED):
        raise DataError(f"{_names(source)} holds no rows", "is it the right file?")
    return recording, dict(recording)


def read_one(step: PlannedStep, path: Path, registry: Registry, wanted: Wanted = EVERYTHING) -> Recording:
    """The streams of one file or folder, checked and stamped. Raises ReadFailed, DataError, StageError."""
    try:
        there = path.exists()
    except OSError as error:  # such as a name that is too long
        raise ReadFailed(path, f"it cannot be read: {error.strerror or error}") from error
    if not there:
        raise ReadFailed(path, "there is no such file or folder")
    if not (path.is_file() or path.is_dir()):
        raise ReadFailed(path, "this is a device or a pipe", hint="save what it gives to a file first")
    extra: dict[str, Any] = {}
    if isinstance(step.stage, Reader):
        extra |= {"registry": registry} if step.stage.delegates else {}
        extra |= {"wanted": wanted} if step.stage.selective else {}
    try:
        returned = guarded(step, lambda: step.stage.run(path=path, params=step.params, **extra))
    except OSError as error:
        raise ReadFailed(path, f"it cannot be read: {error.strerror or error}") from error
    recording = _kept(Recording({}), step, checked(step, returned))
    return Recording(recording.streams, {"sources": [name_of(path)]})


def _kept(recording: Recording, step: PlannedStep, returned: Streams) -> Recording:
    """The recording after a step. Rows of `events` and `metrics` take the place of those of an earlier run's step."""
    import pyarrow.compute as pc  # slow import: only when used

    updates = {}
    for name, table in returned.items():
        if name in APPENDED:
            before = recording.get(name)
            if before is not None and "step" in before.column_names:
                own = pc.equal(before["step"], step.id)
                if pc.any(own).as_py():
                    before = before.filter(pc.invert(pc.fill_null(own, False)))
            updates[name] = append(before, _marked(table, name, step.id))
        else:
            updates[name] = table
    return recording.updated(updates)


def _marked(table: pa.Table, stream: str, step: str) -> pa.Table:
    """The rows with their step: those of an earlier run, read from its files, keep theirs."""
    steps = table["step"] if "step" in table.column_names else pa.nulls(table.num_rows, pa.string())
    columns = {name: table[name] for name in table.column_names if name != "step"}
    return build(by_step(stream), step=steps.fill_null(step), **columns)


def _report(step: PlannedStep, returned: Streams, started: float) -> StepReport:
    learnt = returned["metrics"].to_pylist() if "metrics" in returned else []
    rows = {name: table.num_rows for name, table in returned.items() if name != "metrics"}
    known = [{key: value for key, value in row.items() if _tells(value)} for row in learnt]
    return StepReport(step.id, rows, known, time.perf_counter() - started)


def _tells(value: object) -> bool:
    """Is there something to keep, in a form that JSON knows?"""
    return value not in (None, "") and not (isinstance(value, float) and not math.isfinite(value))


def _refuse(problems: Sequence[Problem], recording: Recording) -> None:
    """What only the file could settle: raises a DataError that names the sensor and the step."""
    if not problems:
        return
    if any(problem.code not in ("missing-input", "wrong-input") for problem in problems):
        raise ConfigError(problems)
    sources = ", ".join(recording.meta.get("sources", [])) or "the recording"
    text = f"{sources} does not hold what the pipeline needs: {problems[0].text}"
    needs = {_need(problem): problem for problem in reversed(problems)}
    further = [problem.text for problem in problems[1:] if needs[_need(problem)] is problem]
    if "'imu'" in needs and "gnss" in recording:
        further.append("it holds GNSS without an IMU, of which the pipeline gnss makes a track: recon run gnss LOG")
    raise DataError(text, "\n  ".join([*further, "'recon inspect' shows what is in it"]))


def _need(problem: Problem) -> str:
    """What is missing, whichever step reads it."""
    return problem.text.partition(" reads ")[2].partition(";")[0]


def _names(paths: Source) -> str:
    return ", ".join(str(path) for path in paths) if not isinstance(paths, Recording) else "the recording"
