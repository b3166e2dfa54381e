"""The pulse of an impact out of the streams of a run, and what may be wrong with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    EVENTS,
    IMU,
    KNOTS,
    METRICS,
    TRAJECTORY,
    Array,
    Params,
    has,
    matrix,
    meta,
    quantity,
    setting,
    time_ns,
)
from recon.clipping import lost, unrecorded
from recon.knots import VELOCITY, Knots
from recon.numerics.budget import Doubt, Pulse
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.rotation import conjugate, rotate, shortest_arc, to_matrix
from recon.numerics.signals import median_rate
from recon.schema import Need
from recon.sensor_classes import SensorClass, typical
from recon.tables import measured_axes, schema_of

LEAD_S: Final = 0.5
_BEHIND_S: Final = 1.5
"""s before and after time zero that are looked at; the filters of EN 1317 want half a second on both sides."""
_MOST_RATE: Final = 2000.0
"""Hz; what is faster adds nothing to CFC 60, and is averaged away."""
_QUIET_S: Final = (1.5, 0.05)
"""s before time zero from which noise is told."""
_LEAST_QUIET_S: Final = 0.3
"""s after another crash that tell it."""
_SMOOTH_S: Final = 0.1
LINEARITY: Final = 0.004
"""Sigma of the further scale error at the accelerations of an impact; data sheets allow 0.5 % of full scale."""
_WAKE_UP: Final = (0.8 / 3.6, 0.02)
"""m/s and s, by which time zero is found."""


NEEDS: Final[Mapping[str, Need]] = {
    "trajectory": TRAJECTORY.need(maybe=["accel", "gyro", "vel", "q", "vel_std"], optional=True),
    "imu": IMU.need("accel", maybe=["gyro"], optional=True),
    "knots": KNOTS.need("root", "chain", "shared", "gyro_noise", "accel_noise", optional=True),
    "events": EVENTS.need("time", "end_time", "kind", optional=True),
    "metrics": METRICS.need("name", "sigma", optional=True),
}
"""Streams that tell an impact and its doubts."""


class PulseParams(Params):
    """What is taken for granted of an IMU that felt an impact."""

    sensor_class: SensorClass = setting("consumer_mems", doc="What kind of IMU it is: its bias and scale error.")
    accel_scale: float | None = quantity(
        None, "%", ge=0, doc="Sigma of the scale error, where no step has told it; none: that of the class."
    )
    mounting_sigma: float = quantity(
        1.0, "deg", ge=0, doc="How well the axes of the vehicle are known, where no step has told it."
    )


@dataclass(frozen=True)
class Motion:
    """What is known of the vehicle, row by row.

    t_ns : (n,); accel : (n, 3) m/s^2, gravity removed; gyro : (n, 3) rad/s, zero where there is none
    directed : is x known to point forward?  turning : is there a gyro?
    unmeasured : columns of axes of the vehicle along which nothing was measured
    """

    t_ns: NDArray[np.int64]
    accel: Array
    gyro: Array
    directed: bool
    turning: bool
    unmeasured: tuple[str, ...] = ()


def motion_of(trajectory: pa.Table | None, imu: pa.Table | None) -> Motion | None:
    """From the trajectory where it has accelerations, else from the imu; None where there is neither."""
    if trajectory is not None and has(trajectory, "accel"):
        return _rows(trajectory, matrix(trajectory, "accel", gaps=True), directed=True)
    if imu is None or not any(has(imu, f"accel_{axis}") for axis in "xyz"):
        return None
    accel, unmeasured = measured_axes(imu, "accel")
    column = schema_of(imu)["accel_x"]
    if column.quantity != "acceleration" and column.frame not in ("vehicle", "level"):
        return _levelled(imu, accel)
    felt = accel if column.quantity == "acceleration" else accel - [0.0, 0.0, STANDARD_GRAVITY]
    found = _rows(imu, felt, directed=column.frame == "vehicle")
    return replace(found, unmeasured=tuple(unmeasured))


def _rows(table: pa.Table, accel: Array, *, directed: bool, turn: Array | None = None) -> Motion:
    turning = has(table, "gyro")
    gyro = matrix(table, "gyro", gaps=True) if turning else np.zeros_like(accel)
    if turn is not None:
        gyro = rotate(turn, gyro)
    known = np.isfinite(accel).all(axis=1) & np.isfinite(gyro).all(axis=1)
    return Motion(time_ns(table)[known], accel[known], gyro[known], directed, turning)


def _levelled(imu: pa.Table, accel: Array) -> Motion:
    """Turned so that the median specific force points up; where forward is, nobody knows."""
    up = np.nanmedian(accel, axis=0) if len(accel) else np.array([0.0, 0.0, 1.0])
    turn = shortest_arc(up, np.array([0.0, 0.0, 1.0])) if np.linalg.norm(up) > 0.0 else np.array([1.0, 0, 0, 0])
    return _rows(imu, rotate(turn, accel) - [0.0, 0.0, float(np.linalg.norm(up))], directed=False, turn=turn)


def pulse_at(
    motion: Motion,
    zero_ns: int,
    imu: pa.Table | None = None,
    events: pa.Table | None = None,
    trajectory: pa.Table | None = None,
    knots: pa.Table | None = None,
) -> Pulse | None:
    """The pulse about a time zero on a regular grid that meets it; None where the log holds fewer than four samples.

    imu, events, trajectory, knots : tell what was clipped, and what that cost
    """
    near = slice(*np.searchsorted(motion.t_ns, [zero_ns - round(LEAD_S * 1e9), zero_ns + round(_BEHIND_S * 1e9) + 1]))
    t_ns = motion.t_ns[near]
    if len(t_ns) < 4:
        return None
    t_s: Array = np.asarray((t_ns - zero_ns) * 1e-9)
    own_s = 1.0 / median_rate(t_ns)
    every = max(int(np.ceil(1.0 / (own_s * _MOST_RATE) - 1e-6)), 1)
    step_s = own_s * every
    first, last = int(np.ceil(t_s[0] / step_s - 1e-6)), int(np.floor(t_s[-1] / step_s + 1e-6))
    grid: Array = np.asarray(np.arange(first, last + 1) * step_s)
    accel, gyro = motion.accel[near], motion.gyro[near]
    cut = lost(t_ns, accel, imu, events, trajectory, knots)
    clipped, doubt = (cut.others, cut.doubt) if cut is not None else ((), ())
    accel, gyro, *others = (
        _on_grid(grid, t_s, y, step_s, every)
        for y in (accel if cut is None else accel + cut.likely, gyro, *clipped, *doubt)
    )
    parts = np.reshape(others, (-1, *accel.shape))
    return Pulse(accel, gyro, step_s, max(-first, 0), parts[: len(clipped)], parts[len(clipped) :])


def _on_grid(grid: Array, t_s: Array, y: Array, step_s: float, every: int) -> Array:
    """Interpolated at the times of a grid (m,); where that is coarser, means over its steps.

    By cubic splines, for lines between samples take up to an eighth off what swings with a sixth of the rate; by lines
    where a step is not between half and twice the usual one, as splines overshoot over gaps and jitter.
    """
    if every == 1:
        steps = np.diff(t_s) / step_s
        if steps.min() > 0.5 and steps.max() < 2.0:
            from scipy.interpolate import CubicSpline  # slow import: only when used

            return np.asarray(CubicSpline(t_s, y)(grid))
        return np.stack([np.interp(grid, t_s, axis) for axis in y.T], axis=1)
    area = np.zeros_like(y)
    np.cumsum(0.5 * np.diff(t_s)[:, None] * (y[1:] + y[:-1]), axis=0, out=area[1:])
    ends = [np.clip(grid + side * step_s / 2.0, t_s[0], t_s[-1]) for side in (-1.0, 1.0)]
    before, after = (np.stack([np.interp(end, t_s, axis) for axis in area.T], axis=1) for end in ends)
    return np.asarray((after - before) / np.maximum(ends[1] - ends[0], 1e-12)[:, None])


@dataclass(frozen=True)
class Known:
    """What a run knows of its accelerations; `doubt` says what may be wrong with a pulse of them.

    crashes : (start, end) of every crash in ns since 1970, sorted
    """

    motion: Motion
    trajectory: pa.Table | None
    knots: pa.Table | None
    metrics: pa.Table | None
    params: PulseParams
    crashes: Sequence[tuple[int, int]]

    def doubt(self, pulse: Pulse, zero_ns: int) -> Doubt:
        """Sigmas for a pulse with that time zero."""
        noise, bias = noise_of(self.motion, zero_ns, self.crashes), self._constant(zero_ns)
        facts = meta(self.trajectory) if self.trajectory is not None else {}
        axes, box = self._axes(facts)
        return Doubt(
            bias=bias,
            axes=axes,
            box=box,
            gyro_bias=typical(self.params.sensor_class, "gyro_bias") if self.trajectory is None else 0.0,
            gyro_scale=typical(self.params.sensor_class, "gyro_scale"),
            lever=np.asarray(facts.get("lever_arm_sigma", (0.0, 0.0, 0.0)), dtype=np.float64),
            time=_time_sigma(pulse, bias, noise),
            noise=noise,
        )

    def closure(self, span: tuple[int, int]) -> tuple[float, float, float] | None:
        """By how much a change of velocity exceeds what was recorded of it: m/s, its sigma, and how many sigmas it is.

        None where no trajectory tells it.
        """
        margin = round(LEAD_S * 1e9)
        near = slice(*np.searchsorted(self.motion.t_ns, [span[0] - margin, span[1] + margin]))
        t_ns, accel = self.motion.t_ns[near], self.motion.accel[near]
        inside = (t_ns >= span[0]) & (t_ns <= span[1])
        if not inside.any():
            return None
        change = unrecorded(t_ns, accel, inside, self.trajectory, self.knots)
        if change is None:
            return None
        size = float(np.linalg.norm(change.lost))
        way = change.lost / max(size, np.finfo(float).tiny)
        sigmas = float(np.sqrt(change.lost @ np.linalg.solve(change.covariance, change.lost)))
        return size, float(np.sqrt(way @ change.covariance @ way)), sigmas

    def _axes(self, facts: Mapping[str, Any]) -> tuple[Array, Array]:
        """Covariance (6, 6) of scale errors and mounting, and the mounting (3, 3), as of recon.numerics.budget.Doubt.

        As the drive told them, else what is usual in the class, of a box whose axes are those of the vehicle.
        """
        extra = np.diag([LINEARITY**2] * 3 + [0.0] * 3)
        if "mounting_covariance" in facts:
            return np.asarray(facts["mounting_covariance"]) + extra, to_matrix(np.asarray(facts["mounting"]))
        told = [self._learnt_sigma(f"mount_{name}") for name in ("roll", "pitch", "yaw")]
        tilt = [self.params.mounting_sigma if sigma is None else np.radians(sigma) for sigma in told]
        told_scale = self.params.accel_scale
        scale = typical(self.params.sensor_class, "accel_scale") if told_scale is None else told_scale
        return np.diag(np.square([scale] * 3 + tilt)) + extra, np.eye(3)

    def _constant(self, zero_ns: int) -> Array:
        """Sigma of what is constant in the acceleration through the impact: (3,) m/s^2, vehicle.

        Where a smoother tells how well it knows changes of velocity, that over half a second before, or since the crash
        before, for bias and tilt stay through it; else the bias of the class.
        """
        trajectory, since_ns = self.trajectory, zero_ns - round(LEAD_S * 1e9)
        if (earlier := _last_before(self.crashes, zero_ns)) is not None:
            since_ns = max(since_ns, earlier[1])
        if trajectory is not None and self.knots is not None and self.knots.num_rows > 1 and has(trajectory, "q"):
            known = Knots.of(self.knots)
            if known.t_ns[0] <= since_ns and zero_ns <= known.t_ns[-1]:
                change = known.covariance_of_change(since_ns, zero_ns)[VELOCITY, VELOCITY]
                row = int(np.searchsorted(time_ns(trajectory), zero_ns).clip(max=trajectory.num_rows - 1))
                q_vn = conjugate(matrix(trajectory.slice(row, 1), "q")[0])
                axes = np.stack([rotate(q_vn, axis) for axis in np.eye(3)], axis=1)
                lasts_s = (zero_ns - since_ns) * 1e-9
                return np.asarray(np.sqrt(np.maximum(np.diag(axes @ change @ axes.T), 0.0)) / lasts_s)
        return np.full(3, typical(self.params.sensor_class, "accel_bias"))

    def _learnt_sigma(self, name: str) -> float | None:
        """Sigma of the last row of a metric that has one."""
        if self.metrics is None:
            return None
        rows = self.metrics.select(["name", "sigma"]).to_pylist()
        known = [row["sigma"] for row in rows if row["name"] == name and row["sigma"] is not None]
        return float(known[-1]) if known else None


def _last_before(crashes: Sequence[tuple[int, int]], zero_ns: int) -> tuple[int, int] | None:
    """The last crash that was over before a time."""
    return max((span for span in crashes if span[1] < zero_ns), default=None)


def noise_of(motion: Motion, zero_ns: int, crashes: Sequence[tuple[int, int]]) -> Array:
    """Sigma of each sample before the impact, vibration included: (3,) m/s^2; 0 where there are too few.

    Another crash is no noise: samples since then count, or those before it where there are hardly any.
    """
    since, until = (zero_ns - round(s * 1e9) for s in _QUIET_S)
    if (earlier := _last_before(crashes, zero_ns)) is not None:
        if until - earlier[1] < round(_LEAST_QUIET_S * 1e9):
            return noise_of(motion, earlier[0], crashes)
        since = max(since, earlier[1])
    part = motion.accel[slice(*np.searchsorted(motion.t_ns, [since, until]))]
    if len(part) < 8:
        return np.zeros(3)
    window = min(max(round(_SMOOTH_S * median_rate(motion.t_ns)), 3), len(part))
    kernel = np.ones(window) / window
    rest = [axis - np.convolve(axis, kernel, mode="same") for axis in (part - part.mean(axis=0)).T]
    inner = slice(window, -window) if len(part) > 4 * window else slice(None)
    sizes = [float(np.std(axis[inner])) for axis in rest]
    return np.asarray(np.array(sizes) * np.sqrt(window / (window - 1.0)))


def _time_sigma(pulse: Pulse, bias: Array, noise: Array) -> float:
    """Of time zero: half a sample, and by how much errors shift the crossing of the threshold, s."""
    change, window_s = _WAKE_UP
    ahead = pulse.accel[pulse.lead : pulse.lead + round(window_s / pulse.step_s) + 1, :2]
    slope = float(np.linalg.norm(ahead[-1] - ahead[0])) if len(ahead) else 0.0
    error = np.hypot(window_s * float(bias[:2].max()), float(noise[:2].max()) * np.sqrt(window_s * pulse.step_s))
    steepest = max(slope, change / window_s)
    return float(np.hypot(pulse.step_s / np.sqrt(12.0), error / steepest))
