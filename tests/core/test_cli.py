"""The command line: what it prints where, its exit codes, and that nothing half written is left behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pytest
from plugin_files import install

import recon
from recon import GNSS, IMU, Recording, build
from recon.cli import _report, main
from recon.cli.run import default_folder
from recon.parameters import bind
from recon.storage import read_recording, write_recording
from recon.tables import with_meta

PLUGIN = '''
"""Stages of another distribution: a simulator, a reader, and what can go wrong."""

import time

import numpy as np

from recon import GNSS, IMU, SAME, Exporter, Filter, Metric, Params, Reader, Simulator, Sniff, build, hookimpl, metrics
from recon import quantity, setting, warning


class Still(Params):
    rows: int = setting(100, gt=0, doc="Number of samples at 100 Hz.")
    pause: float = quantity(0.0, "s", ge=0, doc="Time that the last 10 samples come late.")


def streams(rows, pause=0.0):
    t_ns = np.arange(rows) * 10_000_000
    t_ns[-10:] += round(pause * 1e9)
    accel = np.tile([0.0, 0.0, 9.80665], (rows, 1))
    return {"imu": build(IMU, time=t_ns, accel=accel, gyro=np.zeros((rows, 3)))}


def still(params):
    return streams(params.rows, params.pause)


def read(path, params):
    learnt = [Metric("assumed_rate", 100.0, "Hz"), *[warning("the box is new")] * 3]
    return {**streams(int(path.read_text().split()[1])), "metrics": metrics(learnt)}


def sniff(path, head):
    return Sniff(0.9 if head.startswith(b"still ") else 0.0, "first word")


class Wait(Params):
    time: float = quantity(0.0, "s", ge=0, doc="How long nothing happens.")


def wait(*, imu, params):
    time.sleep(params.time)
    return {"imu": imu}


def fail(*, imu, params):
    raise ZeroDivisionError("nobody foresaw this")


def talk(*, imu, params):
    print("a stage talks")
    return {"imu": imu}


def write(*, imu, folder, about, params):
    (folder / "rows.txt").write_text(str(imu.num_rows))
    return [folder / "rows.txt"]


def write_name(*, imu, folder, about, params):
    text = f"{about.name} of {about.manifest['inputs'][0]['name']}"
    (folder / "name.txt").write_text(text, encoding="utf-8")
    return [folder / "name.txt"]


def write_late(*, imu, folder, about, params):
    time.sleep(60)
    return []


def write_nothing(*, imu, folder, about, params):
    raise ZeroDivisionError("nobody foresaw this")


@hookimpl
def declare_simulators():
    yield Simulator(name="still", summary="A box at rest.", params=Still, run=still, writes={"imu": IMU})


@hookimpl
def declare_readers():
    yield Reader(name="still", summary="A box at rest.", run=read, sniff=sniff, writes={"imu": IMU})


@hookimpl
def declare_filters():
    needs = {"imu": IMU.need("accel")}
    yield Filter(name="wait", summary="Waits.", params=Wait, run=wait, reads=needs, writes={"imu": SAME})
    yield Filter(name="fail", summary="Fails.", run=fail, reads=needs, writes={"imu": SAME})
    yield Filter(name="talk", summary="Prints.", run=talk, reads=needs, writes={"imu": SAME})


@hookimpl
def declare_exporters():
    needs = {"imu": IMU.need("accel")}
    yield Exporter(name="count", summary="Rows.", run=write, reads=needs)
    yield Exporter(name="name", summary="Names.", run=write_name, reads=needs)
    yield Exporter(name="late", summary="Waits.", run=write_late, reads=needs)
    yield Exporter(name="fail", summary="Fails.", run=write_nothing, reads=needs)
'''
STAGES = (
    "simulator.still",
    "reader.still",
    "filter.wait",
    "filter.fail",
    "filter.talk",
    "exporter.count",
    "exporter.name",
    "exporter.late",
    "exporter.fail",
)
PIPELINE = """\
name: box
steps:
  - use: reader.auto
  - use: filter.wait
