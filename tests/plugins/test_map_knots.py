"""The stream `knots` of fuser.map: its covariances against a dense inverse, and against errors of simulated drives."""

from __future__ import annotations

import numpy as np
import pytest
from smoothing_drives import PLACE, Log, Simulated, simulate

from recon import IMU, KNOTS, TRAJECTORY, Recording, build, matrix, meta, time_ns, with_meta
from recon.knots import SIZE, Knots
from recon.numerics.rotation import to_matrix
from recon.numerics.smoothing import Estimate, Model, estimate, level_rotation, sigmas
from recon.numerics.smoothing.soa import mm, mmt, mv, rotation_log
from recon.numerics.smoothing.state import KNOT_SIZE, MOUNT, POSITION, ROTATION, VELOCITY
from recon.storage import STORES, read_recording, write_recording
from recon.tables import conform
from recon_fusers._map_knots import knots

START_NS = 1_714_550_400_123_456_789
SINGLE = 1e-5
"""Of the sigmas: what is asked of covariances that are kept as numbers of single precision, wrong by 6e-8 each."""
SEEDS = range(1, 17)
HONEST = (0.124, 3.27)
"""1e-5 and 1 - 1e-5 quantiles of chi^2 with a degree of freedom for each seed, divided by their number: bounds of the
mean square of error over sigma were the error of a drive one number; the more numbers, the closer it is to one.
"""


@pytest.fixture(scope="module")
def short() -> Estimate:
    """A minute with a stop."""
    sim = simulate(Log(seconds=60.0, rest_s=10.0))
    return estimate(sim.drive, Model(), sim.log.noise, learn_noise=False)


def stream(found: Estimate):
    """The stream of knots, as the fuser makes it."""
    samples = found.smoother.drive.samples
    t_ns = START_NS + np.rint(samples.t_s * 1e9).astype(np.int64)
    imu = build(IMU, time=t_ns, accel=samples.accel_s, gyro=samples.gyro_s)
    trajectory = build(TRAJECTORY, time=t_ns)
    return knots(found, imu, with_meta(trajectory, anchor={"lat": 48.0}, height_datum="ellipsoid", time_scale="UTC"))


def dense_covariance(found: Estimate) -> np.ndarray:
    """Of all unknowns, knots first, by inverting the normal equations that were factored: [[A, B], [B^T, C]]."""
    system, solution = found.solved.system, found.solved.solution
    count = len(system.blocks)
    lower = np.zeros((count * KNOT_SIZE,) * 2)
    for k, block in enumerate(system.blocks):
        here = slice(k * KNOT_SIZE, (k + 1) * KNOT_SIZE)
        lower[here, here] = block[:, :KNOT_SIZE].T
        if k + 1 < count:
            lower[here.stop : here.stop + KNOT_SIZE, here] = block[:, KNOT_SIZE:].T
    border, reduced = lower @ solution.reduced, solution.reduced
    corner = np.linalg.inv(solution.covariance_global) + reduced.T @ reduced
    whole = np.block([[lower @ lower.T, border], [border.T, corner]])
    scale = 1.0 / np.sqrt(np.diag(whole))
    return np.linalg.inv(whole * np.outer(scale, scale)) * np.outer(scale, scale)


def dense_of_knots(found: Estimate) -> np.ndarray:
    """Of position, velocity and attitude of the vehicle, local level, at all knots: (9 N, 9 N)."""
    state, free = found.solved.state, np.flatnonzero(found.smoother.free)
    rot_ln = np.moveaxis(level_rotation(state.pos_n, PLACE), -1, 0)
    rot_lv = rot_ln @ np.moveaxis(mmt(state.rot_ns, state.rot_vs[..., None]), -1, 0)
    mount = [int(np.flatnonzero(free == index)[0]) for index in range(MOUNT.start, MOUNT.stop)]
    jacobian = np.zeros((SIZE * state.knots, KNOT_SIZE * state.knots + len(free)))
    for k in range(state.knots):
        for row, part in enumerate((POSITION, VELOCITY, ROTATION)):
            rows = slice(k * SIZE + 3 * row, k * SIZE + 3 * row + 3)
            jacobian[rows, k * KNOT_SIZE + part.start : k * KNOT_SIZE + part.stop] = rot_ln[k]
        jacobian[rows, [KNOT_SIZE * state.knots + index for index in mount]] = -rot_lv[k]
    return jacobian @ dense_covariance(found) @ jacobian.T


def test_every_covariance_is_that_of_the_dense_inverse(short: Estimate) -> None:
    known, expected = Knots.of(stream(short)), dense_of_knots(short)
    sigma = np.sqrt(np.diag(expected)).reshape(-1, SIZE)
    for i in range(len(sigma)):
        for j in range(len(sigma)):
            wanted = expected[i * SIZE : (i + 1) * SIZE, j * SIZE : (j + 1) * SIZE]
            limit = SINGLE * np.outer(sigma[i], sigma[j])
            assert (np.abs(known.covariance(i, j) - wanted) <= limit).all(), (i, j)


