"""What cannot be verified is told in a sentence, and the command line that verifies."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from evidence_runs import older_arithmetic
from forged_seals import forge

import recon
from recon import api, evidence
from recon.arithmetic import Arithmetic
from recon.cli import main
from recon.errors import ConfigError, Difference, PluginNotFound, ReadFailed, StageError, StorageError
from recon.evidence import archive, replay
from recon.evidence.verification import check_bytes
from recon.registry import Registry


def test_a_module_beside_the_seal_is_not_run(place, tmp_path, monkeypatch):
    """Who sends a seal may send a numpy.py with it, and have the seal ask for an arithmetic that takes a process."""
    monkeypatch.chdir(tmp_path)
    Path("numpy.py").write_text("open('ran', 'w').close()\n", encoding="utf-8")
    manifest = api.open(place / "run").manifest
    elsewhere = {**manifest["environment"], "arithmetic": older_arithmetic(Arithmetic.used()).as_data()}
    replay.run_again({**manifest, "environment": elsewhere}, [place / "drive.txt"], Path("again"), Registry.installed())
    assert not Path("ran").exists()


def test_a_stage_that_is_not_installed_is_named_with_its_distribution(sealed):
    with pytest.raises(PluginNotFound, match=r"its stage 'filter\.moving_average' is not installed here") as caught:
        evidence.verify(sealed, registry=Registry.installed(block=["filter.moving_average"]))
    assert caught.value.hint == f"pip install recon-dynamics=={recon.__version__}"
    with pytest.raises(PluginNotFound, match=r"'reader\.physycom'"):
        evidence.verify(sealed, registry=Registry.installed(block=["reader.physycom"]))


def test_a_seal_of_a_newer_recon_is_told_as_such(sealed):
    def newer(files):
        files["versions.json"] = b'{"recon_seal": 2, "recon": "9.0"}'

    with pytest.raises(ReadFailed, match="newer recon"):
        evidence.verify(forge(sealed, newer))


def test_what_is_no_seal_is_refused(tmp_path):
    for file, what in ((tmp_path / "absent.zip", "there is no such file"), (tmp_path, "this is a folder")):
        with pytest.raises(ReadFailed, match=f"{what}\n  name a file that 'recon seal' wrote"):
            evidence.verify(file)
    (tmp_path / "photo.jpg").write_bytes(b"\xff\xd8\xff")
    with pytest.raises(ReadFailed, match="no zip archive"):
        evidence.verify(tmp_path / "photo.jpg")
    with zipfile.ZipFile(tmp_path / "other.zip", "w") as other:
        other.writestr("a.txt", "a")
    with pytest.raises(Difference, match="no whole seal"):
        evidence.verify(tmp_path / "other.zip")


def test_a_hash_that_is_none_is_a_wrong_option(sealed):
    with pytest.raises(ConfigError, match="is no SHA-256"):
        evidence.verify(sealed, sha256="abc")


@pytest.mark.parametrize("kind", ["disk", "memory"])
def test_a_machine_without_room_for_the_run_is_no_difference(sealed, monkeypatch, kind):
    def too_small(*given, **named):
        error = StorageError("no room") if kind == "disk" else StageError("filter.x", "no room")
        raise error from (None if kind == "disk" else MemoryError())

    monkeypatch.setattr(api, "execute", too_small)
    with pytest.raises(StorageError if kind == "disk" else StageError, match="no room"):
        evidence.verify(sealed)


def test_too_little_memory_is_not_called_a_change(sealed, monkeypatch):
    def too_large(source):
        raise MemoryError

    monkeypatch.setattr(archive, "digest", too_large)
    with archive.opened(sealed) as entries, pytest.raises(MemoryError):
        check_bytes(sealed, entries)


VERIFIED_WITHOUT_ROOM = """
import resource, sys
from recon.cli import main
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
sys.exit(main(["verify", sys.argv[1]]))
"""
"""A limit on the size of files stands for a temporary folder that is full."""


@pytest.mark.skipif(os.name != "posix", reason="limits on the size of files are those of POSIX")
def test_a_temporary_folder_without_room_is_told_in_a_sentence(sealed):
    command = [sys.executable, "-c", VERIFIED_WITHOUT_ROOM, str(sealed)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 8, done.stderr
    assert "could not be written: file too large" in done.stderr


def test_verifying_leaves_nothing_behind_and_changes_nothing(sealed, monkeypatch, tmp_path):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(scratch))
    before = sealed.read_bytes()
    evidence.verify(sealed)
    assert list(scratch.iterdir()) == []
    assert sealed.read_bytes() == before


def test_the_command_line_seals_verifies_and_tells_the_hash(place, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["seal", str(place / "run")]) == 0
    told = capsys.readouterr().out
    digest = hashlib.sha256((tmp_path / "run.zip").read_bytes()).hexdigest()
    assert digest in told
    assert main(["verify", "run.zip", "--sha256", digest]) == 0
    assert "same bytes" in capsys.readouterr().out
    assert main(["verify", "run.zip", "--sha256", "0" * 64, "--json"]) == 7
    assert json.loads(capsys.readouterr().out)["agreement"] == ""
    assert main(["verify", "run.zip", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["agreement"] == "same bytes"
