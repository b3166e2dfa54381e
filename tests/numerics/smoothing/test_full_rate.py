"""The trajectory at every sample: the knots at the knots, and the strap-down integration between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from smoothing_drives import PLACE, Linearised, Log, linearised

from recon.numerics.geodesy import Anchor
from recon.numerics.smoothing.earth import level_rotation
from recon.numerics.smoothing.epochs import Calm, Epochs, locate, state_at
from recon.numerics.smoothing.full_rate import Motion, between_knots, full_rate
from recon.numerics.smoothing.soa import mm, mmt, mv, quat_to_matrix, rotation_log

LIVELY = Log(seconds=30.0, kind="nonstop", rest_s=3.0, imu_hz=100.0)
# Positions of some 100 m and products of rotation matrices.
ROUNDING = 1e-12


def expand(drive: Linearised) -> Motion:
    return full_rate(drive.state, drive.ends(drive.state), drive.increments, drive.sim.drive.samples, PLACE)


def of_sensor(found: Motion, drive: Linearised) -> np.ndarray:
    """Sensor to local level: (3, 3, n + 1)."""
    return mm(quat_to_matrix(found.q_lv), drive.state.rot_vs[..., None])


def test_the_knots_are_met_at_the_knots():
    drive = linearised(LIVELY, off=1.0)
    found, every = expand(drive), drive.sim.drive.samples.per_interval
    rot_ln = level_rotation(drive.state.pos_n, PLACE)
    assert_allclose(found.pos_n[:, ::every], drive.state.pos_n, atol=ROUNDING)
    assert_allclose(found.vel_l[:, ::every], mv(rot_ln, drive.state.vel_n), atol=ROUNDING)
    assert_allclose(of_sensor(found, drive)[..., ::every], mm(rot_ln, drive.state.rot_ns), atol=ROUNDING)


def test_the_motion_just_before_a_knot_leads_to_it():
    drive = linearised(LIVELY, off=1.0)
    found, samples = expand(drive), drive.sim.drive.samples
    before = np.arange(1, samples.intervals) * samples.per_interval - 1
    step = np.diff(samples.t_s)[before]
    # Over one step of 10 ms: 10 m/s^2 and 1 rad/s of the drive.
    ahead = found.pos_n[:, before] + 0.5 * step * (drive_velocity(drive, found, before) + drive.state.vel_n[:, 1:-1])
    assert np.abs(ahead - drive.state.pos_n[:, 1:-1]).max() < 10.0 * 0.01**2
    assert np.abs(found.vel_l[:, before + 1] - found.vel_l[:, before]).max() < 1.5 * 10.0 * 0.01
    turn = rotation_log(mmt(quat_to_matrix(found.q_lv[:, before + 1]), quat_to_matrix(found.q_lv[:, before])))
    assert np.abs(turn).max() < 1.0 * 0.01


def drive_velocity(drive: Linearised, found: Motion, at: np.ndarray) -> np.ndarray:
    rot_nl = level_rotation(found.pos_n[:, at], PLACE).swapaxes(0, 1)
    return mv(rot_nl, found.vel_l[:, at])


@pytest.mark.parametrize("off", [0.0, 1.0], ids=["at the truth", "off"])
def test_every_sample_is_what_the_epochs_see(off):
    drive = linearised(LIVELY, off)
    found, samples = expand(drive), drive.sim.drive.samples
    n, m = len(samples.filled), samples.per_interval
    none = np.zeros((3, n))
    calm = Calm(none, none, none, none)
    interval = np.arange(n) // m
    epochs = Epochs(samples.t_s[:-1], interval, np.full(n, -1), np.ones(n, bool), np.ones(n), none, none, calm, m)
    ends = drive.ends(drive.state)
    rot, vel, pos = state_at(drive.state, ends, epochs, locate(epochs, samples, drive.increments))
    rot_ln = level_rotation(pos, PLACE)
    # exp(u theta) is cut behind u^2: the cube of half the angle to spread over 6. The level frame turns linearly in u
    # by v T / R, which leaves a T^2 / 8 R with 5 m/s^2, and takes the velocity at the knot with it, which leaves that
    # of the velocity gained.
    turn = float(np.linalg.norm(ends.turn_n, axis=0).max())
    gained = float(np.linalg.norm(np.diff(drive.state.vel_n), axis=0).max())
    level = 5.0 * 4.0 / 8.0 / 6.3e6
    assert_allclose(found.pos_n[:, :-1], pos, atol=1e-10)
    away = rotation_log(mmt(of_sensor(found, drive)[..., :-1], mm(rot_ln, rot)))
    assert np.abs(away).max() < (0.5 * turn) ** 3 / 3.0 + level + 1e-9
    speed = float(np.linalg.norm(vel, axis=0).max())
    assert np.abs(found.vel_l[:, :-1] - mv(rot_ln, vel)).max() < speed * level + gained * speed * 2.0 / 6.3e6


def test_a_quiet_drive_is_followed_between_the_knots():
    drive = linearised(replace(LIVELY, quiet=True))
    found, samples = expand(drive), drive.sim.drive.samples
    truth = drive.sim.at(samples.t_s)
    rot_ln = level_rotation(truth.pos_n, PLACE)
    # The trapezoidal rule between knots that are right: T h^2 / 12 |f''|, h^2 f'' the second difference of the samples;
    # and the force that leans while the Earth turns, of which the cubic takes what is even: w 5 m/s^2 T^2 / 8.
    sharp_g, sharp_a = (np.linalg.norm(np.diff(x, 2, axis=0), axis=1).max() for x in (samples.gyro_s, samples.accel_s))
    turn = 2.0 / 12.0 * sharp_g + 7.3e-5 * 0.5
    vel = 2.0 / 12.0 * sharp_a + 2.0 * 12.0 * turn + 3.0 * 7.3e-5 * 5.0 * 4.0 / 8.0
    assert np.abs(rotation_log(mmt(of_sensor(found, drive), mm(rot_ln, truth.rot_ns)))).max() < turn
    assert np.abs(found.vel_l - mv(rot_ln, truth.vel_n)).max() < vel
    assert np.abs(found.pos_n - truth.pos_n).max() < 2.0 * vel


def test_attitude_is_level_at_the_place_however_far_from_the_anchor():
    drive = linearised(replace(LIVELY, place=Anchor(48.0, 11.0, 500.0), quiet=True))
    found = expand(drive)
    far = Anchor(47.0, 11.0, 500.0)
    shifted = replace(
        drive.state,
        rot_ns=mm(to_axes(far), drive.state.rot_ns),
        vel_n=mv(to_axes(far), drive.state.vel_n),
        pos_n=mv(to_axes(far), drive.state.pos_n) + origin(far)[:, None],
    )
    ends, turned = drive.ends(drive.state), to_axes(far)
    there = replace(ends, **{
        name: mv(turned, getattr(ends, name)) for name in ("gravity_n", "turn_n", "square", "cube")
    })  # fmt: skip
    other = full_rate(shifted, there, drive.increments, drive.sim.drive.samples, far)
    # Positions of 111 km, in double precision 1e-11 m, turn by as much over the radius of the Earth.
    assert_allclose(quat_to_matrix(other.q_lv), quat_to_matrix(found.q_lv), atol=1e-11)
    assert_allclose(other.vel_l, found.vel_l, atol=1e-9)


def origin(far: Anchor) -> np.ndarray:
    from recon.numerics.smoothing.earth import positions_n

    return positions_n(np.array([PLACE.lat]), np.array([PLACE.lon]), np.array([PLACE.height]), far)[:, 0]


def to_axes(far: Anchor) -> np.ndarray:
    """(3, 3, 1), axes n of PLACE to those of another anchor."""
    return level_rotation(origin(far)[:, None], far).swapaxes(0, 1)


def test_values_between_knots_lie_on_lines():
    values = np.array([[0.0, 2.0, 1.0], [1.0, 1.0, 5.0]])
    u = np.array([0.0, 0.25, 0.75, 0.0, 0.5, 0.5])
    found = between_knots(values, u, 3)
    assert_array_equal(found, [[0.0, 0.5, 1.5, 2.0, 1.5, 1.5, 1.0], [1.0, 1.0, 1.0, 1.0, 3.0, 3.0, 5.0]])
