"""Any byte of a seal that is not as it was sealed is found."""

from __future__ import annotations

import zipfile

import pytest
from forged_seals import IMU, contents_of, pack
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from recon import evidence
from recon.cli import main
from recon.errors import Difference, ReadFailed
from recon.evidence import archive
from recon.evidence.verification import check_bytes


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    share=st.floats(0.0, 1.0, exclude_max=True), flip=st.integers(1, 255), edge=st.sampled_from(["", "head", "tail"])
)
def test_a_changed_byte_anywhere_is_found(place, tmp_path, share, flip, edge):
    """Anywhere: half of the examples fall into the first header and the directory at the end."""
    data = bytearray((place / "run.zip").read_bytes())
    span = {"": range(len(data)), "head": range(60), "tail": range(len(data) - 1200, len(data))}[edge]
    data[span[int(share * len(span))]] ^= flip
    spoilt = tmp_path / "spoilt.zip"
    spoilt.write_bytes(data)
    with pytest.raises(Difference), archive.opened(spoilt) as entries:
        check_bytes(spoilt, entries)


def test_a_changed_byte_ends_with_exit_code_7_and_says_where(sealed, capsys):
    data = bytearray(sealed.read_bytes())
    data[data.index(b"ax\tay") + 1] ^= 1
    sealed.write_bytes(data)
    assert main(["verify", str(sealed)]) == 7
    assert "inputs/1/drive.txt was changed" in capsys.readouterr().err


@pytest.mark.parametrize("extra", [b"\0", b"PK\x05\x06" + bytes(18)])
def test_bytes_behind_the_archive_are_found(sealed, extra):
    sealed.write_bytes(sealed.read_bytes() + extra)
    with pytest.raises(Difference):
        evidence.verify(sealed)


def test_bytes_in_front_of_the_archive_are_found(sealed):
    sealed.write_bytes(b"#!/bin/sh\n" + sealed.read_bytes())
    with pytest.raises(Difference):
        evidence.verify(sealed)


@pytest.mark.parametrize("length", [0, 10, -1, -200])
def test_a_seal_that_is_cut_short_is_found(sealed, length):
    data = sealed.read_bytes()
    sealed.write_bytes(data[:length])
    with pytest.raises((Difference, ReadFailed)):
        evidence.verify(sealed)


def test_files_that_were_packed_anew_are_told_as_such(sealed):
    files = contents_of(sealed)
    with zipfile.ZipFile(sealed, "w") as other:
        for name, data in files.items():
            other.writestr(zipfile.ZipInfo(name, (2020, 1, 1, 0, 0, 0)), data)
    with pytest.raises(Difference, match="not as recon writes it, though all files in it are as listed"):
        evidence.verify(sealed)


def test_a_compressed_archive_is_no_seal(sealed):
    files = contents_of(sealed)
    with zipfile.ZipFile(sealed, "w", zipfile.ZIP_DEFLATED) as other:
        for name, data in files.items():
            other.writestr(name, data)
    with pytest.raises(Difference, match="compressed or encrypted"):
        evidence.verify(sealed)


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("name", ["manifest.json", "MANIFEST.json"])
def test_two_entries_of_one_name_are_found(sealed, name):
    with zipfile.ZipFile(sealed, "a") as other:
        other.writestr(name, "{}")
    with pytest.raises(Difference, match="a second file of that name"):
        evidence.verify(sealed)


@pytest.mark.parametrize(
    "name",
    ["../outside.txt", "/etc/outside.txt", "inputs/1/../../../outside.txt", "inputs\\1\\x", "inputs//x", "inputs/"],
)
def test_a_name_that_leads_out_of_the_archive_is_refused_and_nothing_is_written_there(sealed, name):
    before = sorted(sealed.parent.rglob("*"))
    with zipfile.ZipFile(sealed, "a") as other:
        other.writestr(name, "gotcha")
    with pytest.raises(Difference, match="its name"):
        evidence.verify(sealed)
    assert sorted(sealed.parent.rglob("*")) == before
    assert not (sealed.parent.parent / "outside.txt").exists()


def test_a_file_that_was_added_or_taken_away_is_found(sealed):
    files = contents_of(sealed)
    pack({**files, "inputs/1/second.txt": b"more"}, sealed)
    with pytest.raises(Difference, match="was added"):
        evidence.verify(sealed)
    pack({name: data for name, data in files.items() if name != IMU}, sealed)
    with pytest.raises(Difference, match=r"imu\.parquet is missing"):
        evidence.verify(sealed)
    pack({**files, "virus.exe": b"MZ"}, sealed)
    with pytest.raises(Difference, match="no such file"):
        evidence.verify(sealed)
