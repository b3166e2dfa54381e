"""Where epochs lie, and that the state there is the truth of a drive without noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from smoothing_drives import Linearised, Log, linearised

from recon.numerics.smoothing.epochs import EPOCH_S, Calm, Epochs, locate, place_epochs, state_at
from recon.numerics.smoothing.samples import Samples
from recon.numerics.smoothing.soa import mmt, rotation_log
from recon.numerics.smoothing.stops import Blocks, block_means

QUIET = Log(seconds=30.0, kind="nonstop", rest_s=3.0, imu_hz=100.0, quiet=True)


def resting(seconds: float = 20.0) -> tuple[Samples, Blocks]:
    """A box at rest, 50 Hz, knots every 2 s."""
    n = round(50.0 * seconds)
    samples = Samples(
        np.arange(n + 1) / 50.0,
        np.tile([0.1, 0.2, 0.3], (n + 1, 1)),
        np.tile([0.0, 0.0, 9.8], (n + 1, 1)),
        np.zeros(n, bool),
        np.arange(n + 1),
        100,
    )
    return samples, block_means(samples, 5)


@pytest.fixture(scope="module")
def drive() -> Linearised:
    return linearised(QUIET)


def everywhere(drive: Linearised, share: float) -> Epochs:
    """One epoch in each interval, at the same share of it."""
    knots = drive.sim.drive.samples.knot_times
    count = len(knots) - 1
    none = np.zeros((3, count))
    calm = Calm(none, none, none, none)
    t_s = knots[:-1] + share * np.diff(knots)
    return Epochs(t_s, np.arange(count), np.full(count, -1), np.ones(count, bool), np.ones(count), none, none, calm, 1)


def test_every_fix_between_the_first_knot_and_the_last_has_an_epoch_of_its_own():
    samples, blocks = resting()
    t_s = np.sort(np.random.default_rng(1).uniform(-3.0, 25.0, 60))
    epochs = place_epochs(samples, blocks, t_s)
    used = epochs.fix[epochs.fix >= 0]
    assert_array_equal(np.sort(used), np.flatnonzero((t_s > 0.0) & (t_s < 20.0)))
    assert_array_equal(epochs.t_s[epochs.fix >= 0], t_s[used])
    assert (epochs.live | (epochs.fix < 0)).all()


def test_every_epoch_lies_in_its_interval_and_slots_fill_from_the_first():
    samples, blocks = resting()
    epochs = place_epochs(samples, blocks, np.sort(np.random.default_rng(2).uniform(0.0, 20.0, 30)))
    knots = samples.knot_times
    assert (epochs.t_s >= knots[epochs.interval]).all()
    assert (epochs.t_s <= knots[epochs.interval + 1]).all()
    live = epochs.live.reshape(samples.intervals, epochs.slots)
    assert_array_equal(live, np.sort(live, axis=1)[:, ::-1])
    assert live[:, -1].any()
    assert not epochs.seconds[~epochs.live].any()


@pytest.mark.parametrize("gnss_s", [0.1, 1.0, 5.0, 40.0], ids=lambda s: f"a fix each {s:g} s")
def test_epochs_stand_for_all_of_the_drive_however_rare_the_fixes(gnss_s):
    samples, blocks = resting()
    fix_t_s = np.arange(0.05, 20.0, gnss_s)
    epochs = place_epochs(samples, blocks, fix_t_s)
    t_s = np.sort(epochs.t_s[epochs.live])
    assert np.diff(np.concatenate([[0.0], t_s, [20.0]])).max() <= 1.5 * EPOCH_S + 1e-9
    # An epoch stands for the half ways to its neighbours; at the ends it may be short of or beyond half an epoch.
    assert epochs.seconds.sum() == pytest.approx(20.0, abs=2.0 * EPOCH_S)


def test_the_samples_near_an_epoch_are_averaged_about_its_time():
    samples, _ = resting()
    slope = np.array([0.1, 0.2, 0.3])
    rising = replace(samples, gyro_s=samples.t_s[:, None] * slope, accel_s=-samples.t_s[:, None] * slope)
    epochs = place_epochs(samples, block_means(rising, 5), np.sort(np.random.default_rng(3).uniform(1.0, 19.0, 40)))
    inside = (epochs.t_s > 1.0) & (epochs.t_s < 19.0)
    assert_allclose(epochs.gyro_s[:, inside], slope[:, None] * epochs.t_s[inside], rtol=1e-12)
    assert_allclose(epochs.accel_s[:, inside], -slope[:, None] * epochs.t_s[inside], rtol=1e-12)


def test_the_weights_reproduce_every_cubic_and_its_slope(drive):
    inside = drive.inside
    duration = drive.increments.duration[drive.smoother.epochs.interval]
    for power in range(4):
        one = np.ones_like(duration)
        ends = np.stack([one * (power == 0), one * (power == 1) / duration, one, power / duration])
        assert_allclose((inside.value * ends).sum(axis=0), inside.u**power, atol=1e-14)
        slope = power * inside.u ** max(power - 1, 0) / duration
        assert_allclose((inside.slope * ends).sum(axis=0), slope, atol=1e-14)


def bounds(drive: Linearised) -> tuple[float, float, float]:
    """What linear interpolation of the samples can miss in an interval T: rad, m/s, m.

    The trapezoidal rule is wrong by T h^2 / 12 |f''| and h^2 f'' is the second difference of the samples. A rotation
    tilts the specific force on top of that. Coriolis acceleration is taken at its mean, gravity at the knot before:
    2 w a T^2 / 8 and g / R v T^2 / 2.
    """
    samples = drive.sim.drive.samples
    length = float(drive.increments.duration.max())
    sharp_g, sharp_a = (np.linalg.norm(np.diff(x, 2, axis=0), axis=1).max() for x in (samples.gyro_s, samples.accel_s))
    speed = float(np.abs(drive.state.vel_n).max())
    force = float(np.linalg.norm(samples.accel_s, axis=1).max())
    turn = length / 12.0 * sharp_g
    rest = 2.0 * 7.3e-5 * 5.0 * length**2 / 8.0 + 9.8 / 6.4e6 * speed * length**2 / 2.0
    vel = length * (sharp_a / 12.0 + force * turn) + rest
    return turn, vel, length * vel


def test_the_misclosure_of_the_truth_is_that_of_the_interpolation_and_of_the_turning_earth(drive):
    ends = drive.ends(drive.state)
    turn, vel, pos = bounds(drive)
    length = float(drive.increments.duration.max())
    # Increments are summed in axes that do not turn with the Earth: the force leans by w t, which is spread, too.
    lean = 7.3e-5 * float(np.linalg.norm(drive.sim.drive.samples.accel_s, axis=1).max())
    assert np.linalg.norm(ends.rotation_n, axis=0).max() < turn
    assert np.linalg.norm(ends.velocity_n, axis=0).max() < vel + lean * length**2 / 2.0
    assert np.linalg.norm(ends.position_n, axis=0).max() < pos + lean * length**3 / 6.0


@pytest.mark.parametrize("share", [0.13, 0.5, 0.875])
def test_the_state_inside_an_interval_is_the_truth(drive, share):
    epochs = everywhere(drive, share)
    inside = locate(epochs, drive.sim.drive.samples, drive.increments)
    rot, vel, pos = state_at(drive.state, drive.ends(drive.state), epochs, inside)
    truth = drive.sim.at(epochs.t_s)
    turn, speed, way = bounds(drive)
    # The last fraction of a step holds the sample before instead of the line: half a step's change of the sample.
    samples, step = drive.sim.drive.samples, 1.0 / QUIET.imu_hz
    part = 0.5 * step
    turn += part * np.linalg.norm(np.diff(samples.gyro_s, axis=0), axis=1).max()
    speed += part * np.linalg.norm(np.diff(samples.accel_s, axis=0), axis=1).max()
    assert np.linalg.norm(rotation_log(mmt(truth.rot_ns, rot)), axis=0).max() < turn
    assert np.linalg.norm(truth.vel_n - vel, axis=0).max() < speed
    assert np.linalg.norm(truth.pos_n - pos, axis=0).max() < way


def test_the_state_at_the_knots_is_that_of_the_knots_whatever_the_misclosure():
    drive = linearised(replace(QUIET, quiet=False), off=1.0)
    epochs = everywhere(drive, 0.0)
    last = replace(epochs, t_s=drive.sim.drive.samples.knot_times[1:])
    state, ends = drive.state, drive.ends(drive.state)
    for where, knots in ((epochs, slice(None, -1)), (last, slice(1, None))):
        inside = locate(where, drive.sim.drive.samples, drive.increments)
        rot, vel, pos = state_at(state, ends, where, inside)
        # The last step to the knot behind is held instead of a line: half its change, 5e-3 s times 1 rad/s and
        # 10 m/s^2 at most from vibration that this drive does not have; noise of 1e-3 rad/s and 1e-2 m/s^2.
        # The misclosure of the rotation is 0.02 rad: what spreading it linearly leaves is second order in the Earth's
        # turn over the interval, 0.02 x 1.5e-4.
        assert np.abs(rotation_log(mmt(state.rot_ns[..., knots], rot))).max() < 1e-5 + 5e-3 * 1e-2
        assert np.abs(vel - state.vel_n[:, knots]).max() < 5e-3 * 0.2
        assert np.abs(pos - state.pos_n[:, knots]).max() < 5e-3 * 5e-3


def shaken(gyro: np.ndarray, accel: np.ndarray) -> Blocks:
    """Means of 0.1 s of rates and forces (3, 300)."""
    count = gyro.shape[1]
    return Blocks(10, 0.05 + 0.1 * np.arange(count), gyro, accel, np.zeros(count), np.ones(count, bool))


def test_what_stays_for_a_second_is_not_taken_off():
    steady = np.ones((3, 300)) * [[0.1], [-0.2], [0.3]]
    calm = Calm.around(shaken(steady, 5.0 * steady), np.linspace(1.0, 29.0, 57))
    assert_allclose(calm.rate, steady[:, :57], rtol=1e-9)
    assert_allclose(calm.force, 5.0 * steady[:, :57], rtol=1e-9)
    assert max(np.abs(calm.turned).max(), np.abs(calm.pushed).max()) < 1e-12


def test_what_bounces_within_a_second_is_its_distance_from_the_mean():
    # Means of 0.1 s and straight lines between take (pi f 0.1)^2 / 6 and (2 pi f 0.1)^2 / 8 of the amplitude, less than
    # a tenth at 1 Hz; the mean of a whole period is nothing.
    t_s, size = 0.05 + 0.1 * np.arange(300), 0.003
    rate = size * 2.0 * np.pi * np.cos(2.0 * np.pi * t_s)
    blocks = shaken(np.stack([0.0 * rate, rate, 0.0 * rate]), np.stack([0.0 * rate, 0.0 * rate, 10.0 * rate]))
    at = np.linspace(2.0, 27.0, 251)
    calm = Calm.around(blocks, at)
    assert_allclose(calm.turned[1], size * np.sin(2.0 * np.pi * at), rtol=0.0, atol=0.1 * size)
    assert_allclose(calm.pushed[2], 10.0 * calm.turned[1], rtol=0.0, atol=1e-12)
    assert np.abs(calm.rate).max() < 0.1 * size * 2.0 * np.pi


def test_where_the_record_begins_or_ends_within_a_second_nothing_is_taken_off():
    noise = np.random.default_rng(1).standard_normal((3, 300))
    calm = Calm.around(shaken(noise, noise), np.array([0.2, 29.8]))
    assert not calm.turned.any()
    assert not calm.pushed.any()
