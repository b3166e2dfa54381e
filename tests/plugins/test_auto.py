"""reader.auto: the reader that knows a file reads it; where none does, the user hears why."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

import pytest

import recon
import recon_readers.auto
import recon_readers.mcap
import recon_readers.parquet
import recon_readers.physycom
from recon import Reader, ReadFailed, Registry, Sniff
from recon.stages import EVERYTHING, Delegation
from recon.tables import Streams

HEADER = "# timestamp ax ay az\n"
ROWS = "".join(f"518716448.{tenth}\t0.1\t0.2\t1.0\n" for tenth in range(10))


def shipped() -> list[Reader]:
    modules = (recon_readers.mcap, recon_readers.parquet, recon_readers.physycom)
    return [record for module in modules for record in module.declare_readers()]


def read(path: Path, *more: Reader) -> Streams:
    return recon_readers.auto.auto(
        path=path, params=Delegation(), registry=Registry.of(*shipped(), *more), wanted=EVERYTHING
    )


def refusal(folder: Path, content: str | bytes, *more: Reader) -> ReadFailed:
    path = folder / "log.txt"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(ReadFailed) as caught:
        read(path, *more)
    return caught.value


def claiming(name: str, confidence: float, reason: str) -> Reader:
    def run(path: Path, params: object) -> Streams:
        raise AssertionError(path)

    return Reader(name=name, summary="Test.", run=run, sniff=lambda path, head: Sniff(confidence, reason), writes={})


def test_the_reader_that_knows_a_file_reads_it(tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_text(HEADER + ROWS)
    streams = read(tmp_path / "log.txt")
    assert streams["imu"].num_rows == 10
    (row,) = [row for row in streams["metrics"].to_pylist() if row["name"] == "reader"]
    assert (row["method"], row["value"]) == ("reader.physycom", 0.9)


def test_a_fault_in_the_first_rows_is_told_by_the_reader_that_knows_the_file(tmp_path: Path) -> None:
    error = refusal(tmp_path, HEADER + ROWS.replace("0.2", "abc", 1))
    assert (error.line, error.column) == (2, 17)
    assert error.what == "ay is 'abc', which is no number"
    assert error.hint == "repair the line or delete it"


@pytest.mark.parametrize(
    ("content", "what"),
    [
        pytest.param("", "the file is empty", id="empty"),
        pytest.param(HEADER, "it holds no rows", id="header only"),
        pytest.param(HEADER + ROWS.replace(".", ","), "'518716448,0' has a decimal comma", id="decimal commas"),
        pytest.param(
            HEADER + ROWS.replace("\t1.0", "\t1.0\t7", 1), "a row of 5 columns among rows of 4", id="wide row"
        ),
        pytest.param(
            HEADER + "1" * 70_000,
            "a row of 1 column, where tabs or spaces part 4, 10 or 14 columns",
            id="endless first row",
        ),
    ],
)
def test_a_file_of_a_known_format_is_refused_in_one_sentence(tmp_path: Path, content: str, what: str) -> None:
    error = refusal(tmp_path, content)
    assert error.what == what
    assert "\n" not in error.hint


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        pytest.param(ROWS.replace("\t", ","), "commas part the columns, not tabs or spaces", id="commas"),
        pytest.param(ROWS.replace("\t", ";"), "semicolons part the columns, not tabs or spaces", id="semicolons"),
        pytest.param(ROWS.replace("\t", "|"), "vertical bars part the columns, not tabs or spaces", id="bars"),
        pytest.param(
            "1" * 70_000, "a row of 1 column, where tabs or spaces part 4, 10 or 14 columns", id="endless row"
        ),
    ],
)
def test_where_no_reader_has_an_idea_each_tells_why_and_equal_reasons_are_told_once(
    tmp_path: Path, content: str | bytes, reason: str
) -> None:
    error = refusal(tmp_path, content)
    assert error.what == "no reader knows this file"
    assert error.hint.splitlines() == [
        "reader.mcap, reader.parquet: another magic number",
        f"  reader.physycom: {reason}",
        "  check that it is the right file; 'recon plugins' lists the readers that are installed",
    ]


@pytest.mark.parametrize(
    ("content", "kind", "advice"),
    [
        pytest.param(ROWS.encode("utf-16"), "UTF-16 text", "save it as UTF-8", id="UTF-16"),
        pytest.param(gzip.compress(ROWS.encode()), "packed by gzip", "unpack it", id="gzip"),
        pytest.param(b"PK\x05\x06" + bytes(18), "an empty zip archive", "pack the log again", id="empty zip"),
    ],
)
def test_what_is_known_not_to_be_a_log_is_told_in_one_sentence(
    tmp_path: Path, content: bytes, kind: str, advice: str
) -> None:
    error = refusal(tmp_path, content)
    assert error.what == f"no reader knows this file, which is {kind}"
    assert error.hint.startswith(advice)
    assert "\n" not in error.hint


def test_a_byte_order_mark_hides_no_format(tmp_path: Path) -> None:
    path = tmp_path / "drive.pos"
    path.write_text("\ufeff%  UTC  latitude(deg) longitude(deg)  height(m)\n2024/01/01 00:00:00 44.5 11.3 60.0\n")
    assert recon.read(path)["gnss"].num_rows == 1


def test_a_name_that_is_too_long_is_told_in_one_sentence() -> None:
    with pytest.raises(ReadFailed, match=r"cannot be read|no such file"):
        recon.read("a" * 300)


def test_a_reader_with_an_idea_of_the_file_is_heard_alone(tmp_path: Path) -> None:
    error = refusal(tmp_path, "prose", claiming("vague", 0.3, "words, perhaps of a log"))
    assert error.hint.splitlines()[:-1] == ["reader.vague: words, perhaps of a log"]


def test_a_reader_that_breaks_is_told_beside_the_others(tmp_path: Path) -> None:
    def broken(path: Path, head: bytes) -> Sniff:
        raise RuntimeError("oh")

    reader = Reader(name="broken", summary="Test.", run=lambda path, params: {}, sniff=broken, writes={})
    assert "reader.broken: RuntimeError: oh" in refusal(tmp_path, "prose", reader).hint


def test_two_that_are_equally_sure_are_named_with_a_way_out(tmp_path: Path) -> None:
    error = refusal(tmp_path, "prose", claiming("one", 0.8, "a"), claiming("two", 0.8, "b"))
    assert error.what == "reader.one and reader.two are equally sure of this file"
    assert "--no-plugin reader.two" in error.hint


def test_a_folder_of_logs_is_refused_as_a_folder(tmp_path: Path) -> None:
    with pytest.raises(ReadFailed, match="this folder is empty"):
        read(tmp_path)
    (tmp_path / "notes.md").write_text("prose")
    with pytest.raises(ReadFailed, match="this is a folder") as caught:
        read(tmp_path)
    assert caught.value.hint.startswith("name the log files in it")
    assert caught.value.hint.endswith("or the folder of a result of recon")


def test_the_logs_in_a_folder_are_named_where_it_is_none_itself(tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_text(HEADER + ROWS)
    (tmp_path / "notes.md").write_text("prose")
    (tmp_path / "empty.txt").touch()
    with pytest.raises(ReadFailed, match="this is a folder") as caught:
        read(tmp_path)
    assert caught.value.hint.endswith("the logs in it: log.txt (reader.physycom)")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ReadFailed, match="not a regular file"):
        read(tmp_path / "pipe")


@pytest.mark.parametrize(
    ("head", "kind", "advice"),
    [(b"\x89PNG\r\n\x1a\n", "a PNG image", "name the log"), (b"PK\x03\x04\x14\0", "a zip archive", "unpack it")],
)
def test_what_is_no_log_is_called_by_its_name(tmp_path: Path, head: bytes, kind: str, advice: str) -> None:
    path = tmp_path / "thing"
    path.write_bytes(head + bytes(range(256)))
    with pytest.raises(ReadFailed, match=f"which is {kind}") as caught:
        read(path)
    assert advice in caught.value.hint.splitlines()[-1]
