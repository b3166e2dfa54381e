"""What a batch will do: a plan for each vehicle, and what is wrong with its pipeline and with what it sets in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from recon.batch import BatchFile
from recon.check import check, with_exports
from recon.errors import ConfigError, PluginNotFound
from recon.parameters import bind
from recon.pipeline import Pipeline, find
from recon.plan import Plan
from recon.problems import Problem, Where
from recon.registry import Registry
from recon.stages import Executor, Simulator, role_of
from recon.validation import validate_pipeline
from recon.yaml_nodes import load_file


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
    listed = batch.root.at(["exports"]).value
    places = [node.where for node in listed if node.value in batch.exports] if isinstance(listed, tuple) else []
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