"""


class Ended(NamedTuple):
    code: int
    out: str
    err: str


VERBS = (
    *("run", "validate", "inspect", "plugins", "export", "convert", "demo", "schema", "new-plugin"),
    "blender-extension",
)

Cli = Callable[..., Ended]


@pytest.fixture(scope="module")
def distribution(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for the path that holds one more distribution, with a broken stage."""
    folder = tmp_path_factory.mktemp("path")
    (folder / "box_plugin.py").write_text(PLUGIN)
    (folder / "box_broken.py").write_text("import no_such_package\n")
    about = folder / "box_plugin-2.5.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: box-plugin\nVersion: 2.5\n")
    points = [f"{stage} = box_plugin" for stage in STAGES] + ["filter.broken = box_broken"]
    (about / "entry_points.txt").write_text("\n".join(["[recon.plugins]", *points, ""]))
    return folder


@pytest.fixture
def cli(distribution: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Cli:
    """`recon` in an empty working directory that holds a log, `drive.txt`, and a pipeline, `box.yaml`."""
    monkeypatch.syspath_prepend(distribution)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drive.txt").write_text("still 100\n")
    (tmp_path / "box.yaml").write_text(PIPELINE)

    def run(*words: str) -> Ended:
        code = main(words)
        return Ended(code, *capsys.readouterr())

    return run


@pytest.fixture
def environment(distribution: Path, tmp_path: Path) -> Mapping[str, str]:
    """Environment of processes of their own, which find what this one finds."""
    (tmp_path / "drive.txt").write_text("still 100\n")
    (tmp_path / "slow.yaml").write_text(PIPELINE + "    params: {time: 60 s}\n")
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(distribution), *filter(None, sys.path)])}


def spawn(*words: str, cwd: Path, env: Mapping[str, str], **streams: int) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "recon", *words]
    return subprocess.Popen(command, cwd=cwd, env=env, text=True, encoding="utf-8", **streams)


def entries(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


# --- help, version, usage -------------------------------------------------------------------------------------------


def test_without_a_verb_it_shows_help_that_names_all_of_them(cli: Cli) -> None:
    ended = cli()
    assert ended.code == 0
    assert ended == cli("--help")
    for verb in VERBS:
        assert f"\n  {verb} " in ended.out


def test_every_verb_has_help_with_an_example(cli: Cli) -> None:
    for verb in VERBS:
        ended = cli(verb, "--help")
        assert ended.code == 0
        assert f"Example: recon {verb}" in ended.out


def test_the_version_is_that_of_the_package(cli: Cli) -> None:
    assert cli("--version") == (0, f"recon {recon.__version__}\n", "")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["rnu"], "no such command 'rnu'"),
        (["run"], "missing argument 'PIPELINE'"),
        (["run", "box.yaml", "--ouch"], "no such option: --ouch"),
        (["validate", "box.yaml", "--format", "xml"], "'xml' is not one of"),
    ],
)
def test_a_wrong_command_line_is_told_in_two_plain_lines(cli: Cli, words: list[str], message: str) -> None:
    ended = cli(*words)
    assert (ended.code, ended.out) == (2, "")
    first, second = ended.err.splitlines()
    assert first.startswith("error: ")
    assert message in first
    assert "--help' shows what it takes" in second


def test_an_unforeseen_error_is_one_sentence_without_a_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    assert _report(KeyError("x"), verbose=False) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: this is a fault of recon")
    assert line.endswith("KeyError: 'x'")


# --- run ------------------------------------------------------------------------------------------------------------


def test_a_run_says_what_came_out_and_where_it_is(cli: Cli, tmp_path: Path) -> None:
    ended = cli("run", "box.yaml", "drive.txt")
    assert ended.code == 0
    assert "  result    drive-box\n" in ended.out
    assert "warning: the box is new (3 times)\n" in ended.out
    assert recon.open(tmp_path / "drive-box").recording["imu"].num_rows == 100


