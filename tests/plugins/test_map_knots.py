from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from map_drives import drive, fused, numbers
from scipy.stats import chi2
from smoothing_drives import Log, simulate

from recon.errors import DataError
from recon.numerics.rotation import to_euler
from recon.numerics.signals import wrap_angle
from recon.numerics.smoothing import Model, estimate
from recon.rows import spans
from recon.scale_errors import between_knots
from recon.tables import matrix, time_ns
from recon.trajectory import Trajectory
from recon_detectors.crash import CrashParams, crash
from recon_fusers._map_knots import _covariances
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams


def test_covariances_that_are_none_to_working_precision_refuse_the_log():
    """As where a drive that was flung about hardly converged; numpy's error would be told as a fault of recon."""
    sim = simulate(Log(kind="nonstop", seconds=120.0))
    found = estimate(sim.drive, Model(), sim.log.noise, False)
    count = found.solved.state.knots
    level = np.tile(np.eye(3), (count, 1, 1))
    singular = replace(found.inverse, conditional=found.inverse.conditional.copy())
    singular.conditional[5, 3, 3] = -1.0
    _covariances(found, np.arange(count), level, level)
    with pytest.raises(DataError, match=r"does not determine a trajectory.*\n.*recon doctor") as caught:
        _covariances(replace(found, inverse=singular), np.arange(count), level, level)
    assert "knot" not in str(caught.value)  # which numbers the unknowns of a solver that no user has seen


def test_the_turn_of_a_spin_between_knots_errs_by_what_its_sigma_says():
    """A scale error of the gyroscope turns the vehicle where it spins, and not evenly until the next knot."""
    ratios = []
    for seed in range(12):
        drawn = np.random.default_rng(seed)
        spin, direction = drawn.uniform(0.4, 1.1) * drawn.choice([-1.0, 1.0]), drawn.uniform(-1.0, 1.0)
        log = simulate_drive(DriveParams(motion="crash", seed=seed, duration=120.0, spin=spin, direction=direction))
        log["events"] = crash(imu=log["imu"], params=CrashParams())["events"]
        found, true = fused(log), log["reference"]
        ((start, end),) = spans(log["events"], "crash")
        pair = [start - 500_000_000, end + 500_000_000]
        yaw = to_euler(matrix(true, "q")[np.searchsorted(time_ns(true), pair)])[0]
        moments = np.array(pair).astype("datetime64[ns]")
        told = Trajectory(found["trajectory"], found["knots"]).between(moments[:1], moments[1:])
        error = wrap_angle(told.heading_change - (yaw[0] - yaw[1]))
        ratios.append(float(error[0] / told.heading_sigma[0]))
    assert np.square(ratios).sum() < chi2.ppf(0.999, len(ratios))


def test_between_knots_the_motion_has_the_scale_errors_that_were_found():
    """What is left of them is hidden in the noise of the gyroscope."""
    log = drive("city", "perfect", gyro_scale=0.005, gyro_noise=1e-5)
    found, true = fused(log), log["reference"]
    t_ns, knots_ns = time_ns(found["trajectory"]), time_ns(found["knots"])
    yaw, wanted = (to_euler(matrix(table, "q"))[0] for table in (found["trajectory"], true))
    off = wrap_angle(yaw - wanted[np.searchsorted(time_ns(true), t_ns)])
    left = off - np.interp(t_ns, knots_ns, off[np.searchsorted(t_ns, knots_ns)])
    scales = [numbers(log)[f"true_{sensor}_scale_{axis}"] for sensor in ("gyro", "accel") for axis in "xyz"]
    made = between_knots(found["trajectory"], knots_ns, t_ns)[:, 8] @ scales
    assert np.std(left) < 0.2 * np.std(made)
