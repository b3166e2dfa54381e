"""recon for notebooks and programs: the same machinery as the command line.

run = recon.run("thesis", "drive.txt", out="result", **{"fuser.weighted_average.weight": 0.02})
run.trajectory.table, run.events, run.metrics, run.manifest
again = recon.open("result")
recon.evaluate(run, "rtk.csv").position["horizontal"]
log = recon.read("drive.txt")
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from os.path import realpath
from pathlib import Path
from typing import Any, TypeAlias

import pyarrow as pa

from recon import evaluation
from recon import manifest as manifests
from recon.calling import call_exporter
from recon.check import check, with_exports, with_span
from recon.drive_summary import summarize
from recon.errors import ConfigError, DataError, NothingToExport
from recon.numerics.evaluation import Alignment
from recon.overrides import Override
from recon.pipeline import Pipeline
from recon.plan import Plan, PlannedStep
from recon.problems import Problem, one_of
from recon.recording import Recording
from recon.registry import Registry
from recon.runner import Progress, Source, refuse_source, run_pipeline, silent
from recon.stages import Exporter
from recon.storage import STORES, read_recording, refuse_existing, staged_folder, write_recording
from recon.trajectory import Trajectory

Input: TypeAlias = str | Path | Sequence[str | Path] | Recording | None


@dataclass(frozen=True)
class Run:
    """A finished run. `folder` is where it is kept, None for one in memory only."""

    recording: Recording
    manifest: Mapping[str, Any]
    folder: Path | None = None

    @property
    def trajectory(self) -> Trajectory:
        """The trajectory, with sigmas of changes where the fuser tells them. Raises DataError where there is none."""
        if "trajectory" not in self.recording:
            raise DataError("this run has no trajectory", f"its streams are {', '.join(self.recording)}")
        return Trajectory(self.recording["trajectory"], self.recording.get("knots"), self.recording.get("frames"))

    @property
    def events(self) -> pa.Table | None:
        """What happened when; None where no step looked for events."""
        return self.recording.get("events")

    @property
    def metrics(self) -> pa.Table | None:
        """What the steps learnt."""
        return self.recording.get("metrics")

    @property
    def warnings(self) -> list[str]:
        """What the user should know before he believes the result."""
        return list(self.manifest.get("warnings", []))

    def summary(self) -> dict[str, float]:
        """distance m, duration s, top_speed m/s, their sigmas, stops, warnings; without what the run does not tell."""
        streams = self.recording
        found = summarize(streams.get("trajectory"), streams.get("gnss"), self.events, streams.get("knots"))
        return {**found, "warnings": len(self.warnings)}

    @property
    def _name(self) -> str:
        return str(self.manifest.get("pipeline", {}).get("name", "run"))

    def __repr__(self) -> str:
        facts = ", ".join(f"{key} {value:,.6g}" for key, value in self.summary().items())
        kept = f", folder {str(self.folder)!r}" if self.folder else ""
        return f"Run(pipeline {self._name!r}{kept}, {facts}, {self.recording!r})"

    def _repr_html_(self) -> str:
        facts = self.summary().items()
        cells = "".join(f"<tr><td>{escape(key)}</td><td>{value:,.6g}</td></tr>" for key, value in facts)
        return f"<b>{escape(self._name)}</b><table>{cells}</table>{self.recording._repr_html_()}"


def run(
    pipeline: str | Path | Pipeline,
    source: Input = None,
    out: str | Path | None = None,
    *,
    start: str | None = None,
    stop: str | None = None,
    exports: Iterable[str] = (),
    store: str | None = None,
    overwrite: bool = False,
    registry: Registry | None = None,
    progress: Progress = silent,
    **overrides: object,
) -> Run:
    """Run a pipeline.

    pipeline : a shipped name, a file, or a Pipeline
    source : file or folder, several of them for one drive, or a Recording; None where the first step simulates
    out : folder for the result; None keeps it in memory
    start, stop : the first and the last time that are taken of the source: "120 s" after its first row, or ISO 8601
    exports : names of exporters to run at the end; needs `out`
    store : "parquet" or "mcap"; by default what the pipeline says
    overrides : parameters by "STEP.NAME", quantities as text with a unit: **{"filter.moving_average.window": "50 ms"}

    Raises ConfigError, PluginError, DataError, StageError, StorageError.
    """
    registry = registry or Registry.installed()
    found = pipeline if isinstance(pipeline, Pipeline) else Pipeline.from_file(pipeline)
    chosen = [Override.from_data(target, value) for target, value in overrides.items()]
    return execute(
        with_span(found, start, stop), source, out, chosen, exports=exports, store=store, overwrite=overwrite,
        registry=registry, progress=progress,
    )  # fmt: skip


def execute(
    pipeline: Pipeline,
    source: Input,
    out: str | Path | None,
    overrides: Iterable[Override],
    *,
    registry: Registry,
    exports: Iterable[str] = (),
    store: str | None = None,
    overwrite: bool = False,
    progress: Progress = silent,
) -> Run:
    """As `run`, with everything already in the framework's own types."""
    inputs = _source(source)
    given = inputs.schemas() if isinstance(inputs, Recording) else None
    plan, problems = check(with_exports(pipeline, exports), registry, overrides, given=given)
    exporters = [step for step in plan.steps if isinstance(step.stage, Exporter)]
    if store not in (None, *STORES):
        problems.append(Problem(None, "unknown-store", f"there is no store '{store}'", f"use {one_of(STORES)}"))
    if exporters and out is None:
        text = f"{exporters[0].id} needs a folder to write to"
        problems.append(Problem(None, "no-folder", text, "name one with out="))
    if problems:
        raise ConfigError(problems)
    if out is None:
        started = datetime.now(UTC)
        outcome = run_pipeline(plan, inputs, registry, progress)
        return Run(outcome.recording, manifests.make(plan, _paths(inputs), outcome, started=started))
    folder = Path(out)
    refuse_source(plan, inputs)
    refuse_existing(folder, overwrite=overwrite)
    _refuse_own_input(folder, _paths(inputs))
    finished = _run_into(folder, plan, inputs, registry, store or pipeline.store, overwrite, progress)
    _export_all(finished, exporters)
    return finished


