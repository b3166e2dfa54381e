"""Sensors of simulated drives: biases, mounting, fixes, outages, wheels and steering."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from metric_rows import values_by_name
from scipy.stats import chi2
from simulated_drives import BOLOGNA, EPS, felt, simulate, triple

from recon.numerics.geodesy import (
    Anchor,
    geodetic_to_enu,
)
from recon.numerics.rotation import (
    conjugate,
    from_euler,
    rotate,
)
from recon.parameters import bind
from recon.rows import spans
from recon.tables import matrix, meta, time_ns, vector
from recon.yaml_nodes import load
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams
from recon_simulators.presets import PRESETS, preset_value


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
    told, imu = values_by_name(streams), streams["imu"]
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
    drawn = [values_by_name(simulate(seed=seed, **rest)) for seed in range(100)]
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


def test_a_box_mounted_nose_down_and_turned_reads_gravity_backwards() -> None:
    streams = simulate(motion="rest", sensors="perfect", mount_pitch="20 deg", mount_yaw="-90 deg")
    gravity = values_by_name(streams)["true_gravity"]
    expected = [-gravity * np.sin(np.radians(20.0)), 0.0, gravity * np.cos(np.radians(20.0))]
    np.testing.assert_allclose(matrix(streams["imu"], "accel")[0], expected, rtol=0.0, atol=8.0 * EPS * 10.0)
    told = values_by_name(streams)
    angles = [told[f"true_mount_{name}"] for name in ("roll", "pitch", "yaw")]
    assert angles == pytest.approx([0.0, 20.0, -90.0], rel=4.0 * EPS)


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


def test_outliers_and_outages_are_told_as_events() -> None:
    streams = simulate(motion="mixed", duration="3600 s", sensors="study_two", seed=3)
    reference, gnss = streams["reference"], streams["gnss"]
    rows = np.searchsorted(time_ns(reference), time_ns(gnss))
    lever_v = np.broadcast_to(triple(values_by_name(streams), "true_lever_arm"), (len(rows), 3))
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
