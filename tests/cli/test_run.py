"""`recon run`: what it prints where, its exit codes, and that nothing half written is left behind."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest
from cli_box import PIPELINE, Cli, entries
from plugin_files import install

import recon
from recon.cli.run import default_folder
from recon.storage import read_recording
from recon.tables import time_ns


def test_a_run_says_what_came_out_and_where_it_is(cli: Cli, tmp_path: Path) -> None:
    ended = cli("run", "box.yaml", "drive.txt")
    assert ended.code == 0
    assert "  result    drive-box\n" in ended.out
    assert "warning: the box is new (3 times)\n" in ended.out
    assert recon.open(tmp_path / "drive-box").recording["imu"].num_rows == 100


def test_off_a_terminal_progress_is_a_plain_line_for_each_step_on_standard_error(cli: Cli) -> None:
    assert cli("run", "box.yaml", "drive.txt").err == "[1/2] reader.auto\n[2/2] filter.wait\n"


def test_a_part_of_a_log_is_named_by_its_times(cli: Cli, tmp_path: Path) -> None:
    assert cli("run", "box.yaml", "drive.txt", "--from", "0.2s", "--to", "0.5s").code == 0
    part = read_recording(tmp_path / "drive-box")["imu"]
    assert (time_ns(part)[[0, -1]] - time_ns(part)[0]).tolist() == [0, 300_000_000]
    ended = cli("run", "box.yaml", "drive.txt", "--from", "2h", "--out", "later")
    assert (ended.code, (tmp_path / "later").exists()) == (4, False)
    assert "no row lies between 2h and the last row" in ended.err


def test_a_run_for_programs_is_json(cli: Cli) -> None:
    told = json.loads(cli("run", "box.yaml", "drive.txt", "--json", "--export", "count").out)
    assert told["folder"] == "drive-box"
    assert told["pipeline"] == "box"
    assert told["summary"] == {"warnings": 3}
    assert told["exports"] == [str(Path("drive-box/exports/count/rows.txt"))]


def test_what_a_stage_prints_does_not_disturb_the_results(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    talker = {"talker.py": "print('a module talks')\nimport no_such_package\n"}
    monkeypatch.syspath_prepend(install(tmp_path / "path", "talker", modules=talker, points={"filter.odd": "talker"}))
    (tmp_path / "box.yaml").write_text(PIPELINE + "  - use: filter.talk\n")
    ended = cli("run", "box.yaml", "drive.txt", "--json")
    assert json.loads(ended.out)["pipeline"] == "box"
    assert "a stage talks\n" in ended.err
    ended = cli("plugins", "--json")
    assert "filter.talk" in {stage["name"] for stage in json.loads(ended.out)}
    assert "a module talks\n" in ended.err


def test_a_pipeline_that_reads_needs_an_input_whatever_is_there(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "box").mkdir()
    ended = cli("run", "box.yaml")
    assert (ended.code, ended.out) == (2, "")
    assert ended.err == "error: pipeline 'box' reads a log, and none is given; name it behind the pipeline\n"


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux takes any bytes as a name")
@pytest.mark.parametrize("store", ["parquet", "mcap"])
def test_names_that_are_no_text_are_kept_escaped(cli: Cli, tmp_path: Path, store: str) -> None:
    log, out = os.fsdecode(b"caf\xe9.txt"), os.fsdecode(b"r\xe9s")
    (tmp_path / "drive.txt").rename(log)
    assert cli("run", "box.yaml", log, "--out", out, "--store", store, "--export", "name").code == 0
    assert Path(out, "exports", "name", "name.txt").read_text(encoding="utf-8") == r"r\xe9s of caf\xe9.txt"
    kept = recon.open(out)
    assert [entry["name"] for entry in kept.manifest["inputs"]] == [r"caf\xe9.txt"]
    assert kept.recording.meta["sources"] == [r"caf\xe9.txt"]
    assert cli("convert", log, "one.mcap").code == 0
    assert read_recording(Path("one.mcap")).meta["sources"] == [r"caf\xe9.txt"]


def test_a_folder_that_is_there_is_refused_before_any_work(cli: Cli) -> None:
    cli("run", "box.yaml", "drive.txt")
    ended = cli("run", "box.yaml", "drive.txt")
    assert ended.code == 2
    assert ended.err == "error: drive-box is there already; choose another place, or add --overwrite\n"
    assert cli("run", "box.yaml", "drive.txt", "--overwrite").code == 0


def test_a_simulation_needs_no_input_and_is_named_after_its_pipeline(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "box.yaml").write_text("steps: [{use: simulator.still}]")
    assert cli("run", "box.yaml").code == 0
    assert (tmp_path / "box" / "manifest.json").is_file()


def test_a_parameter_is_set_from_outside(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "box.yaml").write_text("steps: [{use: simulator.still}]")
    (tmp_path / "rows.yaml").write_text("7")
    cli("run", "box.yaml", "--set", "simulator.still.rows=5", "--out", "five")
    cli("run", "box.yaml", "--set", "simulator.still.rows=@rows.yaml", "--out", "seven", "--store", "mcap")
    assert recon.open("five").recording["imu"].num_rows == 5
    assert recon.open("seven").recording["imu"].num_rows == 7


def test_every_wrong_setting_is_told_and_nothing_is_done(cli: Cli, tmp_path: Path) -> None:
    ended = cli("run", "box.yaml", "drive.txt", "--set", "filter.wait.tme=1 s", "--set", "filter.wiat.time=1 s")
    assert ended.code == 2
    assert ended.err.splitlines() == [
        "--set filter.wait.tme=1 s: error: filter.wait has no parameter 'tme'; did you mean 'time'?",
        "--set filter.wiat.time=1 s: error: 'box' has no step 'filter.wiat'; did you mean 'filter.wait'?",
    ]
    assert entries(tmp_path) == {"drive.txt", "box.yaml"}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--set", "rate"], "--set rate: error: this sets nothing; write --set STEP.PARAMETER=VALUE"),
        (["--set", "filter.wait=1 s"], "'filter.wait' is a step, and the name of a parameter is missing; write filter"),
        (["--set", "filter.wait.time=1"], "filter.wait: time: a unit is missing: write for example '1 s'"),
        (["--store", "mcp"], "--store mcp: error: there is no store 'mcp'; did you mean 'mcap'?"),
        (["--export", "cuont"], "--export cuont: error: there is no stage 'exporter.cuont'; did you mean"),
    ],
)
def test_a_wrong_option_is_exit_2_before_any_work(cli: Cli, tmp_path: Path, words: list[str], message: str) -> None:
    ended = cli("run", "box.yaml", "drive.txt", *words)
    assert ended.code == 2
    assert message in ended.err
    assert "[1/" not in ended.err
    assert entries(tmp_path) == {"drive.txt", "box.yaml"}


def test_a_missing_input_is_exit_4_and_leaves_nothing(cli: Cli, tmp_path: Path) -> None:
    ended = cli("run", "box.yaml", "drvie.txt")
    assert ended.code == 4
    assert ended.err.endswith("error: drvie.txt: there is no such file or folder\n")
    assert entries(tmp_path) == {"drive.txt", "box.yaml"}


def test_a_stage_that_fails_is_exit_5_and_leaves_nothing(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "box.yaml").write_text(PIPELINE + "  - use: filter.fail\n")
    ended = cli("run", "box.yaml", "drive.txt")
    assert ended.code == 5
    assert "error: step filter.fail: ZeroDivisionError: nobody foresaw this\n" in ended.err
    assert "Traceback" not in ended.err
    assert entries(tmp_path) == {"drive.txt", "box.yaml"}


def test_verbose_shows_where_a_stage_failed_wherever_it_stands_in_the_line(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "box.yaml").write_text(PIPELINE + "  - use: filter.fail\n")
    for words in (["-v", "run", "box.yaml", "drive.txt"], ["run", "box.yaml", "drive.txt", "--verbose"]):
        ended = cli(*words)
        assert ended.code == 5
        assert "box_plugin.py" in ended.err


def test_an_export_that_fails_leaves_the_run_and_says_so(cli: Cli, tmp_path: Path) -> None:
    ended = cli("run", "box.yaml", "drive.txt", "--export", "count", "--export", "fail")
    assert ended.code == 5
    assert "the run is complete: drive-box\n" in ended.err
    assert f"export count is complete: {Path('drive-box/exports/count')}\n" in ended.err
    assert "export fail is complete" not in ended.err
    assert entries(tmp_path / "drive-box" / "exports") == {"count"}
    assert recon.open(tmp_path / "drive-box").warnings


def test_an_export_that_finds_nothing_to_show_does_not_stop_the_others(cli: Cli, tmp_path: Path) -> None:
    """A drive without a place on the Earth has no map; the run stands, and what was asked for behind it is made."""
    ended = cli("run", "box.yaml", "drive.txt", "--export", "map", "--export", "kml", "--export", "count")
    assert ended.code == 4
    lines = ended.err.splitlines()
    assert [line for line in lines if line.startswith("error: ")] == [
        "error: step exporter.map: no row of trajectory or gnss has a latitude and longitude, which a map needs"
    ]
    assert "  step exporter.kml: no row of trajectory or gnss has a latitude and longitude, which a map needs" in lines
    assert "  the run is complete: drive-box" in lines
    assert entries(tmp_path / "drive-box" / "exports") == {"count"}
    told = [line.split() for line in ended.out.splitlines()]  # all the same
    assert ["result", "drive-box"] in told
    assert ["export", str(Path("drive-box/exports/count/rows.txt"))] in told
    as_json = cli("run", "box.yaml", "drive.txt", "--export", "map", "--out", "json", "--json")
    assert (as_json.code, json.loads(as_json.out)["folder"]) == (4, "json")
    without = cli("run", "box.yaml", "drive.txt", "--export", "tum", "--export", "count", "--out", "without")
    assert without.code == 4
    assert "error: step exporter.tum: exporter.tum reads 'trajectory', which no step above gave" in without.err
    assert entries(tmp_path / "without" / "exports") == {"count"}
    again = cli("export", "drive-box", "map", "name")
    assert again.code == 4
    assert entries(tmp_path / "drive-box" / "exports") == {"count", "name"}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device that is always full")
def test_on_a_full_disk_it_is_told_what_is_kept_and_how_to_go_on(cli: Cli, tmp_path: Path) -> None:
    ended = cli("run", "box.yaml", "drive.txt", "--export", "count", "--export", "full", "--export", "name")
    assert ended.code == 8
    assert ended.err.splitlines()[-3:] == [
        "  the run is complete: drive-box",
        f"  export count is complete: {Path('drive-box/exports/count')}",
        "  'recon export drive-box full name' makes what is missing",
    ]
    nothing = cli("export", "drive-box", "full")
    assert nothing.code == 8
    assert nothing.err.splitlines()[-1] == "  nothing of it is kept; the same command begins anew"


def test_an_older_result_is_not_taken_for_the_new_one(cli: Cli, tmp_path: Path) -> None:
    cli("run", "box.yaml", "drive.txt")
    (tmp_path / "box.yaml").write_text(PIPELINE + "  - use: filter.fail\n")
    ended = cli("run", "box.yaml", "drive.txt", "--overwrite")
    assert ended.code == 5
    assert "complete" not in ended.err
    assert recon.open(tmp_path / "drive-box").manifest["steps"][-1]["id"] == "filter.wait"


def test_results_are_named_after_input_and_pipeline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "drive").mkdir()
    monkeypatch.chdir(tmp_path / "drive")
    assert default_folder("thesis", [Path("logs/a.b.txt"), Path("c.txt")]) == Path("a.b-thesis")
    assert default_folder("thesis", [Path()]) == Path("drive-thesis")
    assert default_folder("my pipeline/2", []) == Path("my_pipeline_2")
