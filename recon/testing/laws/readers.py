"""Laws of readers. Each needs a case with a small file: contract(..., cases=[Case(path=...)]).

PYTEST_DONT_REWRITE: what a law says is a sentence already.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from recon.errors import DataError, ReadFailed, ReconError
from recon.schema import APPENDED, STREAMS, group_of, unnumbered
from recon.stages import Reader, Sniff
from recon.tables import Streams, schema_of, select_rows, time_ns
from recon.testing.contract import law
from recon.testing.laws.declaration import fault_of_unit
from recon.testing.samples import samples
from recon.testing.subject import Subject

CUTS: Final = 40
SURE: Final = 0.5
HEAD_BYTES: Final = 65_536


def _sniffs(reader: Reader) -> bool:
    return reader.sniff is not None


@law(Reader)
def columns_carry_units_frames_and_quantities(subject: Subject) -> None:
    """What a reader gives says what it is: unit, frame of vectors, quantity where a unit is not enough."""
    for name, table in subject.run().items():
        canonical = STREAMS.get(unnumbered(name))
        schema = schema_of(table)
        for column in schema.columns:
            fault = fault_of_unit(name, column)
            assert not fault, fault
            usual = canonical[column.name] if canonical is not None and column.name in canonical else None
            vector = sum(group_of(other.name) == group_of(column.name) for other in schema.columns) > 1
            framed = bool(usual.frame) if usual else vector
            assert column.frame or not framed, f"{name}.{column.name} is part of a vector and names no frame"
            assert column.quantity or not (usual and usual.quantity), f"{name}.{column.name} names no quantity"


@law(Reader)
def a_cut_file_gives_rows_or_read_failed(subject: Subject) -> None:
    """Batteries fail while a file is written: whole rows, or an error that says where, wherever it is cut."""
    path = _path(subject)
    with TemporaryDirectory() as folder:
        for where, size, cut in _cut_copies(path, Path(folder)):
            fault = _fault_of_reading(subject, cut)
            assert not fault, f"{where} cut after {size} bytes {fault}"


@law(Reader)
def damaged_bytes_give_rows_or_read_failed(subject: Subject) -> None:
    """Cards and radios flip bits: an error that says so, or rows, whichever byte is hit."""
    path = _path(subject)
    rng = np.random.default_rng(3)
    with TemporaryDirectory() as folder:
        copy = _copied(path, Path(folder))
        for file in _files(copy):
            data = file.read_bytes()
            for position in rng.integers(0, len(data), CUTS // len(_files(copy)) + 1).tolist() if data else []:
                file.write_bytes(data[:position] + bytes([data[position] ^ 0xFF]) + data[position + 1 :])
                fault = _fault_of_reading(subject, copy)
                assert not fault, f"{file.name} with byte {position} damaged {fault}"
            file.write_bytes(data)


@law(Reader)
def wrong_times_in_a_file_give_rows_or_read_failed(subject: Subject) -> None:
    """Loggers write lines twice and out of order: times rise nevertheless, or an error says that they do not."""
    lines = _lines(_path(subject))
    third = len(lines) // 3
    repeated = [line for number, line in enumerate(lines) for _ in range(2 if number % 10 == 5 else 1)]
    turned = lines[:third] + lines[2 * third :] + lines[third : 2 * third]
    for what, wrong in (("every tenth line twice", repeated), ("a third of its lines behind the others", turned)):
        with TemporaryDirectory() as folder:
            path = _written(folder, subject, wrong)
            fault = _fault_of_reading(subject, path) if path else ""
        assert not fault, f"a file with {what} {fault}"


@law(Reader)
def a_gap_in_the_file_stays_a_gap(subject: Subject) -> None:
    """A reader gives what was measured; it fills, interpolates and resamples nothing."""
    lines = _lines(_path(subject))
    start, stop = int(0.4 * len(lines)), int(0.7 * len(lines))
    before, during = (_read_lines(subject, lines[:end]) for end in (start, stop))
    holed = _read_lines(subject, lines[:start] + lines[stop:])
    if before is None or during is None or holed is None:
        return  # no format of lines, or one that says that it needs them all
    if not (_timed(before) and _timed(during)):
        return  # tables whose rows have no time of day
    first_ns, last_ns = _last_time(before), _last_time(during)
    for name, table in _timed(holed).items():
        t_ns = time_ns(table)
        made = int(((t_ns > first_ns) & (t_ns <= last_ns)).sum())
        assert not made, (
            f"lines {start + 1} to {stop} were taken out of the file, yet '{name}' has {made} rows in that time: "
            "a reader must not fill gaps or resample"
        )


@law(Reader)
def later_lines_leave_the_first_rows_as_they_are(subject: Subject) -> None:
    """What was measured does not depend on what was measured later; corrections are the work of filters."""
    lines = _lines(_path(subject))
    half = _read_lines(subject, lines[: len(lines) // 2])
    if half is None:
        return  # no format of lines, or one that says that it needs them all
    whole = subject.run()
    for name, table in _timed(half).items():
        there = whole.get(name)
        assert there is not None, f"the first half of the file holds '{name}', the whole file does not"
        rows = select_rows(there, time_ns(there) <= _last_time(half))
        assert rows == table, (
            f"the first half of the file gives another '{name}' than the whole file at the same times: "
            "a reader must not correct, smooth or resample"
        )


def _tells_lines(reader: Reader) -> bool:
    return reader.lines is not None


@law(Reader, when=_tells_lines)
def lines_that_it_tells_are_those_of_its_rows(subject: Subject) -> None:
    """Rows that follow each other stand in lines that do, in the file; a time that no row has stands in none."""
    path, reader = _path(subject), subject.stage
    assert isinstance(reader, Reader)
    assert reader.lines is not None
    count = len(_lines(path))
    for name, table in _timed(subject.run()).items():
        t_ns = time_ns(table)
        told = np.asarray(reader.lines(path, subject.params, name, t_ns))
        if not told.any():
            continue  # a file without lines
        assert told.min() >= 1, f"row {int(told.argmin()) + 1} of '{name}' is told to stand in no line"
        assert told.max() <= count, f"a row of '{name}' is told to stand in line {told.max()} of {count}"
        assert (np.diff(told) > 0).all(), f"rows of '{name}' that follow each other stand in lines that do not"
        nowhere = np.asarray(reader.lines(path, subject.params, name, t_ns[-1:] + 1_000_000_000_000))
        assert not nowhere.any(), f"a time that no row of '{name}' has is told to stand in line {nowhere[0]}"


@law(Reader, when=_sniffs)
def it_knows_its_own_file(subject: Subject) -> None:
    """A reader is sure of the file that its author calls its own."""
    path = _path(subject)
    sniff = _sniffed(subject, path)
    assert SURE <= sniff.confidence <= 1.0, (
        f"it is {sniff.confidence:g} sure of its own file {path.name}; reader.auto asks for at least {SURE:g}"
    )
    assert sniff.reason, f"it does not say why it knows {path.name}"


@law(Reader, when=_sniffs)
def it_leaves_files_of_others_alone(subject: Subject) -> None:
    """A reader that claims what it cannot read takes it away from the one that can."""
    with TemporaryDirectory() as folder:
        for kind, sample in samples(Path(folder)).items():
            sure = _sniffed(subject, sample.path).confidence
            if sample.owner == subject.stage.key or sure < SURE:
                continue
            assert not sample.owner, f"it is {sure:g} sure of {kind}, which belongs to {sample.owner}"
            try:
                subject.read(sample.path)
            except ReconError as error:
                raise AssertionError(f"it is {sure:g} sure of {kind}, and cannot read it: {error.message}") from error


def _path(subject: Subject) -> Path:
    assert subject.case.path is not None, f"{subject.stage.key} needs a file: contract(..., cases=[Case(path=...)])"
    return subject.case.path


def _sniffed(subject: Subject, path: Path) -> Sniff:
    assert isinstance(subject.stage, Reader)
    assert subject.stage.sniff is not None
    head = b""
    if not path.is_dir():
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    return subject.stage.sniff(path, head)


def _files(path: Path) -> list[Path]:
    return sorted(part for part in path.rglob("*") if part.is_file()) if path.is_dir() else [path]


def _copied(path: Path, folder: Path) -> Path:
    copy = folder / path.name
    return Path(shutil.copytree(path, copy) if path.is_dir() else shutil.copyfile(path, copy))


def _cut_copies(path: Path, folder: Path) -> Iterator[tuple[str, int, Path]]:
    """Name of a file, the bytes left of it, and the path to read; each file of a folder is cut in its turn."""
    copy = _copied(path, folder)
    files = _files(copy)
    rng = np.random.default_rng(2)
    for file in files:
        data = file.read_bytes()
        for size in sorted({0, *rng.integers(0, max(len(data), 1), CUTS // len(files) + 1).tolist()}):
            file.write_bytes(data[:size])
            yield file.name, size, copy
        file.write_bytes(data)


def _fault_of_reading(subject: Subject, path: Path) -> str:
    """What is wrong with how a damaged file is read, "" where it gives rows or says where it is damaged."""
    try:
        subject.read(path)
    except ReadFailed as error:
        assert isinstance(subject.stage, Reader)
        half_there = len(_lines(path)) >= 0.5 * len(_lines(_path(subject))) > 1
        nowhere = half_there and error.line is None and not subject.stage.delegates
        return f"raised ReadFailed without the line: {error.message}" if nowhere else ""
    except DataError:
        return ""
    except ReconError as error:
        return f"raised {error.message}; a reader must give whole rows or ReadFailed"
    return ""


def _lines(path: Path) -> list[bytes]:
    """The lines of a text file; none where it is no text."""
    if path.is_dir():
        return []
    data = path.read_bytes()
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return []
    return [] if b"\0" in data else data.splitlines(keepends=True)


def _read_lines(subject: Subject, lines: list[bytes]) -> Streams | None:
    """What the file would give if it held these lines only, None where it could not be read then."""
    with TemporaryDirectory() as folder:
        path = _written(folder, subject, lines)
        try:
            return subject.read(path) if path else None
        except DataError:
            return None


def _written(folder: str, subject: Subject, lines: list[bytes]) -> Path | None:
    """A file of these lines by the name of the case's, None where there are none."""
    path = Path(folder) / _path(subject).name
    path.write_bytes(b"".join(lines))
    return path if lines else None


def _timed(streams: Streams) -> Streams:
    return {name: t for name, t in streams.items() if name not in APPENDED and "time" in t.column_names and t.num_rows}


def _last_time(streams: Streams) -> int:
    return max(int(time_ns(table)[-1]) for table in _timed(streams).values())
