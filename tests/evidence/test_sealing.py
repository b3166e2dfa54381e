"""Equal runs give equal seals, which hold what they should; and what cannot be sealed."""

from __future__ import annotations

import hashlib
import json
import shutil
import socket
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import pytest
from evidence_runs import PIPELINE, older_arithmetic, write_log
from forged_seals import contents_of

import recon
from recon import api, evidence
from recon.arithmetic import Arithmetic
from recon.errors import ConfigError, DataError, Difference
from recon.evidence import contents
from recon.registry import Source


def test_a_seal_comes_out_again_byte_by_byte(place):
    found = evidence.verify(place / "run.zip")
    assert (found.agreement, found.inputs, found.notes) == ("same bytes", ("drive.txt",), ())
    assert found.sha256 == hashlib.sha256((place / "run.zip").read_bytes()).hexdigest()
    assert found.files == len(contents_of(place / "run.zip"))
    assert found.arithmetic == str(Arithmetic.used())


def test_equal_runs_in_other_places_give_equal_seals(place, tmp_path):
    elsewhere = tmp_path / "somewhere else"
    elsewhere.mkdir()
    shutil.copy(place / "drive.txt", elsewhere)
    recon.run(PIPELINE, elsewhere / "drive.txt", elsewhere / "another name")
    evidence.seal(elsewhere / "another name", elsewhere / "other.zip")
    assert (elsewhere / "other.zip").read_bytes() == (place / "run.zip").read_bytes()


def test_the_hashes_are_those_that_sha256sum_reads(place):
    files = contents_of(place / "run.zip")
    listed = dict(reversed(line.split("  ")) for line in files.pop("SHA256SUMS").decode().splitlines())
    assert listed == {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}


def test_the_log_and_the_results_are_in_it_as_they_were(place):
    files = contents_of(place / "run.zip")
    assert files["inputs/1/drive.txt"] == (place / "drive.txt").read_bytes()
    for output in json.loads((place / "run" / "manifest.json").read_text())["outputs"]:
        assert files[f"results/{output['file']}"] == (place / "run" / output["file"]).read_bytes()


def test_a_seal_tells_nothing_of_the_machine_that_it_was_made_on(place):
    """No folder, user, host or time of day; Parquet keeps its own texts uncompressed, so that bytes tell."""
    whole = b"".join(contents_of(place / "run.zip").values())
    for secret in (str(place), place.name, str(Path.home()), f'"{socket.gethostname()}"', '"host"', '"started"'):
        assert secret.encode() not in whole


def test_an_mcap_result_and_a_folder_as_input_are_sealed_too(tmp_path):
    recon.run(PIPELINE, write_log(tmp_path / "drive.txt"), tmp_path / "first")
    again = recon.Pipeline.of("again", "reader.parquet", "filter.moving_average")
    recon.run(again, tmp_path / "first", tmp_path / "second", store="mcap")
    evidence.seal(tmp_path / "second", tmp_path / "second.zip")
    names = contents_of(tmp_path / "second.zip")
    assert "results/streams.mcap" in names
    assert "inputs/1/first/manifest.json" in names
    assert evidence.verify(tmp_path / "second.zip").agreement == "same bytes"


def test_exports_are_taken_along_where_they_are_asked_for(place, tmp_path):
    run = Path(shutil.copytree(place / "run", tmp_path / "run"))
    api.export(api.open(run), ["csv"])
    evidence.seal(run, tmp_path / "with.zip", exports=True)
    assert any(name.startswith("exports/csv/") for name in contents_of(tmp_path / "with.zip"))
    assert evidence.verify(tmp_path / "with.zip").exports == {"csv": "same bytes"}
    evidence.seal(run, tmp_path / "without.zip")
    assert (tmp_path / "without.zip").read_bytes() == (place / "run.zip").read_bytes()


