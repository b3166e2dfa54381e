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
cubic is also the mean of such a process. Left out are scale errors of the IMU inside of an interval: a change of speed
by dv in a part of one, as in a crash, errs besides by up to the scale error times dv.

References
    Barfoot, Tong, Sarkka (2014), "Batch continuous-time trajectory estimation as exactly sparse Gaussian process
    regression", RSS X: eq. 17 to 20 (interpolation and its covariance), white noise on acceleration.
    Rauch, Tung, Striebel (1965), AIAA J. 3(8): the chain of gains.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import pyarrow as pa

from recon.errors import DataError
from recon.tables import Array, time_ns, vector

SIZE: Final = 9
POSITION: Final = slice(0, 3)
VELOCITY: Final = slice(3, 6)
ATTITUDE: Final = slice(6, 9)

_TRIANGLE: Final = np.tril_indices(SIZE)


@dataclass(frozen=True)
class Knots:
    """The covariances of a trajectory at N knots, as in the module's formula.

    t_ns : (N,) ns since 1970; root : (N, 9, 9) L; chain : (N-1, b, b) D; shared : (N, 9, g) T
    gyro_noise, accel_noise : (N,) rad/s^0.5, m/s^1.5 (that is rad/s/sqrt(Hz), m/s^2/sqrt(Hz)), from a knot to the next
    """

    t_ns: np.ndarray
    root: Array
    chain: Array
    shared: Array
    gyro_noise: Array
    accel_noise: Array

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

    def covariance(self, i: int, j: int) -> Array:
        """Covariance of the errors at two knots: (9, 9), rows of knot i, columns of knot j."""
        if i > j:
            return self.covariance(j, i).T
        moved = np.zeros((SIZE, self.chain.shape[1]))
        moved[:, :SIZE] = self.root[i]
        for step in self.chain[i:j]:
            moved += moved @ step
        return np.asarray(moved[:, :SIZE] @ self.root[j].T + self.shared[i] @ self.shared[j].T)

    def covariance_of_change(self, start_ns: int, stop_ns: int) -> Array:
        """Covariance of the error at one time less that at another: (9, 9). Raises DataError outside of the knots."""
        places = [self._locate(start_ns), self._locate(stop_ns)]
        parts: dict[int, Array] = {}
        for sign, (knot, step_s, length_s) in zip((-1.0, 1.0), places, strict=True):
            for index, weights in zip((knot, knot + 1), _interpolation(step_s, length_s), strict=True):
                parts[index] = parts.get(index, 0.0) + sign * weights
        total = np.zeros((SIZE, SIZE))
        for i, left in parts.items():
            for j, right in parts.items():
                total += left @ self.covariance(i, j) @ right.T
        for knot in {place[0] for place in places}:
            inside = [(sign, s, t) for sign, (k, s, t) in zip((-1.0, 1.0), places, strict=True) if k == knot]
            for sign, s, length_s in inside:
                for other, t, _ in inside:
                    total += sign * other * self._pinned(knot, s, t, length_s)
        return np.asarray(0.5 * (total + total.T))

    def _locate(self, t_ns: int) -> tuple[int, float, float]:
        """The knot before a time, s since then, and s from there to the next."""
        if not self.t_ns[0] <= t_ns <= self.t_ns[-1]:
            raise DataError("the sigmas of this trajectory do not reach to one of the times")
        knot = min(int(np.searchsorted(self.t_ns, t_ns, side="right")) - 1, len(self.t_ns) - 2)
        return knot, (t_ns - self.t_ns[knot]) * 1e-9, (self.t_ns[knot + 1] - self.t_ns[knot]) * 1e-9

    def _pinned(self, knot: int, s: float, t: float, length_s: float) -> Array:
        """Covariance at s and t after a knot of noise that is nought there and at the next: (9, 9)."""
        if s > t:
            return self._pinned(knot, t, s, length_s).T
        moving = _wandered(s) @ _moved(t - s).T - _share(s, length_s) @ _wandered(length_s) @ _share(t, length_s).T
        turning = s - s * t / length_s
        return _on_axes(moving * self.accel_noise[knot] ** 2, turning * self.gyro_noise[knot] ** 2)


def _flat(lists: pa.ChunkedArray) -> Array:
    return np.asarray(lists.combine_chunks().flatten(), dtype=np.float64)


def _lists(rows: Array) -> pa.Array:
    """(n, k) as n lists of k numbers."""
    offsets = np.arange(len(rows) + 1, dtype=np.int32) * np.int32(rows.shape[1])
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(rows.astype(np.float32).reshape(-1)))


def _interpolation(step_s: float, length_s: float) -> tuple[Array, Array]:
    """What the errors at the knot before and at the next have in that `step_s` after the first: (9, 9) each."""
    after = _share(step_s, length_s)
    before = _moved(step_s) - after @ _moved(length_s)
    share = step_s / length_s
    return _on_axes(before, 1.0 - share), _on_axes(after, share)


def _share(step_s: float, length_s: float) -> Array:
    """What position and velocity at the end of an interval have in those inside: (2, 2). Barfoot 2014, eq. 19."""
    return np.asarray(_wandered(step_s) @ _moved(length_s - step_s).T @ np.linalg.inv(_wandered(length_s)))


def _moved(step_s: float) -> Array:
    """Position and velocity after a time, from those before: (2, 2)."""
    return np.array([[1.0, step_s], [0.0, 1.0]])


def _wandered(step_s: float) -> Array:
    """Covariance of position and velocity after white noise of unit density on the acceleration: (2, 2)."""
    return np.array([[step_s**3 / 3.0, step_s**2 / 2.0], [step_s**2 / 2.0, step_s]])


def _on_axes(moving: Array, turning: float) -> Array:
    """Of position and velocity (2, 2), and of attitude, the same on all three axes: (9, 9)."""
    whole = np.zeros((SIZE, SIZE))
    whole[:6, :6] = np.kron(moving, np.eye(3))
    whole[ATTITUDE, ATTITUDE] = turning * np.eye(3)
    return whole
