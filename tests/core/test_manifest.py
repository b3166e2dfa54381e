from __future__ import annotations

import hashlib
import json
from datetime import UTC, datetime
from pathlib import Path

import pytest
from helpers import filter_of, imu_table, pipeline_of, source_of

import recon
from recon import manifest
from recon.check import check
from recon.errors import ReadFailed
from recon.parameters import Params, quantity
from recon.registry import Registry
from recon.rows import Metric, metrics, warning
from recon.runner import run_pipeline
from recon.schema import SAME

START = datetime(2020, 1, 2, 3, 4, 5, tzinfo=UTC)


class Window(Params):
    window: float = quantity(50.0, "ms", gt=0, doc="Window.")


def learn(*, imu, params):
    return {"imu": imu, "metrics": metrics([Metric("a", float("inf")), Metric("b", 2.0, "m"), warning("odd")])}


def made(started=START, **options):
    stages = source_of({"imu": imu_table()}), filter_of(learn, params=Window, writes={"imu": SAME})
    registry = Registry.of(*stages)
    plan, problems = check(pipeline_of("use: simulator.made", "use: filter.work"), registry)
    assert problems == []
    return manifest.make(plan, [], run_pipeline(plan, [], registry), started=started, **options)


def test_a_manifest_says_what_made_the_result():
    told = made(store="parquet")
    assert told["recon_manifest"] == 1
    assert told["recon"] == recon.__version__
    assert told["pipeline"]["name"] == "test"
    assert told["pipeline"]["text"].startswith("recon: 1\nname: test\nsteps:\n- use: simulator.made\n")
    assert [step["params"] for step in told["plan"]] == [{}, {"window": 0.05}]
    assert told["steps"][1] == {
        "id": "filter.work",
        "rows": {"imu": 4},
        "metrics": [{"name": "a"}, {"name": "b", "value": 2.0, "unit": "m"}, {"name": "warning", "note": "odd"}],
    }
    assert told["warnings"] == ["odd"]
    assert told["store"] == "parquet"


def test_equal_runs_give_equal_manifests_but_for_the_environment():
    first, second = made(), made(datetime(2021, 1, 1, tzinfo=UTC))
    assert first["environment"]["started"] != second["environment"]["started"]
    del first["environment"], second["environment"]
    assert json.dumps(first) == json.dumps(second)


def test_times_and_hosts_are_in_the_environment_alone():
    told = made()
    assert told["environment"]["started"] == "2020-01-02T03:04:05.000+00:00"
    assert set(told["environment"]["step_seconds"]) == {"simulator.made", "filter.work"}
    assert not {"started", "host", "seconds"} & set(told)


def test_an_exporter_is_given_names_that_it_can_write():
    assert manifest.RunInfo(b"caf\xe9".decode(errors="surrogateescape")).name == r"caf\xe9"


def test_what_is_written_is_read_back(tmp_path):
    told = made()
    assert manifest.write(told, tmp_path) == tmp_path / "manifest.json"
    assert manifest.read(tmp_path) == told


def test_an_input_file_is_known_by_name_size_and_hash(tmp_path):
    file = tmp_path / "log.txt"
    file.write_bytes(b"1 2 3\n")
    assert manifest.describe_input(file) == {
        "name": "log.txt",
        "bytes": 6,
        "sha256": hashlib.sha256(b"1 2 3\n").hexdigest(),
    }


def test_an_input_folder_is_known_by_all_its_files(tmp_path):
    (tmp_path / "drive" / "deep").mkdir(parents=True)
    (tmp_path / "drive" / "b.txt").write_bytes(b"b")
    (tmp_path / "drive" / "deep" / "a.txt").write_bytes(b"")
    told = manifest.describe_input(tmp_path / "drive")
    assert told["name"] == "drive"
    assert [(part["name"], part["bytes"]) for part in told["files"]] == [("b.txt", 1), ("deep/a.txt", 0)]


