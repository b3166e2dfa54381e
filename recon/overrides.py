"""Parameters set from outside of a pipeline: `--set STEP.NAME=VALUE`, a batch file, a keyword of the API."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from recon.errors import ConfigError
from recon.pipeline import Pipeline, Step
from recon.problems import Problem, Where, did_you_mean, shortened
from recon.yaml_nodes import Node, load, load_file


@dataclass(frozen=True)
class Override:
    """Parameters set from outside: `--set STEP.NAME=VALUE`, a batch file, a keyword of the API.

    step : id of a step, or the name of a reader; params : mapping of the parameters; where : the place of the step
    """

    step: str
    params: Node
    where: Where

    @classmethod
    def from_option(cls, option: str) -> Override:
        """From the text after `--set`. A value `@FILE` is read from a YAML file. Raises ConfigError."""
        where = Where(f"--set {shortened(option)}")
        target, equals, value = option.partition("=")
        step, dot, name = target.strip().rpartition(".")
        if not (equals and dot and step and name):
            text = "this sets nothing"
            raise ConfigError([Problem(where, "bad-option", text, "write --set STEP.PARAMETER=VALUE")])
        if value.startswith("@"):
            return cls._of_one(step, name, load_file(value[1:]), where)
        plain = load(value, where.file).plain() if value.strip() else ""
        return cls._of_one(step, name, Node.of(plain, where), where)

    @classmethod
    def from_data(cls, target: str, value: object) -> Override:
        """From "STEP.NAME" and plain data, as the Python API takes it. Raises ConfigError."""
        where = Where(f"override {shortened(target)}")
        step, dot, name = target.rpartition(".")
        if not (dot and step and name):
            hint = "write it as 'STEP.PARAMETER'"
            raise ConfigError([Problem(where, "bad-option", "this names no parameter of a step", hint)])
        try:
            return cls._of_one(step, name, Node.of(value, where), where)
        except TypeError as error:
            hint = "give text, numbers, lists or dictionaries"
            raise ConfigError([Problem(where, "bad-option", str(error), hint)]) from error

    @classmethod
    def _of_one(cls, step: str, name: str, value: Node, where: Where) -> Override:
        return cls(step, Node({name: value}, where, {name: where}), where)


def with_overrides(
    pipeline: Pipeline, overrides: Iterable[Override], delegates: Callable[[Step], bool]
) -> tuple[Pipeline, list[Problem]]:
    """The pipeline with parameters set from outside, and the overrides that fit nowhere.

    delegates : does the step hand over to other readers? It is given the parameters that name another reader.
    """
    steps = list(pipeline.steps)
    problems = []
    for override in overrides:
        index = _target(steps, override, delegates)
        if index is None:
            problems.append(_unplaced(pipeline, override))
        elif steps[index].id == override.step:
            steps[index] = steps[index].with_params(override.params)
        else:
            nested = Node({override.step: override.params}, override.where, {override.step: override.where})
            steps[index] = steps[index].with_params(nested)
    return replace(pipeline, steps=tuple(steps)), problems


def _unplaced(pipeline: Pipeline, override: Override) -> Problem:
    """What is wrong with an override that fits nowhere."""
    ids = [step.id for step in pipeline.steps]
    for name in override.params.keys:
        whole = f"{override.step}.{name}"
        if whole in ids:
            use = pipeline.steps[ids.index(whole)].use
            hint = f"write {whole}.NAME, with a name that 'recon plugins show {use}' lists"
            text = f"'{whole}' is a step, and the name of a parameter is missing"
            return Problem(override.where, "bad-option", text, hint)
    hint = did_you_mean(override.step, ids) or f"the steps are {', '.join(ids)}"
    return Problem(override.where, "unknown-step", f"'{pipeline.name}' has no step '{override.step}'", hint)


def _target(steps: Sequence[Step], override: Override, delegates: Callable[[Step], bool]) -> int | None:
    for index, step in enumerate(steps):
        if step.id == override.step:
            return index
    if override.step.startswith("reader."):
        for index, step in enumerate(steps):
            if delegates(step):
                return index
    return None
