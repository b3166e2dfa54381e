"""Files that are no Physycom log are refused, by line and column."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from physycom_logs import (
    GOOD,
    HEAD,
    RECORDS,
    T0,
    counts,
    motion,
    read_text,
    refusal,
    text_of,
)

from recon.errors import DataError, ReadFailed
from recon_readers.physycom import PhysycomParams, read


@pytest.mark.parametrize(
    ("bad", "line", "column", "says"),
    [
        pytest.param(GOOD.replace("0.2", "oops", 1), 2, 17, "ay is 'oops'", id="text for a number"),
        pytest.param(GOOD.replace("0.1\t", "0,1\t", 1), 2, 13, "decimal comma", id="decimal comma"),
        pytest.param(GOOD.replace(f"{T0}.1", "12:30:00"), 3, 1, "time is '12:30:00'", id="another time"),
        pytest.param(GOOD.replace("\t", ","), 2, None, "commas", id="commas"),
        pytest.param(GOOD.replace("\t", ";"), 2, None, "semicolons", id="semicolons"),
        pytest.param(GOOD.replace("0.2\t", "", 1), 2, None, "3 columns among rows of 4", id="too few columns"),
        pytest.param(GOOD.replace("0.2\t", "0.2\t7\t", 1), 2, None, "5 columns among rows of 4", id="too many columns"),
        pytest.param(GOOD.replace("\t1.0", "\t1\t2\t3"), 2, None, "6 columns", id="unknown width"),
        pytest.param(GOOD.replace("0.2", "inf", 1), 2, 17, "inf lies outside", id="infinity"),
        pytest.param(GOOD.replace(f"{T0}.1", "99999999999.1"), 3, 1, "time lies outside", id="time beyond 2100"),
        pytest.param(GOOD.replace(f"{T0}.1", "9" * 25), 3, 1, "time lies outside|no number", id="absurd time"),
        pytest.param(GOOD.replace(f"{T0}.1", ""), 3, 1, "time is missing", id="no time"),
        pytest.param("", None, None, "no rows", id="no rows"),
        pytest.param(f"{T0}.0\t0.1", 2, None, "3 columns|2 columns|cut off", id="nothing but a cut row"),
    ],
)
def test_a_bad_line_is_refused_by_line_and_column(
    tmp_path: Path, bad: str, line: int | None, column: int | None, says: str
) -> None:
    error = refusal(tmp_path, HEAD + bad)
    assert (error.line, error.column) == (line, column)
    assert any(part in error.message for part in says.split("|"))


@pytest.mark.parametrize("width", [14])
def test_a_latitude_beyond_the_pole_is_refused(tmp_path: Path, width: int) -> None:
    rows = motion(50)
    rows[20, 1] = 90.5
    error = refusal(tmp_path, text_of(rows))
    assert error.line == 22
    assert "lat 90.5 lies outside -90 to 90 deg" in error.message


def test_line_numbers_count_comments_and_blank_lines(tmp_path: Path) -> None:
    lines = GOOD.splitlines()
    text = "\n".join(["# a", "", "# b", lines[0], "", "# c", lines[1], lines[2].replace("0.2", "x"), lines[2]])
    error = refusal(tmp_path, text + "\n", sensor="accelerometer")
    assert (error.line, error.column) == (8, 17)


def test_a_header_with_columns_in_another_order_is_refused(tmp_path: Path) -> None:
    rows = motion(20, place=False)
    error = refusal(tmp_path, text_of(rows, header="# timestamp ax ay az speed gx gy gz |a| timestamp_rel"))
    assert "column 2 ax, where the format inertial has speed" in error.message


@pytest.mark.parametrize(
    ("content", "says"),
    [
        pytest.param(b"", "empty", id="empty"),
        pytest.param(b" \n\n", "nothing but blanks", id="blank"),
        pytest.param(bytes(1000), "empty|not a text", id="zeros"),
        pytest.param(np.random.default_rng(3).bytes(5000), "not a text", id="random bytes"),
        pytest.param((HEAD + GOOD).encode("utf-16"), "UTF-16", id="utf-16"),
        pytest.param((HEAD + GOOD).encode("utf-16-be"), "UTF-16", id="utf-16 without mark"),
        pytest.param(b"It was a dark night.\n" * 500, "no number", id="prose"),
        pytest.param(b"7" * 3_000_000, "columns", id="one endless line"),
        pytest.param(b"[" * 200_000, "JSON|nested", id="endless brackets"),
    ],
)
def test_what_is_no_table_is_refused_in_one_sentence(tmp_path: Path, content: bytes, says: str) -> None:
    assert any(part in refusal(tmp_path, content).message for part in says.split("|"))


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ReadFailed, match="No such file"):
        read(path=tmp_path / "absent.txt", params=PhysycomParams())
    with pytest.raises(ReadFailed, match="folder"):
        read(path=tmp_path, params=PhysycomParams())


@pytest.mark.parametrize("seed", range(8))
def test_damaged_files_are_read_or_refused_and_never_crash(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pieces = [b"\t", b"\n", b" ", b",", b"#", b"nan", b"inf", b"1e999", b"\0", b"\xff", b"\r", b'"', b"9" * 40, b"["]
    sound = [text_of(motion(40)).encode(), text_of(motion(40, place=False)).encode(), json.dumps(RECORDS).encode()]
    for number in range(100):
        damaged = bytearray(sound[number % 3])
        for _ in range(rng.integers(1, 5)):
            start = int(rng.integers(0, len(damaged)))
            stop = start + int(rng.integers(0, 60))
            piece = pieces[rng.integers(len(pieces))]
            damaged[start:stop] = (b"", piece, rng.bytes(stop - start), damaged[:stop])[rng.integers(4)]
        with suppress(DataError):
            read_rows, used, dropped = counts(read_text(tmp_path, bytes(damaged)))
            assert read_rows == used + dropped
