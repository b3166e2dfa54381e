"""Every problem of a pipeline's file at once: those of its form, and those of its steps as far as they are known."""

from __future__ import annotations

from typing import Final

from recon.check import check
from recon.pipeline import Pipeline, parse
from recon.problems import Problem
from recon.registry import Registry
from recon.yaml_nodes import Node

_MAY_FOLLOW: Final = ("missing-input", "wrong-input", "misplaced-step")
"""Kinds of problems that vanish by themselves where a step could not be understood."""


def validate_pipeline(root: Node, registry: Registry) -> tuple[Pipeline, list[Problem]]:
    """The pipeline that a YAML node holds, and what is wrong with it, in the order of the file.

    Raises PluginError where a stage that is named cannot be used.
    """
    pipeline, problems = parse(root)
    _, found = check(pipeline, registry)
    if problems:
        found = [problem for problem in found if problem.code not in _MAY_FOLLOW]
    return pipeline, sorted(problems + found, key=_place)


def _place(problem: Problem) -> tuple[int, int]:
    return (problem.where.line, problem.where.column) if problem.where else (0, 0)
