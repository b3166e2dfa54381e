"""What a batch file names: globs, lists, vehicles, parameters, and what is refused."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest
from fleets import keys, results
from small_fleet import GOOD, rows, told

from recon.cli import main


def test_a_name_that_no_folder_can_have_is_told_before_the_first_job(
    small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A letter that is not ASCII takes six to twelve bytes in the name of a partition."""
    (small.parent / "logs/A12" / f"{60 * 'é'}.txt").write_text("good 1", encoding="utf-8")
    assert main(["batch", str(small)]) == 2
    assert f"batch.yaml:4:10: error: the drive {40 * 'é'}..." in (said := capsys.readouterr().err)
    assert "has too long a name for a folder" in said
    assert not (small.parent / "results").exists()


def test_inputs_in_the_output_are_refused(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small.write_text(small.read_text(encoding="utf-8").replace("output: results", "output: logs"), encoding="utf-8")
    assert main(["batch", str(small), "--dry-run"]) == 2
    said = capsys.readouterr().err
    assert "batch.yaml:5:9: error: the input " in said
    assert "logs/A12/d0.txt lies in the output" in said


def test_what_is_set_for_a_vehicle_that_has_no_drive_is_told(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with small.open("a", encoding="utf-8") as file:
        file.write("vehicles:\n  A21: {reader.trouble: {rows: 60}}\n")
    assert main(["batch", str(small), "--dry-run"]) == 0
    assert "batch.yaml:8:8: warning: no input is of the vehicle 'A21'" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
def test_a_name_that_is_not_utf_8_is_told(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path(os.fsdecode(os.fsencode(small.parent / "logs/A12") + b"/caf\xe9.txt")).write_text("good 1", encoding="utf-8")
    assert main(["batch", str(small)]) == 2
    assert r"logs/*/*.txt cannot be listed: the name caf\xe9.txt in" in capsys.readouterr().err


def refused(small: Path, old: str, new: str, capsys: pytest.CaptureFixture[str]) -> str:
    """What is said of the batch file with one text in place of another."""
    text = small.read_text(encoding="utf-8")
    assert old in text
    small.write_text(text.replace(old, new), encoding="utf-8")
    assert main(["batch", str(small)]) == 2
    assert not (small.parent / "results").exists()
    return capsys.readouterr().err.replace(f"{small}:", "")


def test_a_glob_that_matches_nothing_is_told_at_its_place(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "4:10: error: nothing matches nowhere/*" in refused(small, "logs/*/*.txt", "nowhere/*", capsys)


def test_a_link_to_what_is_not_there_is_a_drive_that_cannot_be_read(small: Path, capsys) -> None:
    """As on a disk that is not mounted: such a drive is not passed over."""
    (small.parent / "logs" / "B7" / "gone.txt").symlink_to(small.parent / "nowhere.txt")
    assert main(["batch", str(small), "--json", "--executor", "serial"]) == 6
    (failure,) = json.loads(capsys.readouterr().out)["failures"]
    assert (failure["job"], failure["code"]) == ("vehicle=B7/drive=gone", "unreadable")
    assert failure["reason"].endswith("gone.txt: there is no such file or folder")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no named pipes in folders")
def test_a_pipe_that_a_glob_matches_is_a_drive_that_cannot_be_read(small: Path, capsys) -> None:
    os.mkfifo(small.parent / "logs" / "B7" / "pipe.txt")
    assert main(["batch", str(small), "--json", "--executor", "serial"]) == 6
    (failure,) = json.loads(capsys.readouterr().out)["failures"]
    assert (failure["job"], failure["code"]) == ("vehicle=B7/drive=pipe", "unreadable")
    assert failure["reason"].endswith("pipe.txt: this is a device or a pipe")


def test_a_link_to_a_folder_is_followed_but_not_without_end(small: Path, capsys) -> None:
    """Two links to the folder that they lie in are 2^40 ways, which a walk would follow until the memory is full."""
    logs = small.parent / "logs"
    for name in ("here", "there"):
        (logs / "B7" / name).symlink_to(".")
    (small.parent / "elsewhere").mkdir()
    (small.parent / "elsewhere" / "d9.txt").write_text("good 9", encoding="utf-8")
    (logs / "C1").symlink_to(small.parent / "elsewhere")
    small.write_text(small.read_text(encoding="utf-8").replace("logs/*/*.txt", "logs/**/*.txt"), encoding="utf-8")
    found = told(capsys, "batch", str(small), "--dry-run")["to_do"]
    assert {one["job"] for one in found} == keys({**GOOD, "C1/d9": ""})


def test_two_files_of_one_name_are_refused(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rule = "'logs/*/*.txt', vehicle: stem, drive: stem"
    assert "are both drive 'd0' of vehicle 'd0'" in refused(small, "'logs/*/*.txt'", rule, capsys)


def test_a_log_that_is_named_twice_is_told_so(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    twice = "'logs/*/*.txt'}, {glob: logs/A12/d0.txt"
    assert "d0.txt is named twice as drive 'd0' of vehicle 'A12'" in refused(small, "'logs/*/*.txt'", twice, capsys)


def test_an_override_that_fits_nowhere_is_told_before_the_first_job(
    small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    error = refused(small, "output:", "vehicles: {A12: {reader.trouble: {row: 3}}}\noutput:", capsys)
    assert "reader.trouble has no parameter 'row'; did you mean 'rows'?" in error


def test_a_pipeline_that_simulates_is_refused(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "makes its own data and reads no input" in refused(small, "short.yaml", "simulated_drive", capsys)


def test_a_regex_names_vehicle_and_drive(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rules = """'logs/**/*.txt', vehicle: 'logs/(?P<vehicle>.)', drive: 'd(?P<drive>\\d+)[.]txt'"""
    text = small.read_text(encoding="utf-8").replace("'logs/*/*.txt'", rules)
    small.write_text(text, encoding="utf-8")
    jobs = told(capsys, "batch", str(small), "--dry-run")["to_do"]
    assert {job["job"] for job in jobs} == keys(f"{vehicle}/{drive}" for vehicle in "AB" for drive in range(3))


def test_a_list_names_drives_that_need_not_lie_together(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = small.read_text(encoding="utf-8").replace("glob: 'logs/*/*.txt'", "list: drives.csv")
    small.write_text(text, encoding="utf-8")
    lines = ["drive,path,vehicle", "x/1,logs/A12/d0.txt,Ä", "2.,logs/none.txt,B"]
    (small.parent / "drives.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert main(["batch", str(small)]) == 6
    root = small.parent / "results"
    assert set(results(root)) == {"vehicle=%C3%84/drive=x%2F1"}
    found = {(row["vehicle"], row["drive"], row["code"]) for row in rows(root)}
    assert found == {("Ä", "x/1", None), ("B", "2.", "unreadable")}


def test_a_list_without_its_columns_is_refused(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (small.parent / "drives.csv").write_text("path,vehicle\n", encoding="utf-8")
    assert "drives.csv has no column drive" in refused(small, "glob: 'logs/*/*.txt'", "list: drives.csv", capsys)
