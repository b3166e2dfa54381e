"""A drive that fails ends alone, with its reason, and no good one suffers."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from fleets import BATCH, finish, fleet, keys, results
from small_fleet import GOOD, rows, told

from recon.cli import main
from recon.fleet.root import SUPERSEDED


def test_on_error_stop_stops_at_the_first_failure(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (small.parent / "logs/A12/d1.txt").write_text("raise 0", encoding="utf-8")
    with small.open("a", encoding="utf-8") as file:
        file.write("on_error: stop\n")
    facts = told(capsys, "batch", str(small))
    assert (facts["done"], facts["failed"], facts["stopped"]) == (1, 1, True)
    assert [row["status"] for row in rows(small.parent / "results")] == ["ok", "failed"]


def test_a_mended_drive_is_no_failure_any_more(small: Path) -> None:
    (small.parent / "logs/A12/d1.txt").write_text("short 0", encoding="utf-8")
    assert main(["batch", str(small)]) == 6
    (failed,) = [row for row in rows(small.parent / "results") if row["status"] == "failed"]
    assert (failed["code"], failed["reason"]) == (
        "not_enough_data",
        "step reader.trouble: not enough imu: needs 10 s, found 1 s",
    )
    (small.parent / "logs/A12/d1.txt").write_text("good 5", encoding="utf-8")
    assert main(["batch", str(small)]) == 0
    assert {row["status"] for row in rows(small.parent / "results")} == {"ok"}


def test_a_result_that_cannot_be_made_anew_leaves_the_dataset(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["batch", str(small)]) == 0
    root = small.parent / "results"
    older = results(root)["vehicle=A12/drive=d1"]
    (small.parent / "logs/A12/d1.txt").write_text("raise 0", encoding="utf-8")
    assert told(capsys, "batch", str(small))["superseded"] == 1
    failed = {(row["vehicle"], row["drive"]) for row in rows(root) if row["status"] == "failed"}
    assert failed == {("A12", "d1")}
    for name in ("events", "metrics"):
        found = pq.read_table(root / f"{name}.parquet", columns=["vehicle", "drive"]).to_pylist()
        assert not failed & {(row["vehicle"], row["drive"]) for row in found}
    assert set(results(root)) == keys(GOOD) - {"vehicle=A12/drive=d1"}
    assert len(list(root.glob("vehicle=*/drive=*/streams/imu.parquet"))) == len(GOOD) - 1
    assert results(root / SUPERSEDED) == {"vehicle=A12/drive=d1": older}
    assert told(capsys, "batch", str(small))["superseded"] == 0


def test_every_bad_drive_has_its_reason_and_every_good_one_its_result(tmp_path: Path) -> None:
    calm = fleet(tmp_path / "calm", GOOD)
    assert finish(calm)[0] == 0
    bad = {
        "short": "not_enough_data",
        "raise": "stage_failed",
        "kill": "died",
        "sleep": "timed_out",
        "eat": "out_of_memory",
        "change": "input_changed",
    }
    drives = {**GOOD, **{f"C/{what}": f"{what} 1" for what in bad}, "C/corrupt": "\0\1\2", "C/empty": ""}
    file = fleet(tmp_path / "bad", drives, BATCH + "timeout: 15 s\nmemory: 1 GB\n")
    code, _, errors = finish(file)
    assert code == 6, errors
    root = file.parent / "results"
    assert results(root) == results(calm.parent / "results")
    failed = {row["drive"]: row["code"] for row in rows(root) if row["status"] == "failed"}
    assert failed == {**bad, "corrupt": "stage_failed", "empty": "stage_failed"}
    assert all(row["reason"] for row in rows(root) if row["status"] == "failed")
    assert not (root / ".scratch").exists()


def test_what_a_stage_raises_is_told_as_text_that_every_program_reads(tmp_path: Path) -> None:
    file = fleet(tmp_path, {"A/good": "ok 1", "A/garble": "garble 1"})
    code, _, errors = finish(file)
    assert code == 6, errors
    reasons = {row["drive"]: row["reason"] or "" for row in rows(file.parent / "results")}
    assert reasons["garble"].startswith(r"step reader.trouble: RuntimeError: no \xff wheel !!!")
    assert len(reasons["garble"]) < 1100


def test_a_process_that_dies_behind_its_result_costs_the_drive_nothing(tmp_path: Path) -> None:
    file = fleet(tmp_path, {"A/good": "ok 1", "A/late": "late 1"})
    code, out, errors = finish(file, "--json")
    assert code == 0, errors
    told = json.loads(out)
    assert (told["done"], told["superseded"]) == (2, 0)
    assert set(results(file.parent / "results")) == {"vehicle=A/drive=good", "vehicle=A/drive=late"}
    assert {row["status"] for row in rows(file.parent / "results")} == {"ok"}


def test_what_may_go_well_another_time_is_tried_again(tmp_path: Path) -> None:
    drives = {**GOOD, "C/once": "once 1", "C/kill": "kill 1", "C/short": "short 1"}
    file = fleet(tmp_path, drives, BATCH + "retries: 1\n")
    code, out, errors = finish(file, "--json", "--log-json")
    assert code == 6
    failures = {failure["job"]: failure["code"] for failure in json.loads(out)["failures"]}
    assert failures == {"vehicle=C/drive=kill": "died", "vehicle=C/drive=short": "not_enough_data"}
    lines = [json.loads(line) for line in errors.splitlines()]
    assert lines[0] == {**lines[0], "total": 9, "ended": 0}
    assert [line["ended"] for line in lines] == list(range(10))


def test_failures_are_told_where_the_record_of_them_cannot_be_written(tmp_path: Path) -> None:
    file = fleet(tmp_path, {**GOOD, "C/raise": "raise 1", "C/short": "short 1"})
    record = file.parent / "results/jobs.parquet"
    record.mkdir(parents=True)
    code, out, errors = finish(file, "--json")
    assert code == 8
    facts = json.loads(out)
    failed = {one["job"]: one["code"] for one in facts["failures"]}
    assert (facts["done"], facts["recorded"]) == (len(GOOD), False)
    assert failed == {"vehicle=C/drive=raise": "stage_failed", "vehicle=C/drive=short": "not_enough_data"}
    assert f"{record} could not be written" in errors
    record.rmdir()
    code, out, _ = finish(file, "--json")
    assert (code, json.loads(out)["done_before"], json.loads(out)["recorded"]) == (6, len(GOOD), True)
    assert {row["drive"] for row in rows(file.parent / "results") if row["status"] == "failed"} == {"raise", "short"}
