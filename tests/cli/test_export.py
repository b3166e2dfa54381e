"""`recon export`: files from a finished run."""

from __future__ import annotations

from pathlib import Path

from cli_box import Cli


def test_an_export_is_made_from_a_finished_run(cli: Cli, tmp_path: Path) -> None:
    cli("run", "box.yaml", "drive.txt")
    ended = cli("export", "drive-box", "count")
    assert ended == (0, f"{Path('drive-box/exports/count/rows.txt')}\n", "")
    assert (tmp_path / "drive-box/exports/count/rows.txt").read_text() == "100"


def test_an_export_takes_parameters(cli: Cli, tmp_path: Path) -> None:
    cli("run", "box.yaml", "drive.txt")
    assert cli("export", "drive-box", "csv", "--set", "exporter.csv.delimiter=semicolon").code == 0
    assert ";" in (tmp_path / "drive-box/exports/csv/imu.csv").read_text().splitlines()[0]
    ended = cli("export", "drive-box", "csv", "--set", "exporter.csv.delimeter=semicolon")
    assert ended.code == 2
    assert "did you mean 'delimiter'?" in ended.err


def test_an_export_needs_a_finished_run(cli: Cli) -> None:
    ended = cli("export", "drive.txt", "count")
    assert ended.code == 4
    assert ended.err.startswith("error: drive.txt: this is no finished run")
