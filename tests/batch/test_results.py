"""The results of a batch are one dataset, with exports beside them, and a summary."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from fleets import keys, results
from small_fleet import GOOD, rows, told

from recon.cli import main


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
