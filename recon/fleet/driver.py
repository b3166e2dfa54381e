"""A batch from its file to its results: which drives are done, the jobs of the others, their outcomes.

What is done is read off the results alone, so that a batch which was ended in any way goes on where it was.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, TypeAlias

import recon
from recon.batch import BatchFile, parse
from recon.batch_plan import plan_batch
from recon.errors import ConfigError, StorageError
from recon.fleet.compacted import Index, failed_before, read_index
from recon.fleet.compaction import Failure, compact
from recon.fleet.drive_job import DriveJob, is_made_of, made_how, made_of
from recon.fleet.flight import Ended, Flight
from recon.fleet.inputs import Drive, Drives, find
from recon.fleet.places import Place, Stamp, fetch
from recon.fleet.root import Root, root_of
from recon.jobs import DIED, FAULT, OUT_OF_MEMORY, TIMED_OUT, Outcome
from recon.manifest import describe_input, digest
from recon.parameters import Params, bind
from recon.pipeline import Pipeline
from recon.problems import Problem
from recon.registry import Registry
from recon.stages import Executor
from recon.storage.json_text import to_json
from recon.yaml_nodes import load_file

DEFAULT_EXECUTOR: Final = "executor.local"
LOST: Final = (DIED, TIMED_OUT, OUT_OF_MEMORY, FAULT)
"""Reasons that others told of a job, which may have put its result to its place before."""
NOT_WRITTEN: Final = "not_written"
AGAIN: Final = (*LOST, "input_changed", NOT_WRITTEN)
"""Reasons that may not be there another time: `retries` is for these. A log that cannot be read stays so."""

MOST_UNWRITTEN: Final = 20
"""Drives that could not be written, one behind the other: none can, and a fleet would be worked through in vain."""
LOOKERS: Final = 16
"""Threads that read manifests from a store, for which they mostly wait; from a disk this one is as fast as many."""
AT_ONCE: Final = 1024
"""Drives whose manifests are asked for together."""


@dataclass(frozen=True)
class Fleet:
    """A batch that may be run.

    plans : resolved steps by vehicle, as manifests hold them; "" for vehicles that the batch file does not name
    """

    batch: BatchFile
    pipeline: Pipeline
    plans: Mapping[str, Sequence[Mapping[str, Any]]]
    executor: Executor
    executor_params: Params
    drives: Drives
    root: Root

    @cached_property
    def made_how(self) -> Mapping[str, str]:
        """Hash of how results are made, by vehicle as `plans`."""
        return {vehicle: made_how(plan, recon.__version__, self.pipeline.store) for vehicle, plan in self.plans.items()}

    def mark(self, drive: Drive, stamped: Stamp) -> str:
        """The hash of all that the result of a drive depends on."""
        how = self.made_how.get(drive.vehicle) or self.made_how[""]
        return made_of(str(drive.place), stamped, how)

    def job(self, drive: Drive) -> DriveJob:
        """The work that a drive is."""
        return DriveJob(
            key=drive.key,
            vehicle=drive.vehicle,
            drive=drive.drive,
            source=drive.place,
            output=self.root.place,
            pipeline=self.pipeline,
            overrides=(*self.batch.defaults, *self.batch.vehicles.get(drive.vehicle, ())),
            exports=self.batch.exports,
            timeout=self.batch.timeout,
            memory=self.batch.memory,
        )


@dataclass(frozen=True)
class State:
    """How far a batch is, told after each outcome.

    total : drives to be done; ended : those of them that are, failed ones included; running : those in work
    kept : drives that were done before
    outcome : the last one, None at the beginning
    """

    total: int
    kept: int
    ended: int = 0
    failed: int = 0
    running: int = 0
    outcome: Outcome | None = None


Told: TypeAlias = Callable[[State], None]


@dataclass(frozen=True)
class Report:
    """What became of a batch.

    superseded : older results of drives that failed, which were moved out of the dataset
    unwritten : why the files of the whole fleet do not tell all this; None where they do
    """

    done: int
    kept: int
    failures: Sequence[Failure] = field(default_factory=list)
    stopped: bool = False
    superseded: int = 0
    unwritten: StorageError | None = None


def load(file: Path, registry: Registry, executor: str = "") -> Fleet:
    """A batch file, checked as a whole, and the drives that it names.

    executor : the one to use in place of the file's
    Raises ConfigError with every problem, PluginError where a stage that is named cannot be used.
    """
    batch, problems = parse(load_file(file))
    if problems:
        raise ConfigError(problems)
    planned = plan_batch(batch, registry)
    if planned.problems or planned.pipeline is None:
        raise ConfigError(planned.problems)
    stage, params = _executor(batch, executor, registry)
    plans = {vehicle: json.loads(to_json(plan.resolved())) for vehicle, plan in planned.plans.items()}
    root = root_of(Place.of(batch.output, batch.folder))
    return Fleet(batch, planned.pipeline, plans, stage, params, find(batch), root)


def _executor(batch: BatchFile, asked: str, registry: Registry) -> tuple[Executor, Params]:
    """The executor and its parameters: those of the file are for the one that the file names."""
    key = asked or batch.executor or DEFAULT_EXECUTOR
    key = key if "." in key else f"{Executor.role}.{key}"
    stage = registry.get(key)
    if not isinstance(stage, Executor):
        raise ConfigError([Problem(None, "misplaced-step", f"{key} runs no jobs", "name an executor")])
    if key != batch.executor:
        return stage, stage.params()
    params, problems = bind(stage.params, batch.executor_params, key)
    if params is None:
        raise ConfigError(problems)
    return stage, params


def remaining(fleet: Fleet, drives: Drives, index: Index, *, verify: bool = False) -> Drives:
    """The drives that are to be done.

    index : of the files that tell of results; verify : hold what is there to the hashes in its manifest too
    """
    if not fleet.batch.resume:
        return drives
    mask: list[bool] = []
    source = iter(drives)
    with ThreadPoolExecutor(LOOKERS) as pool:
        at_once = map if fleet.root.place.is_local else pool.map
        while chunk := list(islice(source, AT_ONCE)):
            mask += at_once(lambda one: not _is_done(fleet, one, index, verify=verify), chunk)
    return drives.where(mask)


def _is_done(fleet: Fleet, drive: Drive, index: Index, *, verify: bool) -> bool:
    """Is the result of a drive there, and what would be made?"""
    key = drive.key
    seen = fleet.root.stamp(key)
    if seen is None or drive.stamp is None:
        return False
    row = index.row(key, seen)
    if row is not None and not verify:
        return bool(index.made_of[row] == fleet.mark(drive, drive.stamp).encode())
    return _is_made(fleet, drive) and (not verify or _verified(fleet.root, drive))


def _is_made(fleet: Fleet, drive: Drive) -> bool:
    """Does the manifest of a drive's result say that it is what would be made?"""
    text = fleet.root.manifest_text(drive.key)
    return text is not None and drive.stamp is not None and is_made_of(text, fleet.mark(drive, drive.stamp))


