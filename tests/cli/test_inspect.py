"""`recon inspect`: what is in a log or a result."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_box import Cli

from recon import GNSS, IMU, Recording, build
from recon.storage import write_recording
from recon.tables import with_meta


def test_a_log_is_shown_with_what_its_reader_assumed(cli: Cli) -> None:
    ended = cli("inspect", "drive.txt")
    assert ended.code == 0
    assert "imu: 100 rows, 1970-01-01 00:00:00.000 to 00:00:00.990 UTC (0.990 s), 100 Hz, no gaps\n" in ended.out
    assert "  accel_x, accel_y, accel_z  m/s^2  sensor  specific_force\n" in ended.out
    assert "  assumed rate         100 Hz\n" in ended.out
    assert "reader.still  first word; the choice is 90 % sure\n" in ended.out
    assert ended.out.count("the box is new") == 1


def test_a_result_is_shown_with_its_pipeline_and_warnings(cli: Cli) -> None:
    cli("run", "box.yaml", "drive.txt")
    ended = cli("inspect", "drive-box")
    assert ended.out.startswith("drive-box: result of pipeline 'box'\n")
    assert "warning: the box is new (3 times)\n" in ended.out
    told = json.loads(cli("inspect", "drive-box", "--json").out)
    assert told["pipeline"] == "box"
    assert told["streams"]["imu"]["rows"] == 100


def test_facts_of_a_stream_are_told_in_a_line() -> None:
    from recon.cli.inspect import _fact

    assert _fact({"height": 105.55977050680667, "lat": 44.5}) == "height 105.56, lat 44.50000000"
    assert _fact([[0.1] * 6] * 6) == "6 x 6 numbers, which --json shows"
    assert _fact("UTC") == "UTC"


def test_gaps_are_counted_and_the_longest_is_told(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "box.yaml").write_text("steps: [{use: simulator.still, params: {pause: 2 s}}]")
    cli("run", "box.yaml")
    assert "100 Hz, 1 gap, the longest 2.010 s\n" in cli("inspect", "box").out
    gaps = json.loads(cli("inspect", "box", "--json").out)["streams"]["imu"]["gaps"]
    assert gaps == {"count": 1, "longest_s": pytest.approx(2.01, abs=1e-9)}  # times are whole ns


def test_times_of_a_clock_that_was_never_set_count_from_the_beginning_of_the_log(cli: Cli, tmp_path: Path) -> None:
    boot_ns = 20_000_000_000
    imu = build(IMU, time=boot_ns + np.arange(100) * 10_000_000, accel=np.zeros((100, 3)), gyro=np.zeros((100, 3)))
    gnss = build(GNSS, time=boot_ns + np.array([2_500_000_000]), lat=np.array([44.5]), lon=np.array([11.3]))
    streams = {name: with_meta(table, clock="relative") for name, table in (("imu", imu), ("gnss", gnss))}
    write_recording(Recording(streams), tmp_path / "log", "parquet")
    ended = cli("inspect", "log")
    assert "imu: 100 rows, 0.000 s to 0.990 s since the log's beginning, 100 Hz, no gaps\n" in ended.out
    assert "gnss: 1 row, 2.500 s to 2.500 s since the log's beginning\n" in ended.out
    assert "1970" not in ended.out
    told = json.loads(cli("inspect", "log", "--json").out)["streams"]["gnss"]
    assert (told["first_s"], told["last_s"], told["span_s"]) == (2.5, 2.5, 0.0)
    assert "first" not in told


def test_a_file_that_no_reader_knows_is_exit_4(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "noise.bin").write_bytes(bytes(range(256)))
    ended = cli("inspect", "noise.bin")
    assert ended.code == 4
    assert ended.err.startswith("error: ")
    assert "noise.bin: no reader knows this file" in ended.err


@pytest.mark.parametrize("text", ['{"recon_manifest": 1}', '{"recon_man'])
def test_a_damaged_manifest_is_told(cli: Cli, tmp_path: Path, text: str) -> None:
    cli("run", "box.yaml", "drive.txt")
    (tmp_path / "drive-box" / "manifest.json").write_text(text)
    for words in (["inspect", "drive-box"], ["export", "drive-box", "count"]):
        ended = cli(*words)
        assert (ended.code, ended.out) == (4, "")
        assert ended.err.startswith(f"error: {Path('drive-box/manifest.json')}: it is damaged")


def test_a_manifest_of_another_program_does_not_keep_a_folder_from_being_read(cli: Cli, tmp_path: Path) -> None:
    cli("run", "box.yaml", "drive.txt")
    (tmp_path / "drive-box" / "manifest.json").write_text('{"name": "a web page"}')
    assert cli("inspect", "drive-box").code == 0


def test_a_sealed_run_is_told_as_such_with_what_can_be_done_with_it(cli: Cli, tmp_path: Path) -> None:
    cli("run", "box.yaml", "drive.txt")
    assert cli("seal", "drive-box").code == 0
    ended = cli("inspect", "drive-box.zip")
    first, *uses = ended.out.splitlines()[:4]
    assert first.startswith("drive-box.zip: pipeline 'box' over drive.txt, sealed with recon ")
    assert [line.split("  ")[1] for line in uses] == [
        "recon verify drive-box.zip",
        "recon explain drive-box.zip METRIC",
        "unzip drive-box.zip",
    ]
    assert "imu: 100 rows" in ended.out
    told = json.loads(cli("inspect", "drive-box.zip", "--json").out)
    assert (told["sealed"]["log"], told["streams"]["imu"]["rows"]) == (["drive.txt"], 100)
    as_a_log = cli("run", "box.yaml", "drive-box.zip")
    assert as_a_log.code == 4
    assert "which is a sealed run\n  'recon inspect' says what it holds" in as_a_log.err


def test_a_changed_seal_is_exit_7(cli: Cli, tmp_path: Path) -> None:
    cli("run", "box.yaml", "drive.txt")
    cli("seal", "drive-box")
    sealed = bytearray((tmp_path / "drive-box.zip").read_bytes())
    at = sealed.index(b"still 100")
    sealed[at + 6] = ord("2")
    (tmp_path / "drive-box.zip").write_bytes(sealed)
    ended = cli("inspect", "drive-box.zip")
    assert (ended.code, ended.out) == (7, "")
    assert ended.err.startswith("error: inputs/1/drive.txt was changed")
