"""The simulated magnetometer: the Earth's field in the box, iron, disturbances."""

from __future__ import annotations

import numpy as np
import pytest

from recon.errors import DataError
from recon.magnetic import magnetic_field_n
from recon.numerics.rotation import conjugate, from_euler, multiply, rotate
from recon.rows import spans
from recon.tables import Streams, matrix, time_ns
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams


def drive(**values: object) -> Streams:
    return simulate_drive(DriveParams(**{"sensors": "perfect", "duration": 60.0, "mag_rate": 10.0, **values}))


def test_without_errors_it_shows_the_earths_field_in_the_box() -> None:
    mount = from_euler(0.4, -1.2, 0.1)
    made = drive(mount_yaw=0.4, mount_pitch=-1.2, mount_roll=0.1)
    start = int(time_ns(made["imu"])[0])
    field_n = magnetic_field_n(44.4949, 11.3426, 100.0, start)
    q_nv = matrix(made["reference"], "q")[::10]
    expected = rotate(conjugate(multiply(q_nv, mount)), field_n)
    np.testing.assert_allclose(matrix(made["mag"], "mag"), expected, atol=1e-15)


def test_a_given_field_is_taken_and_the_sensor_is_optional() -> None:
    field_n = (1e-6, 20e-6, -40e-6)
    size = np.linalg.norm(matrix(drive(earth_field=field_n)["mag"], "mag"), axis=1)
    np.testing.assert_allclose(size, np.linalg.norm(field_n), rtol=1e-12)
    assert "mag" not in drive(mag_rate=0.0)
    assert "mag" not in simulate_drive(DriveParams(duration=20.0))


def test_hard_iron_is_added_and_told() -> None:
    plain, iron = drive(), drive(mag_hard_iron=15e-6)
    offset = matrix(iron["mag"], "mag") - matrix(plain["mag"], "mag")
    told = {row["name"]: row["value"] for row in iron["metrics"].to_pylist()}
    np.testing.assert_allclose(
        offset, np.tile([told[f"true_hard_iron_{a}"] for a in "xyz"], (len(offset), 1)), atol=1e-15
    )


def test_soft_iron_bends_the_field_by_a_symmetric_matrix() -> None:
    plain, iron = matrix(drive()["mag"], "mag"), matrix(drive(mag_soft_iron=0.05)["mag"], "mag")
    bend = np.linalg.lstsq(plain, iron, rcond=None)[0]
    # the flat drive turns about one axis, so that the matrix is known on the span of what was seen, all three axes
    np.testing.assert_allclose(plain @ bend, iron, atol=1e-12)
    np.testing.assert_allclose(bend, bend.T, atol=1e-6)
    assert 0.005 < np.abs(bend - np.eye(3)).max() < 0.3


def test_disturbances_are_told_as_events_and_leave_the_rest_alone() -> None:
    made = drive(mag_disturbance_rate=1.0 / 20.0, duration=120.0)
    apart = matrix(made["mag"], "mag") - matrix(drive(duration=120.0)["mag"], "mag")
    size = np.linalg.norm(apart, axis=1)
    found = [row for row in made["events"].to_pylist() if row["kind"] == "magnetic_disturbance"]
    assert found
    assert all(10e-6 <= row["value"] <= 60e-6 for row in found)
    inside = np.zeros(len(size), dtype=bool)
    for start, stop in spans(made["events"], "magnetic_disturbance"):
        inside |= (time_ns(made["mag"]) >= start) & (time_ns(made["mag"]) <= stop)
    assert size[~inside].max() < 1e-15
    assert 5e-6 < size.max() <= 60e-6


def test_the_magnetometer_leaves_every_other_sensor_as_it_was() -> None:
    without, beside = drive(mag_rate=0.0, sensors="phone"), drive(sensors="phone")
    for stream in ("imu", "gnss", "reference"):
        assert without[stream].equals(beside[stream])


def test_a_phone_stands_in_landscape_with_its_screen_to_the_driver() -> None:
    made = simulate_drive(DriveParams(sensors="phone", motion="rest", duration=5.0))
    felt = matrix(made["imu"], "accel").mean(axis=0)
    # x of the phone points up, leaning back by some 20 deg
    assert felt[0] > 8.0
    assert np.abs(felt[1]) < 2.0
    told = {row["name"]: row["value"] for row in made["metrics"].to_pylist()}
    q_vs = from_euler(*(np.radians(told[f"true_mount_{a}"]) for a in ("yaw", "pitch", "roll")))
    out_of_the_screen = rotate(q_vs, [0.0, 0.0, 1.0])
    assert out_of_the_screen[0] < -0.85
    assert rotate(q_vs, [0.0, 1.0, 0.0])[1] > 0.9


@pytest.mark.parametrize("start", ["1999-05-01T08:00:00Z", "2031-01-01T00:00:00Z"])
def test_a_date_without_a_model_of_the_field_is_refused(start: str) -> None:
    with pytest.raises(DataError, match="World Magnetic Model"):
        drive(start=start)
