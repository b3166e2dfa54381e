"""recon.knots: covariances of a chain against the same chain as one dense matrix; what is between two knots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest

from recon.errors import DataError
from recon.knots import ATTITUDE, POSITION, SIZE, VELOCITY, Knots
from recon.numerics.rotation import Floats
from recon.schema import KNOTS
from recon.tables import build

START_NS = 1_714_550_400_000_000_000
LENGTH_S = 2.0
SINGLE = float(np.finfo(np.float32).eps)


def times(count: int) -> np.ndarray:
    """Knots two seconds apart."""
    return START_NS + np.arange(count) * round(LENGTH_S * 1e9)


def chain(count: int = 6, unknowns: int = 14, common: int = 4, seed: int = 3) -> Knots:
    """Random roots and gains; no gain lets an error grow."""
    rng = np.random.default_rng(seed)
    gains = rng.standard_normal((count - 1, unknowns, unknowns))
    gains *= 0.95 / np.linalg.norm(gains, 2, axis=(1, 2))[:, None, None]
    root = np.tril(rng.standard_normal((count, SIZE, SIZE)))
    shared = rng.standard_normal((count, SIZE, common))
    return Knots(times(count), root, gains - np.eye(unknowns), shared, np.zeros(count), np.zeros(count))


def still(count: int = 4, noise: float = 0.0) -> Knots:
    """Knots without any error, and white noise of one size between them."""
    nothing = np.zeros((count, SIZE, SIZE))
    return Knots(
        times(count),
        nothing,
        np.zeros((count - 1, SIZE, SIZE)),
        np.zeros((count, SIZE, 1)),
        np.full(count, noise),
        np.full(count, noise),
    )


def dense(known: Knots) -> Floats:
    """(N, N, 9, 9). Of x_k - (I + D_k) x_k+1 = noise, with the noise that keeps every x at unit variance."""
    count, size = len(known.t_ns), known.chain.shape[1]
    system, noise = np.eye(count * size), np.eye(count * size)
    for k in range(count - 1):
        gain = np.eye(size) + known.chain[k]
        here, beyond = slice(k * size, (k + 1) * size), slice((k + 1) * size, (k + 2) * size)
        system[here, beyond] = -gain
        noise[here, here] -= gain @ gain.T
    inverse = np.linalg.inv(system)
    whole = (inverse @ noise @ inverse.T).reshape(count, size, count, size)[:, :SIZE, :, :SIZE]
    own = np.einsum("iab,ibjc,jdc->ijad", known.root, whole, known.root)
    return np.asarray(own + np.einsum("iab,jcb->ijac", known.shared, known.shared))


def test_covariances_of_a_chain_are_those_of_the_dense_matrix() -> None:
    known = chain()
    expected = dense(known)
    # Sums of a hundred products of numbers up to ten.
    for i in range(6):
        for j in range(6):
            np.testing.assert_allclose(known.covariance(i, j), expected[i, j], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(("i", "j"), [(0, 5), (1, 2), (4, 3), (2, 2), (5, 0)])
def test_the_covariance_of_a_change_between_knots_is_that_of_the_difference(i: int, j: int) -> None:
    known = chain()
    full = dense(known)
    expected = full[i, i] + full[j, j] - full[i, j] - full[j, i]
    found = known.covariance_of_change(int(known.t_ns[i]), int(known.t_ns[j]))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-11)
    np.testing.assert_array_equal(found, found.T)


def test_many_changes_are_those_of_each_pair() -> None:
    known = replace(chain(), accel_noise=np.full(6, 0.3), gyro_noise=np.full(6, 0.2))
    starts, stops = (known.t_ns[0] + np.rint(np.random.default_rng(k).uniform(0, 1e10, 40)).astype(int) for k in (1, 2))
    stops[:10] = starts[:10] + np.arange(10) * 1_000_000
    many = known.covariance_of_change(starts.reshape(8, 5), stops.reshape(8, 5))
    assert many.shape == (8, 5, SIZE, SIZE)
    for pair, found in zip(zip(starts, stops, strict=True), many.reshape(-1, SIZE, SIZE), strict=True):
        # The same sums in another order, of numbers up to a hundred.
        np.testing.assert_allclose(found, known.covariance_of_change(*map(int, pair)), rtol=0.0, atol=1e-12)
    assert known.covariance_of_change([], []).shape == (0, SIZE, SIZE)


def test_what_a_stream_keeps_is_right_in_single_precision() -> None:
    known = chain()
    kept = Knots.of(build(KNOTS, time=known.t_ns, **known.columns()))
    np.testing.assert_array_equal(kept.t_ns, known.t_ns)
    for name in ("root", "chain", "shared"):
        np.testing.assert_allclose(getattr(kept, name), getattr(known, name), rtol=SINGLE, atol=0.0)
    # Five gains in a row, each of 14 products.
    np.testing.assert_allclose(kept.covariance(0, 5), known.covariance(0, 5), rtol=0.0, atol=5 * 14 * SINGLE * 10.0)


def test_single_precision_suffices_for_changes_far_smaller_than_sigmas() -> None:
    """A place that is known to a kilometre, and to a millimetre relative to where it was two seconds before."""
    known = still(3)
    root = np.broadcast_to(1e3 * np.eye(SIZE), (3, SIZE, SIZE)).copy()
    # The variance of the change is (1 - k^2) + (1 - k)^2 = 2 (1 - k) of that of the place.
    steps = np.broadcast_to(-0.5e-12 * np.eye(SIZE), (2, SIZE, SIZE)).copy()
    known = replace(known, root=root, chain=steps)
    kept = Knots.of(build(KNOTS, time=known.t_ns, **known.columns()))
    change = kept.covariance_of_change(int(kept.t_ns[0]), int(kept.t_ns[1]))
    # In doubles, 1e6 m^2 are known to 1e-10 m^2; the sum is of four such.
    np.testing.assert_allclose(np.diag(change), 1e-6, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("start_s", "stop_s"), [(0.3, 0.4), (0.3, 1.9), (1.0, 3.7), (0.0, 4.5), (5.1, 0.2), (2.0, 4.0)]
)
def test_a_steady_drift_grows_with_time_wherever_the_knots_are(start_s: float, stop_s: float) -> None:
    known = still()
    shared = np.zeros((4, SIZE, 2))
    shared[:, VELOCITY, 0] = [0.3, -0.2, 0.1]
    shared[:, POSITION, 0] = np.outer(LENGTH_S * np.arange(4), [0.3, -0.2, 0.1])
    shared[:, ATTITUDE, 1] = np.outer(LENGTH_S * np.arange(4), [0.01, 0.02, -0.03])
    known = replace(known, shared=shared)
    change = known.covariance_of_change(*(START_NS + round(s * 1e9) for s in (start_s, stop_s)))
    moved = (stop_s - start_s) * np.array([0.3, -0.2, 0.1, 0.0, 0.0, 0.0])
    turned = (stop_s - start_s) * np.array([0.01, 0.02, -0.03])
    np.testing.assert_allclose(change[:6, :6], np.outer(moved, moved), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(change[ATTITUDE, ATTITUDE], np.outer(turned, turned), rtol=0.0, atol=1e-12)


def wiener(s: float, t: float) -> Floats:
    """Covariance of position and velocity at s with those at t of integrated unit white noise: (2, 2)."""
    if s > t:
        return wiener(t, s).T
    return np.array([[s**2 * (3.0 * t - s) / 6.0, s**2 / 2.0], [s * (2.0 * t - s) / 2.0, s]])


@pytest.mark.parametrize(("s", "t"), [(0.5, 0.6), (0.1, 1.9), (1.3, 0.4), (0.0, 1.0), (0.7, 0.7)])
def test_white_noise_between_two_knots_is_pinned_at_both(s: float, t: float) -> None:
    """Against the joint Gaussian of both times and the end, conditioned on the end."""
    at = (s, t)
    joint = np.block([[wiener(a, b) for b in at] for a in at])
    end = np.vstack([wiener(a, LENGTH_S) for a in at])
    given = joint - end @ np.linalg.solve(wiener(LENGTH_S, LENGTH_S), end.T)
    change = np.hstack([-np.eye(2), np.eye(2)])
    expected = 0.04 * change @ given @ change.T
    found = still(noise=0.2).covariance_of_change(*(START_NS + LENGTH_NS + round(x * 1e9) for x in at))
    np.testing.assert_allclose(found[:6, :6], np.kron(expected, np.eye(3)), rtol=0.0, atol=1e-14)
    # The bridge of Brown: variance d (1 - d / T) of a change over d.
    across = 0.04 * abs(t - s) * (1.0 - abs(t - s) / LENGTH_S)
    np.testing.assert_allclose(found[ATTITUDE, ATTITUDE], across * np.eye(3), rtol=0.0, atol=1e-14)


LENGTH_NS = round(LENGTH_S * 1e9)


def test_white_noise_of_two_intervals_is_independent() -> None:
    known = still(noise=0.2)
    apart = known.covariance_of_change(START_NS + LENGTH_NS // 2, START_NS + 2 * LENGTH_NS + LENGTH_NS // 4)
    single = [
        known.covariance_of_change(START_NS, START_NS + LENGTH_NS // 2),
        known.covariance_of_change(START_NS + 2 * LENGTH_NS, START_NS + 2 * LENGTH_NS + LENGTH_NS // 4),
    ]
    np.testing.assert_allclose(apart, sum(single), rtol=0.0, atol=1e-14)


def test_knots_may_be_unevenly_spaced() -> None:
    known = replace(still(3, noise=0.2), t_ns=START_NS + np.array([0, 500_000_000, 3_000_000_000]))
    change = known.covariance_of_change(START_NS + 500_000_000, START_NS + 1_750_000_000)
    np.testing.assert_allclose(np.diag(change)[ATTITUDE], 0.04 * 1.25 * 0.5, rtol=1e-12)


@pytest.mark.parametrize("away_ns", [-1, 3 * LENGTH_NS + 1])
def test_a_time_outside_of_the_knots_is_refused(away_ns: int) -> None:
    with pytest.raises(DataError, match="do not reach"):
        still().covariance_of_change(START_NS, START_NS + away_ns)


def test_the_last_knot_is_inside() -> None:
    change = still(noise=0.2).covariance_of_change(START_NS, START_NS + 3 * LENGTH_NS)
    np.testing.assert_allclose(change, 0.0, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("rows", [0, 1])
def test_fewer_than_two_knots_tell_of_no_change(rows: int) -> None:
    table = build(KNOTS, time=chain().t_ns, **chain().columns())
    with pytest.raises(DataError, match=f"has {rows} rows"):
        Knots.of(table.slice(0, rows))


def test_some_of_the_rows_tell_of_changes_between_them() -> None:
    table = build(KNOTS, time=chain().t_ns, **chain().columns())
    whole, part = Knots.of(table), Knots.of(table.slice(1, 3))
    np.testing.assert_array_equal(part.covariance(0, 2), whole.covariance(1, 3))


@pytest.mark.parametrize("name", ["root", "chain", "shared"])
def test_lists_of_a_wrong_length_are_refused(name: str) -> None:
    table = build(KNOTS, time=chain().t_ns, **chain().columns())
    lists = table[name].to_pylist()
    lists[2] = lists[2][:-1]
    damaged = table.set_column(table.column_names.index(name), name, pa.array(lists, pa.list_(pa.float32())))
    with pytest.raises(DataError, match="damaged"):
        Knots.of(damaged)
