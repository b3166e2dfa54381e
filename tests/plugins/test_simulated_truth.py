"""The truth of simulated drives, by differentiation, and perfect sensors against it."""

from __future__ import annotations

import numpy as np
import pytest
from metric_rows import values_by_name
from simulated_drives import EPS, MOTIONS, felt, simulate, triple

from recon.numerics.geodesy import (
    Anchor,
    geodetic_to_ecef,
    geodetic_to_enu,
    local_axes_e,
)
from recon.numerics.rotation import (
    Floats,
    conjugate,
    heading_from_yaw,
    multiply,
    rotate,
    to_euler,
    to_rotvec,
)
from recon.tables import Streams, matrix, meta, seconds, time_ns, vector


def second_difference(y: Floats) -> float:
    return float(np.abs(np.diff(y, n=2, axis=0)).max())


@pytest.fixture(scope="module", params=MOTIONS)
def perfect(request: pytest.FixtureRequest) -> Streams:
    return simulate(motion=request.param, sensors="perfect", heading="30 deg", imu_rate="400 Hz")


def test_the_truth_differentiates_to_its_rates(perfect: Streams) -> None:
    reference, step = perfect["reference"], 1.0 / 400.0
    q_nv, gyro_v = matrix(reference, "q"), matrix(reference, "gyro")
    acc_n = rotate(q_nv, matrix(reference, "accel"))
    # A central difference is the mean of the derivative over two steps: off by h^2 / 6 times its second derivative,
    # which the largest second difference tells up to a factor of 2 where that derivative jumps. Rounding: of the time
    # stamps to 1 ns, a part of 4e-7, and of values of up to 1e3 m to eps, over two steps.
    rounding = 4e-7 * np.abs(acc_n).max() + EPS * 1e3 / step
    central = (matrix(reference, "vel")[2:] - matrix(reference, "vel")[:-2]) / (2.0 * step)
    np.testing.assert_allclose(central, acc_n[1:-1], rtol=0.0, atol=second_difference(acc_n) / 3.0 + rounding)
    turned = to_rotvec(multiply(conjugate(q_nv[:-2]), q_nv[2:])) / (2.0 * step)
    # As above, and with it the turn of the axis within the two steps: at most |omega|^2 h times |omega' h|.
    coning = step * np.abs(gyro_v).max() ** 2 * np.abs(np.diff(gyro_v, axis=0)).max(initial=0.0)
    atol = second_difference(gyro_v) / 3.0 + coning + 4e-7 * np.abs(gyro_v).max() + 8.0 * EPS / step
    np.testing.assert_allclose(rotate(q_nv[1:-1], turned), rotate(q_nv[1:-1], gyro_v[1:-1]), rtol=0.0, atol=atol)


def test_the_place_moves_with_the_velocity_over_the_ellipsoid(perfect: Streams) -> None:
    reference, step = perfect["reference"], 1.0 / 400.0
    pos_e = geodetic_to_ecef(vector(reference, "lat"), vector(reference, "lon"), vector(reference, "height"))
    axes_e = local_axes_e(vector(reference, "lat"), vector(reference, "lon"))
    vel_e = np.einsum("ijn,nj->ni", axes_e, matrix(reference, "vel"))
    central = (pos_e[2:] - pos_e[:-2]) / (2.0 * step)
    # As for the velocity; positions of 6.4e6 m are rounded to some 1e-9 m, and time stamps to 1 ns.
    atol = second_difference(vel_e) / 3.0 + 8e-9 / (2.0 * step) + 4e-7 * np.abs(vel_e).max()
    np.testing.assert_allclose(central, vel_e[1:-1], rtol=0.0, atol=atol)


