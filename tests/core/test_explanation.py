"""From a number back to the rows of the log."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from evidence_runs import BLOW, PIPELINE, ROWS, write_log

import recon
from recon import evidence
from recon.cli import main
from recon.errors import DataError
from recon.explanation import explain


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with a log and the run of it."""
    folder = tmp_path_factory.mktemp("explained")
    recon.run(PIPELINE, write_log(folder / "drive.txt"), folder / "run")
    return folder


def test_the_walk_goes_from_the_number_to_the_reader(place):
    found = explain(recon.open(place / "run"), "crashes")
    assert found.step == "detector.shock"
    assert [link.use for link in found.links] == ["detector.shock", "filter.moving_average", "reader.auto"]
    assert found.links[0].params["threshold"] == "2 g"
    assert found.links[1].reads == ("imu",)
    assert found.links[-1].writes["imu"] == ROWS
    assert "reader.physycom" in found.links[-1].params
    assert found.inputs[0]["name"] == "drive.txt"


def test_the_rows_and_lines_are_those_of_the_blow(place):
    """The event lies inside the blow, whose first row stands in line 202: the header is line 1."""
    found = explain(recon.open(place / "run"), "crashes")
    imu = next(rows for rows in found.rows if rows.stream == "imu")
    assert BLOW[0] <= imu.rows[0] - 1 <= imu.rows[1] - 1 < BLOW[1]
    assert imu.lines == (imu.rows[0] + 1, imu.rows[1] + 1)
    lines = (place / "drive.txt").read_text().splitlines()
    assert list(imu.texts) == [" ".join(lines[number - 1].split()) for number in imu.lines]
    assert all(text.split()[2] == "3.00000" for text in imu.texts)


def test_a_number_that_is_about_no_event_rests_on_the_whole_log(place):
    found = explain(recon.open(place / "run"), "filter.moving_average.window")
    assert [link.id for link in found.links] == ["filter.moving_average", "reader.auto"]
    imu = next(rows for rows in found.rows if rows.stream == "imu")
    assert (imu.about, imu.rows, imu.lines) == ("the whole log", (1, ROWS), (2, ROWS + 1))


def test_a_name_that_is_not_there_is_answered_with_the_nearest(place):
    with pytest.raises(DataError, match="no metric 'crashs'") as caught:
        explain(recon.open(place / "run"), "crashs")
    assert "crashes" in caught.value.hint


def test_a_name_of_several_steps_asks_which(tmp_path):
    pipeline = recon.Pipeline.from_text(
        "name: x\nsteps: [{use: reader.auto}, {use: filter.moving_average}, {use: filter.moving_average, id: again}]"
    )
    run = recon.run(pipeline, write_log(tmp_path / "drive.txt"))
    with pytest.raises(DataError, match="2 steps have a metric 'window'") as caught:
        explain(run, "window")
    assert "filter.moving_average.window or again.window" in caught.value.hint
    links = explain(run, "again.window", [tmp_path / "drive.txt"]).links
    assert [link.id for link in links] == ["again", "filter.moving_average", "reader.auto"]


def test_a_log_that_is_gone_or_changed_leaves_the_steps(tmp_path):
    log = write_log(tmp_path / "drive.txt")
    recon.run(PIPELINE, log, tmp_path / "run")
    log.write_text(log.read_text().replace("3.00000", "2.00000"))
    found = explain(recon.open(tmp_path / "run"), "crashes")
    assert len(found.links) == 3
    assert not found.rows
    assert "not what the run read" in found.missing


def test_lines_of_a_csv_log_are_those_of_its_sheet(tmp_path):
    lines = ["a box", "t,ax,ay,az,gx,gy,gz", *(f"{0.01 * i:.2f},{3 * (i == 50)},0,1,0,0,0" for i in range(100))]
    (tmp_path / "drive.csv").write_text("\n".join(lines) + "\n")
    mapping = (
        "{imu: {time: {column: t, format: relative, unit: s}, "
        "accel: {columns: [ax, ay, az], unit: g}, gyro: {columns: [gx, gy, gz], unit: deg/s}}}"
    )
    pipeline = recon.Pipeline.from_text(
        f"name: x\nsteps: [{{use: reader.csv, params: {{columns: {mapping}}}}}, {{use: detector.shock}}]"
    )
    found = explain(recon.run(pipeline, tmp_path / "drive.csv"), "crashes", [tmp_path / "drive.csv"])
    assert found.missing == ""
    assert [rows.lines for rows in found.rows] == [(53, 53)]
    assert found.rows[0].texts[0].startswith("0.50,3")


def test_a_sealed_file_is_explained_as_its_run(place, tmp_path, capsys):
    evidence.seal(place / "run", tmp_path / "run.zip")
    assert main(["explain", str(tmp_path / "run.zip"), "crashes", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["rows"][0]["lines"]
    assert main(["explain", str(place / "run"), "crashes", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == told


def test_people_read_the_number_the_steps_and_the_lines(place, capsys):
    assert main(["explain", str(place / "run"), "crashes"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("crashes = 1\n")
    for part in (
        "detector.shock (version 1 of recon-dynamics",
        "threshold = 2 g",
        " UTC\n    imu: rows ",
        "SHA-256",
        "lines 204 to 205 of drive.txt",
    ):
        assert part in text


def test_a_simulated_run_has_no_log(tmp_path):
    pipeline = recon.Pipeline.from_text(
        "name: x\nsteps: [{use: simulator.drive, params: {duration: 60 s}}, {use: filter.moving_average}]"
    )
    found = explain(recon.run(pipeline), "window")
    assert "there is no log" in found.missing


def test_a_part_of_a_log_is_explained_by_its_lines_in_the_whole(logs):
    log = logs / "physycom_crash" / "crash_01.txt"
    pipeline = recon.Pipeline.of("x", "reader.auto", "detector.crash")
    whole = explain(recon.run(pipeline, log), "crashes", [log])
    part = explain(recon.run(pipeline, log, start="30 s", stop="75 s"), "crashes", [log])
    (trim,) = (link for link in part.links if link.use == "filter.trim")
    assert trim.reads == ("imu", "gnss", "events", "metrics")
    imu, same = (next(rows for rows in found.rows if rows.stream == "imu") for found in (part, whole))
    assert imu.lines == same.lines


def test_the_real_crash_is_explained_to_the_line_of_its_time_zero(logs):
    """0.8 km/h in 20 ms begin nearest to this row; 60.276 s, 20 ms before the first row past them, is the next one."""
    log = logs / "physycom_crash" / "crash_01.txt"
    found = explain(recon.run(recon.Pipeline.of("x", "reader.auto", "detector.crash"), log), "crashes", [log])
    imu = next(rows for rows in found.rows if rows.stream == "imu")
    assert imu.lines is not None
    assert imu.texts[0].split()[-1] == "60.2736"
    assert log.read_text().splitlines()[imu.lines[0] - 1].split() == imu.texts[0].split()
