"""Drive simulator: the truth by differentiation, the sensors against the truth, the parameters as people write them."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from scipy.stats import chi2

import recon
from recon.errors import DataError
from recon.numerics.geodesy import (
    Anchor,
    earth_rate_n,
    geodetic_to_ecef,
    geodetic_to_enu,
    local_axes_e,
    normal_gravity,
    radii_of_curvature,
)
from recon.numerics.rotation import (
    Floats,
    conjugate,
    from_euler,
    heading_from_yaw,
    multiply,
    rotate,
    to_euler,
    to_rotvec,
)
from recon.parameters import bind
from recon.problems import Where
from recon.rows import spans
from recon.tables import Streams, matrix, meta, seconds, time_ns, vector
from recon.yaml_nodes import Node, load
from recon_simulators.drive import declare_simulators, simulate_drive
from recon_simulators.drive_params import DriveParams
from recon_simulators.presets import NAMES, PRESETS, preset_value

EPS = np.finfo(float).eps
MOTIONS = ("rest", "straight", "circle", "spring", "roundabout", "s_curve", "hill", "city", "parking", "crash")
LONG = ("country", "mixed", "nonstop", "reverse", "ferry")
BOLOGNA = Anchor(44.4949, 11.3426, 100.0)


def params(**values: object) -> DriveParams:
    """Parameters from plain data as YAML has it."""
    found, problems = bind(DriveParams, Node.of(values, Where("test")), "simulator.drive")
    assert isinstance(found, DriveParams), problems
    return found


def simulate(**values: object) -> Streams:
    return simulate_drive(params(**values))


def faults(**values: object) -> list[str]:
    return [problem.text for problem in bind(DriveParams, Node.of(values, Where("test")), "simulator.drive")[1]]


def learnt(streams: Streams) -> dict[str, float]:
    return {row["name"]: row["value"] for row in streams["metrics"].to_pylist()}


def triple(metrics: dict[str, float], name: str) -> Floats:
    return np.array([metrics[f"{name}_{axis}"] for axis in "xyz"])


def second_difference(y: Floats) -> float:
    return float(np.abs(np.diff(y, n=2, axis=0)).max())


def earth_rates(reference: pa.Table) -> tuple[Floats, Floats]:
    """Rate of the Earth and of the level frame at each place of the truth: (n, 3) rad/s, East-North-Up."""
    lat, height, (east, north, _) = vector(reference, "lat"), vector(reference, "height"), matrix(reference, "vel").T
    meridian, normal = (radius + height for radius in radii_of_curvature(lat))
    transport_n = np.column_stack((-north / meridian, east / normal, east * np.tan(np.radians(lat)) / normal))
    return earth_rate_n(lat), transport_n


def felt(reference: pa.Table) -> tuple[Floats, Floats]:
    """Specific force and inertial angular rate of the truth: (n, 3) m/s^2 and rad/s, vehicle. Groves 2013, eq. 5.54."""
    (earth_n, transport_n), q_vn = earth_rates(reference), conjugate(matrix(reference, "q"))
    up_n = np.zeros((reference.num_rows, 3))
    up_n[:, 2] = normal_gravity(vector(reference, "lat"), vector(reference, "height"))
    coriolis_n = np.cross(2.0 * earth_n + transport_n, matrix(reference, "vel"))
    force_v = matrix(reference, "accel") + rotate(q_vn, coriolis_n + up_n)
    return force_v, matrix(reference, "gyro") + rotate(q_vn, earth_n + transport_n)


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


@pytest.mark.parametrize("sensors", PRESETS)
def test_the_same_parameters_give_the_same_tables(sensors: str) -> None:
    first, again = (simulate(sensors=sensors, duration="60 s", seed=4) for _ in range(2))
    for name, table in first.items():
        assert table.equals(again[name], check_metadata=True), name


def test_another_seed_gives_other_noise_on_the_same_drive() -> None:
    first, other = (simulate(duration="60 s", seed=seed) for seed in (1, 2))
    assert first["reference"].equals(other["reference"])
    assert first["imu"]["time"].equals(other["imu"]["time"])
    # Two noises of sigma s, rounded to steps d, agree in less than d / (2 s sqrt(pi)) of the samples: 8 % of accel and
    # 6 % of gyro; fixes are not rounded.
    for stream, names, most in (("imu", ("accel_x", "gyro_z"), 0.1), ("gnss", ("lat", "vel_u"), 0.0)):
        for name in names:
            assert np.mean(vector(first[stream], name) == vector(other[stream], name)) <= most, name


def test_another_route_is_another_drive() -> None:
    first, other = (simulate(duration="60 s", route=route) for route in (0, 1))
    assert not first["reference"]["pos_e"].equals(other["reference"]["pos_e"])


def test_sensors_leave_each_other_and_the_truth_as_they_are() -> None:
    plain = simulate(duration="60 s")
    receiver = simulate(duration="60 s", gnss_rate="5 Hz", gnss_horizontal="9 m", lever_arm=["1 m", "0 m", "2 m"])
    box = simulate(duration="60 s", accel_noise="1 mg/sqrt(Hz)", mount_yaw="70 deg", imu_jitter="2 ms")
    assert receiver["imu"].equals(plain["imu"])
    assert receiver["reference"].equals(plain["reference"])
    assert box["gnss"].equals(plain["gnss"])


def test_outages_take_fixes_away_and_change_no_other() -> None:
    plain = simulate(duration="60 s")["gnss"]
    written = load("outages: [[20 s, 30 s], [0.5 min, 35.5 s]]", "test")
    found, problems = bind(DriveParams, written.at([]), "simulator.drive")
    assert isinstance(found, DriveParams), problems
    gnss = simulate_drive(found.model_copy(update={"duration": 60.0}))["gnss"]
    kept = np.r_[0:20, 36:60]
    assert gnss.equals(plain.take(pa.array(kept)))


@pytest.mark.parametrize("seed", range(5))
def test_metrics_tell_the_biases_and_scale_errors_that_were_drawn(seed: int) -> None:
    clean = {f"{sensor}_{error}": f"0 {unit}" for sensor, units in (("accel", ("ug/sqrt(Hz)", "ug/sqrt(s)", "mg")),
             ("gyro", ("deg/s/sqrt(Hz)", "deg/s/sqrt(s)", "deg/s")))
             for error, unit in zip(("noise", "bias_walk", "quantisation"), units, strict=True)}  # fmt: skip
    streams = simulate(motion="circle", seed=seed, mount_pitch="10 deg", **clean)
    told, imu = learnt(streams), streams["imu"]
    q_sv = conjugate(from_euler(0.0, np.radians(10.0), 0.0))
    force_v, rate_v = felt(streams["reference"])
    for sensor, true_v, to_si in (("accel", force_v, 1.0), ("gyro", rate_v, np.pi / 180.0)):
        bias, scale = triple(told, f"true_{sensor}_bias") * to_si, triple(told, f"true_{sensor}_scale")
        expected = (1.0 + scale) * rotate(q_sv, true_v) + bias
        np.testing.assert_allclose(matrix(imu, sensor), expected, rtol=0.0, atol=32.0 * EPS * 12.0)
        np.testing.assert_allclose(matrix(streams["imu_truth"], f"{sensor}_bias"), np.tile(bias, (imu.num_rows, 1)))
        np.testing.assert_allclose(triple(told, f"true_{sensor}_bias_end") * to_si, bias)
        assert np.all(bias != 0.0)
        assert np.all(scale != 0.0)


@pytest.mark.parametrize("sensors", ["consumer_mems", "automotive", "tactical"])
def test_biases_and_scale_errors_have_the_sigmas_of_the_preset(sensors: str) -> None:
    rest = {"motion": "rest", "duration": "10 ms", "sensors": sensors}
    drawn = [learnt(simulate(seed=seed, **rest)) for seed in range(100)]
    for sensor, to_si in (("accel", 1.0), ("gyro", np.pi / 180.0)):
        for error, unit in (("bias", to_si), ("scale", 1.0)):
            values = np.array([triple(told, f"true_{sensor}_{error}") for told in drawn]) * unit
            total = np.sum((values / preset_value(sensors, f"{sensor}_{error}")) ** 2)
            # Chi-square of 300 independent normals: between its quantiles 1e-6 and 1 - 1e-6.
            assert chi2.ppf(1e-6, values.size) < total < chi2.ppf(1.0 - 1e-6, values.size)


@pytest.mark.parametrize("sensors", PRESETS)
def test_gnss_reports_the_sigmas_that_it_has_and_none_where_it_has_none(sensors: str) -> None:
    gnss = simulate(motion="rest", sensors=sensors)["gnss"]
    for name, of in (("pos_std_e", "horizontal"), ("pos_std_u", "vertical")):
        sigma = float(np.hypot(preset_value(sensors, f"gnss_{of}"), preset_value(sensors, f"gnss_white_{of}")))
        assert set(gnss[name].to_pylist()) == {sigma or None}
    assert set(gnss["vel_std_n"].to_pylist()) == {preset_value(sensors, "gnss_velocity") or None}
    assert set(gnss["vel_std_u"].to_pylist()) == {preset_value(sensors, "gnss_velocity_vertical") or None}
    assert set(gnss["fix"].to_pylist()) == {3}
    assert set(gnss["satellites"].to_pylist()) == {12}


def test_fixes_may_tell_wrong_sigmas_or_none_and_no_vector_of_velocity() -> None:
    right, wrong, silent = (
        simulate(motion="rest", gnss_told_sigma=factor, gnss_vector=factor > 0.0)["gnss"] for factor in (1.0, 0.5, 0.0)
    )
    for name in ("pos_std", "vel_std"):
        np.testing.assert_allclose(matrix(wrong, name), 0.5 * matrix(right, name), rtol=EPS)
        assert silent[f"{name}_e"].null_count == silent.num_rows
    assert "vel_e" not in silent.column_names
    assert silent["speed"].equals(right["speed"])


def test_a_value_that_is_given_goes_before_the_preset() -> None:
    streams = simulate(motion="rest", duration="10 s", sensors="automotive", imu_rate="50 Hz", gnss_rate="2 Hz")
    assert [streams[name].num_rows for name in ("imu", "reference", "gnss")] == [500, 500, 20]
    quiet = simulate(
        motion="rest", sensors="automotive", gyro_noise="0 deg/s/sqrt(Hz)", gyro_bias_walk="0 deg/s/sqrt(s)"
    )
    assert np.ptp(matrix(quiet["imu"], "gyro"), axis=0).max() == 0.0
    assert np.ptp(matrix(quiet["imu"], "accel"), axis=0).min() > 0.0


@pytest.mark.parametrize("name", NAMES)
def test_every_row_of_the_presets_is_a_parameter_of_that_unit(name: str) -> None:
    assert all(getattr(params(sensors=sensors), name) is None for sensors in PRESETS)
    values = [value for sensors in PRESETS if np.any(value := preset_value(sensors, name))]
    assert values, "no preset gives it"
    text = params(**{name: DriveParams(**{name: values[0]}).as_text()[name]})
    assert getattr(text, name) == values[0]


def test_a_box_mounted_nose_down_and_turned_reads_gravity_backwards() -> None:
    streams = simulate(motion="rest", sensors="perfect", mount_pitch="20 deg", mount_yaw="-90 deg")
    gravity = learnt(streams)["true_gravity"]
    expected = [-gravity * np.sin(np.radians(20.0)), 0.0, gravity * np.cos(np.radians(20.0))]
    np.testing.assert_allclose(matrix(streams["imu"], "accel")[0], expected, rtol=0.0, atol=8.0 * EPS * 10.0)
    told = learnt(streams)
    angles = [told[f"true_mount_{name}"] for name in ("roll", "pitch", "yaw")]
    assert angles == pytest.approx([0.0, 20.0, -90.0], rel=4.0 * EPS)


def test_gravity_is_told_of_the_start() -> None:
    told = learnt(simulate(motion="rest", duration="1 s", lat="-33 deg", lon="151 deg", height="2 km"))
    assert told["true_gravity"] == pytest.approx(float(normal_gravity(-33.0, 2000.0)), rel=4.0 * EPS)


def test_distance_is_that_of_the_truth() -> None:
    streams = simulate(motion="straight", speed="54 km/h")
    # Launch and brake are symmetric eases: 15 s and 10 s at half the speed, 10 s of cruise between them.
    assert learnt(streams)["distance"] == pytest.approx(15.0 * (7.5 + 10.0 + 5.0), rel=1e-12)
    assert learnt(streams)["seed"] == 0.0


def test_a_fix_tells_where_the_antenna_was_before_its_lag() -> None:
    options = {"motion": "straight", "sensors": "perfect"}
    late, now = simulate(gnss_lag="200 ms", **options)["gnss"], simulate(**options)["gnss"]
    # 200 ms are two fixes of ten per second.
    np.testing.assert_allclose(vector(late, "lon")[2:], vector(now, "lon")[:-2], rtol=0.0, atol=64.0 * EPS * 12.0)
    assert time_ns(late)[0] == time_ns(now)[0]


def test_the_antenna_is_where_the_lever_arm_says() -> None:
    arm = {"lever_arm": ["2 m", "-50 cm", "1.5 m"]}
    streams = simulate(motion="rest", duration="1 s", sensors="perfect", heading="0 deg", **arm)
    gnss = streams["gnss"]
    pos_n = geodetic_to_enu(vector(gnss, "lat"), vector(gnss, "lon"), vector(gnss, "height"), BOLOGNA)
    np.testing.assert_allclose(pos_n[0], [0.5, 2.0, 1.5], rtol=0.0, atol=1e-8)


@pytest.mark.parametrize(
    ("start", "first"),
    [
        ("2024-05-01T08:00:00Z", 1714550400_000000000),
        ("2024-05-01T10:00:00.25+02:00", 1714550400_250000000),
        ("2024-05-01 08:00:00", 1714550400_000000000),
    ],
)
def test_the_record_starts_at_the_time_given(start: str, first: int) -> None:
    streams = simulate(motion="rest", duration="1 s", start=start)
    for name in ("imu", "gnss", "reference"):
        assert time_ns(streams[name])[0] == first
        assert meta(streams[name])["time_scale"] == "UTC"
        assert meta(streams[name])["clock"] == "absolute"
    np.testing.assert_array_equal(np.diff(time_ns(streams["imu"])), 10_000_000)


def test_streams_tell_their_datum_anchor_and_heading() -> None:
    streams = simulate(motion="rest", duration="1 s")
    assert meta(streams["gnss"])["heading_kind"] == "course_true"
    assert meta(streams["gnss"])["height_datum"] == meta(streams["reference"])["height_datum"] == "ellipsoid"
    assert "anchor" not in meta(streams["gnss"])
    assert set(streams["reference"]["pos_std_e"].to_pylist()) == {None}


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_record_is_as_long_as_asked_and_stands_once_the_drive_is_over(motion: str) -> None:
    streams = simulate(motion=motion, duration="240 s", sensors="perfect")
    assert streams["imu"].num_rows == 24_000
    # A city drive ends with at least 2 s of rest; sin(pi) is 1e-16 and enters squared.
    np.testing.assert_allclose(matrix(streams["reference"], "vel")[-100:], 0.0, atol=EPS)


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


@pytest.mark.parametrize(
    ("values", "fault"),
    [
        (
            {"motion": "parking", "speed": "10 km/h"},
            "speed: the motion 'parking' does not have it; it has duration, rest",
        ),
        ({"motion": "straight", "route": 3}, "route: the motion 'straight' does not have it"),
        ({"motion": "rest", "rest": "3 s"}, "rest: the motion 'rest' does not have it; it has duration"),
        ({"motion": "flight"}, "motion: "),
        ({"speed": 10.0}, "a unit is missing"),
        ({"outages": [["90 s", "60 s"]]}, "an outage from 90 s to 60 s ends before it begins"),
        ({"outages": [["60 s"]]}, "outages: "),
        ({"outage_length": ["60 s", "30 s"]}, "outage_length: 60 to 30 is no range above zero"),
        ({"multipath": "60 %"}, "multipath: must be at most 50 %"),
        ({"outages": "60 s"}, "outages: must be a list"),
        ({"outages": [["60 s", 90]]}, "a unit is missing"),
        ({"start": "yesterday"}, "start: invalid isoformat string: 'yesterday'"),
        ({"seed": -1}, "seed: "),
        ({"duration": "1e30 s"}, "duration: must be at most 86400 s"),
        ({"begin": "48 h"}, "begin: must be at most 86400 s"),
        ({"imu_rate": "1 MHz"}, "imu_rate: must be at most 100000 Hz"),
    ],
)
def test_what_cannot_be_is_refused_by_the_check(values: dict[str, object], fault: str) -> None:
    found = faults(**values)
    assert len(found) == 1
    assert fault in found[0]


@pytest.mark.parametrize(
    ("values", "fault"),
    [
        ({"motion": "crash", "speed": "36 km/h", "delta_v": "40 km/h"}, r"a crash from 10\.0 m/s loses"),
        ({"motion": "city", "duration": "8 s"}, "a city drive of 8 s that rests for 10 s never moves"),
        ({"motion": "mixed", "duration": "20 s"}, "a drive of 20 s that rests for 30 s never moves"),
        ({"motion": "ferry", "duration": "300 s"}, "a drive with a ferry takes 480 s at least"),
        ({"imu_jitter": "6 ms"}, "below half a period"),
    ],
)
def test_parameters_that_contradict_each_other_are_a_data_error(values: dict[str, object], fault: str) -> None:
    with pytest.raises(DataError, match=fault):
        simulate(**values)


@pytest.mark.parametrize("motion", [*MOTIONS, *LONG])
def test_parameters_read_back_from_their_text(motion: str) -> None:
    given = params(motion=motion, outages=[["1 min", "90 s"]], lever_arm=["1 m", "2 ft", "3 cm"], gyro_bias="0.1 deg/s")
    assert params(**given.as_text()) == given


def test_what_is_returned_is_what_was_declared() -> None:
    (stage,) = declare_simulators()
    for given in (DriveParams(duration=20.0), DriveParams(duration=20.0, gnss_vector=False, wheel_rate=10.0)):
        streams, planned = simulate_drive(given), stage.outputs({}, given)
        assert {name: table.column_names for name, table in streams.items()} == {
            name: list(schema.names) for name, schema in planned.items()
        }
    assert not stage.faults()


def test_the_shipped_pipeline_makes_a_drive_with_truth() -> None:
    run = recon.run(
        "simulated_drive", **{"simulator.drive.duration": "30 s", "simulator.drive.outages": [["5 s", "9 s"]]}
    )
    assert {"imu", "imu_truth", "gnss", "reference", "events", "metrics"} == set(run.recording)
    assert run.recording["gnss"].num_rows == 26


@pytest.mark.parametrize("motion", LONG)
def test_a_record_may_begin_at_speed(motion: str) -> None:
    whole = simulate(motion=motion, duration="540 s", sensors="perfect", wheel_rate="1 Hz")
    late = simulate(motion=motion, duration="480 s", begin="60 s", sensors="perfect", wheel_rate="1 Hz")
    assert time_ns(late["imu"])[0] == time_ns(whole["imu"])[0]
    for stream, group, rows in (("imu", "accel", 6000), ("reference", "vel", 6000), ("gnss", "lat", 600)):
        shifted, now = matrix(late[stream], group), matrix(whole[stream], group)[rows:]
        # The time of 540 s is rounded to 1e-13 s, and enters differently.
        np.testing.assert_allclose(shifted, now, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(vector(late["wheel"], "speed"), vector(whole["wheel"], "speed")[60:], rtol=0.0, atol=1.0)


@pytest.mark.parametrize("sensors", ["study_one", "study_two"])
def test_the_rear_axle_runs_along_the_road_but_for_its_slip(sensors: str) -> None:
    streams = simulate(motion="mixed", duration="600 s", sensors=sensors)
    reference, told = streams["reference"], learnt(streams)
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


def test_outliers_and_outages_are_told_as_events() -> None:
    streams = simulate(motion="mixed", duration="3600 s", sensors="study_two", seed=3)
    reference, gnss = streams["reference"], streams["gnss"]
    rows = np.searchsorted(time_ns(reference), time_ns(gnss))
    lever_v = np.broadcast_to(triple(learnt(streams), "true_lever_arm"), (len(rows), 3))
    anchor = Anchor(**meta(reference)["anchor"])
    antenna_n = matrix(reference, "pos")[rows] + rotate(matrix(reference, "q")[rows], lever_v)
    pos_n = geodetic_to_enu(vector(gnss, "lat"), vector(gnss, "lon"), vector(gnss, "height"), anchor)
    error = np.hypot(*(pos_n - antenna_n)[:, :2].T)
    hit = np.zeros(len(rows), dtype=bool)
    for start, end in spans(streams["events"], "multipath"):
        hit |= (time_ns(gnss) >= start) & (time_ns(gnss) <= end)
    assert 0.03 < hit.mean() < 0.07
    # 2.1 m per axis: more than 5.5 sigma, 11.6 m, once in 4e6 fixes; most of the sizes from 8 to 35 m are above that.
    assert error[~hit].max() < 11.6
    assert np.median(error[hit]) > 11.6
    outages = spans(streams["events"], "outage")
    assert len(outages) == 8
    assert not any(np.any((time_ns(gnss) >= start) & (time_ns(gnss) < end)) for start, end in outages)


def test_the_first_study_has_its_outages_where_they_were() -> None:
    streams = simulate(motion="country", duration="600 s", sensors="study_one")
    since = int(time_ns(streams["imu"])[0])
    found = [((start - since) * 1e-9, (end - since) * 1e-9) for start, end in spans(streams["events"], "outage")]
    assert np.ravel(found) == pytest.approx([210.0, 240.0, 420.0, 480.0])
    given = simulate(motion="country", duration="600 s", sensors="study_one", outages=[])
    assert spans(given["events"], "outage") == []


def test_the_wheels_stand_on_a_ferry_and_tell_the_speed_on_the_road() -> None:
    streams = simulate(motion="ferry", sensors="perfect", wheel_rate="10 Hz", wheel_scale="0 %", wheel_noise="0 m/s")
    wheel, reference = streams["wheel"], streams["reference"]
    ((start, end),) = spans(streams["events"], "ferry")
    aboard = (time_ns(wheel) >= start) & (time_ns(wheel) <= end)
    np.testing.assert_array_equal(vector(wheel, "speed")[aboard], 0.0)
    rows = np.searchsorted(time_ns(reference), time_ns(wheel))
    forward = rotate(conjugate(matrix(reference, "q")[rows]), matrix(reference, "vel")[rows])[:, 0]
    assert np.abs(forward[aboard]).max() > 5.0
    np.testing.assert_allclose(vector(wheel, "speed")[~aboard], forward[~aboard], rtol=0.0, atol=64.0 * EPS * 30.0)


def test_wheels_have_a_scale_error_and_noise_only_while_they_turn() -> None:
    exact, real = (
        simulate(motion="straight", wheel_rate="100 Hz", wheel_scale=scale, wheel_noise=noise)["wheel"]
        for scale, noise in (("0 %", "0 m/s"), ("1 %", "0.02 m/s"))
    )
    true, told = vector(exact, "speed"), vector(real, "speed")
    np.testing.assert_array_equal(told[true == 0.0], 0.0)
    moving = true > 0.0
    scale = np.sum(told * true) / np.sum(true * true)
    assert 0.0 < abs(scale - 1.0) < 0.05
    # 3500 samples: sigma is known to 1.2 %.
    assert np.std((told - scale * true)[moving]) == pytest.approx(0.02, rel=0.06)


def test_the_steering_wheel_and_each_wheel_follow_the_bend() -> None:
    exact = {"steering_noise": "0 deg", "steering_wander": "0 deg", "steering_offset": "0 deg", "tyre_scale": "0 %"}
    streams = simulate(
        motion="circle", radius="50 m", speed="36 km/h", sensors="perfect", steering=True, wheel_rate="10 Hz",
        wheel_scale="0 %", wheel_noise="0 m/s", **exact,
    )  # fmt: skip
    wheel, reference = streams["wheel"], streams["reference"]
    rate = matrix(reference, "gyro")[np.searchsorted(time_ns(reference), time_ns(wheel)), 2]
    speed = vector(wheel, "speed")
    turning = np.abs(rate) > 0.19  # rad/s: 10 m/s on 50 m
    assert turning.sum() > 100
    apart = vector(wheel, "speed_rear_right") - vector(wheel, "speed_rear_left")
    # The body rolls and the Earth turns: some 1e-4 of the rate.
    np.testing.assert_allclose(apart[turning], 1.55 * rate[turning], rtol=1e-2)
    front = np.arctan(2.7 * rate / np.maximum(speed, 1.0)) + np.radians(0.1) * speed * rate
    np.testing.assert_allclose(vector(wheel, "steering_angle")[turning], 16.0 * front[turning], rtol=1e-2)


def test_each_route_of_the_mixed_drive_is_another() -> None:
    ends = [
        matrix(simulate(motion="mixed", duration="120 s", route=route)["reference"], "pos")[-1] for route in range(8)
    ]
    apart = np.linalg.norm(np.array(ends)[:, None] - np.array(ends)[None], axis=2) + 1e9 * np.eye(8)
    assert apart.min() > 1.0


def test_a_start_beyond_the_clock_of_a_log_is_refused() -> None:
    with pytest.raises(ValueError, match="too far from 1970"):
        DriveParams(start="9019-01-01T00:00:00Z")
