"""Laws of filters: no new times, constants and scales as they declare.

PYTEST_DONT_REWRITE: what a law says is a sentence already.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final, TypeAlias

import numpy as np
import pyarrow as pa

from recon.schema import APPENDED
from recon.stages import Filter
from recon.tables import Array, replace, time_ns, vector
from recon.testing.contract import law
from recon.testing.subject import Subject

ROUNDING: Final = 1e-9
"""Of the largest value: a sum over 1e6 rows keeps that much of the 2e-16 of a double."""
SCALES: Final = (-1024.0, 1.0 / 1024.0)
"""Powers of two, so that a scale adds no rounding; so far apart that no threshold survives them."""

Tables: TypeAlias = Mapping[str, pa.Table]


@law(Filter, when=lambda stage: not stage.resamples)
def row_times_are_those_of_the_input(subject: Subject) -> None:
    """A filter may drop rows, but makes none at times that it was not given, unless it declares `resamples`."""
    inputs = subject.inputs()
    for name, table in _shared(subject.run(inputs), inputs).items():
        foreign = np.setdiff1d(time_ns(table), time_ns(inputs[name]))
        assert not len(foreign), (
            f"'{name}' came back with {len(foreign)} rows at times that were not in it, the first {foreign[0]} ns; "
            "a filter that does this declares resamples=True"
        )


@law(Filter, when=lambda stage: stage.resamples)
def row_times_lie_within_the_input(subject: Subject) -> None:
    """A filter that resamples invents nothing before the first row of what it reads and nothing after the last."""
    inputs = subject.inputs()
    given = np.concatenate([time_ns(table) for table in _shared(inputs, inputs).values()])
    for name, table in _shared(subject.run(inputs), inputs).items():
        outside = (time_ns(table) < given.min()) | (time_ns(table) > given.max())
        assert not outside.any(), f"{int(outside.sum())} rows of '{name}' lie outside of the time of what was read"


@law(Filter, when=lambda stage: stage.unit_gain)
def a_constant_passes_unchanged(subject: Subject) -> None:
    """A filter that declares `unit_gain` returns a signal that never changes as it was."""
    inputs = _mapped(subject, subject.inputs(), lambda values: np.full_like(values, values[0]))
    for name, table in _shared(subject.run(inputs), inputs).items():
        assert table.num_rows, f"of a constant '{name}' nothing came back"
        for column in _asked(subject, name, inputs[name]):
            constant, found = vector(inputs[name], column, gaps=True)[0], vector(table, column, gaps=True)
            assert np.allclose(found, constant, rtol=ROUNDING, atol=0.0, equal_nan=True), (
                f"a constant {name}.{column} of {constant:g} came back between {found.min():g} and {found.max():g}; "
                "its record declares unit_gain"
            )


@law(Filter, when=lambda stage: stage.linear)
def a_scaled_input_gives_a_scaled_result(subject: Subject) -> None:
    """A filter that declares `linear` gives k times the result for k times what it reads of the streams it changes."""
    inputs = subject.inputs()
    usual = _shared(subject.run(inputs), inputs)
    for scale in SCALES:
        scaled = subject.run(_mapped(subject, inputs, partial(np.multiply, scale)))
        for name, table in usual.items():
            for column in _asked(subject, name, inputs[name]):
                expected, found = scale * vector(table, column, gaps=True), vector(scaled[name], column, gaps=True)
                assert len(found) == len(expected), f"scaled by {scale:g}, '{name}' has another number of rows"
                allowed = ROUNDING * np.abs(expected).max(initial=0.0, where=np.isfinite(expected))
                assert np.allclose(found, expected, rtol=0.0, atol=allowed, equal_nan=True), (
                    f"{name}.{column}: {scale:g} times the input did not give {scale:g} times the result; "
                    "its record declares linear"
                )


def _shared(returned: Tables, inputs: Tables) -> Tables:
    """Streams that were read and returned, without those that only grow."""
    return {name: table for name, table in returned.items() if name in inputs and name not in APPENDED}


def _asked(subject: Subject, name: str, table: pa.Table) -> list[str]:
    """Numbers that the stage names in what it reads of a stream."""
    named = {column.name for column in subject.stage.reads[name].columns}
    return [field.name for field in table.schema if field.name in named and pa.types.is_floating(field.type)]


def _mapped(subject: Subject, inputs: Tables, change: Callable[[Array], Array]) -> dict[str, pa.Table]:
    """The inputs with what the stage asks of the streams that it writes put through a function."""
    changed = dict(inputs)
    for name in {*subject.stage.writes} & {*inputs} - {*APPENDED}:
        columns = _asked(subject, name, inputs[name])
        changed[name] = replace(
            inputs[name], **{column: change(vector(inputs[name], column, gaps=True)) for column in columns}
        )
    return changed
