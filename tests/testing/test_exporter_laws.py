"""Each law of exporters, broken by an exporter that is right in everything else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from broken_laws import broken_laws

from recon import GNSS, DataError, Exporter, NothingToExport, Params, seconds, time_ns, vector
from recon.testing import Case


def written(gnss: pa.Table, folder: Path, factor: float = 1.0) -> Path:
    """One line for each row: time in ns and speed."""
    speeds = vector(gnss, "speed", gaps=True) * factor
    lines = [f"{t} {speed!r}\n" for t, speed in zip(time_ns(gnss).tolist(), speeds.tolist(), strict=True)]
    (folder / "gnss.txt").write_text("".join(lines), encoding="utf-8")
    return folder / "gnss.txt"


def read_back(paths: Sequence[Path]) -> Mapping[str, Mapping[str, Any]]:
    cells = [line.split() for line in paths[0].read_text(encoding="utf-8").splitlines()]
    return {"gnss": {"time": [int(t) for t, _ in cells], "speed": [float(speed) for _, speed in cells]}}


def right(*, gnss: pa.Table, folder: Path, about: object, params: Params) -> list[Path]:
    return [written(gnss, folder)]


def beside(*, gnss: pa.Table, folder: Path, about: object, params: Params) -> list[Path]:
    (folder.parent / "log.txt").write_text("done", encoding="utf-8")
    return [written(gnss, folder)]


def where_the_user_stands(*, gnss: pa.Table, folder: Path, about: object, params: Params) -> list[Path]:
    Path("notes.txt").write_text("mine now", encoding="utf-8")
    return [written(gnss, folder)]


def names_another(*, gnss: pa.Table, folder: Path, about: object, params: Params) -> list[Path]:
    return [written(gnss, folder), folder / "map.kml"]


def keeps_quiet(*, gnss: pa.Table, folder: Path, about: object, params: Params) -> list[Path]:
    (folder / "index.txt").write_text("gnss", encoding="utf-8")
    return [written(gnss, folder)]


def twice(*, gnss: pa.Table, folder: Path, about: object, params: Params) -> list[Path]:
    return [written(gnss, folder)] * 2


def in_kmh(*, gnss: pa.Table, folder: Path, about: object, params: Params) -> list[Path]:
    return [written(gnss, folder, 3.6)]


def from_the_first_row(*, streams: Mapping[str, pa.Table], folder: Path, about: object, params: Params) -> list[Path]:
    assert all(seconds(table)[0] == 0.0 for name, table in streams.items() if name != "metrics")
    return [written(streams["gnss"], folder)]


def finds_nothing(*, gnss: pa.Table, folder: Path, about: object, params: Params) -> list[Path]:
    if not np.isfinite(vector(gnss, "speed", gaps=True)).any():
        raise NothingToExport("no row of gnss has a speed")
    return [written(gnss, folder)]


def fails_without_a_speed(*, gnss: pa.Table, folder: Path, about: object, params: Params) -> list[Path]:
    if not np.isfinite(vector(gnss, "speed", gaps=True)).any():
        raise DataError("no row of gnss has a speed")
    return [written(gnss, folder)]


def exporter(run=right, **declared) -> Exporter:
    reads = {"gnss": GNSS.need("speed")}
    return Exporter(**{"name": "toy", "summary": "Times and speeds.", "run": run, "reads": reads, **declared})


def test_a_right_exporter_breaks_no_law():
    assert broken_laws(exporter(), Case(read_back=read_back)) == {}


def test_an_exporter_that_says_that_it_finds_nothing_to_show_breaks_no_law():
    assert broken_laws(exporter(finds_nothing), Case(read_back=read_back)) == {}


@pytest.mark.parametrize(
    ("run", "law", "words"),
    [
        (beside, "it_writes_only_inside_its_folder", "it touched log.txt, which is outside of its folder"),
        (keeps_quiet, "it_returns_what_it_wrote", "it wrote index.txt and did not return its path"),
        (twice, "it_returns_what_it_wrote", "it returns a file twice"),
        (
            fails_without_a_speed,
            "a_drive_with_nothing_to_show_is_told_from_an_error",
            "'gnss' without a row raised DataError: step exporter.toy: no row of gnss has a speed",
        ),
        (in_kmh, "files_read_back_to_the_same_numbers", "gnss.speed reads back with another value in row"),
    ],
)
def test_a_wrong_exporter_breaks_its_law_and_no_other(run, law: str, words: str):
    broken = broken_laws(exporter(run), Case(read_back=read_back))
    assert words in broken[law]
    assert broken.keys() == {law}


def test_a_file_in_the_working_directory_is_watched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    broken = broken_laws(exporter(where_the_user_stands), Case(read_back=read_back))
    assert "it touched notes.txt" in broken["it_writes_only_inside_its_folder"]


def test_a_file_that_is_not_there_breaks_its_law():
    broken = broken_laws(exporter(names_another), Case(read_back=read_back))
    assert "it did not write map.kml, which it names" in broken["it_returns_what_it_wrote"]


def test_an_exporter_that_needs_rows_everywhere_breaks_its_law():
    wrong = exporter(from_the_first_row, reads={}, every_stream=True)
    broken = broken_laws(wrong, Case(read_back=read_back))
    assert "without a row raised step exporter.toy: IndexError" in broken["empty_streams_are_written"]


def test_an_exporter_without_a_way_back_is_told_to_bring_one():
    broken = broken_laws(exporter())
    assert broken.keys() == {"files_read_back_to_the_same_numbers"}
    assert (
        "needs a way back: contract(..., cases=[Case(read_back=...)])"
        in (broken["files_read_back_to_the_same_numbers"])
    )


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({}, "nothing was read back"),
        ({"velocity": [1.0]}, "gnss.velocity reads back with a name that the stream does not have"),
        ({"speed": [1.0]}, "gnss.speed reads back with 1 rows in place of"),
        ({"time": np.zeros(328, dtype=np.int64)}, "gnss.time reads back with times that the stream does not have"),
    ],
)
def test_a_way_back_that_brings_something_else_breaks_the_law(columns: dict[str, Any], words: str):
    broken = broken_laws(exporter(), Case(read_back=lambda paths: {"gnss": columns}))
    assert words in broken["files_read_back_to_the_same_numbers"]
