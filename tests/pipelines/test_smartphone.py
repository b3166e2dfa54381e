"""The pipeline `smartphone` on simulated phones with truth, and on real logs beside `best_accuracy`."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from benchmarks import smartphone as benchmark

import recon
from recon.comparison import compare
from recon.numerics.evaluation import Statistics
from recon.numerics.signals import interpolate
from recon.rows import warnings_of
from recon.schema import IMU
from recon.storage import write_recording
from recon.tables import build, matrix, meta, time_ns, vector, with_meta

SEEDS = {"plain": 20, "nine_axes": 8}
"""Of the 40 and more that the benchmark takes."""


@lru_cache(maxsize=4)
def drive(seed: int) -> recon.Run:
    """Two minutes of town as a phone without a magnetometer sees them."""
    return benchmark.drive("plain", seed)


@pytest.mark.parametrize("phone", list(SEEDS))
def test_it_beats_the_fixes_in_95_percent_of_drives(phone: str) -> None:
    better = []
    for seed in range(SEEDS[phone]):
        made = drive(seed) if phone == "plain" else benchmark.drive(phone, seed)
        found = recon.run("smartphone", made.recording).recording
        better.append(benchmark.horizontal(found, made) < benchmark.raw(made))
    assert np.mean(better) >= 0.95


def test_a_phone_with_nine_axes_in_a_car_knows_its_heading() -> None:
    made = benchmark.drive("nine_axes", 1)
    run = recon.run("smartphone", made.recording)
    # A course of 0.05 m/s against accelerations of 0.5 m/s^2 in every bend, and soft iron of 4 %: 3 deg each.
    assert benchmark.heading_error(run, made) < 4.5
    assert "magnetic_disturbance" in {row["name"] for row in run.metrics.to_pylist()}


def test_both_errors_are_told_and_best_accuracy_is_the_better() -> None:
    made = drive(1)
    runs = [recon.run(pipeline, made.recording) for pipeline in ("smartphone", "best_accuracy")]
    plain, best = compare(runs).errors
    assert plain.found is not None
    assert best.found is not None
    for group, name in (("velocity", "horizontal"), ("attitude", "heading")):
        figures = [getattr(error.found, group)[name] for error in (plain, best)]
        assert all(isinstance(figure, Statistics) for figure in figures)
        assert figures[1].rmse < figures[0].rmse


def test_without_a_magnetometer_the_heading_comes_from_course_and_says_so() -> None:
    run = recon.run("smartphone", drive(1).recording)
    assert any("the heading comes from the course of GNSS" in note for note in warnings_of(run.metrics))
    assert meta(run.trajectory.table)["body"] == "sensor"


def test_its_sigmas_are_of_the_size_of_its_errors() -> None:
    squares = []
    for seed in range(5):
        made = drive(seed)
        run = recon.run("smartphone", made.recording)
        found = recon.evaluate(run).consistency["velocity"]
        assert found is not None
        squares.append(found.nees)
    # Errors of attitude are no white noise, as which they are taken: sigmas of velocity are up to twice too large.
    assert 0.1 < np.mean(squares) < 1.5


@pytest.fixture(scope="module")
def boston(logs: Path) -> Path:
    return logs / "neu_boston_car" / "first_test"


def test_a_town_with_nine_axes_and_a_table_for_each_sensor(boston: Path) -> None:
    mapping = Path(__file__).parents[1] / "plugins" / "csv_mappings" / "boston_car.yaml"
    files = [boston / "town_imu.csv", boston / "town_gps.csv"]
    columns = {"reader.csv.columns": yaml.safe_load(mapping.read_text(encoding="utf-8"))}
    plain, best = (recon.run(pipeline, files, **columns) for pipeline in ("smartphone", "best_accuracy"))
    (distance,) = compare([best, plain]).distances
    assert distance.found is not None
    apart = distance.found.position["horizontal"]
    assert apart is not None
    # The receiver is 0.7 s late, which best_accuracy finds: 4 m at 6 m/s.
    assert apart.rmse < 6.0
    assert "heading" in {row["name"] for row in plain.metrics.to_pylist()}


def test_a_motorbike_is_no_faster_than_its_receiver_says(logs: Path) -> None:
    """Where it turns back, two fixes of the phone lie 40 m beside the way; its own speed, 2 m/s, tells that."""
    mapping = Path(__file__).parents[1] / "plugins" / "csv_mappings" / "dresden_motorbike.yaml"
    columns = {"reader.csv.columns": yaml.safe_load(mapping.read_text(encoding="utf-8"))}
    run = recon.run("smartphone", logs / "balzer82_dresden" / "2016-08-09-Motorbike.csv", **columns)
    assert any(
        "2 of 107 gnss positions contradict the speed that gnss itself tells" in n for n in warnings_of(run.metrics)
    )
    gnss, found = run.recording["gnss"], run.trajectory
    speed = np.hypot(*matrix(found.table, "vel")[:, :2].T)
    apart = interpolate(time_ns(gnss), time_ns(found.table), speed) - vector(gnss, "speed")
    # A fix a second that scatters by 1 to 2 m, and the phone's speed, which lags by 0.7 s while accelerations are 1
    # m/s^2: a metre a second, two or three of them together at the worst.
    assert np.sqrt(np.nanmean(apart**2)) < 1.0
    assert np.nanmax(np.abs(apart)) < 4.0
    assert speed.max() < vector(gnss, "speed").max() + 2.0


def test_stops_are_found_where_accelerometer_and_gyroscope_have_times_of_their_own() -> None:
    """As phones write them: each sample of the gyroscope 3 ms after one of the accelerometer, in rows of its own."""
    recording = drive(1).recording
    imu = recording["imu"]
    t_ns, accel, gyro = time_ns(imu), matrix(imu, "accel"), matrix(imu, "gyro")
    rows, nothing = np.argsort(np.r_[t_ns, t_ns + 3_000_000]), np.full_like(accel, np.nan)
    apart = build(
        IMU,
        time=np.r_[t_ns, t_ns + 3_000_000][rows],
        accel=np.vstack([accel, nothing])[rows],
        gyro=np.vstack([nothing, gyro])[rows],
    )
    given = {name: table for name, table in recording.items() if name in ("gnss", "mag")}
    ran = recon.run("smartphone", recon.Recording({**given, "imu": with_meta(apart, **meta(imu))}))
    assert "standstill" in ran.recording["events"]["kind"].to_pylist()


def test_distances_are_measured_between_images_beside_the_log(tmp_path: Path) -> None:
    made = drive(1)
    start = int(time_ns(made.recording["imu"])[0]) // 1_000_000
    write_recording(made.recording, tmp_path / "drive")
    (tmp_path / "images").mkdir()
    for second in range(20, 80, 2):
        (tmp_path / "images" / f"frame_{start + second * 1000}.jpg").touch()
    run = recon.run("smartphone", [tmp_path / "drive", tmp_path / "images"])
    moved, truth = run.trajectory.between("#5", "#15"), recon.Trajectory(made.recording["reference"])
    assert moved.duration == 20.0
    # Three sigmas of two fixes of 2 m and 1 m, as if they had nothing in common: 3 sqrt(2 (4 + 1)).
    assert moved.ground_distance == pytest.approx(truth.between(moved.start, moved.stop).ground_distance, abs=9.5)
    assert 0.5 < moved.ground_distance_sigma < 4.0


def test_distances_err_by_as_much_as_their_sigmas_say() -> None:
    squares: dict[float, list[float]] = {5.0: [], 20.0: [], 60.0: []}
    for seed in range(6):
        made = drive(seed)
        found, truth = recon.run("smartphone", made.recording).trajectory, recon.Trajectory(made.recording["reference"])
        late = float((time_ns(found.table)[0] - time_ns(truth.table)[0]) * 1e-9)
        for span, each in squares.items():
            start = np.linspace(1.0, found.duration - span - 1.0, 20)
            moved, true = found.between(start, start + span), truth.between(start + late, start + span + late)
            error = (moved.displacement - true.displacement)[:, :2]
            spread = moved.displacement_covariance[:, :2, :2]
            each.append(float(np.einsum("ni,nij,nj->n", error, np.linalg.inv(spread), error).mean()) / 2.0)
    # Over 5 s what the acceleration errs by counts, which is no white noise; over 60 s the slow errors of 12 axes.
    for span, (low, high) in {5.0: (0.2, 1.3), 20.0: (0.4, 1.6), 60.0: (0.4, 2.5)}.items():
        assert low < np.mean(squares[span]) < high, span