def test_off_a_terminal_progress_is_a_plain_line_for_each_step_on_standard_error(cli: Cli) -> None:
    assert cli("run", "box.yaml", "drive.txt").err == "[1/2] reader.auto\n[2/2] filter.wait\n"


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
    without = cli("run", "box.yaml", "drive.txt", "--export", "tum", "--export", "count", "--out", "without")
    assert without.code == 4
    assert "error: step exporter.tum: exporter.tum reads 'trajectory', which no step above gave" in without.err
    assert entries(tmp_path / "without" / "exports") == {"count"}
    again = cli("export", "drive-box", "map", "name")
    assert again.code == 4
    assert entries(tmp_path / "drive-box" / "exports") == {"count", "name"}


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


# --- validate -------------------------------------------------------------------------------------------------------


def test_a_valid_file_is_a_line(cli: Cli) -> None:
    assert cli("validate", "box.yaml") == (0, "box.yaml: pipeline 'box' is valid, 2 steps\n", "")


def test_every_problem_of_every_file_is_printed_with_its_place(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text(
        "name: 5\nsteps:\n  - use: reader.auto\n  - use: filter.wiat\n    params: {a: b}\n"
    )
    ended = cli("validate", "bad.yaml", "box.yaml", "gone.yaml")
    assert ended.code == 2
    assert ended.out.splitlines() == [
        "box.yaml: pipeline 'box' is valid, 2 steps",
        "bad.yaml:1:7: error: name must be text; put it in quotes",
        "bad.yaml:4:10: error: there is no stage 'filter.wiat'; did you mean 'filter.wait'?",
        "gone.yaml: error: there is no such file",
    ]


def test_problems_for_programs_are_json_and_for_github_annotations(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text("steps: [{use: filter.wiat}]")
    ended = cli("validate", "bad.yaml", "box.yaml", "--format", "json")
    (problem, *_) = json.loads(ended.out)
    assert (problem["file"], problem["line"], problem["column"]) == ("bad.yaml", 1, 15)
    assert ended.code == 2
    ended = cli("validate", "bad.yaml", "--format", "github")
    assert ended.out.startswith("::error file=bad.yaml,line=1,col=15,")
    assert json.loads(cli("validate", "box.yaml", "--format", "json").out) == []


def test_a_stage_that_is_broken_is_exit_3_only_where_it_is_used(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text("steps: [{use: reader.auto}, {use: filter.broken}]")
    ended = cli("validate", "bad.yaml", "box.yaml")
    assert ended.code == 3
    assert "bad.yaml: error: box_broken (box-plugin 2.5) cannot be imported: ModuleNotFoundError" in ended.out
    assert "box.yaml: pipeline 'box' is valid" in ended.out


def test_a_batch_file_is_checked_with_its_pipeline(cli: Cli, tmp_path: Path) -> None:
    text = "batch: june\npipeline: box.yaml\ninputs: [{glob: '*.txt'}]\noutput: results\n"
    (tmp_path / "june.yaml").write_text(text)
    assert cli("validate", "june.yaml") == (0, "june.yaml: batch 'june' is valid\n", "")
    (tmp_path / "june.yaml").write_text(text + "defaults: {filter.wait: {tme: 1 s}}\n")
    ended = cli("validate", "june.yaml")
    assert ended.code == 2
    assert ended.out == "june.yaml:5:26: error: filter.wait has no parameter 'tme'; did you mean 'time'?\n"


def test_the_list_of_verbs_is_wrapped_in_a_narrow_terminal_and_not_cut() -> None:
    from recon.cli._app import _command

    told = _command().make_context("recon", [], terminal_width=80, max_content_width=80).get_help()
    assert "..." not in told.partition("Commands:")[2]
    assert "units, axes, clocks, samples, receiver." in " ".join(told.split())


def test_findings_of_the_doctor_go_on_below_themselves_in_a_terminal() -> None:
    from recon.cli.doctor import _in_short

    some = [{"code": "gaps", "value": 0.0, "explanation": "No hole in 300 s of the IMU. More."}]
    assert _in_short(some, None) == ["  gaps  0  No hole in 300 s of the IMU."]
    assert _in_short(some, 24) == ["  gaps  No hole in 300 s\n        of the IMU."]


# --- inspect --------------------------------------------------------------------------------------------------------


def test_a_log_is_shown_with_what_its_reader_assumed(cli: Cli) -> None:
    ended = cli("inspect", "drive.txt")
    assert ended.code == 0
    assert "imu: 100 rows, 1970-01-01T00:00:00.000000000Z to " in ended.out
    assert "(0.990 s), 100 Hz, no gaps\n" in ended.out
    assert "  accel_x, accel_y, accel_z  m/s^2  sensor  specific_force\n" in ended.out
    assert "  assumed_rate " in ended.out
    assert "reader.still  first word\n" in ended.out


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

    assert _fact({"height": 105.55977050680667, "lat": 44.5}) == "height 105.5597705, lat 44.5"
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
    assert "gnss: 1 rows, 2.500 s to 2.500 s since the log's beginning\n" in ended.out
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


# --- plugins --------------------------------------------------------------------------------------------------------


def test_the_list_names_stage_distribution_and_what_is_broken(cli: Cli) -> None:
    ended = cli("plugins")
    assert ended.code == 0
    lines = {line.split()[0]: line for line in ended.out.splitlines()}
    assert lines["filter.wait"].split() == ["filter.wait", "box-plugin", "2.5", "Waits."]
    assert "BROKEN: box_broken (box-plugin 2.5) cannot be imported: ModuleNotFoundError" in lines["filter.broken"]
    told = {stage["name"]: stage for stage in json.loads(cli("plugins", "filter", "--json").out)}
    assert {stage["role"] for stage in told.values()} == {"filter"}
    assert told["filter.wait"]["broken"] == ""
    assert told["filter.broken"]["broken"]


def test_one_stage_is_shown_in_full(cli: Cli) -> None:
    ended = cli("plugins", "show", "simulator.still")
    assert ended.code == 0
    assert "simulator.still  version 1  (box-plugin 2.5, box_plugin)" in ended.out
    assert "  pause  number        0 s      s     Time that the last 10 samples come late.\n" in ended.out
    assert "    accel_x, accel_y, accel_z  m/s^2  sensor  specific_force\n" in ended.out
    told = json.loads(cli("plugins", "show", "filter.wait", "--json").out)
    assert told["parameters"][0]["unit"] == "s"
    assert told["yaml"] == "- use: filter.wait\n  params:\n    time: 0 s\n"
    assert told["reads"]["imu"]["columns"][0]["name"] == "accel_x"


def test_what_a_record_declares_of_itself_is_shown(cli: Cli) -> None:
    assert "\ncapabilities: sniff\n" in cli("plugins", "show", "reader.still").out
    assert "capabilities" not in cli("plugins", "show", "detector.shock").out
    assert "\ncapabilities: every_stream, repeats\n" in cli("plugins", "show", "exporter.csv").out
    assert "\nreads\n  every stream\n" in cli("plugins", "show", "exporter.csv").out


def test_the_step_that_is_shown_is_that_of_the_defaults(cli: Cli) -> None:
    registry = recon.Registry.installed()
    for key in ("reader.auto", "reader.physycom", "simulator.drive", "filter.resample", "exporter.csv", "filter.wait"):
        step = json.loads(cli("plugins", "show", key, "--json").out)["yaml"]
        (pasted,) = recon.Pipeline.from_text(f"steps:\n{step}").steps
        stage = registry.get(key)
        assert bind(stage.params, pasted.params, key) == (stage.params(), [])


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["show", "filter.wiat"], 3, "error: there is no stage 'filter.wiat'\n  did you mean 'filter.wait'?\n"),
        (["show", "filter.broken"], 3, "error: box_broken (box-plugin 2.5) cannot be imported"),
        (["fliter"], 2, "error: there is no role 'fliter'; did you mean 'filter'?\n"),
        (["filter.wait"], 2, "write 'recon plugins show filter.wait'\n"),
        (["show", "a", "b"], 2, "error: too many words"),
        (["show"], 2, "error: 'show' needs the name of a stage; 'recon plugins' lists them\n"),
    ],
)
def test_a_stage_that_cannot_be_shown_is_told(cli: Cli, words: list[str], code: int, message: str) -> None:
    ended = cli("plugins", *words)
    assert ended.code == code
    assert message in ended.err


