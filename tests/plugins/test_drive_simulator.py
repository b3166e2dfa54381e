"""The drive simulator: its record, its parameters as people write them, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from metric_rows import values_by_name
from simulated_drives import EPS, LONG, MOTIONS, params, simulate

import recon
from recon.errors import DataError
from recon.numerics.geodesy import (
    normal_gravity,
)
from recon.parameters import bind
from recon.problems import Where
from recon.tables import matrix, meta, time_ns, vector
from recon.yaml_nodes import Node
from recon_simulators.drive import declare_simulators, simulate_drive
from recon_simulators.drive_params import DriveParams
from recon_simulators.presets import NAMES, PRESETS, preset_value


def faults(**values: object) -> list[str]:
    return [problem.text for problem in bind(DriveParams, Node.of(values, Where("test")), "simulator.drive")[1]]


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


def test_gravity_is_told_of_the_start() -> None:
    told = values_by_name(simulate(motion="rest", duration="1 s", lat="-33 deg", lon="151 deg", height="2 km"))
    assert told["true_gravity"] == pytest.approx(float(normal_gravity(-33.0, 2000.0)), rel=4.0 * EPS)


def test_distance_is_that_of_the_truth() -> None:
    streams = simulate(motion="straight", speed="54 km/h")
    # Launch and brake are symmetric eases: 15 s and 10 s at half the speed, 10 s of cruise between them.
    assert values_by_name(streams)["distance"] == pytest.approx(15.0 * (7.5 + 10.0 + 5.0), rel=1e-12)
    assert values_by_name(streams)["seed"] == 0.0


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


def test_each_route_of_the_mixed_drive_is_another() -> None:
    ends = [
        matrix(simulate(motion="mixed", duration="120 s", route=route)["reference"], "pos")[-1] for route in range(8)
    ]
    apart = np.linalg.norm(np.array(ends)[:, None] - np.array(ends)[None], axis=2) + 1e9 * np.eye(8)
    assert apart.min() > 1.0


def test_a_start_beyond_the_clock_of_a_log_is_refused() -> None:
    with pytest.raises(ValueError, match="too far from 1970"):
        DriveParams(start="9019-01-01T00:00:00Z")
