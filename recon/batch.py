"""Batch files: one pipeline over many recordings.

    recon: 1
    batch: june_fleet
    pipeline: best_accuracy            # a shipped name or a file
    inputs:
      - glob: data/*/2026-06-*/*.txt   # or  list: drives.csv  with columns path, vehicle, drive
        vehicle: parent 2              # name of the N-th folder above the file, stem, or a regex with a named group
        drive: stem                    # file name without ending; these two are the defaults: parent 1 and stem
    output: results
    defaults: {reader.physycom: {gravity: 9.80665 m/s^2}}
    vehicles:
      A12: {fuser.map: {lever_arm: [0.8 m, -0.3 m, 1.1 m]}}
    exports: [report]
    executor: {use: executor.local, params: {workers: 2}}
    on_error: continue                 # or stop
    retries: 1
    timeout: 10 min
    memory: 2 GB
    resume: true

Paths are relative to the folder of the batch file. A regex is searched for in the path with `/` between its parts, and
its group is called `vehicle` or `drive`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from recon.check import check, with_exports
from recon.errors import ConfigError, PluginNotFound
from recon.form import Form
from recon.overrides import Override
from recon.parameters import bind
from recon.pipeline import FORMAT, Pipeline, find
from recon.plan import Plan
from recon.problems import Problem, Where
from recon.registry import Registry
from recon.stages import Executor, Simulator, role_of
from recon.units import UnitError, parse_quantity
from recon.validation import validate_pipeline
from recon.yaml_nodes import Node, load_file

ON_ERROR: Final = ("continue", "stop")
BYTES: Final = {
    "B": 1,
    "kB": 10**3,
    "MB": 10**6,
    "GB": 10**9,
    "TB": 10**12,
    "KiB": 2**10,
    "MiB": 2**20,
    "GiB": 2**30,
    "TiB": 2**40,
}

_NEEDED: Final = ("batch", "pipeline", "inputs", "output")
_KEYS: Final = (
    *("recon", *_NEEDED, "defaults", "vehicles", "exports", "executor"),
    *("on_error", "retries", "timeout", "memory", "resume"),
)  # fmt: skip
_INPUT_KEYS: Final = ("glob", "list", "vehicle", "drive")
_PARENT: Final = re.compile(r"parent [1-9][0-9]*")
_SIZE: Final = re.compile(rf"([0-9]+(?:\.[0-9]*)?)\s*({'|'.join(BYTES)})")


@dataclass(frozen=True)
class Inputs:
    """Where recordings are: a `glob` with the rules that name vehicle and drive, or a CSV file that lists them."""

    glob: str = ""
    list_file: str = ""
    vehicle: str = "parent 1"
    drive: str = "stem"


@dataclass(frozen=True)
class BatchFile:
    """A batch file. `root` keeps the places, for messages.

    vehicles : by vehicle, what is set for it beyond `defaults`
    executor : "" for the default one
    timeout : s; memory : bytes; None is without limit
    """

    name: str
    pipeline: str
    inputs: tuple[Inputs, ...]
    output: str
    defaults: tuple[Override, ...]
    vehicles: Mapping[str, tuple[Override, ...]]
    exports: tuple[str, ...]
    executor: str
    executor_params: Node
    on_error: str
    retries: int
    timeout: float | None
    memory: int | None
    resume: bool
    root: Node

    @property
    def folder(self) -> Path:
        """What its paths are relative to."""
        return Path(self.root.where.file).parent


def parse(root: Node) -> tuple[BatchFile, list[Problem]]:
    """The batch file that a YAML node holds, as far as it can be understood, and what is wrong with its form."""
    form = Form()
    top = form.mapping(root, "a batch file", _KEYS, needs=_NEEDED)
    form.number_of_format(top.get("recon"), FORMAT)
    vehicles = form.entries(top.get("vehicles"), "vehicles must be a mapping", "write a line for each vehicle")
    exports = form.items(top.get("exports"), "exports", "write [csv]")
    executor, executor_params = _executor(top.get("executor"), form)
    batch = BatchFile(
        name=form.text(top.get("batch"), "batch"),
        pipeline=form.text(top.get("pipeline"), "pipeline"),
        inputs=_inputs(top.get("inputs"), form),
        output=form.text(top.get("output"), "output"),
        defaults=_overrides(top.get("defaults"), "defaults", form),
        vehicles={name: _overrides(node, f"vehicles.{name}", form) for name, node in vehicles.items()},
        exports=tuple(form.text(node, "an export") for node in exports),
        executor=executor,
        executor_params=executor_params,
        on_error=form.choice(top.get("on_error"), "on_error", ON_ERROR),
        retries=_count(top.get("retries"), "retries", form),
        timeout=_seconds(top.get("timeout"), "timeout", form),
        memory=_bytes(top.get("memory"), "memory", form),
        resume=_switch(top.get("resume"), "resume", form),
        root=root,
    )
    return batch, form.problems


def _inputs(node: Node | None, form: Form) -> tuple[Inputs, ...]:
    items = form.items(node, "inputs", "write '- glob: data/*.txt'")
    if node is not None and node.value in (None, ()):
        form.report(node.where, "bad-value", "inputs must name at least one place", "write '- glob: data/*.txt'")
    return tuple(_input(item, form) for item in items)


def _input(item: Node, form: Form) -> Inputs:
    entries = form.mapping(item, "an input", _INPUT_KEYS)
    if isinstance(item.value, Mapping) and ("glob" in entries) == ("list" in entries):
        form.report(item.where, "bad-value", "an input needs either 'glob' or 'list'")
    texts = {key: form.text(node, key) for key, node in entries.items()}
    for key in ("vehicle", "drive"):
        if key in entries and "list" in entries:
            text = f"'{key}' goes with a glob; a list has a column for it"
            form.report(item.where_of_key(key), "bad-value", text)
        elif texts.get(key):
            _check_rule(key, texts[key], entries[key].where, form)
    return Inputs(
        glob=texts.get("glob", ""),
        list_file=texts.get("list", ""),
        vehicle=texts.get("vehicle") or Inputs.vehicle,
        drive=texts.get("drive") or Inputs.drive,
    )


def _check_rule(key: str, rule: str, where: Where, form: Form) -> None:
    """A rule that names a vehicle or a drive: `parent N`, `stem`, or a regex with a group of that name."""
    if rule == "stem" or _PARENT.fullmatch(rule):
        return
    example = f"write 'parent 1', 'stem' or a regex with a group '(?P<{key}>...)'"
    try:
        named = key in re.compile(rule).groupindex
    except (re.error, OverflowError, RecursionError) as error:
        form.report(where, "bad-value", f"{key}: '{rule}' is no regex: {error}", example)
        return
    if not named:
        form.report(where, "bad-value", f"{key}: '{rule}' does not tell the {key}", example)


def _overrides(node: Node | None, what: str, form: Form) -> tuple[Override, ...]:
    example = "write {filter.resample: {rate: 100 Hz}}"
    steps = form.entries(node, f"{what} must be a mapping of steps to parameters", example)
    for step, params in steps.items():
        form.entries(params, f"{step} must be a mapping of its parameters", example)
    return tuple(
        Override(step, params, node.where_of_key(step))
        for step, params in steps.items()
        if node is not None and isinstance(params.value, Mapping)
    )


def _executor(node: Node | None, form: Form) -> tuple[str, Node]:
    if node is None:
        return "", Node.of({}, Where(""))
    entries = form.mapping(node, "executor", ("use", "params"), needs=("use",))
    params = entries.get("params", Node.of({}, node.where))
    form.entries(params, "params must be a mapping", "write 'name: value' lines below it")
    kept = params if isinstance(params.value, Mapping) else Node.of({}, params.where)
    return form.text(entries.get("use"), "use"), kept


def _count(node: Node | None, key: str, form: Form) -> int:
    if node is None:
        return 0
    if isinstance(node.value, int) and not isinstance(node.value, bool) and node.value >= 0:
        return node.value
    form.report(node.where, "bad-value", f"{key} must be a whole number, 0 or more")
    return 0


def _switch(node: Node | None, key: str, form: Form) -> bool:
    if node is not None and not isinstance(node.value, bool):
        form.report(node.where, "bad-value", f"{key} must be true or false")
    return node is None or node.value is True


def _seconds(node: Node | None, key: str, form: Form) -> float | None:
    if node is None:
        return None
    try:
        value = parse_quantity(str(node.value), "s")
    except UnitError as error:
        form.report(node.where, "bad-value", f"{key}: {error}")
        return None
    if value <= 0:
        form.report(node.where, "bad-value", f"{key} must be above 0 s")
    return value


def _bytes(node: Node | None, key: str, form: Form) -> int | None:
    if node is None:
        return None
    found = _SIZE.fullmatch(str(node.value))
    size = float(found[1]) * BYTES[found[2]] if found else 0.0
    if not 0.0 < size < math.inf:
        form.report(node.where, "bad-value", f"{key} must be a size such as 2 GB", f"units are {', '.join(BYTES)}")
        return None
    return int(size)


@dataclass(frozen=True)
class Planned:
    """What a batch will do, to be run only where `problems` is empty.

    pipeline : the one that it names, None where it cannot be read
    plans : by vehicle, for those that the batch file names, and under "" for all others
    """

    pipeline: Pipeline | None
    plans: Mapping[str, Plan]
    problems: list[Problem]


def plan_batch(batch: BatchFile, registry: Registry) -> Planned:
    """The plans of a batch, and what is wrong with its pipeline and with what it sets in it, at its place there.

    Raises PluginError where a stage that is named cannot be used.
    """
    executor_problems = _executor_problems(batch, registry)
    pipeline, problems = _pipeline(batch, registry)
    plans: dict[str, Plan] = {}
    if pipeline is not None and not problems:
        whole = _with_exports(pipeline, batch)
        problems += _source_problems(pipeline, batch)
        for vehicle, own in {"": (), **batch.vehicles}.items():
            plans[vehicle], found = check(whole, registry, [*batch.defaults, *own])
            problems += found
    return Planned(pipeline, plans, list(dict.fromkeys(problems + executor_problems)))


def check_batch(batch: BatchFile, registry: Registry) -> list[Problem]:
    """What is wrong with a batch. Raises PluginError as `plan_batch`."""
    return plan_batch(batch, registry).problems


def _source_problems(pipeline: Pipeline, batch: BatchFile) -> list[Problem]:
    """A batch has inputs, so its pipeline must read them."""
    if not pipeline.steps or role_of(pipeline.steps[0].use) != Simulator.role:
        return []
    text = f"pipeline '{pipeline.name}' makes its own data and reads no input"
    where = batch.root.at(["pipeline"]).where
    return [Problem(where, "misplaced-step", text, "name a pipeline that begins with a reader")]


def _pipeline(batch: BatchFile, registry: Registry) -> tuple[Pipeline | None, list[Problem]]:
    """The pipeline named, None where it cannot be read, and its own problems."""
    where = batch.root.at(["pipeline"]).where
    if not batch.pipeline:
        return None, []
    try:
        found = find(batch.pipeline)
        path = batch.folder / found if found == Path(batch.pipeline) else found
        return validate_pipeline(load_file(path), registry)
    except ConfigError as error:
        return None, [
            problem if problem.where and problem.where.line else _named_at(where, problem) for problem in error.problems
        ]


def _named_at(where: Where, problem: Problem) -> Problem:
    """A problem with a file as a whole, at the place that names the file."""
    text = f"{problem.where}: {problem.text}" if problem.where else problem.text
    return replace(problem, where=where, text=text)


def _with_exports(pipeline: Pipeline, batch: BatchFile) -> Pipeline:
    """The pipeline with the batch's exports as steps, each at its place in the batch file."""
    whole = with_exports(pipeline, batch.exports)
    count = len(pipeline.steps)
    places = [batch.root.at(["exports", index]).where for index in range(len(batch.exports))]
    exports = [replace(step, where=where) for step, where in zip(whole.steps[count:], places, strict=True)]
    return replace(whole, steps=(*pipeline.steps, *exports))


def _executor_problems(batch: BatchFile, registry: Registry) -> list[Problem]:
    where = batch.root.at(["executor", "use"]).where
    if not batch.executor:
        return []
    try:
        stage = registry.get(batch.executor)
    except PluginNotFound as error:
        return [Problem(where, "unknown-stage", error.message, error.hint)]
    if not isinstance(stage, Executor):
        return [Problem(where, "misplaced-step", f"{stage.key} runs no jobs", "name an executor")]
    return bind(stage.params, batch.executor_params, stage.key)[1]
