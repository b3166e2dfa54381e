"""Laws of what a stage says of itself: its name, its parameters, its columns, what its import costs.

PYTEST_DONT_REWRITE: what a law says is a sentence already.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from functools import cache
from importlib import import_module
from multiprocessing.reduction import ForkingPickler
from typing import Final

from recon.parameters import ParamInfo, bind
from recon.pipeline import Pipeline, Step
from recon.problems import Where
from recon.schema import STREAMS, Column, unnumbered
from recon.stages import ROLES, Executor
from recon.testing.contract import law
from recon.testing.subject import Subject
from recon.units import UnitError, si_unit
from recon.yaml_nodes import Node

HEAVY: Final = (
    *(f"scipy.{part}" for part in ("signal", "ndimage", "optimize", "interpolate", "stats", "spatial", "sparse")),
    *("pandas", "matplotlib", "sklearn", "torch", "tensorflow", "jax", "numba", "sympy"),
    *("pyquaternion", "mcap_ros2", "mcap_protobuf", "typer", "rich", "pytest"),
)
"""Packages whose import takes longer than all of recon's."""

_UNITS: Final = (
    r"ns|us|ms|s|min|h|hz|khz|deg|rad|mm|cm|m|km|deg/s|rad/s|m/s|km/h|mps|kmh|m/s\^2|seconds|degrees|metres|hertz"
)
_UNIT_IN_NAME: Final = re.compile(rf"_({_UNITS})$")
_UNIT_IN_DOC: Final = re.compile(rf"\b[Ii]n ({_UNITS})(?=[\s.,;:)]|$)", re.IGNORECASE)


@law()
def name_equals_entry_point(subject: Subject) -> None:
    """Every stage that the module declares is found under an entry point of its name."""
    source = subject.registry.source(subject.stage.key)
    if not source.distribution:
        return  # a record that was handed over needs no entry point
    module = import_module(source.module)
    hooks = [getattr(module, f"declare_{role}s", tuple) for role in ROLES]
    lost = [record.key for hook in hooks for record in hook() if record.key not in subject.registry]
    assert not lost, f"{source.module} declares {lost[0]}, which no entry point names: nobody can find it"


@law()
def summary_is_one_sentence(subject: Subject) -> None:
    """Lists show one sentence for each stage."""
    summary = subject.stage.summary
    is_one = summary.endswith(".") and "\n" not in summary
    assert is_one, f"the summary must be one sentence on one line, with its full stop: {summary!r}"


@law()
def parameters_have_docs_and_units(subject: Subject) -> None:
    """Every parameter says what it means, and a number with a unit is a quantity."""
    for info in subject.stage.params.describe():
        assert info.doc.strip(), f"the parameter '{info.name}' says nothing of itself: give it a doc"
        unit = _unit_in_words(info)
        assert not unit, (
            f"the parameter '{info.name}' names its unit, {unit}, in words: declare it with "
            f'quantity(..., "{unit}", doc=...), so that users write the unit and it is converted'
        )


@law()
def defaults_are_valid(subject: Subject) -> None:
    """What is not set keeps the limits of its parameter."""
    params = subject.stage.params
    try:
        written = Node.of(params.model_construct().as_text(), Where(subject.stage.key))
    except TypeError:
        return  # cannot be written: a law of its own
    _, problems = bind(params, written, subject.stage.key)
    wrong = [problem.text for problem in problems if problem.code != "missing-parameter"]
    assert not wrong, f"a default is refused when it is written out: {wrong[0]}"


@law()
def parameters_survive_yaml(subject: Subject) -> None:
    """Written into a pipeline and read back, parameters are the same to the last bit."""
    stage, params = subject.stage, subject.params
    where = Where(f"<{stage.key}>")
    try:
        step = Step(stage.key, stage.key, Node.of(params.as_text(), where), where)
        text = Pipeline("contract", (step,)).to_yaml()
    except TypeError as error:
        raise AssertionError(f"the parameters cannot be written as YAML: {error}") from error
    (again,) = Pipeline.from_text(text).steps
    found, problems = bind(stage.params, again.params, stage.key)
    assert not problems, f"the parameters cannot be read back from YAML: {problems[0].text}"
    assert found == params, f"the parameters {params!r} come back from YAML as {found!r}"


@law()
def import_loads_no_heavy_package(subject: Subject) -> None:
    """Lists and checks import many stages: what takes long is imported inside the function that uses it."""
    source = subject.registry.source(subject.stage.key)
    if not source.distribution:
        return  # nothing imports a record that was handed over
    loaded = _loaded_by(source.module, os.pathsep.join(filter(None, sys.path)))
    heavy = [name for name in HEAVY if name in loaded]
    assert not heavy, f"the import of {source.module} loads {heavy[0]}: import it inside the function that uses it"


@law()
def canonical_columns_have_canonical_units(subject: Subject) -> None:
    """A column of a canonical name means what everybody expects; any other is in SI."""
    asked = [(port, column) for port, need in subject.stage.reads.items() for column in need.columns]
    faults = [fault_of_unit(stream, column) for stream, column in asked]
    assert not any(faults), next(filter(None, faults))
    if isinstance(subject.stage, Executor):
        return
    (step,) = subject.plan(subject.inputs()).steps
    given = [(name, column) for name, schema in step.outputs.items() for column in schema.columns]
    faults = [fault_of_unit(stream, column) for stream, column in given]
    assert not any(faults), next(filter(None, faults))


@law()
def it_can_be_sent_to_another_process(subject: Subject) -> None:
    """The record and its parameters pickle, by reference, as batch runs need it."""
    sent = (subject.stage, subject.params)
    try:
        received = ForkingPickler.loads(ForkingPickler.dumps(sent))
    except Exception as error:  # pickle raises what it likes
        raise AssertionError(
            f"the record cannot be pickled, {type(error).__name__}: {error}; "
            "its functions and its parameter class must stand at the top of a module"
        ) from error
    assert received == sent, "the record that comes out of a pickle is not the one that went in"


def fault_of_unit(stream: str, column: Column) -> str:
    """What is wrong with the unit of a column, as a sentence; "" where nothing is."""
    canonical = STREAMS.get(unnumbered(stream))
    if canonical is not None and column.name in canonical:
        wanted = canonical[column.name].unit
    elif column.name in ("lat", "lon"):
        wanted = "deg"
    else:
        try:
            wanted = si_unit(column.unit) if column.unit else ""
        except UnitError:
            wanted = column.unit  # of a sensor that recon knows nothing of
    if column.unit == wanted:
        return ""
    return f"{stream}.{column.name} is declared in {column.unit or 'no unit'}; it must be in {wanted or 'no unit'}"


def _unit_in_words(info: ParamInfo) -> str:
    """A unit that the name or the doc of a number tells although the declaration does not, "" for none."""
    if info.unit or not re.search(r"\bnumbers?\b", info.type):
        return ""
    found = _UNIT_IN_NAME.search(info.name) or _UNIT_IN_DOC.search(info.doc)
    return found[1] if found else ""


@cache
def _loaded_by(module: str, path: str) -> frozenset[str]:
    """Modules that a fresh interpreter has loaded after the import."""
    script = f"import {module}, sys; sys.stdout.write(' '.join(sys.modules))"
    run = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, env={**os.environ, "PYTHONPATH": path}
    )
    assert run.returncode == 0, f"{module} cannot be imported in a fresh process: {run.stderr.strip()[-300:]}"
    return frozenset(run.stdout.split())
