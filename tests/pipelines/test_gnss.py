"""The pipeline `gnss` on a simulated receiver with truth, and on real logs of receivers alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import recon
from recon import DataError, Recording
from recon.numerics.geodesy import Anchor, geodetic_to_enu
from recon.numerics.signals import interpolate
from recon.tables import matrix, meta, time_ns, vector

SETTINGS = {"motion": "city", "duration": "240 s", "gnss_white_horizontal": "2 m"}


@pytest.fixture(scope="module")
def drive() -> recon.Run:
    """Four minutes of town, with fixes that scatter by 2 m."""
    return recon.run("simulated_drive", **{f"simulator.drive.{name}": value for name, value in SETTINGS.items()})


def horizontal(streams: Recording, truth: recon.Run) -> float:
    """Root mean square m of what the fixes err by in east and north."""
    reference, gnss = truth.recording["reference"], streams["gnss"]
    anchor = Anchor(**meta(reference)["anchor"])
    found = geodetic_to_enu(*(vector(gnss, name, gaps=True) for name in ("lat", "lon", "height")), anchor)
    true = interpolate(time_ns(gnss), time_ns(reference), matrix(reference, "pos"))
    off = (found - true)[:, :2]
    return float(np.sqrt(np.nanmean(np.sum(off**2, axis=1))))


def test_the_track_is_nearer_to_the_truth_than_the_fixes(drive: recon.Run) -> None:
    alone = Recording({"gnss": drive.recording["gnss"]}, drive.recording.meta)
    run = recon.run("gnss", alone)
    # what is new in every fix has a variance of 2 m squared on two axes; at least half of it goes, the slow error stays
    assert horizontal(run.recording, drive) ** 2 < horizontal(alone, drive) ** 2 - 0.5 * 2 * 2.0**2


def test_distance_and_duration_are_told_without_a_trajectory(drive: recon.Run) -> None:
    run = recon.run("gnss", Recording({"gnss": drive.recording["gnss"]}, drive.recording.meta))
    true = np.linalg.norm(np.diff(matrix(drive.recording["reference"], "pos")[:, :2], axis=0), axis=1).sum()
    summary = run.summary()
    # speeds once a second: the trapezoid errs by a^2 / 12 v of a second at every change, less than 2 % in town
    assert summary["distance"] == pytest.approx(true, rel=0.02)
    assert summary["duration"] == pytest.approx(240.0, abs=2.0)


def test_best_accuracy_names_it_where_there_is_no_imu(logs: Path) -> None:
    with pytest.raises(DataError) as caught:
        recon.run("best_accuracy", logs / "formats/nmea/GPS-raw-data.txt")
    assert "recon run gnss LOG" in caught.value.hint


@pytest.mark.parametrize(
    ("log", "metres"),
    [
        ("formats/nmea/GPS-raw-data.txt", (470.0, 480.0)),
        ("formats/ubx/gnss_1730.ubx", (125.0, 131.0)),
        ("rtklibexplorer_walk/gnss_1730_sf.pos", (125.0, 131.0)),  # the same walk, its speed derived
    ],
)
def test_real_receivers_alone(logs: Path, log: str, metres: tuple[float, float]) -> None:
    run = recon.run("gnss", logs / log)
    assert metres[0] < run.summary()["distance"] < metres[1]
    assert run.summary()["stops"] == 2


def test_a_track_without_speeds_gets_those_between_its_points(logs: Path) -> None:
    run = recon.run("gnss", logs / "formats/gpx/around-visnjan-with-car.gpx")
    assert 20.0 < run.summary()["top_speed"] < 30.0  # a country road
