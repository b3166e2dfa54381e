"""Laws of what a stage makes of what logs are like: without rows, without values, without sensors, with wrong times.

It may always refuse by a DataError that says in words what is missing; nothing else may come out of it.

PYTEST_DONT_REWRITE: what a law says is a sentence already.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import pyarrow as pa

from recon.errors import DataError, ReconError
from recon.schema import group_of
from recon.testing.contract import law
from recon.testing.distortions import (
    Distortion,
    emptied,
    one_row,
    variations,
    with_backward_times,
    with_gap,
    with_nan,
    with_null_rows,
    with_repeated_times,
    without_group,
    without_values,
)
from recon.testing.laws.common import result, transforms, works_on_streams
from recon.testing.subject import Subject


@law(when=works_on_streams)
def optional_streams_and_columns_may_be_absent(subject: Subject) -> None:
    """What is declared optional is missing in somebody's log: a result, or a DataError that says why not."""
    inputs = subject.inputs()
    for port, need in subject.stage.reads.items():
        if port not in inputs:
            continue
        if need.optional:
            rest = {name: table for name, table in inputs.items() if name != port}
            _assert_result_or_data_error(subject, rest, f"a recording without the optional stream '{port}'")
        for group in {group_of(column.name) for column in need.columns if column.optional}:
            less = {**inputs, port: without_group(inputs[port], group)}
            _assert_result_or_data_error(subject, less, f"a '{port}' without the optional {group}")


@law(when=works_on_streams)
def empty_streams_give_a_result_or_a_data_error(subject: Subject) -> None:
    """A log may hold no row of a sensor."""
    _assert_bears(subject, emptied, "without a row")


@law(when=works_on_streams)
def one_row_gives_a_result_or_a_data_error(subject: Subject) -> None:
    """A log may be cut after its first row."""
    _assert_bears(subject, one_row, "of one row")


@law(when=works_on_streams)
def missing_values_give_a_result_or_a_data_error(subject: Subject) -> None:
    """Sensors fall silent: null in some rows, null in all rows, NaN in place of null."""
    _assert_bears(subject, with_null_rows, "with a tenth of its rows null")
    _assert_bears(subject, without_values, "without a value")
    _assert_bears(subject, with_nan, "with a tenth of its values NaN")


@law(when=works_on_streams)
def a_gap_gives_a_result_or_a_data_error(subject: Subject) -> None:
    """Loggers lose minutes."""
    _assert_bears(subject, with_gap, "with a gap in the middle")


@law(when=transforms)
def wrong_times_give_a_result_or_a_data_error(subject: Subject) -> None:
    """Times that repeat or run backwards: the runner refuses streams with them, a function called directly may do so
    by ValueError.
    """
    inputs = subject.inputs()
    absent = dict.fromkeys(port for port in subject.stage.reads if port not in inputs)
    every = subject.stage.every_stream
    for what, distort in (("repeated", with_repeated_times), ("backward", with_backward_times)):
        for stream, tables in variations(inputs, distort):
            _assert_result_or_data_error(subject, tables, f"{stream} with {what} times")
            try:
                with warnings.catch_warnings(action="ignore"):  # a division by a step of zero
                    given = {"streams": tables} if every else {**tables, **absent}
                    subject.stage.run(**given, params=subject.params)
            except (DataError, ValueError):
                continue
            except Exception as error:  # a stage is somebody else's code
                raise AssertionError(
                    f"{stream} with {what} times raised {type(error).__name__}: {error}; "
                    "a stage must give a result, or say what is wrong by DataError or ValueError"
                ) from error


def _assert_bears(subject: Subject, distort: Distortion, what: str) -> None:
    for stream, tables in variations(subject.inputs(), distort):
        _assert_result_or_data_error(subject, tables, f"{stream} {what}")


def _assert_result_or_data_error(subject: Subject, inputs: Mapping[str, pa.Table], what: str) -> None:
    try:
        result(subject, inputs)
    except DataError:
        return
    except ReconError as error:
        raise AssertionError(f"{what} raised {error.message}; a stage must give a result or a DataError") from error