def _verified(root: Root, drive: Drive) -> bool:
    """Have the input and the result the hashes that the manifest says?"""
    manifest = root.manifest(drive.key)
    if manifest is None:
        return False
    with TemporaryDirectory(prefix="recon-") as folder:
        scratch = Path(folder)
        (described,) = manifest["inputs"]
        if describe_input(fetch(drive.place, scratch)) != described:
            return False
        for output in manifest["outputs"]:
            place = root.place / drive.key / output["file"]
            try:
                if digest(fetch(place, scratch)) != output["sha256"]:
                    return False
            except OSError:
                return False
    return True


def run(fleet: Fleet, told: Told, *, only: str = "", verify: bool = False) -> Report:
    """Do what is to be done, and bring the files of the whole fleet up to date.

    A result is only there for a drive that did not fail the last time, so that the dataset says what `jobs` says.

    only : a vehicle, where not all are to be done
    Raises ConfigError where another batch is at work on the output, StorageError where nothing can be written there.
    """
    drives = chosen(fleet, only)
    with fleet.root.prepared():
        index = read_index(fleet.root)
        todo = remaining(fleet, drives, index, verify=verify)
        kept = len(drives) - len(todo)
        told(State(len(todo), kept))
        before = _failed_before(fleet)
        failures: list[Failure] = []
        done = superseded = 0
        unwritten: StorageError | None = None
        try:
            with closing(_outcomes(fleet, todo, kept, told)) as outcomes:
                for drive, outcome in outcomes:
                    before.pop(drive.key, None)
                    done += outcome.ok
                    if outcome.ok:
                        continue
                    failures.append(Failure(drive, outcome))
                    superseded += fleet.root.set_aside(drive.key)
                    if fleet.batch.on_error == "stop":
                        break
            compact(fleet.root, index, {**before, **{failure.drive.key: failure.row() for failure in failures}})
        except StorageError as error:
            unwritten = error
    stopped = done + len(failures) < len(todo)
    return Report(done, kept, failures, stopped=stopped, superseded=superseded, unwritten=unwritten)


def _failed_before(fleet: Fleet) -> dict[str, dict[str, Any]]:
    """Rows of drives that failed the last time and that the batch still names, by key."""
    rows = failed_before(fleet.root)
    named = {drive.key for drive in fleet.drives if drive.key in rows} if rows else set()
    return {key: row for key, row in rows.items() if key in named}


def chosen(fleet: Fleet, only: str) -> Drives:
    """The drives of one vehicle, or all. Raises ConfigError for a vehicle that has none."""
    if not only:
        return fleet.drives
    found = fleet.drives.where([drive.vehicle == only for drive in fleet.drives])
    if not len(found):
        known = ", ".join(fleet.drives.vehicles[:20])
        raise ConfigError([Problem(None, "bad-option", f"no input is of the vehicle '{only}'", f"there are {known}")])
    return found


def _outcomes(fleet: Fleet, todo: Drives, kept: int, told: Told) -> Ended:
    """The last outcome of each drive: what may go well another time is tried again, after all others.

    Raises StorageError where MOST_UNWRITTEN of them were not written.
    """
    ended, failed, unwritten, total = 0, 0, 0, len(todo)
    for tries_left in range(fleet.batch.retries, -1, -1):
        again: list[Drive] = []
        flight = Flight(fleet.executor, fleet.executor_params, todo, fleet.job)
        with closing(flight.outcomes()) as outcomes:
            for drive, lost_or_told in outcomes:
                outcome = _as_found(fleet, drive, lost_or_told)
                unwritten = unwritten + 1 if outcome.code == NOT_WRITTEN else 0
                if unwritten == MOST_UNWRITTEN:
                    text = f"none of the last {unwritten} drives was written, the last one: {outcome.text}"
                    raise StorageError(text, outcome.hint)
                if tries_left and outcome.code in AGAIN:
                    again.append(drive)
                    continue
                ended += 1
                failed += not outcome.ok
                told(State(total, kept, ended, failed, len(flight.out), outcome))
                yield drive, outcome
        if not again:
            return
        todo = Drives.of(again)


def _as_found(fleet: Fleet, drive: Drive, outcome: Outcome) -> Outcome:
    """The outcome; of a job whose process ended between its result and its word, that the drive is done."""
    if outcome.code in LOST and _is_made(fleet, drive) and _verified(fleet.root, drive):
        return Outcome(outcome.job, seconds=outcome.seconds)
    return outcome
