"""Batches whose inputs and outputs are in an object store: servers on this machine that speak the stores' protocols.

S3 is that of moto, Google's that of gcp-storage-emulator. Azure's is Azurite, a program of Node.js; with it on the path
the same tests run there:  npm install --global azurite
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlencode

import pyarrow.parquet as pq
import pytest
from fleets import BATCH, fleet, results

from recon.cli import main
from recon.fleet import lock
from recon.fleet.places import Place, below, fetch, glob, stamp
from recon.fleet.root import SUPERSEDED, root_of

moto = pytest.importorskip("moto.server")
pytest.importorskip("gcp_storage_emulator")

LOCAL = {f"{vehicle}/d{number}": f"good {number + 1}" for vehicle in "AB" for number in range(2)}
REGION = "us-east-1"
AZURITE = shutil.which("azurite-blob")
STORES = ("s3", "gs", "abfs") if AZURITE else ("s3", "gs")


@contextmanager
def s3_server() -> Iterator[str]:
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    query = f"endpoint_override={host}:{port}&scheme=http&region={REGION}&allow_bucket_creation=true"
    yield f"s3://fleet?{query}"
    server.stop()


@contextmanager
def gs_server() -> Iterator[str]:
    port = free_port()
    options = ("start", "--host", "127.0.0.1", "--port", str(port), "--in-memory", "--default-bucket", "fleet")
    command = [sys.executable, "-c", "from gcp_storage_emulator.__main__ import main; main()", *options]
    with serving(command, port):
        yield f"gs://anonymous@fleet?endpoint_override=127.0.0.1:{port}&scheme=http&retry_limit_seconds=2"


@contextmanager
def abfs_server() -> Iterator[str]:
    port = free_port()
    options = ("--inMemoryPersistence", "--silent", "--skipApiVersionCheck", "--disableTelemetry")
    with serving([str(AZURITE), "--blobHost", "127.0.0.1", "--blobPort", str(port), *options], port):
        yield f"abfs://devstoreaccount1@127.0.0.1:{port}/fleet?enable_tls=false&{shared_access()}"


def shared_access() -> str:
    """Query by which Azurite's only account is open to who has it (Azure Storage, "Create an account SAS")."""
    key = "Eby8vdM02xNOcqFlqUwJPLlmEtlCDXJ1OUzFT50uSRZ6IFsuFq2UVErCz4I6tq/K1SZFPTOtr/KBHBeksoGMGw=="  # known to all
    told = {"sp": "rwdlac", "ss": "b", "srt": "sco", "se": "2099-01-01T00:00:00Z", "spr": "https,http"}
    parts = ["devstoreaccount1", told["sp"], told["ss"], told["srt"], "", told["se"], "", told["spr"], "2020-02-10", ""]
    signed = hmac.new(base64.b64decode(key), "\n".join(parts).encode(), hashlib.sha256).digest()
    return urlencode({**told, "sv": "2020-02-10", "sig": base64.b64encode(signed).decode()})


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def serving(command: list[str], port: int) -> Iterator[None]:
    """A server in a process of its own, from when it answers."""
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            deadline = time.monotonic() + 60.0
            while True:
                try:
                    socket.create_connection(("127.0.0.1", port)).close()
                    break
                except OSError:
                    assert process.poll() is None, "the server ended"
                    assert time.monotonic() < deadline, "the server does not answer"
                    time.sleep(0.05)
            yield
        finally:
            process.terminate()


