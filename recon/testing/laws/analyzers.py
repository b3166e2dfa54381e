"""Laws of analyzers: they add, replace nothing, and see no error where there is none.

PYTEST_DONT_REWRITE: what a law says is a sentence already.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import pyarrow as pa

from recon.schema import APPENDED, STREAMS
from recon.stages import Analyzer
from recon.testing.contract import law
from recon.testing.subject import Subject

ROUNDING: Final = 1e-6
"""m, m/s, rad, deg: an arc cosine turns the 1e-16 of a double into 1e-8, positions of some 100 m add their own."""
MAY_ADD: Final = (*APPENDED, "residuals")


@law(Analyzer)
def what_is_added_has_a_name_of_its_own(subject: Subject) -> None:
    """An analyzer adds metrics, events, residuals and streams of new names, so that nothing is replaced."""
    inputs = subject.inputs()
    returned = {*subject.plan(inputs).steps[0].outputs, *subject.run(inputs)}
    taken = sorted(returned & {*STREAMS, *inputs} - {*MAY_ADD})
    assert not taken, (
        f"it returns '{', '.join(taken)}', which other stages make; an analyzer adds streams under names of its own"
    )


@law(Analyzer, when=lambda stage: stage.compares is not None)
def a_stream_against_itself_shows_no_error(subject: Subject) -> None:
    """All metrics named *_error are zero where the two streams that `compares` names are one and the same."""
    first, second = _compared(subject)
    inputs = subject.inputs()
    for name, error in _errors(subject, {**inputs, first: inputs[second]}).items():
        assert abs(error) <= ROUNDING, (
            f"of '{second}' against itself the metric '{name}' is {error}, where it must be 0"
        )


@law(Analyzer, when=lambda stage: stage.compares is not None)
def streams_that_differ_show_an_error(subject: Subject) -> None:
    """At least one metric named *_error tells a stream that drifts from the truth."""
    first, second = _compared(subject)
    errors = _errors(subject, subject.inputs())
    assert any(abs(error) > ROUNDING for error in errors.values()), (
        f"'{first}' drifts away from '{second}', but all of {', '.join(errors)} are 0"
    )


def _compared(subject: Subject) -> tuple[str, str]:
    assert isinstance(subject.stage, Analyzer)
    assert subject.stage.compares is not None
    return subject.stage.compares


def _errors(subject: Subject, inputs: Mapping[str, pa.Table]) -> dict[str, float]:
    """Value by name of the metrics that measure the difference."""
    learnt = subject.run(inputs).get("metrics")
    rows = [] if learnt is None else learnt.to_pylist()
    found = {row["name"]: row["value"] for row in rows if row["name"].endswith("_error") and row["value"] is not None}
    assert found, "its record says that it compares two streams, but it returns no metric named *_error with a value"
    return found