def test_variances_of_changes_are_those_of_the_dense_inverse_relative_to_themselves(short: Estimate) -> None:
    known, expected = Knots.of(stream(short)), dense_of_knots(short)
    count = len(known.t_ns)
    for i, j in [(0, 1), (3, 4), (10, 11), (5, 12), (2, count - 1)]:
        rows = np.r_[i * SIZE : (i + 1) * SIZE, j * SIZE : (j + 1) * SIZE]
        change = np.hstack([-np.eye(SIZE), np.eye(SIZE)])
        wanted = np.diag(change @ expected[np.ix_(rows, rows)] @ change.T)
        found = np.diag(known.covariance_of_change(int(known.t_ns[i]), int(known.t_ns[j])))
        np.testing.assert_allclose(found, wanted, rtol=SINGLE)


def test_sigmas_of_knots_are_those_that_the_trajectory_gets(short: Estimate) -> None:
    known, wanted = Knots.of(stream(short)), sigmas(short)
    found = np.sqrt([np.diag(known.covariance(k, k)) for k in range(len(known.t_ns))]).T
    np.testing.assert_allclose(found[:6], wanted[:6], rtol=SINGLE)
    np.testing.assert_allclose(found[8], wanted[8], rtol=SINGLE)


def test_knots_are_the_states_at_their_times(short: Estimate) -> None:
    table, state = stream(short), short.solved.state
    assert conform(table, KNOTS, stream="knots", step="fuser.map") == table
    np.testing.assert_array_equal(time_ns(table), START_NS + np.arange(state.knots) * 2_000_000_000)
    np.testing.assert_array_equal(matrix(table, "pos"), state.pos_n.T)
    np.testing.assert_array_equal(matrix(table, "gyro_bias"), state.gyro_bias.T)
    np.testing.assert_array_equal(matrix(table, "drift"), state.drift_n.T)
    rot_ln = level_rotation(state.pos_n, PLACE)
    rot_lv = np.moveaxis(mm(rot_ln, mmt(state.rot_ns, state.rot_vs[..., None])), -1, 0)
    np.testing.assert_allclose(to_matrix(matrix(table, "q")), rot_lv, rtol=0.0, atol=1e-14)
    assert meta(table) == {"anchor": {"lat": 48.0}, "time_scale": "UTC"}


def test_a_knot_takes_two_and_a_half_kilobytes(short: Estimate) -> None:
    table = stream(short)
    assert table.nbytes / table.num_rows < 2500.0


@pytest.mark.parametrize("store", STORES)
def test_lists_are_kept_by_every_store(short: Estimate, store: str, tmp_path) -> None:
    table = stream(short)
    write_recording(Recording({"knots": table}), tmp_path / "kept", store)
    kept = read_recording(tmp_path / "kept")["knots"]
    assert kept.equals(table, check_metadata=True)


def errors(sim: Simulated, found: Estimate) -> np.ndarray:
    """Of position, velocity and attitude of the vehicle at the knots, local level: (9, N)."""
    state, truth = found.solved.state, sim.at(sim.drive.samples.knot_times)
    rot_ln = level_rotation(state.pos_n, PLACE)
    rot_nv = mmt(state.rot_ns, state.rot_vs[..., None])
    attitude = rotation_log(mmt(mm(rot_ln, rot_nv), mm(rot_ln, truth.rot_nv)))
    return np.concatenate([mv(rot_ln, state.pos_n - truth.pos_n), mv(rot_ln, state.vel_n - truth.vel_n), attitude])


def test_errors_of_changes_over_ten_seconds_are_as_large_as_their_sigmas_say() -> None:
    honest, naive = [], []
    for seed in SEEDS:
        sim = simulate(Log(seconds=120.0, seed=seed, rest_s=5.0))
        found = estimate(sim.drive, Model(), sim.log.noise, learn_noise=False)
        known, error = Knots.of(stream(found)), errors(sim, found)
        pairs = [(i, i + 5) for i in range(len(known.t_ns) - 5)]
        squares = np.array([(error[:, j] - error[:, i]) ** 2 for i, j in pairs])
        told = [known.covariance_of_change(int(known.t_ns[i]), int(known.t_ns[j])) for i, j in pairs]
        summed = [known.covariance(i, i) + known.covariance(j, j) for i, j in pairs]
        honest.append((squares / [np.diag(c) for c in told]).mean(axis=0))
        naive.append((squares / [np.diag(c) for c in summed]).mean(axis=0))
    mean = np.mean(honest, axis=0)
    assert (mean > HONEST[0]).all(), mean
    assert (mean < HONEST[1]).all(), mean
    # As if errors at two times had nothing in common: by the same bounds no sigma of a change of place.
    assert (np.mean(naive, axis=0)[:3] < HONEST[0]).all()