# --- export, convert, schema, demo ----------------------------------------------------------------------------------


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


def test_the_schema_is_printed_or_written(cli: Cli, tmp_path: Path) -> None:
    printed = json.loads(cli("schema").out)
    assert cli("schema", "--out", "recon.schema.json") == (0, "recon.schema.json\n", "")
    assert json.loads((tmp_path / "recon.schema.json").read_text()) == printed


def test_the_demo_compares_with_the_truth_and_is_not_overwritten(cli: Cli, tmp_path: Path) -> None:
    ended = cli("demo")
    assert ended.code == 0
    assert "against the truth\n" in ended.out
    assert "position, horizontal [m]" in ended.out
    assert "rms error against the reference  best_accuracy  thesis\n" in ended.out
    assert entries(tmp_path / "recon-demo") == {"drive", "best_accuracy", "thesis"}
    again = cli("demo")
    assert (again.code, again.out) == (2, "")


# --- processes of their own -----------------------------------------------------------------------------------------


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no signals to a single process")
@pytest.mark.parametrize(
    ("words", "sent", "code", "told"),
    [
        (["run", "slow.yaml", "drive.txt"], signal.SIGINT, 130, "interrupted; nothing was written\n"),
        (["-v", "run", "slow.yaml", "drive.txt"], signal.SIGINT, 130, "interrupted; nothing was written\n"),
        (["run", "slow.yaml", "drive.txt"], signal.SIGTERM, 143, "terminated; nothing was written\n"),
    ],
)
def test_a_stopped_run_is_one_line_and_leaves_nothing(
    words: list[str], sent: signal.Signals, code: int, told: str, tmp_path: Path, environment: Mapping[str, str]
) -> None:
    before = entries(tmp_path)
    with spawn(*words, cwd=tmp_path, env=environment, stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        while "filter.wait" not in process.stderr.readline():
            assert process.poll() is None, "it ended before the step began"
        process.send_signal(sent)
        assert process.stderr.read() == told
        assert process.wait() == code
    assert entries(tmp_path) == before


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no signals to a single process")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_after_the_end_does_not_spoil_what_is_done(name: str, environment: Mapping[str, str]) -> None:
    program = f"""
        import os, signal, sys
        from recon.cli import main
        sys.argv = ["recon", "--version"]
        code = main()
        os.kill(os.getpid(), signal.{name})
        sys.exit(code)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, env=environment, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, f"recon {recon.__version__}\n", "")


def test_a_caller_in_the_same_process_keeps_his_signals(cli: Cli) -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    cli("run", "box.yaml", "drive.txt")
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_the_command_hears_ctrl_c_before_anything_slow_is_imported() -> None:
    program = "import sys; import recon.cli; sys.exit(f'{[*sys.modules]}' if 'recon.errors' in sys.modules else 0)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no SIGINT to a single process")
def test_ctrl_c_in_an_export_says_that_the_run_is_complete(tmp_path: Path, environment: Mapping[str, str]) -> None:
    (tmp_path / "box.yaml").write_text(PIPELINE)
    words = ["run", "box.yaml", "drive.txt", "--export", "late"]
    with spawn(*words, cwd=tmp_path, env=environment, stderr=subprocess.PIPE) as process:
        while not any((tmp_path / "drive-box").glob("exports/.late.partial-*")):
            assert process.poll() is None, "it ended before the export began"
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate()
    assert process.returncode == 130
    assert err.endswith("interrupted; the run is complete: drive-box\n")
    assert recon.open(tmp_path / "drive-box").recording["imu"].num_rows == 100
    assert not (tmp_path / "drive-box" / "exports").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="a pipe is broken otherwise on Windows")
def test_a_reader_that_goes_away_is_not_complained_of(tmp_path: Path, environment: Mapping[str, str]) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        with spawn("plugins", cwd=tmp_path, env=environment, stdout=writing, stderr=subprocess.PIPE) as process:
            _, err = process.communicate()
    finally:
        os.close(writing)
    assert (process.returncode, err) == (141, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device that is always full")
def test_output_to_a_full_disk_is_an_error(tmp_path: Path, environment: Mapping[str, str]) -> None:
    with (
        Path("/dev/full").open("w") as full,
        spawn("plugins", cwd=tmp_path, env=environment, stdout=full.fileno(), stderr=subprocess.PIPE) as process,
    ):
        _, err = process.communicate()
    assert process.returncode == 8
    assert err == "error: the output could not be written: No space left on device\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device that is always full")
def test_a_run_whose_report_cannot_be_written_says_that_it_is_complete(
    tmp_path: Path, environment: Mapping[str, str]
) -> None:
    (tmp_path / "box.yaml").write_text(PIPELINE)
    words = ["run", "box.yaml", "drive.txt"]
    buffered = {key: value for key, value in environment.items() if key != "PYTHONUNBUFFERED"}
    with (
        Path("/dev/full").open("w") as full,
        spawn(*words, cwd=tmp_path, env=buffered, stdout=full.fileno(), stderr=subprocess.PIPE) as process,
    ):
        _, err = process.communicate()
    assert process.returncode == 8
    assert err.splitlines()[-2:] == [
        "error: the output could not be written: No space left on device",
        "  the run is complete: drive-box",
    ]


def test_a_console_of_few_characters_shows_what_it_can(tmp_path: Path, environment: Mapping[str, str]) -> None:
    narrow = {**environment, "PYTHONIOENCODING": "cp1252"}
    (tmp_path / "\u03a9.yaml").write_text("steps: [{use: simulator.still}]")
    with spawn("validate", "\u03a9.yaml", cwd=tmp_path, env=narrow, stdout=subprocess.PIPE) as process:
        out, _ = process.communicate()
    assert (process.returncode, out) == (0, "?.yaml: pipeline '?' is valid, 1 step\n")


def test_a_live_display_shows_the_steps_on_a_terminal(tmp_path: Path, environment: Mapping[str, str]) -> None:
    pty = pytest.importorskip("pty", reason="there are no pseudo-terminals here")
    (tmp_path / "brief.yaml").write_text(PIPELINE + "    params: {time: 0.5 s}\n")
    ours, theirs = pty.openpty()
    env = {**environment, "TERM": "xterm", "COLUMNS": "80"}
    with spawn(
        "run", "brief.yaml", "drive.txt", cwd=tmp_path, env=env, stdout=subprocess.PIPE, stderr=theirs
    ) as process:
        out, _ = process.communicate()
    os.close(theirs)
    shown = b""
    try:
        while part := os.read(ours, 4096):
            shown += part
    except OSError:  # how Linux ends a terminal that nobody holds any more
        pass
    os.close(ours)
    assert process.returncode == 0
    assert b"1/2" in shown
    assert b"filter.wait" in shown
    assert "result" in out


@pytest.mark.parametrize(
    ("words", "unwanted"),
    [
        (["--help"], "numpy pyarrow pydantic yaml scipy rich.live mcap pyquaternion recon.pipeline recon.registry"),
        (
            ["validate", "thesis"],
            "scipy rich.live mcap zstandard pyquaternion pyarrow.parquet recon.api recon.trajectory",
        ),
        (["validate", "thesis"], "recon_readers.physycom recon_simulators recon_exporters recon.batch recon.runner"),
    ],
)
def test_a_verb_imports_only_what_it_needs(words: list[str], unwanted: str) -> None:
    program = f"""
        import sys
        from recon.cli import main
        assert main({words}) == 0
        found = [name for name in {unwanted.split()} if name in sys.modules]
        sys.exit(f"imported: {{found}}" if found else 0)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, encoding="utf-8", check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
