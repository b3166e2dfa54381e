"""Batches whose inputs and outputs are in an object store, which speaks the protocol of S3 on this machine."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from fleets import BATCH, fleet, results

from recon.cli import main
from recon.fleet import lock
from recon.fleet.places import Place, glob, stamp

moto = pytest.importorskip("moto.server")

LOCAL = {f"{vehicle}/d{number}": f"good {number + 1}" for vehicle in "AB" for number in range(2)}
REGION = "us-east-1"


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    yield f"{host}:{port}"
    server.stop()


@pytest.fixture
def store(endpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Place:
    """A bucket of its own for each test."""
    for name, value in {"ACCESS_KEY_ID": "test", "SECRET_ACCESS_KEY": "test", "EC2_METADATA_DISABLED": "true"}.items():
        monkeypatch.setenv(f"AWS_{name}", value)
    bucket = f"b{abs(hash(tmp_path)):x}"
    query = f"?endpoint_override={endpoint}&scheme=http&region={REGION}&allow_bucket_creation=true"
    place = Place.of(f"s3://{bucket}{query}")
    place.filesystem.create_dir(bucket)
    return place


def put(store: Place, name: str, text: str) -> None:
    with store.filesystem.open_output_stream((store / name).path) as file:
        file.write(text.encode())


def remote(store: Place, name: str) -> str:
    return f"{store.head}/{name}{store.query}"


@pytest.fixture
def batch(store: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A batch from the store to the store."""
    for name, text in LOCAL.items():
        put(store, f"logs/{name}.txt", text)
    text = BATCH.replace("logs/*/*.txt", remote(store, "logs/*/*.txt")).replace(
        "output: results", f"output: '{remote(store, 'fleets/june')}'"
    )
    file = fleet(tmp_path, {}, text)
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    return file


def found(store: Place, pattern: str) -> list[str]:
    return [place.path.partition("/")[2] for place, _ in glob(store / pattern)]


def test_a_place_is_shown_without_what_may_be_secret(endpoint: str) -> None:
    place = Place.of(f"s3://key:secret@bucket/logs/A/d0.txt?endpoint_override={endpoint}&scheme=http&region={REGION}")
    assert place.path == "bucket/logs/A/d0.txt"
    assert str(place) == "s3://bucket/logs/A/d0.txt"


def test_a_batch_from_the_store_to_the_store_is_that_of_local_files(
    batch: Path, store: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    near = fleet(tmp_path / "near", LOCAL)
    assert main(["batch", str(near)]) == 0
    assert main(["batch", str(batch)]) == 0
    for key, files in results(near.parent / "results").items():
        with store.filesystem.open_input_stream((store / f"fleets/june/{key}/manifest.json").path) as file:
            manifest = json.loads(file.read())
        assert [(output["file"], output["sha256"]) for output in manifest["outputs"]] == files
        for output in manifest["outputs"]:
            assert stamp(store / f"fleets/june/{key}/{output['file']}")[0] == output["bytes"]
    with store.filesystem.open_input_file((store / "fleets/june/jobs.parquet").path) as file:
        assert pq.read_table(file)["status"].to_pylist() == ["ok"] * len(LOCAL)
    assert found(store, "fleets/june/.lock") == []


def test_it_goes_on_where_it_was(batch: Path, store: Place, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["batch", str(batch)]) == 0
    put(store, "logs/A/d1.txt", "good 1234")
    capsys.readouterr()
    assert main(["batch", str(batch), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["done"], facts["done_before"]) == (1, len(LOCAL) - 1)


def test_a_result_whose_manifest_is_missing_does_not_count(batch: Path, store: Place, capsys) -> None:
    assert main(["batch", str(batch)]) == 0
    store.filesystem.delete_file((store / "fleets/june/vehicle=B/drive=d0/manifest.json").path)
    capsys.readouterr()
    assert main(["batch", str(batch), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["done"] == 1


def test_the_summary_reads_the_store(batch: Path, store: Place, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["batch", str(batch)]) == 0
    capsys.readouterr()
    assert main(["fleet", "summary", remote(store, "fleets/june"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["done"] == len(LOCAL)


def test_a_store_that_does_not_answer_is_told_at_its_place(
    batch: Path, store: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    text = batch.read_text(encoding="utf-8").replace("/logs/*", "-none/logs/*")
    batch.write_text(text, encoding="utf-8")
    assert main(["batch", str(batch)]) == 2
    assert f"{batch}:4:10: error: " in capsys.readouterr().err


def test_a_lease_is_refused_while_it_is_renewed_and_taken_when_it_is_not(
    store: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lock, "BEAT_S", 0.1)
    monkeypatch.setattr(lock, "DEAD_S", 1.0)
    with lock.leased(store), pytest.raises(lock.ConfigError, match="another batch is at work"), lock.leased(store):
        pass
    put(store, lock.NAME, "a dead one 7")
    started = time.monotonic()
    with lock.leased(store):
        assert time.monotonic() - started > 1.0
    assert found(store, lock.NAME) == []
