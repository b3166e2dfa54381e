"""Laws of exporters, beside those of all stages. Each needs a case that reads the files back:
contract(..., cases=[Case(read_back=...)]).

PYTEST_DONT_REWRITE: what a law says is a sentence already.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import chdir
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
import pyarrow as pa

from recon.errors import ContractError, DataError, NothingToExport, ReconError, StageError
from recon.schema import APPENDED
from recon.stages import Exporter
from recon.tables import select_rows, time_ns, vector
from recon.testing.contract import law
from recon.testing.distortions import emptied, variations, without_texts, without_values
from recon.testing.subject import Subject

ROUNDING: Final = 1e-9
"""Of the largest number of a column."""

_OUTSIDE: Final = "outside of its folder"


@law(Exporter)
def it_writes_only_inside_its_folder(subject: Subject) -> None:
    """The folder is all that an exporter was given: what lies beside it, or where the user stands, is not its own."""
    with TemporaryDirectory() as place, TemporaryDirectory() as elsewhere:
        (Path(elsewhere) / "notes.txt").write_text("of somebody else", encoding="utf-8", newline="\n")
        folder = Path(place) / "export"
        folder.mkdir()
        before = _contents(Path(place)) | _contents(Path(elsewhere))
        fault = ""
        with chdir(elsewhere):
            try:
                subject.export(folder)
            except ContractError as error:
                fault = error.message
        after = _contents(Path(place)) | _contents(Path(elsewhere))
        touched = [
            path
            for path in sorted({*before, *after})
            if before.get(path) != after.get(path) and not path.is_relative_to(folder)
        ]
        assert not touched, f"it touched {touched[0].name}, which is outside of its folder"
        assert _OUTSIDE not in fault, fault


@law(Exporter)
def it_returns_what_it_wrote(subject: Subject) -> None:
    """The manifest lists what an exporter returns: every file, and none that is not there."""
    with TemporaryDirectory() as folder:
        try:
            returned = subject.export(Path(folder))
        except ContractError as error:
            if _OUTSIDE in error.message:
                return  # a law of its own
            raise AssertionError(error.message) from error
        assert len(returned) == len(set(returned)), "it returns a file twice"
        there = {path for path in Path(folder).rglob("*") if path.is_file()}
        kept_quiet = sorted(path.name for path in there - set(returned))
        assert not kept_quiet, f"it wrote {kept_quiet[0]} and did not return its path"


@law(Exporter)
def files_read_back_to_the_same_numbers(subject: Subject) -> None:
    """Another program finds in the files the numbers of the recording."""
    read_back = subject.case.read_back
    assert read_back is not None, f"{subject.stage.key} needs a way back: contract(..., cases=[Case(read_back=...)])"
    inputs = subject.inputs()
    with TemporaryDirectory() as folder:
        streams = read_back(subject.export(Path(folder), inputs))
    for name, columns in streams.items():
        assert name in inputs, f"read back is a stream '{name}', which was not exported"
        table = _rows_at(inputs[name], columns.get("time"), name)
        for column, values in columns.items():
            fault = _fault_of(table, column, np.asarray(values))
            assert not fault, f"{name}.{column} reads back with {fault}"
    assert any(len(values) for columns in streams.values() for values in columns.values()), (
        "nothing was read back from the files"
    )


@law(Exporter)
def empty_streams_are_written(subject: Subject) -> None:
    """A drive without an event is a drive; only without what it cannot do without may an exporter refuse."""
    inputs = subject.inputs()
    for name, table in inputs.items():
        with TemporaryDirectory() as folder:
            try:
                subject.export(Path(folder), {**inputs, name: emptied(table)})
            except ReconError as error:
                if isinstance(error, DataError) and name in subject.stage.reads and name not in APPENDED:
                    continue
                raise AssertionError(f"'{name}' without a row raised {error.message}") from error


@law(Exporter)
def a_drive_with_nothing_to_show_is_told_from_an_error(subject: Subject) -> None:
    """Without rows or values an exporter writes what there is, or raises NothingToExport: any other error costs a
    fleet the whole drive.
    """
    for what, distort in (("a row", emptied), ("a value", without_values), ("a text", without_texts)):
        for streams, inputs in variations(subject.inputs(), distort):
            with TemporaryDirectory() as folder:
                try:
                    subject.export(Path(folder), inputs)
                except NothingToExport:
                    continue
                except (DataError, StageError) as error:
                    text = f"{streams} without {what} raised {type(error).__name__}: {error.message}"
                    raise AssertionError(f"{text}; what shows nothing must be a NothingToExport") from error


def _contents(folder: Path) -> dict[Path, bytes]:
    """The bytes of every file below a folder."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _rows_at(table: pa.Table, times_ns: Sequence[int] | None, name: str) -> pa.Table:
    """The rows at these times, for formats that keep some of them; all where no times are given."""
    if times_ns is None:
        return table
    rows = np.flatnonzero(np.isin(time_ns(table), np.asarray(times_ns, dtype=np.int64)))
    assert len(rows) == len(times_ns), f"{name}.time reads back with times that the stream does not have"
    return select_rows(table, rows)


def _fault_of(table: pa.Table, column: str, found: np.ndarray) -> str:
    """How values that were read back differ from a column, "" where they do not."""
    if column not in table.column_names:
        return "a name that the stream does not have"
    if len(found) != table.num_rows:
        return f"{len(found)} rows in place of {table.num_rows}"
    if pa.types.is_timestamp(table[column].type):
        wrong = found.astype(np.int64) != time_ns(table, column)
    elif pa.types.is_string(table[column].type):
        wrong = found != np.array(table[column].fill_null("").to_pylist(), dtype=object)
    else:
        wanted = vector(table, column, gaps=True)
        limit = ROUNDING * np.nanmax(np.abs(wanted), initial=0.0)
        wrong = ~np.isclose(found.astype(np.float64), wanted, rtol=0.0, atol=limit, equal_nan=True)
    if not np.any(wrong):
        return ""
    row = int(np.argmax(wrong))
    return f"another value in row {row}: {found[row]} in place of {table[column][row]}"
