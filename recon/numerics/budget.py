"""What errors of an impact's acceleration do to the numbers that are read from it: propagation of uncertainty.

    sigma^2 = sum over sources of ((f(x + s) - f(x - s)) / 2)^2 + var(f(x + noise))

Each systematic source - a bias, a scale error, a tilt of the mounting, a turn rate, a lever arm, a time - is moved up
and down by its sigma, and all numbers are computed anew; white noise is drawn so often that its sigma is known to a
tenth. A maximum of a noisy signal is too large by what the noise adds on average, by which the interval of 95 % is
moved.

Scale errors belong to the axes of the box: one that is turned in the vehicle spreads them over both of its directions,
and mistakes one for the other by half of their difference. A drive tells them together with the mounting, often their
sum better than either, so they are moved together, along the columns of a root of their covariance:

    a_found - a = (R diag(s) R^T - [t]x) a,    (s, t) ~ N(0, C)

with R from box to vehicle, scale errors s and the turn t that is missing in R.

References
    JCGM 100:2008 (GUM), section 5.1 and note 2 to 5.1.3 (differences in place of derivatives); JCGM 101:2008 (noise).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Measures = Callable[[Floats, Floats], Mapping[str, Floats]]
"""From accelerations (b, n, 3) and yaw rates (b, n) to numbers (b,), angles among them in degrees."""

NORMAL_95: Final = 1.959964
"""Sigmas to either side that hold 95 % of a normal distribution."""
_DRAWS: Final = 48
"""Pulses with noise of their own, from which what noise does is told."""
_FINE_S: Final = 1e-3
"""Longest step that maxima are looked for in."""
_LEAST_SPLINE: Final = 4
"""Samples of a cubic spline."""
_PLAIN: Final = 0.5
"""Of sigma: a shift by noise beyond this is more than the chance of the draws."""
_NOTHING_BUT_NOISE: Final = 1.0 + np.sqrt(2.0)
"""Drawing noise on a signal that is nothing but noise raises its maximum by (sqrt(2) - 1) of what it has too much."""


@dataclass(frozen=True)
class Pulse:
    """The motion about an impact in vehicle axes, regularly sampled.

    accel : (n, 3) m/s^2, gravity removed; gyro : (n, 3) rad/s; step_s : s
    lead : number of samples before time zero
    clipped : (v, n, 3) m/s^2, other courses of what clipping cut off, less the one in accel; none where nothing was
    restored : (j, n, 3) m/s^2, one sigma each of what accel has in place of that; none where it is as recorded
    """

    accel: Floats
    gyro: Floats
    step_s: float
    lead: int
    clipped: Floats
    restored: Floats


@dataclass(frozen=True)
class Doubt:
    """Sigmas of what may be wrong with a pulse.

    bias : (3,) m/s^2, vehicle, of what is constant through the impact
    axes : (6, 6) covariance of the scale errors of the box's axes, 1, and of the turn of the box about the vehicle's x,
        y, z, rad; box : (3, 3) takes the box's axes to the vehicle's
    gyro_bias : rad/s; gyro_scale : 1; lever : (3,) m; time : s, of time zero; noise : (3,) m/s^2 of each sample
    """

    bias: Floats
    axes: Floats
    box: Floats
    gyro_bias: float
    gyro_scale: float
    lever: Floats
    time: float
    noise: Floats


@dataclass(frozen=True)
class Uncertain:
    """A number with what is known of it: sigma, the interval (low, high) of 95 %, shares : sigma by source.

    clipped : what clipping cut off is in the interval
    """

    value: float
    sigma: float
    low: float
    high: float
    shares: Mapping[str, float]
    clipped: bool


def propagate(pulse: Pulse, doubt: Doubt, measures: Measures, angles: tuple[str, ...] = ()) -> dict[str, Uncertain]:
    """Every number of `measures` with its uncertainty; NaN where the nominal pulse does not have it.

    angles : names of those in degrees that go round
    """
    moved = _moved(pulse, doubt)
    names = [name for name, _ in moved]
    noise = np.random.default_rng(0).standard_normal((_DRAWS, *pulse.accel.shape)) * doubt.noise
    others = pulse.accel + pulse.clipped
    accel = np.concatenate([pulse.accel[None], others, [p.accel for _, p in moved], pulse.accel + noise])
    same = [pulse.gyro[:, 2]]
    yaw = np.stack([*same * (1 + len(others)), *(p.gyro[:, 2] for _, p in moved), *same * _DRAWS])
    found = measures(accel, yaw)
    return {name: _one(values, names, name in angles, len(others)) for name, values in found.items()}


def _one(values: Floats, names: list[str], angle: bool, courses: int) -> Uncertain:
    """From the values of all variants: nominal, other courses of what was clipped, pairs by source, draws of noise."""
    nominal = float(values[0])
    off = values - nominal
    if angle:
        off = (off + 180.0) % 360.0 - 180.0
    off = np.where(np.isfinite(off), off, 0.0)
    variance: dict[str, float] = {}
    clipped, moved, drawn = np.split(off[1:], [courses, courses + len(names)])
    for i, name in enumerate(names[::2]):
        variance[name] = variance.get(name, 0.0) + float((moved[2 * i] - moved[2 * i + 1]) ** 2) / 4.0
    variance["noise"] = float(drawn.var(ddof=1))
    sigma = float(np.sqrt(sum(variance.values())))
    shift, below, above = float(drawn.mean()), float(clipped.min(initial=0.0)), float(clipped.max(initial=0.0))
    shifts = (shift, _NOTHING_BUT_NOISE * shift) if abs(shift) > _PLAIN * sigma else (shift, shift)
    low = min(nominal - max(shifts) - NORMAL_95 * sigma + below, nominal)
    high = max(nominal - min(shifts) + NORMAL_95 * sigma + above, nominal)
    shares = {name: float(np.sqrt(v)) for name, v in variance.items()}
    if above > below:
        shares["clipping"] = (above - below) / np.sqrt(12.0)
        sigma = float(np.hypot(sigma, shares["clipping"]))
    return Uncertain(nominal, sigma, low, high, shares, above > below or "restoring" in shares)


def _moved(pulse: Pulse, doubt: Doubt) -> list[tuple[str, Pulse]]:
    """The pulse with each source at plus and minus its sigma, in pairs."""
    found: list[tuple[str, Pulse]] = []

    def pair(name: str, accel: Floats, gyro: Floats | None = None) -> None:
        turn = np.zeros_like(pulse.gyro) if gyro is None else gyro
        found.extend(
            (name, replace(pulse, accel=pulse.accel + sign * accel, gyro=pulse.gyro + sign * turn))
            for sign in (1.0, -1.0)
        )

    still, up = np.zeros_like(pulse.accel), np.array([0.0, 0.0, 1.0])
    for axis in np.eye(3):
        pair("bias", still + doubt.bias * axis)
        if doubt.lever.any():
            pair("lever arm", swing(pulse.gyro, doubt.lever * axis, pulse.step_s))
    for name, matrices in axes_errors(doubt.axes, doubt.box).items():
        for matrix in matrices:
            pair(name, pulse.accel @ matrix.T)
    for one_sigma in pulse.restored:
        pair("restoring", one_sigma)
    pair("gyro", still, still + doubt.gyro_bias * up)
    pair("gyro", still, doubt.gyro_scale * pulse.gyro)
    for sign in (1.0, -1.0):
        early = shifted(pulse.accel, sign * doubt.time / pulse.step_s)
        found.append(("timing", replace(pulse, accel=early)))
    return found


def axes_errors(covariance: Floats, box: Floats) -> dict[str, Floats]:
    """What one sigma of each independent part does to an acceleration in vehicle axes: (3, 3, 3) to multiply it by.

    `scale` are the scale errors with the turns that go along with them, `alignment` the turns that they leave open.

    covariance, box : as in Doubt
    """
    values, vectors = np.linalg.eigh(covariance)
    half = vectors * np.sqrt(np.maximum(values, 0.0))
    _, upper = np.linalg.qr(half.T)
    root = upper.T  # as Cholesky's, which a sigma of nought has not
    scaled = np.einsum("ij,jk,lj->kil", box, root[:3], box)
    turned = np.cross(np.eye(3)[None], root[3:].T[:, None, :]).swapaxes(1, 2)
    moved = scaled + turned
    return {"scale": moved[:3], "alignment": moved[3:]}


def fineness(step_s: float) -> int:
    """Into how many steps one of a pulse is cut before numbers are read from it."""
    return max(int(np.ceil(step_s / _FINE_S - 1e-6)), 1)


def refined(y: Floats, times: int) -> Floats:
    """Cubic splines through regular samples (b, n, ...), with each step cut: (b, times (n - 1) + 1, ...).

    Trapezoids through ten samples lose a hundredth of a mean over the middle of a pulse and land between two samples;
    what errs in a sample errs around it alike, so errors are drawn before.
    """
    n = y.shape[1]
    return y if times == 1 else _spline(y, np.arange(times * (n - 1) + 1) / times, axis=1)


def shifted(y: Floats, steps: float) -> Floats:
    """Regular samples (n, ...) as they would be if all had been taken some part of a step later; the ends stay."""
    return _spline(y, np.clip(np.arange(len(y)) + steps, 0.0, len(y) - 1.0), axis=0)


def _spline(y: Floats, at: Floats, axis: int) -> Floats:
    """Cubic spline through samples one apart, at other places."""
    if y.shape[axis] < _LEAST_SPLINE:
        return np.asarray(np.take(y, np.rint(at).astype(np.intp), axis))
    from scipy.interpolate import CubicSpline  # slow import: only when used

    return np.asarray(CubicSpline(np.arange(y.shape[axis]), y, axis=axis)(at))


def swing(gyro: Floats, lever: Floats, step_s: float) -> Floats:
    """Acceleration of a point at a lever arm (3,) m relative to the origin of a turning body: (n, 3) m/s^2, its axes.

        omega' x r + omega x (omega x r)

    gyro : (n, 3) rad/s, regularly sampled
    """
    rate = np.gradient(gyro, step_s, axis=0) if len(gyro) > 1 else np.zeros_like(gyro)
    return np.asarray(np.cross(rate, lever) + np.cross(gyro, np.cross(gyro, lever)))