@pytest.fixture(scope="module", params=STORES)
def bucket(request: pytest.FixtureRequest) -> Iterator[Place]:
    """A bucket of each kind of store."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("ACCESS_KEY_ID", "SECRET_ACCESS_KEY", "EC2_METADATA_DISABLED"):
            patch.setenv(f"AWS_{name}", "true")
        server = {"s3": s3_server, "gs": gs_server, "abfs": abfs_server}[request.param]
        with server() as uri:
            place = Place.of(uri)
            if request.param != "gs":
                place.filesystem.create_dir("fleet")
            yield place


@pytest.fixture
def store(bucket: Place, tmp_path: Path) -> Place:
    """A part of the bucket for each test."""
    return bucket / f"{abs(hash(tmp_path)):x}"


def put(store: Place, name: str, text: str) -> None:
    with store.filesystem.open_output_stream((store / name).path) as file:
        file.write(text.encode())


def remote(store: Place, name: str) -> str:
    scheme = store.head.partition(":")[0]
    path = store.path if scheme == "abfs" else store.path.removeprefix("fleet/")
    return f"{store.head}/{path}/{name}{store.query}"


@pytest.fixture
def batch(store: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A batch from the store to the store."""
    for name, text in LOCAL.items():
        put(store, f"logs/{name}.txt", text)
    text = BATCH.replace("logs/*/*.txt", remote(store, "logs/*/*.txt")).replace(
        "output: results", f"output: '{remote(store, 'fleets/june')}'"
    )
    text = text.replace("executor.local, params: {workers: 3}", "executor.serial")
    file = fleet(tmp_path, {}, text)
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    return file


def found(store: Place, pattern: str) -> list[str]:
    return [place.path.removeprefix(f"{store.path}/") for place, _ in glob(store / pattern)]


def test_a_place_is_shown_without_what_may_be_secret() -> None:
    place = Place.of(f"s3://key:secret@bucket/logs/A/d0.txt?endpoint_override=127.0.0.1:9&scheme=http&region={REGION}")
    assert place.path == "bucket/logs/A/d0.txt"
    assert str(place) == "s3://bucket/logs/A/d0.txt"
    azure = Place.of("abfs://bucket@account.dfs.core.windows.net/logs/A?credential_kind=anonymous&sig=secret")
    assert azure.path == "bucket/logs/A"
    assert str(azure) == "abfs://bucket@account.dfs.core.windows.net/logs/A"


def test_folders_are_found_by_the_names_in_them(store: Place, tmp_path: Path) -> None:
    """Nobody makes folders in an object store: they are there when an object is."""
    for name in ("A/d0/imu.csv", "A/d0/more/gnss.csv", "A/d1.txt", "B/d0.txt", "B/.hidden"):
        put(store, f"logs/{name}", name)
    assert found(store, "logs/*") == ["logs/A", "logs/B"]
    assert found(store, "logs/*/*") == ["logs/A/d0", "logs/A/d1.txt", "logs/B/d0.txt"]
    assert found(store, "logs/**/*.csv") == ["logs/A/d0/imu.csv", "logs/A/d0/more/gnss.csv"]
    assert stamp(store / "logs/A/d0")[0] == len("A/d0/imu.csv") + len("A/d0/more/gnss.csv")
    assert below(store / "nothing") == []
    copy = fetch(store / "logs/A/d0", tmp_path)
    assert (copy / "more/gnss.csv").read_text(encoding="utf-8") == "A/d0/more/gnss.csv"


def test_a_result_is_set_aside(store: Place) -> None:
    key, root = "vehicle=A/drive=d0", root_of(store)
    assert not root.set_aside(key)
    for text in ("first", "second"):
        put(store, f"{key}/manifest.json", text)
        put(store, f"{key}/streams/imu.parquet", text)
        assert root.set_aside(key)
        assert found(store, f"{key}/**") == []
        with store.filesystem.open_input_stream((store / f"{SUPERSEDED}/{key}/streams/imu.parquet").path) as file:
            assert file.read() == text.encode()
    assert found(store, "vehicle=*/drive=*/streams/*") == []


def test_a_batch_from_the_store_to_the_store_is_that_of_local_files(
    batch: Path, store: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    near = fleet(tmp_path / "near", LOCAL)
    assert main(["batch", str(near), "--executor", "serial"]) == 0
    assert main(["batch", str(batch), "--executor", "local"]) == 0
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
    nobody = f"127.0.0.1:{free_port()}"
    known = batch.read_text(encoding="utf-8")
    batch.write_text(re.sub(r"127\.0\.0\.1:\d+", nobody, known, count=1), encoding="utf-8")
    assert main(["batch", str(batch)]) == 2
    said = capsys.readouterr().err
    assert f"{batch}:4:10: error: " in said
    assert "scheme=http" not in said
    assert "sig=" not in said


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
