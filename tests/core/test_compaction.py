"""The three files of a fleet: what they tell is what the results tell, however much of it was taken over."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from recon.fleet import compaction
from recon.fleet.compacted import NAMES, TOKEN, failed_before, is_settled, read_index
from recon.fleet.compaction import compact
from recon.fleet.inputs import key_of
from recon.fleet.places import Place
from recon.fleet.root import Root, root_of
from recon.rows import Event, events
from recon.schema import by_step
from recon.storage.parquet import write_file
from recon.tables import build

DRIVES = [(vehicle, f"d{number}") for vehicle in ("A 1", "B=2", "C%203") for number in range(6)]


def put(root: Root, vehicle: str, drive: str, version: int, metrics: int = 2, happened: int = 1) -> Path:
    """A result as a batch leaves it: its manifest, and its events where it has any."""
    folder = Path(root.place.path) / key_of(vehicle, drive)
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "streams").mkdir(parents=True)
    if happened:
        stops = [Event(number, number + 1, "standstill", float(version)) for number in range(happened)]
        found = events(stops)
        columns = {name: found[name] for name in found.column_names}
        whole = build(by_step("events"), step=pa.array(["x"] * happened), **columns)
        write_file(whole, folder / "streams/events.parquet")
    learnt = [{"name": f"m{number}", "value": float(version)} for number in range(metrics)]
    manifest = {
        "made_of": f"{version:064d}",
        "recon_manifest": 1,
        "recon": "1",
        "pipeline": {"name": "p"},
        "plan": [{"distribution": "d", "distribution_version": "1"}],
        "steps": [{"id": "x", "rows": {"imu": version, "events": happened}, "metrics": learnt}],
        "warnings": [],
        "store": "parquet",
        "environment": {"started": "2026-01-01T00:00:00+00:00", "seconds": float(version), "job": {}},
    }
    path = folder / "manifest.json"
    path.write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
    return path


def compacted(root: Root, failures: dict[str, dict[str, Any]] | None = None) -> dict[str, pa.Table]:
    compact(root, read_index(root), failures or {})
    return {name: pq.read_table(Path(root.place.path) / f"{name}.parquet") for name in NAMES}


def failure(vehicle: str, drive: str) -> dict[str, Any]:
    return {"vehicle": vehicle, "drive": drive, "status": "failed", "code": "died", "reason": "it died"}


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Root:
    monkeypatch.setattr(compaction, "_CHUNK", 4)
    return root_of(Place.of(str(tmp_path)))


@pytest.mark.parametrize("seed", range(8))
def test_what_is_taken_over_is_what_would_be_read(root: Root, seed: int) -> None:
    """Results come, change, go and fail at random; beside it the same from nothing."""
    rng = np.random.default_rng(seed)
    for version in range(6):
        failures = {}
        for vehicle, drive in DRIVES:
            fate, key = rng.choice(["stays", "stays", "made", "goes", "fails"]), key_of(vehicle, drive)
            if fate == "made":
                put(root, vehicle, drive, version, int(rng.integers(0, 4)), int(rng.integers(0, 3)))
            elif fate in ("goes", "fails"):
                shutil.rmtree(Path(root.place.path) / key, ignore_errors=True)
            if fate == "fails":
                failures[key] = failure(vehicle, drive)
        taken_over = compacted(root, failures)
        for name in NAMES:
            (Path(root.place.path) / f"{name}.parquet").unlink()
        anew = compacted(root, failures)
        for name in NAMES:
            assert taken_over[name].equals(anew[name])


def test_a_manifest_that_is_as_it_was_is_not_read_again(root: Root) -> None:
    path = put(root, "A", "d0", 1)
    put(root, "A", "d1", 1)
    compacted(root)
    before = path.stat()
    path.write_text(path.read_text(encoding="utf-8").replace('"seconds": 1.0', '"seconds": 7.0'), encoding="utf-8")
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    put(root, "A", "d1", 2)
    assert compacted(root)["jobs"]["seconds"].to_pylist() == [1.0, 2.0]
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns + 1))
    assert compacted(root)["jobs"]["seconds"].to_pylist() == [7.0, 2.0]


def test_files_that_tell_all_are_left_as_they_are(root: Root) -> None:
    put(root, "A", "d0", 1)
    failures = {key_of("A", "d1"): failure("A", "d1")}
    compacted(root, failures)
    file = Path(root.place.path) / "jobs.parquet"
    before = file.stat().st_mtime_ns
    index = read_index(root)
    compact(root, index, failed_before(root))
    assert file.stat().st_mtime_ns == before
    compact(root, index, {})
    assert file.stat().st_mtime_ns != before


def test_a_drive_with_a_result_has_not_failed(root: Root) -> None:
    """A batch that was killed after it had mended the drive leaves both behind."""
    put(root, "A", "d0", 1)
    assert compacted(root, {key_of("A", "d0"): failure("A", "d0")})["jobs"]["status"].to_pylist() == ["ok"]


@pytest.mark.parametrize("moved", [["metrics"], ["metrics", "events"]])
def test_a_batch_that_died_while_it_put_the_files_in_place_costs_nothing(root: Root, moved: list[str]) -> None:
    """They are moved one by one, jobs.parquet last."""
    put(root, "A", "d0", 1, metrics=3)
    put(root, "A", "d1", 1, metrics=1)
    older = {name: (Path(root.place.path) / f"{name}.parquet") for name in NAMES}
    compacted(root)
    before = {name: path.read_bytes() for name, path in older.items()}
    put(root, "A", "d0", 2, metrics=1)
    put(root, "A", "d1", 2, metrics=3)
    whole = compacted(root)
    for name in set(NAMES) - set(moved):
        older[name].write_bytes(before[name])
    again = compacted(root)
    assert all(again[name].equals(whole[name]) for name in NAMES)


@pytest.mark.parametrize("harm", ["gone", "cut", "of another compaction", "of another recon"])
def test_files_that_do_not_belong_together_are_made_from_the_results(root: Root, harm: str) -> None:
    put(root, "A", "d0", 1, metrics=3)
    whole = compacted(root)
    file = Path(root.place.path) / "metrics.parquet"
    if harm == "gone":
        file.unlink()
    elif harm == "cut":
        file.write_bytes(file.read_bytes()[:-5])
    elif harm == "of another compaction":
        pq.write_table(whole["metrics"].replace_schema_metadata({TOKEN: b"other"}), file)
    else:
        pq.write_table(whole["metrics"].append_column("mood", pa.array(["good"] * 3)), file)
    assert not read_index(root).rows
    assert compacted(root)["metrics"].equals(whole["metrics"])


def test_a_time_of_a_coarse_clock_is_relied_on_when_it_has_gone_on() -> None:
    now = 1_700_000_000_500_000_000
    assert is_settled((1, now - 1), now)
    assert not is_settled((1, 1_700_000_000_000_000_000), now)
    assert not is_settled((1, 1_700_000_009_000_000_000), now)
    assert is_settled((1, 1_699_999_998_000_000_000), now)
