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

from recon.arithmetic import one_thread
from recon.check import settled
from recon.errors import (
    ConfigError,
    ContractError,
    DataError,
    NothingToExport,
    ReadFailed,
    ReconError,
    StageError,
)
from recon.joining import combine
from recon.plan import Plan, PlannedStep
from recon.problems import Problem
from recon.recording import Recording
from recon.registry import Registry
from recon.rows import metrics, warnings_of
from recon.schema import APPENDED, METRICS, Schema, by_step, match, unnumbered
from recon.stages import EVERYTHING, Exporter, Reader, Simulator, Wanted
from recon.storage.json_text import readable
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
        returned = _checked(step, _call(step, recording))
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
        parts = [_kept(nothing, step, _checked(step, _call(step, nothing)))]
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
        returned = _guarded(step, lambda: step.stage.run(path=path, params=step.params, **extra))
    except OSError as error:
        raise ReadFailed(path, f"it cannot be read: {error.strerror or error}") from error
    recording = _kept(Recording({}), step, _checked(step, returned))
    return Recording(recording.streams, {"sources": [readable(path.name)]})


def _call(step: PlannedStep, recording: Recording) -> Streams:
    tables = _tables(step, recording)
    try:
        returned: Streams = _guarded(step, lambda: step.stage.run(**tables, params=step.params))
    except OSError as error:
        raise StageError(step.id, f"{type(error).__name__}: {error}") from error
    return returned


def _tables(step: PlannedStep, recording: Recording) -> dict[str, pa.Table | None]:
    """What a step reads, by port.

    Raises DataError where an earlier step left out what it might have given; for an exporter that is NothingToExport.
    """
    error = NothingToExport if isinstance(step.stage, Exporter) else DataError
    tables: dict[str, pa.Table | None] = {}
    for port, need in step.stage.reads.items():
        stream = step.step.inputs.get(port, port)
        tables[port] = table = recording.get(stream)
        if table is None and not need.optional:
            raise error(f"step {step.id}: {step.stage.key} reads '{stream}', which no step above gave")
        faults = match(need, schema_of(table), stream) if table is not None else []
        if faults:
            missing = all(fault.missing for fault in faults)
            raise (error if missing else DataError)(f"step {step.id}: {step.stage.key} reads {faults[0].text}")
    return tables


def call_exporter(step: PlannedStep, recording: Recording, folder: Path, about: object) -> list[Path]:
    """Let an exporter write into a folder.

    Raises NothingToExport where the recording lacks what it reads, ContractError where it names a file outside of it.
    """
    tables: dict[str, Any] = dict(_tables(step, recording))
    if isinstance(step.stage, Exporter) and step.stage.every_stream:
        tables["streams"] = dict(recording)
    returned = _guarded(step, lambda: step.stage.run(**tables, folder=folder, about=about, params=step.params))
    if not isinstance(returned, Sequence) or not all(isinstance(path, Path) for path in returned):
        raise ContractError(step.id, "it did not return a list of paths")
    files = list(returned)
    outside = [path for path in files if not path.resolve().is_relative_to(folder.resolve())]
    if outside:
        raise ContractError(step.id, f"it wrote {outside[0]}, which is outside of its folder")
    absent = [path for path in files if not path.is_file()]
    if absent:
        raise ContractError(step.id, f"it did not write {absent[0].name}, which it names")
    return files


def _guarded(step: PlannedStep, work: Callable[[], Any]) -> Any:
    """Whatever a stage raises becomes an error of ours that names the step; OSError passes. On one thread of BLAS."""
    try:
        with one_thread():
            return work()
    except ReadFailed:
        raise
    except ReconError as error:
        error.message = f"step {step.id}: {error.message}"
        raise
    except OSError:
        raise
    except MemoryError as error:
        raise StageError(step.id, "there is not enough memory") from error
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a stage is somebody else's code, and may even exit
        hint = f"this is a fault of {step.source or step.stage.key}; '-v' shows where"
        raise StageError(step.id, f"{type(error).__name__}: {error}", hint) from error


def _checked(step: PlannedStep, returned: Any) -> Streams:
    """What a step returned, by stream, stamped; raises ContractError where it is not what was planned."""
    if not isinstance(returned, Mapping) or not all(isinstance(t, pa.Table) for t in returned.values()):
        raise ContractError(step.id, "it did not return a mapping of stream names to Arrow tables")
    streams = {step.stream_of(port): table for port, table in returned.items()}
    if isinstance(step.stage, Reader) and step.stage.self_describing:
        return {name: conform(table, schema_of(table), stream=name, step=step.id) for name, table in streams.items()}
    planned = step.outputs
    for name in streams:
        if _planned_for(name, step) is None:
            raise ContractError(step.id, f"it returned the stream '{name}', which it does not declare")
    for name, schema in planned.items():
        if name not in streams and name not in APPENDED and not schema.uncertain:
            raise ContractError(step.id, f"it did not return the stream '{name}', which it declares")
    return {
        name: conform(table, _planned_for(name, step) or METRICS, stream=name, step=step.id)
        for name, table in streams.items()
    }


def _planned_for(name: str, step: PlannedStep) -> Schema | None:
    """The schema planned for a stream; a reader's `imu_2` is planned with its `imu`."""
    if name not in step.outputs and isinstance(step.stage, Reader):
        name = unnumbered(name)
    return step.outputs.get(name)


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
