"""Attitude of a phone by VQF, Madgwick and Mahony: simulated drives with truth, and a real one."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute
import pytest
from metric_rows import rows_by_name

import recon
from recon import IMU, build
from recon.errors import DataError
from recon.numerics.rotation import Floats, conjugate, from_euler, multiply, rotate, to_euler, to_rotvec
from recon.numerics.rotation_series import slerp
from recon.numerics.signals import wrap_angle
from recon.rows import warnings_of
from recon.tables import Streams, matrix, meta, replace, schema_of, select_rows, time_ns, vector, with_meta
from recon_integrators.madgwick import MadgwickParams, integrate_madgwick
from recon_integrators.mahony import MahonyParams, integrate_mahony
from recon_integrators.vqf import VqfParams, integrate_vqf
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams

FILTERS: dict[str, tuple[Callable[..., Streams], type[Any]]] = {
    "vqf": (integrate_vqf, VqfParams),
    "madgwick": (integrate_madgwick, MadgwickParams),
    "mahony": (integrate_mahony, MahonyParams),
}
every_filter = pytest.mark.parametrize("name", list(FILTERS))


@cache
def drive(seed: int = 1, **values: Any) -> Streams:
    """Five minutes of city traffic with a phone in landscape."""
    return simulate_drive(DriveParams(sensors="phone", seed=seed, imu_rate=50.0, **values))


def truth(made: Streams) -> Floats:
    told = {row["name"]: row["value"] for row in made["metrics"].to_pylist()}
    q_vs = from_euler(*(np.radians(told[f"true_mount_{a}"]) for a in ("yaw", "pitch", "roll")))
    return multiply(matrix(made["reference"], "q"), q_vs)


def run(name: str, made: Streams, *, mag: bool = True, gnss: bool = True, **values: Any) -> Streams:
    function, params = FILTERS[name]
    return function(
        imu=made["imu"], mag=made["mag"] if mag else None, gnss=made["gnss"] if gnss else None, params=params(**values)
    )


def errors(found: Streams, made: Streams) -> tuple[float, float]:
    """Root mean square error of the tilt and of the heading, deg."""
    off = np.degrees(to_rotvec(multiply(matrix(found["attitude"], "q"), conjugate(truth(made)))))
    return float(np.sqrt((off[:, :2] ** 2).sum(axis=1).mean())), float(np.sqrt((off[:, 2] ** 2).mean()))


@every_filter
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_phone_in_landscape_knows_its_attitude(name: str, seed: int) -> None:
    tilt, heading = errors(run(name, drive(seed)), drive(seed))
    # the accelerometer's bias of 20 mg an axis tilts by 1.1 deg, 1.6 on two; Mahony's start takes a minute of the five
    assert tilt < (2.0 if name == "vqf" else 4.0)
    assert heading < 4.0


@every_filter
def test_heading_comes_from_the_course_without_a_magnetometer_and_that_is_said(name: str) -> None:
    found = run(name, drive(), mag=False)
    assert errors(found, drive())[1] < 3.0
    assert rows_by_name(found)["heading"]["method"] == "course"
    assert any("without a magnetometer" in note for note in warnings_of(found["metrics"]))
    assert meta(found["attitude"])["heading_kind"] == "true"


@every_filter
def test_heading_comes_from_the_magnetometer_where_nothing_else_is_heard(name: str) -> None:
    found = run(name, drive(), heading="magnetometer")
    # soft iron of 4 % an element makes up to 0.04 x 47 / 23 rad, 5 deg, and what is left of the hard iron 2
    assert errors(found, drive())[1] < 8.0
    assert rows_by_name(found)["heading"]["method"] == "magnetometer"


def test_declination_turns_magnetic_into_true_north() -> None:
    made = drive()
    found = [matrix(run("vqf", made, heading="magnetometer", declination=d)["attitude"], "q") for d in (0.0, 0.1)]
    turn = to_rotvec(multiply(found[1], conjugate(found[0])))
    # north lies 0.1 rad further to the west of where the needle points: every heading grows by 0.1 rad
    np.testing.assert_allclose(turn.mean(axis=0), [0.0, 0.0, -0.1], atol=2e-3)
    declination = rows_by_name(run("vqf", made))["declination"]
    assert declination["value"] == pytest.approx(rows_by_name(made)["true_declination"]["value"], abs=0.01)
    assert declination["method"] == "World Magnetic Model"


def test_hard_iron_is_found_or_taken_as_given() -> None:
    made = drive(mag_soft_iron=0.0, mag_disturbance_rate=0.0)
    true = [rows_by_name(made)[f"true_hard_iron_{a}"]["value"] for a in "xyz"]
    rows = rows_by_name(run("vqf", made))
    for axis, value in zip("xyz", true, strict=True):
        row = rows[f"hard_iron_{axis}"]
        # what the tilt's error of a degree, 0.7 uT of 42, adds lasts all the time
        assert abs(row["value"] - value) < 4.0 * row["sigma"] + 1.5e-6
    given = run("vqf", made, hard_iron=tuple(true), heading="magnetometer")
    assert "hard_iron_x" not in rows_by_name(given)
    assert errors(given, made)[1] < 2.5


def test_disturbed_samples_are_left_out_and_counted() -> None:
    made = drive(mag_soft_iron=0.0, mag_disturbance_rate=0.0)
    field = matrix(made["mag"], "mag")
    field[5000:8000] += [40e-6, 0.0, 0.0]  # upwards, where the Earth's is 42 uT downwards
    shifted = {**made, "mag": replace(made["mag"], mag=field)}
    found = run("vqf", shifted, heading="magnetometer")
    # 3000 of 15000 rows
    assert rows_by_name(found)["magnetic_disturbance"]["value"] == pytest.approx(20.0, abs=3.0)
    assert errors(found, made)[1] < errors(run("vqf", made, heading="magnetometer"), made)[1] + 1.5


def test_a_magnetometer_of_other_axes_is_refuted_by_the_course() -> None:
    made = drive()
    turned = {**made, "mag": replace(made["mag"], mag=matrix(made["mag"], "mag")[:, [0, 2, 1]] * [1.0, 1.0, -1.0])}
    found = run("vqf", turned)
    assert errors(found, made)[1] < 4.0
    assert any("left out" in note for note in warnings_of(found["metrics"]))


def test_a_field_that_cannot_be_the_earths_is_left_out_and_counted() -> None:
    made = drive()
    doubled = {**made, "mag": replace(made["mag"], mag=2.0 * matrix(made["mag"], "mag"))}
    found = run("vqf", doubled)
    assert rows_by_name(found)["heading"]["method"] == "course"
    assert rows_by_name(found)["magnetic_disturbance"]["value"] == 100.0
    assert any("upwards where the Earth has" in note for note in warnings_of(found["metrics"]))
    assert errors(found, made)[1] < 4.0
    alone = run("vqf", doubled, heading="magnetometer")
    assert meta(alone["attitude"])["heading_kind"] == "arbitrary"


def test_kinds_of_heading_are_never_mixed() -> None:
    made = drive()
    nowhere = {**made, "gnss": made["gnss"].drop_columns(["lat", "lon"])}
    by_course = run("vqf", nowhere)
    assert rows_by_name(by_course)["heading"]["method"] == "course"
    assert meta(by_course["attitude"])["heading_kind"] == "true"
    alone = run("vqf", made, gnss=False)
    assert meta(alone["attitude"])["heading_kind"] == "magnetic"
    assert any(
        "declination is not known" in n or "neither is the declination" in n for n in warnings_of(alone["metrics"])
    )
    blind = run("vqf", made, mag=False, gnss=False)
    assert meta(blind["attitude"])["heading_kind"] == "arbitrary"
    grid = {**made, "gnss": with_meta(made["gnss"].drop_columns(["vel_e", "vel_n", "vel_u"]), heading_kind="grid")}
    left_out = run("vqf", grid, mag=False)
    assert any("'grid'" in note for note in warnings_of(left_out["metrics"]))
    assert meta(left_out["attitude"])["heading_kind"] == "arbitrary"


def test_a_magnetic_course_is_turned_by_the_declination() -> None:
    made = drive()
    plain = made["gnss"].drop_columns(["vel_e", "vel_n", "vel_u"])
    angle = np.radians(rows_by_name(made)["true_declination"]["value"])
    magnetic = with_meta(replace(plain, course=vector(plain, "course") - angle), heading_kind="magnetic")
    found = [run("vqf", {**made, "gnss": gnss})["attitude"] for gnss in (plain, magnetic)]
    np.testing.assert_allclose(matrix(found[0], "q"), matrix(found[1], "q"), atol=1e-5)  # of another fix, some km on


def test_a_date_outside_the_model_is_refused_unless_the_declination_is_given() -> None:
    made = drive()
    shift = pa.scalar(-30 * 365 * 86_400 * 10**9, pa.duration("ns"))
    early: Streams = dict(made)
    for stream in ("imu", "mag", "gnss"):
        times = pa.compute.add(made[stream]["time"], shift)
        early[stream] = made[stream].set_column(0, made[stream].schema.field("time"), times)
    with pytest.raises(DataError, match="World Magnetic Model"):
        run("vqf", early)
    assert meta(run("vqf", early, declination=0.06)["attitude"])["heading_kind"] == "true"


def test_behind_a_gap_the_attitude_is_found_anew() -> None:
    made = drive()
    rows = np.ones(made["imu"].num_rows, dtype=bool)
    rows[6000:6500] = False
    found = run("vqf", {**made, "imu": select_rows(made["imu"], rows)})
    off = to_rotvec(multiply(matrix(found["attitude"], "q"), conjugate(truth(made)[rows])))
    assert np.degrees(np.sqrt((off[:, 2] ** 2).mean())) < 4.0
    assert any("gap" in note for note in warnings_of(found["metrics"]))


def test_the_attitude_is_of_the_sensor_and_says_so() -> None:
    found = run("mahony", drive())["attitude"]
    assert schema_of(found)["qw"].frame == "sensor"
    assert found.num_rows == drive()["imu"].num_rows


def test_acceleration_without_gravity_is_refused() -> None:
    made = drive()
    weightless = {**made, "imu": replace(made["imu"], accel=matrix(made["imu"], "accel") * 0.01)}
    with pytest.raises(DataError, match="gravity"):
        run("vqf", weightless)


@pytest.mark.parametrize("first", [1.0, 2.0, -3.0])
def test_any_first_heading_is_found(first: float) -> None:
    made = drive(seed=4, heading=first)
    tilt, heading = errors(run("vqf", made), made)
    assert tilt < 2.0
    assert heading < 4.0


def test_a_car_in_boston_agrees_with_the_attitude_of_its_own_filter(logs: Path) -> None:
    """VN-100 in a car, its yaw magnetic and not calibrated: the roll and pitch that it reports are a weak reference."""
    table = np.genfromtxt(logs / "neu_boston_car" / "first_test" / "town_imu.csv", delimiter=",", names=True)
    t_ns = np.round(table["stamp"] * 1e6).astype(np.int64) * 1000
    keep = np.append(True, np.diff(t_ns) > 0)

    def flu(group: str) -> np.ndarray:
        """Along forward, left, up; logged along forward, right, down, -g along z at rest."""
        return np.column_stack([table[f"{group}_x"], -table[f"{group}_y"], -table[f"{group}_z"]])[keep]

    imu = build(IMU, time=t_ns[keep], accel=flu("accel"), gyro=flu("gyro"))
    found = matrix(integrate_vqf(imu=imu, mag=None, gnss=None, params=VqfParams())["attitude"], "q")
    up_s = rotate(conjugate(found), [0.0, 0.0, 1.0])
    roll, pitch = np.radians(table["roll"][keep]), np.radians(table["pitch"][keep])
    # of its forward-right-down axes: up is minus down
    reference = np.column_stack([np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)])
    apart = np.degrees(np.arccos(np.clip((up_s * reference).sum(axis=1), -1.0, 1.0)))
    assert np.median(apart) < 2.0


@every_filter
def test_a_phone_on_a_straight_road_is_not_misled_by_the_iron_about_it(name: str, logs: Path) -> None:
    """A minute of a motorway, heading north, that begins with 25 s of speeding up. Where the Earth has 42 uT downwards
    the phone measures 25 uT upwards, as its own calibration left some 65 uT of the car's iron; by that field east would
    be 60 deg further on.
    """
    made = dict(recon.read(logs / "comma2k19_example" / "seg40"))
    found = run(name, made)
    assert rows_by_name(found)["heading"]["method"] == "course"
    assert any("upwards where the Earth has 23 and -42" in note for note in warnings_of(found["metrics"]))
    reference = made["reference"]
    q = slerp(time_ns(reference), time_ns(found["attitude"]), matrix(found["attitude"], "q"))
    inside = np.isfinite(q).all(axis=1)
    yaw, pitch, roll = (a - b for a, b in zip(to_euler(q), to_euler(matrix(reference, "q")), strict=True))
    # The camera stands within some degrees of the IMU; GNSS velocities of 0.1 m/s against accelerations of 0.5 m/s^2
    # show the heading to 10 deg in a second, to a few in the ten seconds or so in which it speeds up or brakes.
    assert np.degrees(np.sqrt((wrap_angle(yaw[inside]) ** 2).mean())) < 6.0
    assert np.degrees(max(np.abs(pitch[inside]).max(), np.abs(roll[inside]).max())) < 5.0