def test_perfect_sensors_feel_gravity_and_the_turning_earth(perfect: Streams) -> None:
    force_v, rate_v = felt(perfect["reference"])
    # The same terms in another order: 250 m/s^2 in a crash, some ten roundings.
    np.testing.assert_allclose(matrix(perfect["imu"], "accel"), force_v, rtol=0.0, atol=16.0 * EPS * 250.0)
    np.testing.assert_allclose(matrix(perfect["imu"], "gyro"), rate_v, rtol=0.0, atol=16.0 * EPS)
    np.testing.assert_array_equal(time_ns(perfect["reference"]), time_ns(perfect["imu"]))
    np.testing.assert_array_equal(matrix(perfect["imu_truth"], "accel_bias"), 0.0)
    np.testing.assert_array_equal(matrix(perfect["imu_truth"], "gyro_bias"), 0.0)


def test_perfect_fixes_lie_on_the_truth(perfect: Streams) -> None:
    reference, gnss = perfect["reference"], perfect["gnss"]
    rows = np.searchsorted(time_ns(reference), time_ns(gnss))
    np.testing.assert_array_equal(time_ns(reference)[rows], time_ns(gnss))
    # Positions on the Earth, 6.4e6 m from its centre, resolve 1e-9 m; a degree is 1.1e5 m.
    for name, atol in (("lat", 4e-14), ("lon", 6e-14), ("height", 4e-9)):
        np.testing.assert_allclose(vector(gnss, name), vector(reference, name)[rows], rtol=0.0, atol=atol)
    np.testing.assert_allclose(matrix(gnss, "vel"), matrix(reference, "vel")[rows], rtol=0.0, atol=64.0 * EPS * 30.0)
    vel_n = matrix(gnss, "vel")
    np.testing.assert_allclose(vector(gnss, "speed"), np.hypot(vel_n[:, 0], vel_n[:, 1]), rtol=4.0 * EPS)
    moving = vector(gnss, "speed") > 0.1
    course = heading_from_yaw(np.arctan2(vel_n[moving, 1], vel_n[moving, 0]))
    np.testing.assert_allclose(vector(gnss, "course")[moving], course, rtol=4.0 * EPS)


def test_latitude_and_longitude_are_those_of_the_local_position(perfect: Streams) -> None:
    reference = perfect["reference"]
    anchor = Anchor(**meta(reference)["anchor"])
    pos_n = geodetic_to_enu(vector(reference, "lat"), vector(reference, "lon"), vector(reference, "height"), anchor)
    # Positions on the Earth, 6.4e6 m from its centre, resolve 1e-9 m.
    np.testing.assert_allclose(pos_n, matrix(reference, "pos"), rtol=0.0, atol=1e-8)
    assert (anchor.lat, anchor.lon, anchor.height) == pytest.approx((44.4949, 11.3426, 100.0), rel=2.0 * EPS)
    np.testing.assert_allclose(matrix(reference, "pos")[0], 0.0, atol=1e-8)


def test_every_motion_but_rest_begins_at_rest_and_then_moves_the_way_it_faces(perfect: Streams) -> None:
    reference = perfect["reference"]
    speed = np.linalg.norm(matrix(reference, "vel"), axis=1)
    np.testing.assert_array_equal(speed[seconds(reference) <= 10.0], 0.0)
    yaw = to_euler(matrix(reference, "q")[:1])[0]
    assert float(heading_from_yaw(yaw)[0]) == pytest.approx(np.radians(30.0), rel=8.0 * EPS)
    if speed.max() > 0.0:
        first = matrix(reference, "vel")[np.flatnonzero(speed > 0.01)[0]]
        assert np.degrees(np.arctan2(first[0], first[1])) == pytest.approx(30.0, abs=1e-9)


@pytest.mark.parametrize("direction", [0.0, 60.0, -120.0, 180.0])
def test_a_crash_pushes_from_where_its_force_comes(direction: float) -> None:
    shape = {"speed": "54 km/h", "delta_v": "36 km/h", "pulse": "100 ms", "direction": f"{direction} deg"}
    crash = simulate(motion="crash", sensors="perfect", imu_rate="1000 Hz", **shape)["reference"]
    accel = matrix(crash, "accel")
    middle = int(np.linalg.norm(accel[:, :2], axis=1).argmax())
    change = accel[middle - 55 : middle + 55, :2].sum(axis=0) / 1000.0
    # The body dives by 3 deg meanwhile, and the skid that follows begins softly.
    wanted = 10.0 * np.array([-np.cos(np.radians(direction)), np.sin(np.radians(direction))])
    np.testing.assert_allclose(change, wanted, rtol=0, atol=0.1)


