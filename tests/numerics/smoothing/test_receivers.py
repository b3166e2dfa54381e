"""Further receivers: antennas, clocks and errors are found, what is common tells nothing twice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from smoothing_drives import Log, further_receiver, simulate

from recon.numerics.smoothing import Fixes, Model, estimate, sigmas
from recon.numerics.smoothing.receivers import find_receiver, joined, solved_with
from recon.numerics.smoothing.soa import mmt, rotation_log
from recon.numerics.smoothing.state import ROTATION

AWAY_V = np.array([-1.6, 0.9, 0.2])
"""m, from the first antenna to the second; vehicle."""
LATE_S = 0.4
SLOW = np.array([1.0, 1.0, 1.5])
YAW = ROTATION.start + 2


@pytest.fixture(scope="module")
def sim():
    return simulate(Log(seconds=400.0, seed=5))


@pytest.fixture(scope="module")
def found(sim):
    return estimate(sim.drive, Model(), sim.log.noise, False)


@pytest.fixture(scope="module")
def second(sim) -> Fixes:
    lever = tuple(np.array(sim.log.lever_v) + AWAY_V)
    return further_receiver(sim, lever_v=lever, lag=-LATE_S, velocity=0.2, drift=0.5)


@pytest.fixture(scope="module")
def receiver(found, second):
    return find_receiver(found, second, SLOW, None, 0.0)


def test_antenna_and_clock_are_found_within_their_sigmas(sim, receiver):
    away_s = sim.log.box.T @ AWAY_V
    assert (np.abs(receiver.offset_s - away_s) < 4.0 * receiver.offset_sigma).all()
    # the turns of a car, 0.1 rad/s, show a lever of a metre as 0.1 m/s: 0.2 m/s in 400 fixes tell 0.1 m
    assert receiver.offset_sigma[:2].max() < 0.2
    assert abs(receiver.lag - LATE_S) < max(4.0 * receiver.lag_sigma, 0.01)
    assert abs(receiver.drift) < 4.0 * receiver.drift_sigma


def test_velocities_have_the_sigma_of_their_errors_whatever_is_reported(found, second):
    """It errs by 0.2 m/s; the solution's own error, 0.03 m/s, adds a hundredth; 800 components tell 3 %."""
    doubted = replace(second, vel_sigma=second.vel_sigma / 7.0)
    told = find_receiver(found, doubted, SLOW, None, 0.0).fixes.vel_sigma
    assert_allclose(told[0], 0.2, rtol=0.12)


def test_what_lasts_in_positions_counts_in_full(receiver):
    """Slow errors of 1 m and 0.5 m, 60 s long, and 0.5 m white, as one white sigma: the root of 1.25 * 120, 11 m.

    Four blocks tell it, two axes each: a factor of two either way.
    """
    assert 5.0 < receiver.fixes.pos_sigma[0, 0] < 25.0


def test_a_receiver_of_the_same_errors_shares_all_of_them(sim, found, receiver):
    twin = find_receiver(found, sim.drive.fixes, SLOW, np.zeros(3), 0.01)
    assert twin.shared > 0.9
    # of 800 components a correlation is told to 0.04; the solution's error passes for a common one of 0.03
    assert receiver.shared < 0.2


def test_a_twin_adds_nothing(sim, found):
    fixes, _, _ = joined(found, [find_receiver(found, sim.drive.fixes, SLOW, np.zeros(3), 0.01)])
    again = sigmas(solved_with(found, fixes))
    # velocities count as one; its positions, of which the slow error is known to be that of the first, hardly do
    assert (again[3:5] > 0.9 * sigmas(found)[3:5]).all()


def test_another_receiver_makes_velocities_better_and_errors_stay_within_sigmas(sim, found):
    own = further_receiver(sim, lever_v=tuple(np.array(sim.log.lever_v) + AWAY_V))
    fixes, which, row = joined(found, [find_receiver(found, own, SLOW, None, 0.0)])
    assert (np.bincount(which) == len(own.t_s)).all()
    assert (np.diff(fixes.t_s) >= 0.0).all()
    assert_allclose(np.sort(row[which == 1]), np.arange(len(own.t_s)))
    both = solved_with(found, fixes)
    true = sim.state(both.smoother.drive.samples.knot_times)
    spread = np.sqrt(np.einsum("nii->in", both.covariance[:, 3:9, 3:9]))
    turned = rotation_log(mmt(true.rot_ns, both.solved.state.rot_ns))
    error = np.concatenate([turned, true.vel_n - both.solved.state.vel_n])
    assert (np.abs(error) < 4.5 * spread).all()  # exceeded by 7e-6 of Gaussian errors
    # the IMU knows a part of the velocity, so that it is less than the root of two better
    assert 0.7 < np.median(sigmas(both)[3:5] / sigmas(found)[3:5]) < 0.9


def test_a_known_base_line_tells_the_heading():
    """Two antennas 1.85 m apart whose positions err by 5 mm, 4 mrad a fix, beside a gyroscope ten times as noisy."""
    exact = {"drift": 1e-3, "white": 0.005}
    sim = simulate(Log(seconds=200.0, seed=5, gyro=np.radians(0.1), gyro_walk=np.radians(0.005), **exact))
    alone = estimate(sim.drive, Model(), sim.log.noise, False)
    own = further_receiver(sim, lever_v=tuple(np.array(sim.log.lever_v) + AWAY_V), **exact)
    away_s = sim.log.box.T @ AWAY_V
    receiver = find_receiver(alone, own, sim.log.noise.drift, away_s, 1e-3)
    assert_allclose(receiver.offset_s, away_s)
    both = solved_with(alone, joined(alone, [receiver])[0])
    before, after = (np.sqrt(solution.covariance[:, YAW, YAW]) for solution in (alone, both))
    assert np.median(after / before) < 0.8
    true = sim.state(both.smoother.drive.samples.knot_times)
    turned = rotation_log(mmt(true.rot_ns, both.solved.state.rot_ns))[2]
    assert (np.abs(turned) < 4.5 * after).all()


def test_too_few_fixes_in_the_drive_are_refused(found, second):
    with pytest.raises(ValueError, match="0 of its fixes"):
        find_receiver(found, replace(second, t_s=second.t_s + 1e6), SLOW, None, 0.0)
