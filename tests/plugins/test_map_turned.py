"""fuser.map and a box that turns in its mount: found, turned back, told; a loose box is a doubt."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from csv_logs import MAPPINGS, params_of
from map_drives import drive, errors, fused, numbers
from turned_drives import turned

from recon import Event, Streams, events, matrix, time_ns
from recon.numerics.rotation import angle, conjugate, from_euler, from_rotvec, multiply, rotate
from recon.numerics.smoothing import estimate
from recon.rows import spans, warnings_of
from recon.tables import replace
from recon_readers.csv import read

AT_S, LASTS_S = 270.0, 1.5
TURNS = [(10.0, 3.0, 2.0), (-5.0, 0.0, 0.0), (0.0, 6.0, 0.0), (0.0, 0.0, 20.0), (90.0, 0.0, 0.0), (170.0, 5.0, 0.0)]
"""Yaw, pitch and roll in deg, of the box since then in its axes of before."""


@pytest.fixture(scope="module")
def streams() -> Streams:
    return drive("mixed", seed=31, duration=600.0)


@pytest.fixture(scope="module", params=TURNS, ids=str)
def case(streams: Streams, request: pytest.FixtureRequest) -> tuple[np.ndarray, Streams]:
    """How the box turned, and what comes out."""
    q_old_new = from_euler(*np.radians(request.param))
    return q_old_new, fused({**streams, "imu": turned(streams, q_old_new, AT_S)})


def test_the_turn_is_an_event_with_its_size(streams, case):
    q_old_new, found = case
    ((first, last),) = (np.array(spans(found["events"], "box_turned")) - time_ns(streams["imu"])[0]) * 1e-9
    assert AT_S - 2.0 < first <= AT_S + 0.2
    assert AT_S + LASTS_S - 0.2 <= last < AT_S + LASTS_S + 2.0
    (row,) = (row for row in found["events"].to_pylist() if row["kind"] == "box_turned")
    true = np.degrees(angle(q_old_new, np.array([1.0, 0.0, 0.0, 0.0])))
    # Without wheels the heading of this drive is known to half a degree.
    assert row["value"] == pytest.approx(true, abs=2.0)


def test_it_is_told(case):
    notes = [note for note in warnings_of(case[1]["metrics"]) if "the box turned in its mount by" in note]
    assert len(notes) == 1


def test_the_vehicle_is_where_the_box_would_have_told_it_unturned(streams, case):
    """Left as it is, a turn by 10 degrees is one of 5 in the mean."""
    off = errors(streams, case[1])
    assert off.heading_of_vehicle < 0.4
    assert np.degrees(np.sqrt((off.turn[:, :2] ** 2).mean())) < 0.6
    assert off.horizontal() < 1.3 * errors(streams, fused(streams)).horizontal()


def test_the_mounting_is_that_of_before(streams, case):
    ours, true = numbers(case[1]), numbers(streams)
    q_vs = np.array([ours[f"mount_q{part}"] for part in "wxyz"])
    true_vs = from_euler(*np.radians([true[f"true_mount_{name}"] for name in ("yaw", "pitch", "roll")]))
    assert np.degrees(angle(q_vs, true_vs)) < 1.0


def test_a_box_that_stays_is_left_as_it_is(streams):
    found = fused(streams)
    assert spans(found["events"], "box_turned") == []
    assert found["trajectory"].num_rows == streams["imu"].num_rows


def test_two_turns_are_two():
    log = drive("country", seed=32, duration=600.0)
    true = [from_euler(*np.radians(turn)) for turn in ((-12.0, 0.0, 4.0), (25.0, -10.0, 0.0))]
    imu = turned({**log, "imu": turned(log, true[0], 200.0)}, true[1], 400.0)
    found = fused({**log, "imu": imu})
    assert len(spans(found["events"], "box_turned")) == 2
    assert errors(log, found).heading_of_vehicle < 0.4


def test_a_car_whose_box_is_laid_down_is_no_motorbike():
    """Two large turns look like roads that bank by tens of degrees, some of which leaning into bends would explain."""
    log = drive("country", "study_one", 9428, duration=600.0)
    true = [from_rotvec(np.radians(turn)) for turn in ((-8.0, 23.1, -99.4), (26.8, 99.6, 59.0))]
    imu = turned({**log, "imu": turned(log, true[0], 120.9, 5.0)}, true[1], 221.8, 2.4)
    found = fused({**log, "imu": imu})
    assert len(spans(found["events"], "box_turned")) == 2
    assert errors(log, found).heading_of_vehicle < 0.3


def test_a_turn_is_found_wherever_the_noise_is_learnt_from():
    """Which are twenty minutes of the drive, those with most motion: the first ten are not among them."""
    log = drive("mixed", "study_one", 9501, duration=3600.0)
    found = fused({**log, "imu": turned(log, from_euler(*np.radians((0.0, 5.0, 0.0))), 600.0)})
    assert len(spans(found["events"], "box_turned")) == 1
    assert np.degrees(np.sqrt((errors(log, found).turn[:, :2] ** 2).mean())) < 0.3


def test_a_loose_box_is_a_doubt(streams):
    imu, there = streams["imu"], from_euler(np.radians(9.0), 0.0, 0.0)
    for count, at_s in enumerate(np.arange(40.0, 590.0, 9.0)):
        imu = turned({**streams, "imu": imu}, there if count % 2 else conjugate(there), float(at_s))
    assert any(
        "has the box turned in its mount" in note for note in warnings_of(fused({**streams, "imu": imu})["metrics"])
    )


def test_a_turn_in_an_impact_leaves_its_samples_in_place(streams):
    start_ns = time_ns(streams["imu"])[0] + round(AT_S * 1e9)
    impact = events([Event(start_ns, start_ns + 100_000_000, "crash", 5.0, "m/s")])
    imu = turned(streams, from_euler(*np.radians(TURNS[0])), AT_S)
    assert fused({**streams, "imu": imu, "events": impact})["trajectory"].num_rows == imu.num_rows


def test_turning_about_the_vehicle_first_changes_nothing(streams):
    """However the box is mounted: its axes are none of the vehicle's."""
    other = from_euler(1.0, -0.7, 2.0)
    log = drive("mixed", seed=31, duration=600.0, accel_scale=0.0, gyro_scale=0.0)
    for stream, names in (("imu", ("accel", "gyro")), ("imu_truth", ("accel_bias", "gyro_bias"))):
        log[stream] = replace(log[stream], **{name: rotate(other, matrix(log[stream], name)) for name in names})
    q_old_new = multiply(other, multiply(from_euler(*np.radians(TURNS[0])), conjugate(other)))
    found = fused({**log, "imu": turned(log, q_old_new, AT_S)})
    assert len(spans(found["events"], "box_turned")) == 1
    assert errors(log, found).heading_of_vehicle < 0.4


def test_no_turn_explains_forces_of_the_wrong_sign(logs: Path) -> None:
    """A rough log, its accelerometer believed to tell gravity: more than the mounting does not fit."""
    params = params_of((MAPPINGS / "dresden_car.yaml").read_text(encoding="utf-8"))
    log = read(path=logs / "balzer82_dresden" / "2014-03-26-000-Data.csv", params=params)
    found = fused({**log, "imu": replace(log["imu"], accel=-matrix(log["imu"], "accel"))})
    assert not len(spans(found["events"], "box_turned"))
    assert any("contradict each other" in note for note in warnings_of(found["metrics"]))


def test_without_learning_of_the_noise_a_turn_is_found_and_a_box_that_stays_is_not_suspected(
    streams: Streams, monkeypatch: pytest.MonkeyPatch
) -> None:
    turned_box = {**streams, "imu": turned(streams, from_euler(*np.radians(TURNS[0])), AT_S)}
    assert len(spans(fused(turned_box, estimate_noise=False)["events"], "box_turned")) == 1
    solutions = []
    monkeypatch.setattr("recon.driving.estimate", lambda *given: solutions.append(given) or estimate(*given))
    fused(streams, estimate_noise=False)
    assert len(solutions) == 1