def _run_into(
    folder: Path, plan: Plan, inputs: Source, registry: Registry, store: str, overwrite: bool, progress: Progress
) -> Run:
    started = datetime.now(UTC)
    with staged_folder(folder, overwrite=overwrite) as scratch:  # first: a place that will not do is told at once
        outcome = run_pipeline(plan, inputs, registry, progress)
        written = write_recording(outcome.recording, scratch, store)
        outputs = manifests.describe_outputs(scratch, written)
        made = manifests.make(plan, _paths(inputs), outcome, store=store, outputs=outputs, started=started)
        manifests.write(made, scratch)
    return Run(outcome.recording, made, folder)


def _refuse_own_input(folder: Path, inputs: Sequence[Path]) -> None:
    """Raises ConfigError where the result would take the place of what it is made from."""
    for path in inputs:
        if Path(realpath(path)).is_relative_to(realpath(folder)):
            text = f"the input {path} lies in the output folder {folder}"
            raise ConfigError([Problem(None, "output-is-input", text, "choose another place")])


def open(folder: str | Path) -> Run:
    """A finished run from its folder. Raises ReadFailed."""
    path = Path(folder)
    manifest = manifests.read(path)
    return Run(read_recording(path), manifest, path)


def read(
    path: str | Path | Sequence[str | Path], *, registry: Registry | None = None, **overrides: object
) -> Recording:
    """A log as a recording, by the reader that knows it. Several files of one drive become one recording.

    overrides : parameters of readers by "reader.NAME.PARAMETER"
    """
    chosen = [Override.from_data(target, value) for target, value in overrides.items()]
    pipeline = Pipeline.of("read", "reader.auto")
    return execute(pipeline, path, None, chosen, registry=registry or Registry.installed()).recording


def evaluate(
    run: Run | str | Path,
    reference: Run | Recording | str | Path | None = None,
    *,
    align: Alignment = "none",
) -> evaluation.Evaluation:
    """Errors of a run's trajectory against a reference, and whether its sigmas are honest.

    run : a finished run, or its folder
    reference : what holds a stream `reference` or `trajectory`: another run, a recording, a log; by default the
        reference that the run itself holds

    Raises ReadFailed, DataError.
    """
    finished = run if isinstance(run, Run) else open(run)
    if reference is None and "reference" not in finished.recording:
        raise DataError("this run holds no reference", "name one: another run, or a log of the same drive")
    given = finished if reference is None else read(reference) if isinstance(reference, str | Path) else reference
    holder = given.recording if isinstance(given, Run) else given
    _, table = evaluation.reference_in(holder)
    return evaluation.evaluate(finished.trajectory.table, table, finished.events, align=align)


def export(
    finished: Run, names: Iterable[str], registry: Registry | None = None, overrides: Iterable[Override] = ()
) -> list[Path]:
    """Make exports from a finished run that is kept in a folder. Returns the files.

    overrides : parameters of the exporters
    """
    registry = registry or Registry.installed()
    empty = Pipeline("export", ())
    plan, problems = check(with_exports(empty, names), registry, overrides, given=finished.recording.schemas())
    if problems:
        raise ConfigError(problems)
    return _export_all(finished, plan.steps)


def _export_all(finished: Run, steps: Iterable[PlannedStep]) -> list[Path]:
    """The files of all exporters. One that finds nothing to show, as a map without a place, does not stop the others.

    Raises NothingToExport for the first such one when all are done, whose hint tells of the others; any other error at
    once.
    """
    files: list[Path] = []
    empty: list[NothingToExport] = []
    for step in steps:
        try:
            files += export_step(finished, step)
        except NothingToExport as error:
            empty.append(error)
    if empty:
        hints = (empty[0].hint, *(error.message for error in empty[1:]))
        raise NothingToExport(empty[0].message, "\n".join(filter(None, hints))) from empty[0]
    return files


def export_step(finished: Run, step: PlannedStep) -> list[Path]:
    """Run one exporter into DIR/exports/<name>; the folder appears when it is complete, with a manifest of its own."""
    if finished.folder is None:
        raise DataError(f"{step.id} needs a run that is kept in a folder")
    target = finished.folder / "exports" / step.stage.name
    about = manifests.RunInfo(finished.folder.name, finished.manifest)
    with staged_folder(target, overwrite=True) as scratch:
        written = call_exporter(step, finished.recording, scratch, about)
        manifests.write_export(step, scratch, written, about.name)
    return [target / path.relative_to(scratch) for path in written]


def _source(source: Input) -> Source:
    if source is None:
        return []
    if isinstance(source, Recording):
        return source
    if isinstance(source, pa.Table):
        raise DataError("a table is no recording", "give Recording({'imu': table})")
    return [Path(source)] if isinstance(source, str | Path) else [Path(part) for part in source]


def _paths(inputs: Source) -> Sequence[Path]:
    return [] if isinstance(inputs, Recording) else inputs
