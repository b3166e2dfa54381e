"""Drive simulator: the truth by differentiation, the sensors against the truth, the parameters as people write them."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from scipy.stats import chi2

import recon
from recon.errors import DataError
from recon.numerics.geodesy import Anchor, geodetic_to_enu, normal_gravity
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
from recon.tables import Streams, matrix, meta, seconds, time_ns, vector
from recon.yaml_nodes import Node, load
from recon_simulators.drive import DriveParams, declare_simulators, simulate_drive
from recon_simulators.presets import NAMES, PRESETS, preset_value

EPS = np.finfo(float).eps
MOTIONS = ("rest", "straight", "circle", "spring", "roundabout", "s_curve", "hill", "city", "parking", "crash")
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


@pytest.fixture(scope="module", params=MOTIONS)
def perfect(request: pytest.FixtureRequest) -> Streams:
    return simulate(motion=request.param, sensors="perfect", heading="30 deg", imu_rate="400 Hz")


def test_the_truth_differentiates_to_what_perfect_sensors_read(perfect: Streams) -> None:
    reference, step = perfect["reference"], 1.0 / 400.0
    q_nv = matrix(reference, "q")
    gravity = [0.0, 0.0, learnt(perfect)["true_gravity"]]
    acc_n = rotate(q_nv, matrix(perfect["imu"], "accel")) - gravity
    # A central difference is the mean of the derivative over two steps: off by h^2 / 6 times its second derivative,
    # which the largest second difference tells up to a factor of 2 where that derivative jumps. Rounding: of the time
    # stamps to 1 ns, a part of 4e-7, and of values of up to 1e3 m to eps, over two steps.
    rounding = 4e-7 * np.abs(acc_n).max() + EPS * 1e3 / step
    central = (matrix(reference, "vel")[2:] - matrix(reference, "vel")[:-2]) / (2.0 * step)
    np.testing.assert_allclose(central, acc_n[1:-1], rtol=0.0, atol=second_difference(acc_n) / 3.0 + rounding)

    gyro_v = matrix(perfect["imu"], "gyro")
    turned = to_rotvec(multiply(conjugate(q_nv[:-2]), q_nv[2:])) / (2.0 * step)
    # As above, and with it the turn of the axis within the two steps: at most |omega|^2 h times |omega' h|.
    coning = step * np.abs(gyro_v).max() ** 2 * np.abs(np.diff(gyro_v, axis=0)).max(initial=0.0)
    atol = second_difference(gyro_v) / 3.0 + coning + 4e-7 * np.abs(gyro_v).max() + 8.0 * EPS / step
    np.testing.assert_allclose(rotate(q_nv[1:-1], turned), rotate(q_nv[1:-1], gyro_v[1:-1]), rtol=0.0, atol=atol)


def test_the_truth_holds_acceleration_without_gravity_and_the_angular_rate(perfect: Streams) -> None:
    reference, imu = perfect["reference"], perfect["imu"]
    up_v = rotate(conjugate(matrix(reference, "q")), [0.0, 0.0, learnt(perfect)["true_gravity"]])
    # Specific force is made of the same terms in another order: 250 m/s^2 in a crash, some ten roundings.
    np.testing.assert_allclose(
        matrix(reference, "accel"), matrix(imu, "accel") - up_v, rtol=0.0, atol=16.0 * EPS * 250.0
    )
    np.testing.assert_array_equal(matrix(reference, "gyro"), matrix(imu, "gyro"))
    np.testing.assert_array_equal(time_ns(reference), time_ns(imu))


def test_perfect_fixes_lie_on_the_truth(perfect: Streams) -> None:
    reference, gnss = perfect["reference"], perfect["gnss"]
    rows = np.searchsorted(time_ns(reference), time_ns(gnss))
    np.testing.assert_array_equal(time_ns(reference)[rows], time_ns(gnss))
    for name in ("lat", "lon", "height", "vel_e", "vel_n", "vel_u"):
        # 1e3 m and the sizes of degrees and metres above the ellipsoid, each with some roundings.
        np.testing.assert_allclose(vector(gnss, name), vector(reference, name)[rows], rtol=0.0, atol=1e3 * EPS * 64.0)
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
    np.testing.assert_array_equal(matrix(reference, "pos")[0], 0.0)


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
    told, imu, reference = learnt(streams), streams["imu"], streams["reference"]
    q_sv = conjugate(from_euler(0.0, np.radians(10.0), 0.0))
    force_v = matrix(reference, "accel") + rotate(conjugate(matrix(reference, "q")), [0.0, 0.0, told["true_gravity"]])
    for sensor, true_v, to_si in (("accel", force_v, 1.0), ("gyro", matrix(reference, "gyro"), np.pi / 180.0)):
        bias, scale = triple(told, f"true_{sensor}_bias") * to_si, triple(told, f"true_{sensor}_scale")
        expected = (1.0 + scale) * rotate(q_sv, true_v) + bias
        np.testing.assert_allclose(matrix(imu, sensor), expected, rtol=0.0, atol=32.0 * EPS * 12.0)
        assert np.all(bias != 0.0)
        assert np.all(scale != 0.0)


@pytest.mark.parametrize("sensors", ["consumer_mems", "automotive"])
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
    for name, value in (("pos_std_e", "horizontal"), ("pos_std_u", "vertical"), ("vel_std_n", "velocity")):
        sigma = preset_value(sensors, f"gnss_{value}")
        assert set(gnss[name].to_pylist()) == {sigma or None}
    assert set(gnss["fix"].to_pylist()) == {3}
    assert set(gnss["satellites"].to_pylist()) == {12}


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
    given, default = (params(sensors=sensors) for sensors in ("automotive", "perfect"))
    assert getattr(given, name) is getattr(default, name) is None
    worse = [preset_value(sensors, name) for sensors in ("consumer_mems", "automotive")]
    assert min(worse) > 0.0
    text = params(**{name: DriveParams(**{name: worse[0]}).as_text()[name]})
    assert getattr(text, name) == worse[0]


def test_a_box_mounted_nose_down_and_turned_reads_gravity_backwards() -> None:
    streams = simulate(motion="rest", sensors="perfect", mount_pitch="20 deg", mount_yaw="-90 deg")
    gravity = learnt(streams)["true_gravity"]
    expected = [-gravity * np.sin(np.radians(20.0)), 0.0, gravity * np.cos(np.radians(20.0))]
    np.testing.assert_allclose(matrix(streams["imu"], "accel")[0], expected, rtol=0.0, atol=8.0 * EPS * 10.0)
    told = learnt(streams)
    angles = [told[f"true_mount_{name}"] for name in ("roll", "pitch", "yaw")]
    assert angles == pytest.approx([0.0, 20.0, -90.0], rel=4.0 * EPS)


def test_gravity_is_normal_gravity_of_the_start() -> None:
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
        ({"outages": "60 s"}, "outages: must be a list"),
        ({"outages": [["60 s", 90]]}, "a unit is missing"),
        ({"start": "yesterday"}, "start: invalid isoformat string: 'yesterday'"),
        ({"seed": -1}, "seed: "),
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
        ({"imu_jitter": "6 ms"}, "below half a period"),
    ],
)
def test_parameters_that_contradict_each_other_are_a_data_error(values: dict[str, object], fault: str) -> None:
    with pytest.raises(DataError, match=fault):
        simulate(**values)


@pytest.mark.parametrize("motion", MOTIONS)
def test_parameters_read_back_from_their_text(motion: str) -> None:
    given = params(motion=motion, outages=[["1 min", "90 s"]], lever_arm=["1 m", "2 ft", "3 cm"], gyro_bias="0.1 deg/s")
    assert params(**given.as_text()) == given


def test_what_is_returned_is_what_was_declared() -> None:
    (stage,) = declare_simulators()
    streams = simulate_drive(DriveParams(duration=20.0))
    planned = stage.outputs({}, DriveParams())
    assert {name: table.column_names for name, table in streams.items()} == {
        name: list(schema.names) for name, schema in planned.items()
    }
    assert not stage.faults()


def test_the_shipped_pipeline_makes_a_drive_with_truth() -> None:
    run = recon.run(
        "simulated_drive", **{"simulator.drive.duration": "30 s", "simulator.drive.outages": [["5 s", "9 s"]]}
    )
    assert {"imu", "gnss", "reference", "metrics"} == set(run.recording)
    assert run.recording["gnss"].num_rows == 26
