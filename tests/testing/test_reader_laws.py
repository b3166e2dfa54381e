"""Each law of readers, broken by a reader of a toy format that is right in everything else."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from broken_laws import broken_laws

from recon import GNSS, Reader, ReadFailed, Schema, Sniff, Streams, build
from recon.parameters import NoParams
from recon.schema import Column
from recon.testing import Case

HEAD = b"toy log"
"""The first line; then on each line seconds since 1970 and speed in m/s."""


@pytest.fixture
def case(tmp_path: Path) -> Case:
    lines = "".join(f"{1_700_000_000 + row} {row % 9}.25\n" for row in range(60))
    (tmp_path / "drive.toy").write_bytes(HEAD + b"\n" + lines.encode())
    return Case(path=tmp_path / "drive.toy")


def sniff(path: Path, head: bytes) -> Sniff:
    return Sniff(1.0 if head.startswith(HEAD) else 0.0, "its first line")


def rows(path: Path, *, rising: bool = True) -> np.ndarray:
    """(n, 2) s and m/s; a last line that was cut off is left out, as is a line whose time does not rise."""
    head, *lines = path.read_bytes().split(b"\n")
    if head != HEAD:
        raise ReadFailed(path, "this is no toy log", line=1)
    found = [(0.0, 0.0)]
    for number, line in enumerate(lines[:-1], start=2):
        try:
            t_s, speed = map(float, line.split())
        except ValueError:
            raise ReadFailed(path, "two numbers are wanted", line=number) from None
        if not 0.0 <= t_s < 4e9 or not math.isfinite(speed):
            raise ReadFailed(path, "out of range", line=number)
        if t_s > found[-1][0] or not rising:
            found.append((t_s, speed))
    return np.array(found[1:]).reshape(-1, 2)


def gnss(values: np.ndarray) -> Streams:
    return {"gnss": build(GNSS.only("speed"), time=np.rint(values[:, 0] * 1e9).astype(np.int64), speed=values[:, 1])}


def right(path: Path, params: NoParams) -> Streams:
    return gnss(rows(path))


def bare(path: Path, params: NoParams) -> Streams:
    stream = right(path, params)["gnss"]
    return {"gnss": pa.table(dict(zip(stream.column_names, stream.columns, strict=True)))}


def in_kmh(path: Path, params: NoParams) -> Streams:
    stream = right(path, params)["gnss"]
    other = Schema((GNSS["time"], Column("speed", "km/h", quantity="speed")))
    return {"gnss": build(other, **{name: stream[name] for name in stream.column_names})}


def with_force(path: Path, params: NoParams) -> Streams:
    values = rows(path)
    force = np.column_stack([values[:, 1]] * 3)
    return {**gnss(values), "force": build(FORCE, time=np.rint(values[:, 0] * 1e9).astype(np.int64), force=force)}


def careless(path: Path, params: NoParams) -> Streams:
    for line in path.read_bytes().split(b"\n")[1:]:
        if line:
            line.split()[1]
    return right(path, params)


def placeless(path: Path, params: NoParams) -> Streams:
    if not path.read_bytes().endswith(b"\n"):
        raise ReadFailed(path, "the file was cut short")
    return right(path, params)


def of_text(path: Path, params: NoParams) -> Streams:
    path.read_text(encoding="utf-8")
    return right(path, params)


def trusting(path: Path, params: NoParams) -> Streams:
    return gnss(rows(path, rising=False))


def on_a_grid(path: Path, params: NoParams) -> Streams:
    values = rows(path)
    if not len(values):
        return gnss(values)
    grid = np.arange(values[0, 0], values[-1, 0] + 0.5)
    return gnss(np.column_stack([grid, np.interp(grid, *values.T)]))


def about_its_mean(path: Path, params: NoParams) -> Streams:
    values = rows(path)
    return gnss(values - [0.0, values[:, 1].mean() if len(values) else 0.0])


def reader(run=right, **declared) -> Reader:
    summary = "Toy logs."
    writes = {"gnss": GNSS.only("speed")}
    return Reader(**{"name": "toy", "summary": summary, "run": run, "sniff": sniff, "writes": writes, **declared})


def lines(path: Path, params: NoParams, stream: str, t_ns: np.ndarray) -> np.ndarray:
    own = np.rint(rows(path)[:, 0] * 1e9).astype(np.int64)
    at = np.searchsorted(own, t_ns).clip(max=len(own) - 1)
    return np.where(own[at] == t_ns, at + 2, 0)


def off_by_the_head(path: Path, params: NoParams, stream: str, t_ns: np.ndarray) -> np.ndarray:
    return np.searchsorted(np.rint(rows(path)[:, 0] * 1e9).astype(np.int64), t_ns) + 1


def always_the_first(path: Path, params: NoParams, stream: str, t_ns: np.ndarray) -> np.ndarray:
    return np.ones(len(t_ns), dtype=np.int64)


def unsure(path: Path, head: bytes) -> Sniff:
    return Sniff(0.4, "its first line")


def silent(path: Path, head: bytes) -> Sniff:
    return Sniff(sniff(path, head).confidence, "")


def greedy(path: Path, head: bytes) -> Sniff:
    return Sniff(1.0, "everything is a toy")


def likes_tables(path: Path, head: bytes) -> Sniff:
    return Sniff(float(head.startswith((HEAD, b"day,"))), "its first line")


FORCE = Schema((GNSS["time"], *(Column(f"force_{axis}", "N") for axis in "xyz")))


def test_a_right_reader_breaks_no_law(case: Case):
    assert broken_laws(reader(), case) == {}
    assert broken_laws(reader(lines=lines), case) == {}


@pytest.mark.parametrize(
    ("wrong", "law", "words"),
    [
        (
            reader(bare, self_describing=True),
            "columns_carry_units_frames_and_quantities",
            "gnss.time names no quantity",
        ),
        (
            reader(in_kmh, self_describing=True),
            "columns_carry_units_frames_and_quantities",
            "gnss.speed is declared in km/h; it must be in m/s",
        ),
        (
            reader(with_force, writes={"gnss": GNSS.only("speed"), "force": FORCE}),
            "columns_carry_units_frames_and_quantities",
            "force.force_x is part of a vector and names no frame",
        ),
        (reader(placeless), "a_cut_file_gives_rows_or_read_failed", "raised ReadFailed without the line"),
        (
            reader(of_text),
            "damaged_bytes_give_rows_or_read_failed",
            "damaged raised step reader.toy: UnicodeDecodeError",
        ),
        (reader(trusting), "wrong_times_in_a_file_give_rows_or_read_failed", "every tenth line twice raised step"),
        (reader(on_a_grid), "a_gap_in_the_file_stays_a_gap", "lines 25 to 42 were taken out of the file, yet 'gnss'"),
        (
            reader(about_its_mean),
            "later_lines_leave_the_first_rows_as_they_are",
            "must not correct, smooth or resample",
        ),
        (
            reader(lines=off_by_the_head),
            "lines_that_it_tells_are_those_of_its_rows",
            "a time that no row of 'gnss' has is told to stand in line",
        ),
        (
            reader(lines=always_the_first),
            "lines_that_it_tells_are_those_of_its_rows",
            "rows of 'gnss' that follow each other stand in lines that do not",
        ),
        (reader(sniff=unsure), "it_knows_its_own_file", "it is 0.4 sure of its own file drive.toy"),
        (reader(sniff=silent), "it_knows_its_own_file", "it does not say why it knows drive.toy"),
        (reader(sniff=greedy), "it_leaves_files_of_others_alone", "it is 1 sure of a physycom log, which belongs to"),
        (reader(sniff=likes_tables), "it_leaves_files_of_others_alone", "sure of a CSV table of no sensor, and cannot"),
    ],
)
def test_a_wrong_reader_breaks_its_law_and_no_other(case: Case, wrong: Reader, law: str, words: str):
    broken = broken_laws(wrong, case)
    assert words in broken[law]
    assert broken.keys() == {law}


def test_a_reader_that_stumbles_over_a_cut_line_breaks_its_law(case: Case):
    broken = broken_laws(reader(careless), case)
    assert "raised step reader.toy: IndexError" in broken["a_cut_file_gives_rows_or_read_failed"]


def test_a_reader_without_a_file_is_told_to_bring_one():
    assert "reader.toy needs a file: contract(..., cases=[Case(path=...)])" in broken_laws(reader())["times_rise"]
