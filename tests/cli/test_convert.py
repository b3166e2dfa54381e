"""`recon convert`: a log as Parquet or MCAP."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pytest
from cli_box import Cli, entries

import recon
from recon.storage import read_recording


def test_a_log_becomes_parquet_or_mcap_with_the_same_numbers(cli: Cli) -> None:
    assert cli("convert", "drive.txt", "parquet").code == 0
    assert cli("convert", "drive.txt", "mcap", "--store", "mcap").code == 0
    assert cli("convert", "drive.txt", "one.mcap").code == 0
    folder, other, file = (read_recording(Path(name)) for name in ("parquet", "mcap", "one.mcap"))
    assert set(folder) == set(other) == set(file) == {"imu", "metrics"}
    for name in folder:
        assert folder[name].equals(other[name], check_metadata=True)
        assert folder[name].equals(file[name], check_metadata=True)
    assert isinstance(folder["imu"], pa.Table)
    assert file.meta["manifest"]["inputs"] == recon.open("parquet").manifest["inputs"]


def test_an_mcap_file_is_known_in_capitals_too(cli: Cli, tmp_path: Path) -> None:
    assert cli("convert", "drive.txt", "one.MCAP").code == 0
    assert (tmp_path / "one.MCAP").is_file()


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("drive.csv", "error: convert writes no csv; convert to a folder, then write 'recon export FOLDER csv'\n"),
        ("drive.parquet", "error: drive.parquet would be a folder, with a Parquet file for each stream; write drive\n"),
    ],
)
def test_no_folder_is_made_under_the_name_of_a_file(cli: Cli, tmp_path: Path, target: str, message: str) -> None:
    ended = cli("convert", "drive.txt", target)
    assert (ended.code, ended.err) == (2, message)
    assert entries(tmp_path) == {"drive.txt", "box.yaml"}


def test_only_an_mcap_file_is_replaced_by_one(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "foreign.mcap").write_text("not MCAP")
    assert cli("convert", "drive.txt", "foreign.mcap", "--overwrite").code == 2
    assert (tmp_path / "foreign.mcap").read_text() == "not MCAP"
    assert cli("convert", "drive.txt", "one.mcap").code == 0
    assert cli("convert", "drive.txt", "one.mcap").code == 2
    assert cli("convert", "drive.txt", "one.mcap", "--overwrite").code == 0
    assert cli("convert", "drive.txt", "two.mcap", "--store", "parquet").code == 2
