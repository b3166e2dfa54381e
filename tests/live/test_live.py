"""recon live over a log that grows, as a user runs it."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import recon
from recon.cli.live import _viewer
from recon.errors import StorageError
from recon.live.session import Session, following
from recon.pipeline import Pipeline
from recon.registry import Registry
from recon.rows import warnings_of
from recon.schema import GNSS, WHEEL
from recon.storage.mcap import read_file
from recon.tables import build, matrix, seconds, time_ns, vector

EPOCH_2000 = 946_681_200


@pytest.fixture(scope="module")
def lines():
    """Six minutes of a physycom log at 20 Hz, a line each, the header first."""
    made = recon.run(
        "simulated_drive",
        **{"simulator.drive.duration": "360 s", "simulator.drive.imu_rate": "20 Hz", "simulator.drive.seed": 3},
    ).recording
    imu, gnss = made["imu"], made["gnss"]
    accel, gyro = matrix(imu, "accel") / 9.80665, np.degrees(matrix(imu, "gyro"))
    t_ns = time_ns(imu)
    last = np.clip(np.searchsorted(time_ns(gnss), t_ns, side="right") - 1, 0, None)
    place = [vector(gnss, name)[last] for name in ("lat", "lon", "height")]
    course = np.nan_to_num(np.degrees(vector(gnss, "course", gaps=True)))[last] % 360.0
    rows = np.column_stack([
        *place, course, 3.6 * vector(gnss, "speed")[last], accel, gyro, np.linalg.norm(accel, axis=1), seconds(imu)
    ])  # fmt: skip
    names = [
        "timestamp",
        "lat",
        "lon",
        "alt",
        "heading",
        "speed",
        "ax",
        "ay",
        "az",
        "gx",
        "gy",
        "gz",
        "|a|",
        "time_rel",
    ]
    stamps = [f"{ns // 10**9 - EPOCH_2000}.{ns % 10**9 // 10**5:04d}" for ns in t_ns.tolist()]
    text = [
        "\t".join([stamp, *(f"{value:.8g}" for value in row)]) for stamp, row in zip(stamps, rows.tolist(), strict=True)
    ]
    return ["# " + "\t".join(names), *text]


def command(source, out, *more):
    return [
        sys.executable,
        "-m",
        "recon",
        "live",
        "best_accuracy",
        str(source),
        "--out",
        str(out),
        "--every",
        "50 ms",
        *more,
    ]


def test_a_log_on_standard_input_becomes_a_whole_trajectory(lines, tmp_path):
    out = tmp_path / "drive.mcap"
    text = "\n".join(lines) + "\n"
    done = subprocess.run(command("-", out, "--json"), input=text, capture_output=True, text=True, check=True)
    told = [json.loads(line) for line in done.stdout.splitlines()]
    assert told
    assert told[-1].keys() >= {"time", "lat", "lon", "speed_m_s", "heading_deg", "position_sigma_m"}
    found = recon.read(out)
    assert found["imu"].num_rows == len(lines) - 1
    assert time_ns(found["trajectory"]).tolist() == time_ns(found["imu"]).tolist()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive.mcap"]


def test_a_run_that_is_killed_loses_nothing_that_was_written_and_goes_on(lines, tmp_path):
    log, out = tmp_path / "log.txt", tmp_path / "drive.mcap"
    part = tmp_path / "drive.part.mcap"
    half = 6_500  # 325 s: the window has moved once, so there is something to go on from
    with log.open("w") as file:
        file.write("\n".join(lines[:half]) + "\n")
    running = subprocess.Popen(command(log, out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    until = time.monotonic() + 60.0
    while not (tmp_path / "drive.state").exists() and time.monotonic() < until:
        time.sleep(0.05)
    time.sleep(0.5)
    running.send_signal(signal.SIGKILL if hasattr(signal, "SIGKILL") else signal.SIGTERM)
    running.wait()
    before = recon.read(part)
    with log.open("a") as file:
        file.write("\n".join(lines[half:]) + "\n")
    again = subprocess.run(command(log, out, "--until-end"), capture_output=True, text=True, check=True)
    assert "going on with" in again.stdout
    found = recon.read(out)
    assert not part.exists()
    assert time_ns(found["imu"]).tolist() == time_ns(found["trajectory"]).tolist()
    assert found["imu"].num_rows == len(lines) - 1
    kept = before["trajectory"]
    assert kept.num_rows > 1000
    assert found["trajectory"].slice(0, kept.num_rows).equals(kept)


def live(log, out, *more):
    return subprocess.run(command(log, out, "--until-end", *more), capture_output=True, text=True, check=False)


def test_a_result_is_gone_on_with_by_the_same_command_alone(lines, tmp_path):
    log, other, out = tmp_path / "log.txt", tmp_path / "other.txt", tmp_path / "drive.mcap"
    log.write_text("\n".join(lines[:201]) + "\n")
    other.write_text("\n".join(lines[:101]) + "\n")
    assert live(log, out).returncode == 0
    made = out.read_bytes()
    of_another = live(other, out)
    with_others = live(log, out, "--set", "fuser.map.sensor_class=automotive")
    assert [of_another.returncode, with_others.returncode] == [2, 2]
    hint = "; choose another file with --out, or move it away\n"
    assert of_another.stderr == f"error: {out} holds what pipeline 'best_accuracy' made of {log}{hint}"
    assert with_others.stderr == f"error: {out} holds what other parameters made of this log{hint}"
    assert out.read_bytes() == made
    log.write_text("\n".join(lines[:301]) + "\n")
    again = live(log, out)
    assert again.stdout.startswith(f"going on with {out}\n")
    assert recon.read(out)["imu"].num_rows == 300
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive.mcap", "log.txt", "other.txt"]


def test_what_a_killed_run_left_is_not_taken_into_another_drive(lines, tmp_path):
    log, other, out = tmp_path / "log.txt", tmp_path / "other.txt", tmp_path / "drive.mcap"
    part = tmp_path / "drive.part.mcap"
    for file in (log, other):
        file.write_text("\n".join(lines[:201]) + "\n")
    running = subprocess.Popen(command(log, out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    until = time.monotonic() + 60.0
    while (not part.exists() or part.stat().st_size < 10_000) and time.monotonic() < until:
        time.sleep(0.05)
    running.kill()
    running.wait()
    left = part.read_bytes()
    refused = live(other, out)
    assert (refused.returncode, part.read_bytes(), out.exists()) == (2, left, False)
    assert refused.stderr.startswith(f"error: {part} holds what pipeline 'best_accuracy' made of {log}")
    assert live(log, out).returncode == 0
    assert recon.read(out)["imu"].num_rows == 200


def test_a_log_that_was_replaced_by_one_of_other_columns_is_refused_before_the_end(lines, tmp_path):
    log, out = tmp_path / "log.txt", tmp_path / "drive.mcap"
    log.write_text("\n".join(lines[:201]) + "\n")
    assert live(log, out).returncode == 0
    made = recon.read(out)["gnss"]
    kept = [0, 5, 6, 7, 8, 9, 10, 11, 12, 13]  # all but lat, lon, alt and heading
    rows = [line.removeprefix("# ").split("\t") for line in (lines[0], *lines[301:501])]
    log.write_text("\n".join("\t".join(row[column] for column in kept) for row in rows) + "\n")
    refused = live(log, out)
    assert refused.returncode == 2
    assert f"{out} holds rows of gnss that differ in columns: course, height, lat, lon" in refused.stderr
    assert recon.read(out)["gnss"].equals(made)


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("none.txt", "there is no such file\n  start the logger first"),
        ("", "this is a folder\n  name the log that grows"),
    ],
)
def test_a_source_that_is_not_there_leaves_nothing(name, sentence, tmp_path):
    place = tmp_path / "logs"
    place.mkdir()
    told = live(place / name, tmp_path / "drive.mcap")
    assert told.returncode == 4
    assert told.stderr.startswith(f"error: {place / name}: {sentence}")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["logs"]


def test_what_another_version_of_the_fuser_left_to_go_on_from_is_not_used(lines, tmp_path):
    log, out = tmp_path / "log.txt", tmp_path / "drive.mcap"
    log.write_text("\n".join(lines[:101]) + "\n")
    left = json.dumps({"source": str(log), "fuser": "map 0", "offset": 3000})
    (tmp_path / "drive.state").write_bytes(left.encode() + b"\nof another shape")
    registry = Registry.installed()
    session = Session(following(Pipeline.from_file("best_accuracy"), registry), str(log), out, 10.0, registry)
    assert not session.resumed
    list(session.new(last=True))
    session.close()
    assert recon.read(out)["imu"].num_rows == 100


def test_fixes_that_a_log_repeats_on_every_row_are_taken_once_however_the_rows_come(lines, tmp_path):
    log, out = tmp_path / "log.txt", tmp_path / "drive.mcap"
    log.write_text("\n".join(lines[:11]) + "\n")
    registry = Registry.installed()
    session = Session(following(Pipeline.from_file("best_accuracy"), registry), str(log), out, 10.0, registry)
    for at in range(11, 411, 10):
        list(session.new())
        with log.open("a") as file:
            file.write("\n".join(lines[at : at + 10]) + "\n")
    list(session.new(last=True))
    session.close()
    whole, live = recon.read(log), recon.read(out)
    assert len(set(time_ns(live["gnss"]).tolist()) ^ set(time_ns(whole["gnss"]).tolist())) <= 1
    assert live["imu"].num_rows == whole["imu"].num_rows


def test_a_line_that_cannot_be_read_is_left_out_and_told(lines, tmp_path):
    log, out = tmp_path / "log.txt", tmp_path / "drive.mcap"
    cells = lines[301].split("\t")
    broken = [
        *lines[:200],
        "12\tgarb",
        *lines[200:301],
        "\t".join([*cells[:6], "x" + cells[6], *cells[7:]]),
        *lines[302:],
    ]
    log.write_text("\n".join(broken[:150]) + "\n")
    registry = Registry.installed()
    session = Session(following(Pipeline.from_file("best_accuracy"), registry), str(log), out, 10.0, registry)
    for at in (150, 300, 450):
        list(session.new())
        with log.open("a") as file:
            file.write("\n".join(broken[at : at + 150]) + "\n")
    list(session.new(last=True))
    session.close()
    assert [fault.split(":")[1] for fault in session.bad] == ["201", "303"]
    found = recon.read(out)
    assert found["imu"].num_rows == 599 - 2
    (told,) = warnings_of(found["metrics"])
    assert told.startswith("2 lines that could not be read left out, the first: ")
    assert read_file(out).meta["manifest"]["lines_left_out"] == 2


def test_a_unit_that_cannot_be_right_is_told_in_a_line_and_kept_with_the_result(lines, tmp_path):
    log, out = tmp_path / "log.txt", tmp_path / "drive.mcap"
    rows = [line.split("\t") for line in lines[1:601]]
    in_si = ["\t".join([*row[:6], *(f"{9.80665 * float(cell):.8g}" for cell in row[6:9]), *row[9:]]) for row in rows]
    log.write_text("\n".join([lines[0], *in_si]) + "\n")
    told = live(log, out)
    sentence = "accel_unit: The accelerometer feels 95."
    assert told.stderr.count(f"warning: {sentence}") == 2  # when it is found, and at the end
    (kept,) = warnings_of(recon.read(out)["metrics"])
    assert kept.startswith(sentence)
    assert "the file is not in g. It is m/s^2." in kept


def test_a_log_of_which_no_line_can_be_read_is_refused(lines, tmp_path):
    log = tmp_path / "log.txt"
    log.write_text("\n".join([*lines[:50], *["1\tx"] * 200]) + "\n")
    told = subprocess.run(command(log, tmp_path / "x.mcap", "--until-end"), capture_output=True, text=True, check=False)
    assert told.returncode == 4
    assert "100 lines cannot be read, the last: " in told.stderr


def test_before_the_heading_is_known_it_says_what_it_waits_for_and_what_gnss_says(lines, tmp_path):
    log, out = tmp_path / "log.txt", tmp_path / "x.mcap"
    log.write_text("\n".join(lines[:601]) + "\n")
    told = subprocess.run(command(log, out, "--until-end", "--json"), capture_output=True, text=True, check=True)
    first = json.loads(told.stdout.splitlines()[0])
    assert first["lat"] == pytest.approx(44.4949, abs=0.01)
    assert first["heading_deg"] is None
    assert first["waiting_for"] == "60 s of the imu, of which 30 s are there"
    assert "no trajectory: it was waiting for 60 s" in told.stderr


def test_a_long_log_gives_results_while_it_is_worked_through(lines, tmp_path):
    log, out = tmp_path / "log.txt", tmp_path / "x.mcap"
    log.write_text("\n".join(lines) + "\n")
    told = subprocess.run(command(log, out, "--until-end", "--json"), capture_output=True, text=True, check=True)
    times = [json.loads(line)["time"] for line in told.stdout.splitlines()]
    assert len(times) > 10
    assert times == sorted(times)


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"", "no row of a log came"),
        (b"hello\n", "no row of a log came"),
        (b"\xb5b\x01\x07\x5c\x00" * 99, "no text"),
        (b"1\t2\n", "standard input: no reader knows"),
    ],
)
def test_what_is_no_text_log_is_a_sentence_and_leaves_nothing(data, sentence, tmp_path):
    told = subprocess.run(command("-", tmp_path / "x.mcap"), input=data, capture_output=True, check=False)
    assert told.returncode == 4
    assert sentence in told.stderr.decode()
    assert b"recon-live-" not in told.stderr
    assert not list(tmp_path.iterdir())


def test_an_error_while_standard_input_is_still_open_ends_the_program(tmp_path):
    with subprocess.Popen(
        command("-", tmp_path / "x.mcap"), stdin=subprocess.PIPE, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL
    ) as running:
        running.stdin.write(b"\0\n")
        running.stdin.flush()
        assert running.wait(60) == 4
        assert b"Fatal" not in running.stderr.read()


@pytest.mark.parametrize("name", ["best_accuracy", "crash"])
def test_detectors_before_the_fuser_are_left_to_a_run_over_the_whole_drive(name):
    steps = following(Pipeline.from_file(name), Registry.installed())
    assert steps.fuser.id == "fuser.map"
    assert {"detector.crash", "analyzer.consistency"} <= set(steps.left_out)


def test_a_pipeline_that_needs_the_whole_drive_is_refused(tmp_path):
    log = tmp_path / "log.txt"
    log.write_text("1 2 3\n")
    told = subprocess.run(
        [sys.executable, "-m", "recon", "live", "thesis", str(log), "--out", str(tmp_path / "x.mcap")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert told.returncode == 2
    assert "cannot follow 'thesis'" in told.stderr
    assert "Traceback" not in told.stderr


@pytest.mark.parametrize(("option", "told"), [("0 s", "less than 0.01 s"), ("-1 s", "negative")])
def test_a_pause_of_no_length_is_refused_in_a_sentence(lines, option, told, tmp_path):
    log = tmp_path / "log.txt"
    log.write_text("\n".join(lines[:50]) + "\n")
    done = subprocess.run(
        [sys.executable, "-m", "recon", "live", "best_accuracy", str(log), f"--every={option}"],
        cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert done.returncode == 2
    assert told in done.stderr
    assert "Traceback" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["log.txt"]


WITHOUT_ROOM = """
import resource, sys
from recon.cli import main
most = int(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
sys.exit(main(sys.argv[2:]))
"""
"""A limit on the size of files stands for the disk."""


def without_room(most, log, out):
    """`recon live` where no file may have more bytes."""
    _, _, _, *words = command(log, out, "--until-end")
    program = [sys.executable, "-c", WITHOUT_ROOM, str(most), *words]
    return subprocess.run(program, capture_output=True, text=True, check=False)


@pytest.mark.skipif(sys.platform == "win32", reason="the limit on the size of files is one of POSIX")
def test_a_full_disk_loses_nothing_that_was_written_and_the_same_command_goes_on(lines, tmp_path):
    log, out = tmp_path / "log.txt", tmp_path / "drive.mcap"
    log.write_text("\n".join(lines[:2001]) + "\n")
    nowhere = without_room(100_000, log, out)  # not even for what has come: 0.3 MB
    assert nowhere.returncode == 8
    assert f"{log.name} could not be written: file too large" in nowhere.stderr
    full = without_room(350_000, log, out)
    assert full.returncode == 8
    assert "drive.part.mcap could not be written: file too large" in full.stderr
    assert full.stderr.endswith("\n  what was written is kept; the same command goes on with it\n")
    before = recon.read(tmp_path / "drive.part.mcap")["imu"]
    assert before.num_rows > 100
    again = live(log, out)
    assert (again.returncode, "going on with" in again.stdout) == (0, True)
    found = recon.read(out)
    assert found["imu"].num_rows == 2000
    assert found["imu"].slice(0, before.num_rows).equals(before)


def test_a_live_view_is_whole_where_the_result_cannot_be_written(tmp_path):
    rerun = pytest.importorskip("rerun_cli", reason="rerun-sdk is not installed")
    assert rerun
    rrd = tmp_path / "live.rrd"
    with pytest.raises(StorageError), _viewer(wanted=False, file=rrd):
        raise StorageError("the disk is full")
    verified = subprocess.run(
        [sys.executable, "-m", "rerun_cli", "rrd", "verify", str(rrd)], capture_output=True, check=False
    )
    assert verified.returncode == 0, verified.stderr


def test_a_live_view_is_a_recording_that_rerun_verifies(lines, tmp_path):
    rerun = pytest.importorskip("rerun_cli", reason="rerun-sdk is not installed")
    assert rerun
    log, rrd = tmp_path / "log.txt", tmp_path / "live.rrd"
    log.write_text("\n".join(lines[:3000]) + "\n")
    subprocess.run(command(log, tmp_path / "x.mcap", "--until-end", "--rrd", str(rrd)), check=True, capture_output=True)
    verified = subprocess.run(
        [sys.executable, "-m", "rerun_cli", "rrd", "verify", str(rrd)], capture_output=True, check=False
    )
    assert verified.returncode == 0, verified.stderr


def test_rows_whose_times_are_far_ahead_do_not_end_the_run(lines, tmp_path):
    log, out = tmp_path / "log.txt", tmp_path / "drive.mcap"
    ahead = [f"{float(line.split(maxsplit=1)[0]) + 1800:.4f}\t{line.split(maxsplit=1)[1]}" for line in lines[300:302]]
    log.write_text("\n".join([*lines[:300], *ahead]) + "\n")
    registry = Registry.installed()
    session = Session(following(Pipeline.from_file("best_accuracy"), registry), str(log), out, 10.0, registry)
    list(session.new())
    with log.open("a") as file:
        file.write("\n".join(lines[302:402]) + "\n")
    list(session.new(last=True))
    session.close()
    assert recon.read(out)["imu"].num_rows == 399
    (warned,) = session.warnings
    assert "far ahead" in warned
    assert "1 more" in warned


def test_a_clock_that_is_set_back_is_told_and_ends_nothing(lines, tmp_path):
    log, out = tmp_path / "log.txt", tmp_path / "drive.mcap"
    log.write_text("\n".join(lines[:402]) + "\n")
    registry = Registry.installed()
    session = Session(following(Pipeline.from_file("best_accuracy"), registry), str(log), out, 10.0, registry)
    list(session.new())
    for first in (202, 302, 402):  # ten seconds back, for two hundred rows
        with log.open("a") as file:
            file.write("\n".join(lines[first : first + 100]) + "\n")
        list(session.new())
    list(session.new(last=True))
    session.close()
    assert recon.read(out)["imu"].num_rows == 501
    assert ["set back" in note for note in session.warnings] == [True]


def test_a_map_of_heights_is_left_to_a_run_over_the_whole_drive():
    steps = following(Pipeline.from_file("mountain"), Registry.installed())
    assert steps.fuser.id == "fuser.map"
    assert "filter.terrain" in steps.left_out


def test_what_it_is_given_and_does_not_use_is_told():
    steps = following(Pipeline.from_file("best_accuracy"), Registry.installed())
    live = steps.fuser.stage.live(steps.fuser.params, 10.0, None)
    wheel = build(WHEEL, time=np.arange(3) * 10**9, speed=np.ones(3), steering_angle=np.zeros(3))
    fix = build(GNSS, time=np.arange(2) * 10**9, speed=np.zeros(2))
    live.advance({"wheel": wheel, "gnss": fix, "gnss_2": fix})
    assert live.unused == ("gnss_2", "the steering angle of wheel")
