"""How errors of a trajectory at two times belong together: covariances of changes, from the stream `knots`.

The errors of position and velocity (local) and attitude (a rotation about East, North, Up) at knot k are, in order,

    z_k = [L_k 0] x_k + T_k y,    x_k = (I + D_k) x_k+1 + independent noise,    x_k, y ~ N(0, I)

    cov(z_i, z_j) = [L_i 0] (I + D_i) ... (I + D_j-1) [L_j 0]^T + T_i T_j^T,  i <= j

with L_k the lower triangular root of the covariance if all that the drive has in common (levers, delays, scale errors,
the mounting) were known, D_k a step of the chain of the smoother's b unknowns in units of their sigmas, and T_k what
the g common unknowns y, made independent, do to the knot. D and not I + D is kept, so that single precision holds for
changes, too, however much smaller than its ends they are: 1e-7 of the sigmas of the ends.

Between knots the trajectory is the logged motion, bent so that it meets both: attitude linear, position a cubic. Its
error is therefore that of the two knots, interpolated likewise, and white noise of the IMU pinned down at both; the
cubic is also the mean of such a process. Scale errors, which are among y, bend it besides, as recon.scale_errors
tells: to what T has of both knots B C is added, B (9, 6) what each does there and C (6, g) what y is to them. Left out
is vibration that shakes the box and not the vehicle, which is motion to the trajectory: where it has the sigma a, in
m/s^2, about the frequency f, velocities err by some a / (2 pi f).

Where L is NaN on its diagonal, as that of the attitude is where a fuser took it as given, nothing is known.

References
    Barfoot, Tong, Sarkka (2014), "Batch continuous-time trajectory estimation as exactly sparse Gaussian process
    regression", RSS X: eq. 17 to 20 (interpolation and its covariance), white noise on acceleration.
    Rauch, Tung, Striebel (1965), AIAA J. 3(8): the chain of gains.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, combinations_with_replacement
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike

from recon.errors import DataError
from recon.tables import Array, meta, time_ns, vector

SIZE: Final = 9
POSITION: Final = slice(0, 3)
VELOCITY: Final = slice(3, 6)
ATTITUDE: Final = slice(6, 9)

_TRIANGLE: Final = np.tril_indices(SIZE)
_AT_ONCE: Final = 8192
"""Changes; each takes some 10 kB while it is worked out."""


@dataclass(frozen=True)
class Knots:
    """The covariances of a trajectory at N knots, as in the module's formula.

    t_ns : (N,) ns since 1970; root : (N, 9, 9) L; chain : (N-1, b, b) D; shared : (N, 9, g) T
    gyro_noise, accel_noise : (N,) rad/s^0.5, m/s^1.5 (that is rad/s/sqrt(Hz), m/s^2/sqrt(Hz)), from a knot to the next
    scales : (6, g) C, None where nothing is known of it
    """

    t_ns: np.ndarray
    root: Array
    chain: Array
    shared: Array
    gyro_noise: Array
    accel_noise: Array
    scales: Array | None = None

    @classmethod
    def of(cls, table: pa.Table) -> Knots:
        """From a stream `knots`. Raises DataError where there are fewer than two, or the lists are of odd lengths."""
        count = table.num_rows
        if count < 2:
            raise DataError(f"the stream 'knots' has {count} rows; there is no change to tell of")
        triangle, chain, shared = _flat(table["root"]), _flat(table["chain"][:-1]), _flat(table["shared"])
        size = round(np.sqrt(len(chain) / (count - 1)))
        common = len(shared) // (count * SIZE)
        sizes = (len(triangle), len(chain), len(shared))
        if sizes != (count * len(_TRIANGLE[0]), (count - 1) * size**2, count * SIZE * common) or size < SIZE:
            raise DataError(f"the stream 'knots' is damaged: {count} rows hold {sizes} numbers")
        root = np.zeros((count, SIZE, SIZE))
        root[:, *_TRIANGLE] = triangle.reshape(count, -1)
        return cls(
            time_ns(table),
            root,
            chain.reshape(count - 1, size, size),
            shared.reshape(count, SIZE, common),
            vector(table, "gyro_noise"),
            vector(table, "accel_noise"),
            None if (scales := meta(table).get("scales")) is None else np.asarray(scales, dtype=np.float64),
        )

    def columns(self) -> dict[str, object]:
        """The columns `root`, `chain`, `shared` and the noise, as `recon.build` takes them."""
        count = len(self.t_ns)
        chain = _lists(self.chain.reshape(count - 1, -1))
        return {
            "gyro_noise": self.gyro_noise,
            "accel_noise": self.accel_noise,
            "root": _lists(self.root[:, *_TRIANGLE]),
            "chain": pa.concat_arrays([chain, pa.array([[]], chain.type)]),
            "shared": _lists(self.shared.reshape(count, -1)),
        }

    def facts(self) -> dict[str, object]:
        """The fact `scales` of the stream, as `recon.tables.with_meta` takes it."""
        return {"scales": None if self.scales is None else self.scales.tolist()}

    def covariance(self, i: ArrayLike, j: ArrayLike) -> Array:
        """Covariance of the errors at pairs of knots: (..., 9, 9) of (...) numbers, rows of knot i, columns of j."""
        i, j = np.broadcast_arrays(i, j)
        first, last = np.minimum(i, j).ravel(), np.maximum(i, j).ravel()
        moved = np.zeros((len(first), SIZE, self.chain.shape[1]))
        moved[:, :, :SIZE] = self.root[first]
        for knot in range(first.min(initial=len(self.t_ns)), last.max(initial=0)):
            passing = (first <= knot) & (knot < last)
            moved[passing] += moved[passing] @ self.chain[knot]
        both = moved[:, :, :SIZE] @ _turned(self.root[last]) + self.shared[first] @ _turned(self.shared[last])
        turned = (i > j).ravel()
        both[turned] = _turned(both[turned])
        return np.asarray(both.reshape(*i.shape, SIZE, SIZE))

    def covariance_of_change(self, start_ns: ArrayLike, stop_ns: ArrayLike, bent: Array | None = None) -> Array:
        """Covariance of the error at one time less that at another: (..., 9, 9) of (...) ns since 1970.

        bent : (..., 9, 6), B at `stop_ns` less that at `start_ns`; None for none

        Raises DataError outside of the knots.
        """
        start_ns, stop_ns = np.broadcast_arrays(np.asarray(start_ns, np.int64), np.asarray(stop_ns, np.int64))
        pairs = np.stack([start_ns.ravel(), stop_ns.ravel()])
        shared = self._shared_bend(bent, pairs.shape[1])
        blocks = [slice(first, first + _AT_ONCE) for first in range(0, pairs.shape[1], _AT_ONCE)]
        found = [self._of_changes(pairs[0, block], pairs[1, block], shared[block]) for block in blocks]
        return np.concatenate([np.zeros((0, SIZE, SIZE)), *found]).reshape(*start_ns.shape, SIZE, SIZE)

    def _shared_bend(self, bent: Array | None, count: int) -> Array:
        """B C of each change: (count, 9, g)."""
        if bent is None or self.scales is None:
            return np.zeros((count, SIZE, self.shared.shape[2]))
        return np.asarray(bent.reshape(count, SIZE, -1) @ self.scales)

    def _of_changes(self, start_ns: np.ndarray, stop_ns: np.ndarray, bend: Array) -> Array:
        """As `covariance_of_change` of times (n,). bend : (n, 9, g)"""
        (before, s, length_s), (after, t, other_length_s) = self._locate(start_ns), self._locate(stop_ns)
        knots = np.stack([before, before + 1, after, after + 1])
        weights = np.stack([*(-_interpolation(s, length_s)), *_interpolation(t, other_length_s)])
        for one, other in combinations(range(4), 2):  # what two share is added up first: it may nearly cancel
            same = knots[one] == knots[other]
            weights[one, same] += weights[other, same]
            weights[other, same] = 0.0
        total = np.zeros((len(start_ns), SIZE, SIZE))
        for one, other in combinations_with_replacement(range(4), 2):
            known = np.nan_to_num(self.covariance(knots[one], knots[other]))
            part = weights[one] @ known @ _turned(weights[other])
            total += part if one == other else part + _turned(part)
        beside = (weights @ self.shared[knots]).sum(axis=0) @ _turned(bend)
        total += bend @ _turned(bend) + beside + _turned(beside)
        total += self._pinned(before, s, s, length_s) + self._pinned(after, t, t, other_length_s)
        common = self._pinned(before, np.minimum(s, t), np.maximum(s, t), length_s)
        total -= (before == after)[:, None, None] * (common + _turned(common))
        unknown = np.isnan(np.diagonal(self.root[0]))
        total[:, unknown], total[:, :, unknown] = np.nan, np.nan
        return np.asarray(0.5 * (total + _turned(total)))

    def _locate(self, t_ns: np.ndarray) -> tuple[np.ndarray, Array, Array]:
        """The knot before each time, s since then, and s from there to the next."""
        if not ((self.t_ns[0] <= t_ns) & (t_ns <= self.t_ns[-1])).all():
            raise DataError("the sigmas of this trajectory do not reach to one of the times")
        knot = np.minimum(np.searchsorted(self.t_ns, t_ns, side="right") - 1, len(self.t_ns) - 2)
        return knot, (t_ns - self.t_ns[knot]) * 1e-9, (self.t_ns[knot + 1] - self.t_ns[knot]) * 1e-9

    def _pinned(self, knot: np.ndarray, s: Array, t: Array, length_s: Array) -> Array:
        """Covariance at s and t, not before s, after a knot of noise that is nought there and at the next: (n, 9, 9).

        Of times in one interval; for others it means nothing.
        """
        moving = _wandered(s) @ _turned(_moved(t - s))
        moving -= cubic_share(s, length_s) @ _wandered(length_s) @ _turned(cubic_share(t, length_s))
        turning = s - s * t / length_s
        accel, gyro = self.accel_noise[knot] ** 2, self.gyro_noise[knot] ** 2
        return _on_axes(moving * accel[:, None, None], turning * gyro)


def _flat(lists: pa.ChunkedArray) -> Array:
    return np.asarray(lists.combine_chunks().flatten(), dtype=np.float64)


def _lists(rows: Array) -> pa.Array:
    """(n, k) as n lists of k numbers."""
    offsets = np.arange(len(rows) + 1, dtype=np.int32) * np.int32(rows.shape[1])
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(rows.astype(np.float32).reshape(-1)))


def _turned(matrices: Array) -> Array:
    """(..., n, m) as (..., m, n)."""
    return np.asarray(matrices.swapaxes(-1, -2))


def _interpolation(step_s: Array, length_s: Array) -> Array:
    """What the errors at the knot before and at the next have in those that long after the first: (2, n, 9, 9)."""
    after = cubic_share(step_s, length_s)
    before = _moved(step_s) - after @ _moved(length_s)
    share = step_s / length_s
    return np.stack([_on_axes(before, 1.0 - share), _on_axes(after, share)])


def cubic_share(step_s: Array, length_s: Array) -> Array:
    """What position and velocity at the end of an interval have in those inside: (n, 2, 2). Barfoot 2014, eq. 19."""
    return np.asarray(_wandered(step_s) @ _turned(_moved(length_s - step_s)) @ np.linalg.inv(_wandered(length_s)))


def _moved(step_s: Array) -> Array:
    """Position and velocity after a time, from those before: (n, 2, 2)."""
    one, none = np.ones_like(step_s), np.zeros_like(step_s)
    return _two_by_two(one, step_s, none, one)


def _wandered(step_s: Array) -> Array:
    """Covariance of position and velocity after white noise of unit density on the acceleration: (n, 2, 2)."""
    return _two_by_two(step_s**3 / 3.0, step_s**2 / 2.0, step_s**2 / 2.0, step_s)


def _two_by_two(*entries: Array) -> Array:
    return np.stack(entries, axis=-1).reshape(-1, 2, 2)


def _on_axes(moving: Array, turning: Array) -> Array:
    """Of position and velocity (n, 2, 2), and of attitude (n,), the same on all three axes: (n, 9, 9)."""
    whole = np.zeros((len(moving), SIZE, SIZE))
    whole[:, :6, :6] = np.einsum("nij,kl->nikjl", moving, np.eye(3)).reshape(-1, 6, 6)
    whole[:, ATTITUDE, ATTITUDE] = turning[:, None, None] * np.eye(3)
    return whole