def test_a_run_of_another_processor_comes_out_again_byte_by_byte(tmp_path):
    """A smoother makes more of how a processor rounds; so a replay computes as the processor of the run did."""
    text = """
        recon: 1
        name: short
        steps:
          - {use: simulator.drive, params: {duration: 1 min, imu_rate: 50 Hz}}
          - use: fuser.map
        """
    (tmp_path / "short.yaml").write_text(dedent(text))
    elsewhere = older_arithmetic(Arithmetic.used())
    command = [sys.executable, "-m", "recon", "run", str(tmp_path / "short.yaml"), "--out", str(tmp_path / "run")]
    subprocess.run(command, env=elsewhere.environment(), check=True, capture_output=True)
    here = recon.run(tmp_path / "short.yaml", out=tmp_path / "here")
    assert api.open(tmp_path / "run").manifest["outputs"] != here.manifest["outputs"]  # else any replay would do

    evidence.seal(tmp_path / "run", tmp_path / "run.zip")  # raises unless it comes out again byte by byte
    manifest = json.loads(contents_of(tmp_path / "run.zip")["manifest.json"])
    assert Arithmetic.from_data(manifest["environment"]["arithmetic"]) == elsewhere


def test_a_log_that_was_changed_since_is_not_sealed(place, tmp_path):
    log = write_log(tmp_path / "drive.txt")
    recon.run(PIPELINE, log, tmp_path / "run")
    log.write_text(log.read_text().replace("3.00000", "2.00000"))
    with pytest.raises(DataError, match="is not what the run read"):
        evidence.seal(tmp_path / "run", tmp_path / "run.zip")
    evidence.seal(tmp_path / "run", tmp_path / "run.zip", [place / "drive.txt"])
    log.unlink()
    with pytest.raises(DataError, match="no longer there"):
        evidence.seal(tmp_path / "run", tmp_path / "other.zip")
    assert not (tmp_path / "other.zip").exists()


def test_a_result_that_was_changed_since_is_not_sealed(place, tmp_path):
    run = Path(shutil.copytree(place / "run", tmp_path / "run"))
    (run / "streams" / "imu.parquet").write_bytes((run / "streams" / "gnss.parquet").read_bytes())
    with pytest.raises(DataError, match="is not the file that the run left there"):
        evidence.seal(run, tmp_path / "run.zip")


def test_a_run_that_does_not_come_out_again_is_not_sealed(place, tmp_path):
    run = Path(shutil.copytree(place / "run", tmp_path / "run"))
    manifest = json.loads((run / "manifest.json").read_text())
    manifest["steps"][1]["metrics"][0]["value"] = 77.0
    (run / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(Difference, match="the run is not sealed, since it does not come out again"):
        evidence.seal(run, tmp_path / "run.zip")
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_a_seal_is_never_replaced(place):
    before = (place / "run.zip").read_bytes()
    with pytest.raises(ConfigError, match="never replaced"):
        evidence.seal(place / "run", place / "run.zip")
    assert (place / "run.zip").read_bytes() == before


def test_a_run_of_tables_in_memory_has_no_log_to_seal(place, tmp_path):
    recon.run(PIPELINE, recon.read(place / "drive.txt"), tmp_path / "run")
    with pytest.raises(DataError, match="made from tables in memory"):
        evidence.seal(tmp_path / "run", tmp_path / "run.zip")


def test_the_code_that_is_hashed_holds_its_data_and_what_python_makes_of_it_not(tmp_path, monkeypatch):
    """A limit in a data file changes results as a line of code does."""
    package = tmp_path / "stages_of_ours"
    (package / "__pycache__").mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "limits.yaml").write_text("a: 1")
    monkeypatch.syspath_prepend(str(tmp_path))

    def digest():
        source = Source("ours", "1.0", "stages_of_ours.one")
        return next(part["sha256"] for part in contents.versions_of([source])["code"] if part["package"] != "recon")

    before = digest()
    (package / "__pycache__" / "one.cpython-311.pyc").write_bytes(b"x")
    (package / "README.md").write_text("words")
    assert digest() == before
    (package / "limits.yaml").write_text("a: 2")
    assert digest() != before


def test_the_page_in_the_archive_says_how_to_check_it(place):
    text = contents_of(place / "run.zip")[contents.README].decode()
    assert "sha256sum -c SHA256SUMS" in text
    assert "recon verify FILE" in text
