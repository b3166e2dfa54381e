"""`recon measure`: GeographicLib's own distances and bearings, sigmas of the smoother, null for what is not known."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from geographiclib.geodesic import Geodesic

import recon
from recon import FRAMES, Recording, build
from recon.cli import main
from recon.numerics.geodesy import Anchor, enu_to_geodetic
from recon.schema import TRAJECTORY
from recon.tables import vector, with_meta

START_NS = 1_574_762_400_000_000_000
"""2019-11-26 10:00 UTC."""
ROWS = 301


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of five minutes, 6 km to the north-east and 50 m up, with a frame each 10 s."""
    t_s = np.arange(float(ROWS))
    anchor = Anchor(48.0831, 11.6354, 560.0)
    pos = np.column_stack([12.0 * t_s, 16.0 * t_s, t_s / 6.0])
    lat, lon, height = enu_to_geodetic(pos, anchor)
    q = np.tile([1.0, 0.0, 0.0, 0.0], (ROWS, 1))
    time = START_NS + np.arange(ROWS) * 1_000_000_000
    table = build(
        TRAJECTORY,
        time=time,
        pos=pos,
        vel=np.tile([12.0, 16.0, 1 / 6], (ROWS, 1)),
        q=q,
        lat=lat,
        lon=lon,
        height=height,
    )
    frames = build(FRAMES, time=time[::10], index=np.arange(0, ROWS, 10) // 10, file=pa.array(["x.jpg"] * 31))
    streams = {"trajectory": with_meta(table, anchor=asdict(anchor), earth="wgs84"), "frames": frames}
    place = tmp_path_factory.mktemp("measure") / "run"
    recon.run(recon.Pipeline("given", ()), Recording(streams), place)
    return place


def measured(folder: Path, start: str, stop: str, capsys: pytest.CaptureFixture[str]) -> dict[str, dict[str, object]]:
    assert main(["measure", str(folder), "--from", start, "--to", stop, "--json"]) == 0
    found: dict[str, dict[str, object]] = json.loads(capsys.readouterr().out)
    return found


@pytest.mark.parametrize(("start", "stop"), [("#0", "#30"), ("100s", "2019-11-26T10:00:30Z"), ("1.5 min", "90.25 s")])
def test_distance_and_bearings_are_those_of_geographiclib(
    folder: Path, start: str, stop: str, capsys: pytest.CaptureFixture[str]
) -> None:
    found = measured(folder, start, stop, capsys)
    trajectory = recon.open(folder).trajectory
    here, there = trajectory.at(start), trajectory.at(stop)
    expected = Geodesic.WGS84.Inverse(here.lat, here.lon, there.lat, there.lon)
    assert found["distance"] == {"value": pytest.approx(expected["s12"], abs=1e-3), "sigma": None, "unit": "m"}
    for name, azimuth in (("initial_bearing", "azi1"), ("final_bearing", "azi2")):
        # A millimetre across the way.
        limit = np.degrees(1e-3 / expected["s12"])
        assert found[name] == {
            "value": pytest.approx(expected[azimuth] % 360.0, abs=limit),
            "sigma": None,
            "unit": "deg",
        }
    seconds = (there.time - here.time).astype(int) * 1e-9
    assert found["elapsed"] == {"value": pytest.approx(seconds), "sigma": None, "unit": "s"}
    assert found["path_length"]["value"] == pytest.approx(abs(seconds) * np.hypot(20.0, 1.0 / 6.0))
    assert found["height_difference"]["value"] == pytest.approx(there.height - here.height, abs=1e-9)


def test_bearings_of_the_same_place_are_not_known(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = measured(folder, "#3", "30s", capsys)
    assert [found[name]["value"] for name in ("distance", "initial_bearing", "final_bearing")] == [0.0, None, None]


def test_people_get_a_table(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["measure", str(folder), "--from", "#3", "--to", "#4"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("from 2019-11-26 10:00:30.000 to 2019-11-26 10:00:40.000 UTC")
    assert [line.split()[0] for line in lines[1:]] == ["distance", "path", "initial", "final", "height", "elapsed"]


@pytest.mark.parametrize(
    ("start", "told"),
    [
        ("#99", "there is no frame #99; there are #0 to #30"),
        ("noon", "'noon' is no time"),
        ("12.5", "with a unit it is one: '12.5s' after the first row"),
        ("301s", "the time 2019-11-26T10:05:01.000000000 UTC lies outside the trajectory"),
        ("-1s", "after its first row that is from '0s' to '300s'"),
    ],
)
def test_what_cannot_be_measured_is_one_sentence(
    folder: Path, start: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["measure", str(folder), f"--from={start}", "--to", "0s"]) == 4
    assert told in capsys.readouterr().err


def test_sigmas_are_those_of_the_smoother(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive = {"simulator.drive.motion": "s_curve"}
    made = recon.run("simulated_drive", **drive)
    run = recon.run("best_accuracy", made.recording, tmp_path / "run")
    found = measured(tmp_path / "run", "12s", "20s", capsys)
    moved = run.trajectory.between(12.0, 20.0)
    assert found["distance"]["sigma"] == moved.ground_distance_sigma > 0.0
    assert found["initial_bearing"]["sigma"] == np.degrees(moved.bearing_sigma) > 0.0
    assert found["height_difference"]["sigma"] == moved.height_sigma > 0.0
    # Errors of two times have most in common: that is why the root sum of squares would be wrong.
    table = run.trajectory.table
    apart = np.sqrt(2.0) * np.median(np.hypot(vector(table, "pos_std_e"), vector(table, "pos_std_n")))
    assert moved.ground_distance_sigma < 0.5 * apart
    # And they are honest: a distance that lies within four sigmas of the truth, seen along the ground.
    true = recon.Trajectory(made.recording["reference"]).between(moved.start, moved.stop)
    assert abs(moved.ground_distance - true.ground_distance) < 4.0 * moved.ground_distance_sigma
