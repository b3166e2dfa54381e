"""`recon batch`: what is done once stays done, what is wrong is told, and the result is a dataset."""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from fleets import BATCH, finish, fleet, keys, made, results

from recon.cli import main
from recon.fleet.root import SUPERSEDED

GOOD = {f"{vehicle}/d{number}": f"good {number + 1}" for vehicle in ("A12", "B7") for number in range(3)}


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A batch file over good drives, run in this process."""
    file = fleet(tmp_path, GOOD, BATCH.replace("executor.local, params: {workers: 3}", "executor.serial"))
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    return file


def rows(root: Path) -> list[dict]:
    """Rows of jobs.parquet, but for the times, which have more digits than Python's."""
    return pq.read_table(root / "jobs.parquet").drop_columns(["modified", "started"]).to_pylist()


def told(capsys: pytest.CaptureFixture[str], *words: str) -> dict:
    capsys.readouterr()
    assert main([*words, "--json"]) in (0, 6)
    return json.loads(capsys.readouterr().out)


# --- results --------------------------------------------------------------------------------------------------------


def test_every_drive_has_a_whole_result_in_its_partition(small: Path) -> None:
    assert main(["batch", str(small)]) == 0
    root = small.parent / "results"
    assert set(results(root)) == keys(GOOD)
    assert not (root / ".scratch").exists()


def test_jobs_events_and_metrics_are_compacted(small: Path) -> None:
    assert main(["batch", str(small)]) == 0
    root = small.parent / "results"
    jobs = rows(root)
    assert [(row["vehicle"], row["drive"]) for row in jobs] == [tuple(name.split("/")) for name in GOOD]
    assert {(row["status"], row["pipeline"], row["rows"]) for row in jobs} == {("ok", "short", 50)}
    folders = [root / f"vehicle={row['vehicle']}" / f"drive={row['drive']}" / "streams" for row in jobs]
    for name in ("events", "metrics"):
        kept = [folder / f"{name}.parquet" for folder in folders if (folder / f"{name}.parquet").is_file()]
        assert pq.read_metadata(root / f"{name}.parquet").num_rows == sum(
            pq.read_metadata(path).num_rows for path in kept
        )


def test_the_root_is_a_dataset_of_hive_partitions(small: Path) -> None:
    from pyarrow.dataset import dataset

    assert main(["batch", str(small)]) == 0
    files = [str(path) for path in sorted((small.parent / "results").glob("vehicle=*/drive=*/streams/imu.parquet"))]
    found = dataset(files, partitioning="hive", partition_base_dir=str(small.parent / "results")).to_table()
    assert found.num_rows == 50 * len(GOOD)
    assert set(found["vehicle"].to_pylist()) == {"A12", "B7"}


# --- again ----------------------------------------------------------------------------------------------------------


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


def test_exports_come_with_the_result(small: Path) -> None:
    with small.open("a", encoding="utf-8") as file:
        file.write("exports: [csv]\n")
    assert main(["batch", str(small)]) == 0
    root = small.parent / "results"
    assert all((root / key / "exports/csv/export.json").is_file() for key in keys(GOOD))


def test_a_drive_in_which_an_export_finds_nothing_to_show_is_done_without_it(small: Path) -> None:
    """These drives have no place on the Earth: what was reconstructed is not thrown away for want of a map."""
    with small.open("a", encoding="utf-8") as file:
        file.write("exports: [map, csv]\n")
    assert main(["batch", str(small)]) == 0
    for key in keys(GOOD):
        folder = small.parent / "results" / key
        assert [path.name for path in (folder / "exports").iterdir()] == ["csv"]
        told = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))["environment"]["job"]
        assert "exporter.map: no row of trajectory or gnss has a latitude" in told["exports_left_out"]
    found = rows(small.parent / "results")
    assert {(row["status"], row["reason"].partition(":")[0]) for row in found} == {("ok", "step exporter.map")}


def test_an_export_that_was_told_to_use_what_is_not_there_fails_the_drive(small: Path) -> None:
    with small.open("a", encoding="utf-8") as file:
        file.write("exports: [map, csv]\ndefaults: {exporter.csv: {streams: [imu_3]}}\n")
    assert main(["batch", str(small)]) == 6
    root = small.parent / "results"
    found = {(row["code"], row["reason"], row["hint"]) for row in rows(root)}
    assert found == {("bad_data", "step exporter.csv: there is no stream 'imu_3'", "did you mean 'imu'?")}
    assert not results(root)


# --- failures -------------------------------------------------------------------------------------------------------


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


# --- what a batch file names ----------------------------------------------------------------------------------------


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


# --- summary --------------------------------------------------------------------------------------------------------


def test_the_summary_counts_drives_and_failures(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (small.parent / "logs/A12/d1.txt").write_text("short 0", encoding="utf-8")
    assert main(["batch", str(small)]) == 6
    root = str(small.parent / "results")
    facts = told(capsys, "fleet", "summary", root)
    assert (facts["drives"], facts["done"], facts["vehicles"]) == (6, 5, 2)
    assert facts["failures"] == {"not_enough_data": 1}
    assert main(["fleet", "summary", root]) == 0
    assert "6 of 2 vehicles: 5 done, 1 failed" in capsys.readouterr().out


def test_a_folder_without_jobs_has_no_summary(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fleet", "summary", str(tmp_path)]) == 4
    assert "name the output of a batch" in capsys.readouterr().err