@pytest.mark.parametrize("told", [".", "..", "drive/.."])
def test_the_folder_in_which_one_is_has_its_own_name(tmp_path, monkeypatch, told):
    inside = tmp_path / "drive" / "deep" / "drive"
    inside.mkdir(parents=True)
    monkeypatch.chdir(inside.parent)
    assert manifest.describe_input(Path(told))["name"] == {"..": "drive"}.get(told, "deep")


def test_a_missing_input_is_a_read_failure(tmp_path):
    with pytest.raises(ReadFailed, match=r"no.txt: it cannot be read"):
        manifest.describe_input(tmp_path / "no.txt")


def test_outputs_are_described_in_order_with_paths_of_one_form(tmp_path):
    (tmp_path / "streams").mkdir()
    files = [tmp_path / "streams" / name for name in ("b", "a")]
    for file in files:
        file.write_bytes(b"x")
    told = manifest.describe_outputs(tmp_path, files)
    assert [entry["file"] for entry in told] == ["streams/a", "streams/b"]


@pytest.mark.parametrize("text", ["[]", "{}", '{"recon_manifest": "1"}', '{"recon_manifest": 0.5}'])
def test_anything_else_is_no_manifest(tmp_path, text):
    (tmp_path / "manifest.json").write_text(text, encoding="utf-8")
    with pytest.raises(ReadFailed, match="this is no manifest of recon"):
        manifest.read(tmp_path)


@pytest.mark.parametrize("data", [b"", b"\x00\x01", b"\xff\xfe\x00", b'{"recon_manifest": 1', b"[" * 100_000])
def test_what_is_cut_short_or_no_json_is_damaged(tmp_path, data):
    (tmp_path / "manifest.json").write_bytes(data)
    assert manifest.is_there(tmp_path)
    with pytest.raises(ReadFailed, match="it is damaged or cannot be read"):
        manifest.read(tmp_path)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"pipeline": None}, "'pipeline' is missing or of a wrong type"),
        ({"pipeline": 3}, "'pipeline' is missing or of a wrong type"),
        ({"pipeline": {"name": 3}}, "'pipeline.name' is missing or of a wrong type"),
        ({"pipeline": {"name": "a"}}, "'pipeline.text' is missing or of a wrong type"),
        ({"warnings": "odd"}, "'warnings' is missing or of a wrong type"),
        ({"warnings": ["even", 1]}, r"'warnings\[1\]' is missing or of a wrong type"),
        ({"inputs": [{"sha256": ""}]}, r"'inputs\[0\].name' is missing or of a wrong type"),
        ({"plan": [3]}, r"'plan\[0\]' is missing or of a wrong type"),
        ({"steps": [{"id": "a", "rows": {}, "metrics": [None]}]}, r"'steps\[0\].metrics\[0\]' is missing"),
        ({"outputs": [{"file": "a"}]}, r"'outputs\[0\].sha256' is missing or of a wrong type"),
    ],
)
def test_a_manifest_of_another_shape_is_damaged(tmp_path, change, fault):
    manifest.write({**made(), **change}, tmp_path)
    assert manifest.is_there(tmp_path)
    with pytest.raises(ReadFailed, match=f"it is damaged: {fault}"):
        manifest.read(tmp_path)


def test_the_manifest_of_another_program_is_not_there(tmp_path):
    assert not manifest.is_there(tmp_path)
    (tmp_path / "manifest.json").write_text('{"name": "a web page"}', encoding="utf-8")
    assert not manifest.is_there(tmp_path)


def test_a_run_that_is_not_there_is_told_as_such(tmp_path):
    with pytest.raises(ReadFailed, match=r"drive-thesis: there is no such file or folder"):
        manifest.read(tmp_path / "drive-thesis")


def test_a_folder_without_manifest_is_no_finished_run(tmp_path):
    with pytest.raises(ReadFailed, match=r"this is no finished run: it holds no manifest.json"):
        manifest.read(tmp_path)


def test_a_manifest_of_a_newer_recon_says_so(tmp_path):
    (tmp_path / "manifest.json").write_text('{"recon_manifest": 2, "recon": "9.0"}', encoding="utf-8")
    with pytest.raises(ReadFailed, match=r"it was written by a newer recon \(9.0\)"):
        manifest.read(tmp_path)