def test_a_crash_may_spin_the_vehicle_and_come_twice() -> None:
    shape = {"speed": "54 km/h", "delta_v": "18 km/h", "direction": "45 deg", "spin": "90 deg", "again": "0.7 s"}
    streams = simulate(motion="crash", sensors="perfect", **shape)
    crash, t_s = streams["reference"], seconds(streams["reference"])
    # A turn of 90 deg within a second: the peak of its rate is twice the mean; samples are 10 ms apart.
    assert np.degrees(vector(crash, "gyro_z").max()) == pytest.approx(180.0, rel=0.01)
    vel, in_n = matrix(crash, "vel"), rotate(matrix(crash, "q"), matrix(crash, "accel"))
    # Central differences of 10 ms err by h^2 / 6 (2 pi / T)^2 = 7 % of a pulse of T = 0.1 s with a peak of 100 m/s^2.
    np.testing.assert_allclose(np.gradient(vel, t_s, axis=0), in_n, rtol=0, atol=8.0)
    hard = np.flatnonzero(np.linalg.norm(in_n, axis=1) > 20.0)
    assert np.diff(hard).max() > 50  # two pulses
    np.testing.assert_allclose(vel[-1], 0.0, atol=1e-12)


def test_motions_take_their_shape_from_the_parameters() -> None:
    crash = simulate(motion="crash", speed="72 km/h", delta_v="36 km/h", pulse="80 ms", sensors="perfect")["reference"]
    peak = np.linalg.norm(matrix(crash, "accel"), axis=1).max()
    assert peak == pytest.approx(2.0 * 10.0 / 0.08, rel=np.pi**2 * (0.005 / 0.08) ** 2)  # up to 5 ms from the peak
    spring = simulate(motion="spring", slope="5 deg", turns=2, radius="10 m", rest="3 s", sensors="perfect")[
        "reference"
    ]
    # The slope eases in and out as the curvature does, so that height goes with the angle turned; sin to first order.
    climb = 2.0 * np.pi * 2.0 * 10.0 * np.radians(5.0)
    assert float(vector(spring, "pos_u")[-1]) == pytest.approx(climb, rel=np.radians(5.0) ** 2)
    moving = np.linalg.norm(matrix(spring, "vel"), axis=1) > 0.0
    assert seconds(spring)[moving][0] == pytest.approx(3.01, abs=1e-9)


@pytest.mark.parametrize("sensors", ["study_one", "study_two"])
def test_the_rear_axle_runs_along_the_road_but_for_its_slip(sensors: str) -> None:
    streams = simulate(motion="mixed", duration="600 s", sensors=sensors)
    reference, told = streams["reference"], values_by_name(streams)
    vel_v = rotate(conjugate(matrix(reference, "q")), matrix(reference, "vel"))
    axle_v = vel_v + np.cross(matrix(reference, "gyro"), triple(told, "true_rear_axle"))
    lateral = matrix(reference, "accel")[:, 1]
    slip = told["true_body_slip"] * lateral * axle_v[:, 0]
    fast = np.abs(axle_v[:, 0]) > 3.0
    # The springs smooth what they feel by 0.25 s, so that slip lags where bends begin, and the road's camber tilts the
    # sideways axis by the lean of the body, 0.03 rad at most, times what lean turns out of the pitch and slip: second
    # order, below 1e-3 of the speed.
    assert np.std((axle_v[:, 1] + slip)[fast]) < 0.25 * np.std(slip[fast])
    assert np.std(axle_v[fast, 1]) > 0.01, "the axle never slips"
