"""What a clipped accelerometer cut off an impact, as far as a trajectory or the flanks of the pulse tell it.

The trajectory knows the change of velocity over an impact by what was measured before and after it, however little of
the pulse was recorded; recon.numerics.saturation has the formulas.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.knots import VELOCITY, Knots
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.integration import cumulative
from recon.numerics.rotation import rotate, to_matrix
from recon.numerics.saturation import clipped, courses, hidden, impulses
from recon.rows import spans
from recon.tables import Array, has, matrix, measured_axes, time_ns, vector

Times = NDArray[np.int64]

_LEAST: Final = 1.2 * STANDARD_GRAVITY
"""m/s^2; no sensor ends below."""
_NEAR: Final = 1e-3
"""Share of the end of a range within which a sample is there."""
_TOLD: Final = 0.25
"""Sigma of what was lost, of the most that the flanks allow, below which it is told by the trajectory."""
_SCALE: Final = 0.006
"""Sigma of the scale error of what was recorded in an impact, by which what was lost is wrong, too."""


@dataclass(frozen=True)
class Lost:
    """What clipping cut off n accelerations of the vehicle, m/s^2.

    likely : (n, 3), to be added to them; zero where nothing tells how much it was
    others : (2, n, 3), courses between which it lies, less the likely one
    doubt : (j, n, 3), one sigma each of how much it was; none where nothing tells it
    """

    likely: Array
    others: Array
    doubt: Array


def lost(
    t_ns: Times,
    accel: Array,
    imu: pa.Table | None,
    events: pa.Table | None,
    trajectory: pa.Table | None = None,
    knots: pa.Table | None = None,
) -> Lost | None:
    """What clipping cut off; None where nothing was clipped, or not in these rows.

    t_ns : (n,) ns since 1970, times of imu and trajectory; accel : (n, 3) m/s^2, vehicle, gravity removed
    imu : as logged; events : kinds saturation and crash; trajectory, knots : know changes of velocity
    """
    if imu is None or not len(t_ns) or not any(a <= t_ns[-1] and b >= t_ns[0] for a, b in spans(events, "saturation")):
        return None
    logged, _ = measured_axes(imu, "accel")
    rows = _rows_at(imu, t_ns)
    if rows is None:
        return None
    felt, t_s = logged[rows], (t_ns - t_ns[0]) * 1e-9
    mask = clipped(logged, least=_LEAST)[rows] | saturated(t_ns, felt, events)
    most = np.stack([hidden(t_s, felt[:, axis], mask[:, axis]) for axis in range(3)], axis=1)
    plateaus = _Plateaus(t_s, felt, most, mask, _turn(felt, accel))
    likely, doubt = np.zeros_like(accel), [np.zeros((0, *accel.shape))]
    flat, peaked = np.zeros_like(accel), most @ plateaus.rot_vs.T
    for start_ns, stop_ns in spans(events, "crash"):
        inside = (t_ns >= start_ns) & (t_ns <= stop_ns)
        change = unrecorded(t_ns, accel, inside, trajectory, knots) if mask[inside].any() else None
        parts = plateaus.filled(inside, change) if change is not None else None
        if parts is not None:
            flat[inside], peaked[inside], one_sigma = parts
            likely[inside] = 0.5 * (flat + peaked)[inside]
            doubt.append(one_sigma)
    return Lost(likely, np.stack([flat, peaked]) - likely, np.concatenate(doubt))


def saturated(t_ns: Times, felt: Array, events: pa.Table | None) -> NDArray[np.bool_]:
    """Samples (n, 3) that events say to be at the end of the sensor's range, which somebody may have told them.

    t_ns : (n,) ns since 1970; felt : (n, 3) m/s^2, as logged; events : of kind saturation, with the largest as value
    """
    mask = np.zeros(felt.shape, dtype=bool)
    if events is None:
        return mask
    import pyarrow.compute as pc  # slow import: only when used

    hits = events.filter(pc.equal(events["kind"], "saturation"))
    ends = zip(time_ns(hits), time_ns(hits, "end_time"), vector(hits, "value", gaps=True), strict=True)
    for start_ns, stop_ns, limit in ends:
        inside = (t_ns >= start_ns) & (t_ns <= stop_ns)
        mask[inside] |= np.abs(felt[inside]) >= (1.0 - _NEAR) * limit
    return mask


class Unrecorded(NamedTuple):
    """How much of a change of velocity was not recorded: (3,) m/s, its covariance, and (n, 3, 3) vehicle to local."""

    lost: Array
    covariance: Array
    rot_nv: Array


@dataclass(frozen=True)
class _Plateaus:
    """Where the axes of a box were clipped. felt, most, mask : (n, 3) by its axes; rot_vs : (3, 3) box to vehicle"""

    t_s: Array
    felt: Array
    most: Array
    mask: NDArray[np.bool_]
    rot_vs: Array

    def filled(self, inside: NDArray[np.bool_], change: Unrecorded) -> tuple[Array, Array, Array] | None:
        """Two courses of what was lost in some rows (m, 3), and one sigma of each impulse (k, n, 3), m/s^2, vehicle.

        Beforehand it may be as much as the flanks allow, or as much again as was recorded: of a plateau of two samples
        the steps into it, which are cut off themselves, allow nothing. None where the change does not tell it.
        """
        axes = [axis for axis in range(3) if (self.mask[:, axis] & inside).any()]
        shapes = np.stack([courses(self.t_s, self.most[:, i], self.mask[:, i] & inside) for i in axes])
        ways = np.stack([np.sign(self.felt[:, i, None]) * self.rot_vs[:, i] for i in axes])
        step_s = np.gradient(self.t_s)
        middle = shapes.mean(axis=1)[..., None] * ways
        directions = np.einsum("nij,knj,n->ik", change.rot_nv, middle, step_s)
        hit = (self.mask & inside[:, None])[:, axes]
        bounds = step_s @ (np.maximum(np.abs(self.most), np.abs(self.felt))[:, axes] * hit)
        found, covariance = impulses(change.lost, change.covariance, directions, bounds)
        main = int(np.argmax(bounds))
        if covariance[main, main] > (_TOLD * bounds[main]) ** 2:
            return None
        flat, peaked = (np.einsum("k,kn,kni->ni", found, shapes[:, i], ways)[inside] for i in (0, 1))
        return flat, peaked, np.einsum("kj,kni->jni", np.linalg.cholesky(covariance), middle)


def unrecorded(
    t_ns: Times, accel: Array, inside: NDArray[np.bool_], trajectory: pa.Table | None, knots: pa.Table | None
) -> Unrecorded | None:
    """What the trajectory knows of a change of velocity beyond what was recorded; None where it knows nothing.

    t_ns : (n,) ns since 1970; accel : (n, 3) m/s^2, vehicle, gravity removed; inside : (n,) rows of the change
    """
    if trajectory is None or knots is None or knots.num_rows < 2:
        return None
    rows = _rows_at(trajectory, t_ns) if has(trajectory, "q") and has(trajectory, "vel") else None
    known, (first, last) = Knots.of(knots), np.flatnonzero(inside)[[0, -1]]
    if rows is None or not known.t_ns[0] <= t_ns[first] <= t_ns[last] <= known.t_ns[-1]:
        return None
    ends = matrix(trajectory, "vel")[rows[[first, last]]]
    covariance = known.covariance_of_change(int(t_ns[first]), int(t_ns[last]))[VELOCITY, VELOCITY]
    q_nv = matrix(trajectory, "q")[rows]
    t_s = (t_ns[inside] - t_ns[first]) * 1e-9
    recorded = cumulative(t_s, rotate(q_nv, accel)[inside], "trapezoid")[-1]
    error = np.eye(3) * float(_SCALE**2 * recorded @ recorded)
    change = Unrecorded(ends[1] - ends[0] - recorded, covariance + error, to_matrix(q_nv))
    return change if np.isfinite(change.lost).all() and np.isfinite(covariance).all() else None


def _rows_at(table: pa.Table, t_ns: Times) -> NDArray[np.intp] | None:
    """The rows of a table with these times; None where one is missing."""
    own = time_ns(table)
    rows = np.searchsorted(own, t_ns)
    return rows if len(own) and (own[np.minimum(rows, len(own) - 1)] == t_ns).all() else None


def _turn(box: Array, vehicle: Array) -> Array:
    """The rotation (3, 3) that takes the changes of one vector (n, 3) best to those of another. Kabsch (1976)."""
    left, _, right = np.linalg.svd((vehicle - vehicle.mean(axis=0)).T @ (box - box.mean(axis=0)))
    return np.asarray(left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right)
