"""Streams beside IMU, GNSS and wheels: what fuser.map makes of them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from recon.aiding import AidTrust, aids_of
from recon.fixes import Trust, observe
from recon.numerics.barometer import height_pressure, pressure_height
from recon.numerics.rotation import from_rotvec
from recon.numerics.smoothing.aids import Direction, Ground, Rate
from recon.numerics.smoothing.climbs import Climb
from recon.tables import matrix, replace, seconds, time_ns, vector
from recon.testing.drives import Conditions, drive
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams


@pytest.fixture(scope="module")
def streams():
    return drive(Conditions(noise=0.0))


def aids(streams, **chosen):
    start_ns = int(time_ns(streams["imu"])[0])
    observed = observe(streams["gnss"], start_ns, Trust(), reported=True)
    given = {name: chosen.get(name) for name in ("baro", "ground", "visual")}
    return aids_of(streams["imu"], *given.values(), observed, start_ns, AidTrust(), chosen.get("wheel"))


def test_nothing_is_made_of_nothing(streams):
    assert aids(streams) == ((), [])


def test_a_barometer_tells_climbs_whose_noise_is_that_of_its_record(streams):
    baro = streams["baro"]
    t_s, rng = seconds(baro), np.random.default_rng(1)
    noisy = replace(baro, pressure=height_pressure(20.0 * np.sin(t_s / 30.0) + rng.normal(0.0, 1.0, len(t_s))))
    ((climb,), learnt) = aids(streams, baro=noisy)
    assert isinstance(climb, Climb)
    assert not learnt
    # means of 2 s of noise of 1 m; roads bend by 20 / 30^2 m/s^2, 0.09 m in 2 s; some hundred means tell it to a tenth
    assert climb.white == pytest.approx(1.0 / np.sqrt(2.0 / np.median(np.diff(t_s))), rel=0.3)
    assert aids(streams, baro=baro)[0][0].white == 0.1


def test_heights_of_the_standard_atmosphere():
    # ISO 2533, table 5: 898.76 hPa at 1000 m and 701.21 hPa at 3000 m of geopotential height 999.84 and 2998.59 m.
    assert_allclose(pressure_height([101_325.0, 89_876.2, 70_121.1]), [0.0, 999.84, 2998.6], atol=0.1)


def test_the_level_of_a_map_is_that_of_gnss(streams):
    ((plane,), learnt) = aids(streams, ground=streams["ground"])
    assert isinstance(plane, Ground)
    assert learnt[0].name == "ground_level"
    assert learnt[0].value == pytest.approx(0.0, abs=0.01)
    assert_allclose(plane.normal_n[2], 1.0, atol=1e-6)
    assert_allclose(plane.pos_n[2], 0.0, atol=0.02)


def test_a_camera_tells_turn_rates_and_directions(streams):
    visual = streams["visual"]
    ((rate, way), learnt) = aids(streams, visual=visual)
    assert isinstance(rate, Rate)
    assert isinstance(way, Direction)
    assert learnt[0].value == visual.num_rows
    # Turn rates of at most 0.5 rad/s over 0.1 s, the gyroscope's ten samples joined by the trapezoid rule.
    assert_allclose(rate.seen_s, rate.gyro_s, atol=2e-3)
    assert len(way.t_s) < visual.num_rows


def test_the_steering_wheel_tells_turn_rates_about_the_vertical_axis(streams):
    turned = vector(streams["wheel"], "speed") * 0.0 + 0.3  # rad, held: no bend tells the ratio
    held = replace(streams["wheel"], steering_angle=turned)
    assert aids(streams, wheel=streams["wheel"])[0] == ()
    ((), (note,)) = aids(streams, wheel=held)
    assert (note.name, note.note) == ("steering", "not used: too few bends to tell its ratio")


def test_the_steering_wheel_agrees_with_the_gyroscope_on_a_drive_with_bends():
    bends = simulate_drive(DriveParams(
        motion="mixed", duration=400.0, imu_rate=50.0, seed=1, route=1, sensors="perfect", steering=True,
        wheel_rate=20.0, wheel_scale=0.0, steering_wander=0.0,
    ))  # fmt: skip
    ((rate,), learnt) = aids(bends, wheel=bends["wheel"])
    told = {row.name: row.value for row in learnt}
    # 16 times 2.7 m, but for the arcus tangens, 4 % in a bend of 8 m.
    assert told["steering_ratio_length"] == pytest.approx(43.2, rel=0.03)
    assert told["steering_error"] < 0.3
    apart = (rate.axes_s * (rate.gyro_s - rate.seen_s)).sum(axis=0)
    assert np.median(np.abs(apart)) < np.radians(0.2)


def test_without_directions_a_camera_tells_turn_rates_alone(streams):
    visual = replace(streams["visual"], direction=np.full((streams["visual"].num_rows, 3), np.nan))
    assert np.isnan(matrix(visual, "direction", gaps=True)).all()
    (made, _) = aids(streams, visual=visual)
    assert [type(aid) for aid in made] == [Rate]


def test_in_a_bend_the_direction_is_that_of_the_middle_between_two_images(streams):
    """On a circle the chord is turned by half of the turn, while the box moves straight ahead all the time."""
    visual = streams["visual"].slice(0, 2)
    turn = from_rotvec(np.array([0.0, 0.0, 0.2]))
    chord = [np.cos(0.1), np.sin(0.1), 0.0]
    visual = replace(visual, q=np.tile(turn, (2, 1)), direction=np.tile(chord, (2, 1)), direction_std=np.full(2, 0.01))
    ((_, way), _) = aids(streams, visual=visual)
    assert_allclose(way.direction_s.T, [[1.0, 0.0, 0.0]] * 2, atol=1e-12)
    assert_allclose(way.t_s, [0.05, 0.15])
