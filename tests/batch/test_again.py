"""A batch begun again does what is new or changed, and nothing else."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from fleets import keys, made, results
from small_fleet import GOOD, rows, told

from recon.cli import main


def test_what_is_done_is_not_done_again(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["batch", str(small)]) == 0
    root = small.parent / "results"
    before, jobs = made(root), (root / "jobs.parquet").stat().st_mtime_ns
    facts = told(capsys, "batch", str(small))
    assert (facts["done"], facts["done_before"]) == (0, len(GOOD))
    assert made(root) == before
    assert (root / "jobs.parquet").stat().st_mtime_ns == jobs


def test_a_changed_input_is_done_again_and_no_other(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["batch", str(small)]) == 0
    before = results(small.parent / "results")
    (small.parent / "logs/A12/d1.txt").write_text("good 77", encoding="utf-8")
    assert told(capsys, "batch", str(small))["done"] == 1
    after = results(small.parent / "results")
    assert {key for key in after if after[key] != before[key]} == {"vehicle=A12/drive=d1"}


def test_a_parameter_set_for_one_vehicle_does_its_drives_again(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["batch", str(small)]) == 0
    with small.open("a", encoding="utf-8") as file:
        file.write("vehicles:\n  B7: {reader.trouble: {rows: 60}}\n")
    assert told(capsys, "batch", str(small), "--dry-run")["done_before"] == 3
    assert told(capsys, "batch", str(small))["done"] == 3
    assert {(row["vehicle"], row["rows"]) for row in rows(small.parent / "results")} == {("A12", 50), ("B7", 60)}


def test_a_result_without_its_manifest_is_made_again(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["batch", str(small)]) == 0
    shutil.rmtree(small.parent / "results/vehicle=B7/drive=d0")
    assert told(capsys, "batch", str(small))["done"] == 1
    assert set(results(small.parent / "results")) == keys(GOOD)


def test_verify_finds_a_damaged_result(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["batch", str(small)]) == 0
    damaged = small.parent / "results/vehicle=B7/drive=d0/streams/imu.parquet"
    damaged.write_bytes(damaged.read_bytes()[:-1] + b"?")
    assert told(capsys, "batch", str(small))["done"] == 0
    assert told(capsys, "batch", str(small), "--verify")["done"] == 1
    assert told(capsys, "batch", str(small), "--verify")["done"] == 0


def test_resume_false_does_all_again(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["batch", str(small)]) == 0
    with small.open("a", encoding="utf-8") as file:
        file.write("resume: false\n")
    assert told(capsys, "batch", str(small))["done"] == len(GOOD)


def test_one_vehicle_leaves_the_others_as_they_are(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (small.parent / "logs/B7/d0.txt").write_text("raise 0", encoding="utf-8")
    assert main(["batch", str(small)]) == 6
    (small.parent / "logs/A12/d0.txt").write_text("good 8", encoding="utf-8")
    assert told(capsys, "batch", str(small), "--only", "A12")["done"] == 1
    assert [row["code"] for row in rows(small.parent / "results") if row["status"] == "failed"] == ["stage_failed"]
    assert main(["batch", str(small), "--only", "C"]) == 2
    assert "no input is of the vehicle 'C'; there are A12, B7" in capsys.readouterr().err.replace("\n  ", "; ")


def test_a_dry_run_leaves_nothing(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    facts = told(capsys, "batch", str(small), "--dry-run")
    assert {job["job"] for job in facts["to_do"]} == keys(GOOD)
    assert not (small.parent / "results").exists()
