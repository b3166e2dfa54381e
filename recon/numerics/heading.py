"""Heading of a levelled sensor: by the changes of velocity that GNSS shows, and by a magnetometer, smoothed over time.

A gyroscope and an accelerometer give the attitude q_ls of a sensor in a level frame l whose z points up and whose x
axis points anywhere, and drifts. What is left is the angle delta(t) by which l is turned about up against
East-North-Up.
Two kinds of evidence tell it, as complex numbers whose phase is delta and whose size says how much they are worth:

    course           z = dv_n conj(dv_l)         change of the horizontal velocity over a second, by GNSS and by the box
    magnetometer     z = h_n conj(h_l)           horizontal field, by the model of the Earth and as measured

East is the real, north the imaginary axis. The course needs no knowledge of how the sensor sits in the vehicle, but
changes of velocity: bends, braking, speeding up. What lasts of these for half a minute is taken off both: a filter
takes a steady acceleration for a tilt, and feels the opposite when it is over. The smoothed angle is the one that makes
the sum over seconds k of

    w_k (angle of z_k - delta_k)^2 + (second difference of delta)_k^2 / rho^2

least: its rate may wander slowly, as the bias of a gyroscope does. Residuals beyond two sigma count less (Huber).

References
    Whittaker (1923), "On a new method of graduation", Proc. Edinburgh Math. Soc. 41, 63-75.
    Huber (1964), "Robust estimation of a location parameter", Annals of Math. Statistics 35(1), 73-101.
    Gebre-Egziabher et al. (2006), "Calibration of strapdown magnetometers in magnetic field domain", J. Aerospace
    Engineering 19(2), 87-102: what hard and soft iron do.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon.numerics.moving_window import moving_average
from recon.numerics.rotation import Floats, rotate

Complexes = NDArray[np.complex128]

_HUBER = 2.0
"""Sigmas from which a misfit counts less than its square."""
_ROUNDS = 6
_SETTLED = 1e-5
"""rad, below which another round of weights changes nothing that matters."""
_ROUGH_S = 60.0
"""Seconds over which evidence is summed for a first guess of the angle."""
_FASTEST = np.radians(3.0)
"""rad/s, bias of a gyroscope about the vertical."""
_SHORTEST_S, _LONGEST_S = 0.5, 2.5
"""Time between two fixes whose difference is used."""
_TURN_S = 30.0
"""Within that a vehicle makes its bends, and a level frame does not drift."""
_IRON_HZ = 2.0
"""Samples a second that suffice to see a bend."""
_HORIZONTAL_T, _VERTICAL_T, _PRIOR_T = 2e-6, 4e-6, 1e-3
"""Sigmas in T: of the horizontal field, of the vertical one, whose error lasts, and of hard iron beforehand."""


class HardIron(NamedTuple):
    """Constant field that turns with a magnetometer: (3,) T, sensor, and its covariance (3, 3) T^2."""

    offset_s: Floats
    covariance: Floats


def horizontal(vector: Floats) -> Complexes:
    """East + i north: (n,) of (n, 3)."""
    return np.asarray(vector[:, 0] + 1j * vector[:, 1])


def smooth_angle(evidence: Complexes, wander: float) -> tuple[Floats, Floats]:
    """The angle that evidence of it, second by second, shows together.

    evidence : (n,) its phase is the angle, its size the inverse variance 1/rad^2; 0 where there is none
    wander : rho, rad/s^1.5, by which the rate of the angle wanders
    returns : angle (n,) rad, not wrapped, and its sigma (n,) rad, inf where there is no evidence at all
    """
    weight = np.abs(evidence)
    if not weight.any():
        return np.zeros(len(weight)), np.full(len(weight), np.inf)
    angle = _rough(evidence)
    kept = weight
    for _ in range(_ROUNDS):
        residual = np.angle(evidence * np.exp(-1j * angle))
        size = np.abs(residual) * np.sqrt(weight)
        kept = weight * np.minimum(1.0, _HUBER / np.maximum(size, 1e-12))
        before, angle = angle, _whittaker(kept, angle + residual, 1.0 / wander**2)
        if np.abs(angle - before).max() < _SETTLED:
            break
    return angle, _sigma(kept, wander)


def _rough(evidence: Complexes) -> Floats:
    """Phase of the evidence within about a minute, unwrapped: (n,) rad.

    First the rate at which it turns as a whole, the bias of the gyroscope, is taken out: it may go round in a minute.
    """
    width = int(_ROUGH_S) | 1
    turning = _rate(evidence, width) * np.arange(len(evidence))
    slow = evidence * np.exp(-1j * turning)
    total = np.convolve(slow, np.hanning(width + 2)[1:-1], mode="full")[width // 2 :][: len(evidence)]
    known = np.flatnonzero(np.abs(total) > 0.0)
    return turning + np.interp(np.arange(len(total)), known, np.unwrap(np.angle(total[known])))


def _rate(evidence: Complexes, width: int) -> float:
    """The rate in rad/s, among those of biased gyroscopes, at which the evidence of two minutes turns most evenly."""
    rates = np.arange(-_FASTEST, _FASTEST + 1e-9, 0.25 / width)
    padded = np.concatenate((evidence, np.zeros(-len(evidence) % (2 * width), dtype=np.complex128)))
    parts = padded.reshape(-1, 2 * width)
    turned = parts @ np.exp(-1j * np.outer(np.arange(2 * width), rates))
    return float(rates[np.abs(turned).sum(axis=0).argmax()])


def _whittaker(weight: Floats, value: Floats, stiffness: float) -> Floats:
    """The y that makes sum weight (y - value)^2 + stiffness (second difference of y)^2 least: (n,)."""
    from scipy.linalg import solveh_banded  # slow import: only when used

    n = len(weight)
    weight = weight + 1e-9 * weight.max()
    if n < 3:
        return np.full(n, float(weight @ value) / float(weight.sum()))
    bands = np.zeros((3, n))
    for offset, parts in enumerate(((1.0, 4.0, 1.0), (-2.0, -2.0), (1.0,))):
        for shift, part in enumerate(parts):
            bands[offset, shift : shift + n - 2] += stiffness * part
    bands[0] += weight
    usual = value[int(weight.argmax())]  # taken off, so that a constant comes back to the last digit
    return np.asarray(usual + solveh_banded(bands, weight * (value - usual), lower=True))


def _sigma(weight: Floats, wander: float) -> Floats:
    """Sigma (n,) rad where the weight were everywhere as it is on average within a minute and a half.

    The spectrum of what is left is 1 / (w + omega^4 / rho^2), its integral a / (2 sqrt(2) w), a^4 = w rho^2.
    """
    near = np.maximum(moving_average(weight, 91), 1e-12)
    return np.asarray(np.sqrt((near * wander**2) ** 0.25 / (2.0**1.5 * near)))


def course_evidence(
    t_s: Floats, change_l: Complexes, fix_s: Floats, vel_n: Complexes, sigma: float, seconds: int
) -> Complexes:
    """Evidence of the angle from level frame to East-North-Up by changes of velocity between fixes.

    t_s : (m,) s; change_l : (m,) m/s, integral of the horizontal specific force in the level frame up to then
    fix_s : (k,) s, strictly increasing; vel_n : (k,) m/s, east + i north
    sigma : m/s, of a change of velocity, what an imperfect levelling adds in a second included
    seconds : how many of them the result has
    returns : (seconds,) 1/rad^2, second j from j to j + 1
    """
    result = np.zeros(seconds, dtype=np.complex128)
    inside = (fix_s >= t_s[0]) & (fix_s <= t_s[-1]) & np.isfinite(vel_n)
    fix_s, vel_n = fix_s[inside], vel_n[inside]
    apart = np.append(True, np.diff(np.floor(fix_s + 1e-6)) > 0.0) if len(fix_s) else np.zeros(0, dtype=bool)
    fix_s, vel_n = fix_s[apart], vel_n[apart]
    if len(fix_s) < 2:
        return result
    seen_l = np.interp(fix_s, t_s, change_l.real) + 1j * np.interp(fix_s, t_s, change_l.imag)
    span = np.diff(fix_s)
    close = (span >= _SHORTEST_S) & (span <= _LONGEST_S)
    span, told, felt = span[close], np.diff(vel_n)[close], np.diff(seen_l)[close]
    found = _without_lasting(told, span) * np.conj(_without_lasting(felt, span)) / (sigma * np.maximum(span, 1.0)) ** 2
    middle = np.clip(np.floor(0.5 * (fix_s[1:] + fix_s[:-1])).astype(np.intp), 0, seconds - 1)
    np.add.at(result, middle[close], found)
    return result


def _without_lasting(change: Complexes, span: Floats) -> Complexes:
    """Changes of velocity over spans of s less what lasts for half a minute, which levels the sensor wrongly."""
    width = max(3, round(_TURN_S / float(np.median(span)))) | 1 if len(span) else 1
    rate = change / span
    return np.asarray(span * (rate - moving_average(rate.real, width) - 1j * moving_average(rate.imag, width)))


def field_evidence(t_s: Floats, field_l: Complexes, north: complex, sigma: float, seconds: int) -> Complexes:
    """Evidence of the angle by the horizontal field: means over the seconds, each worth 1 / sigma^2.

    t_s : (m,) s; field_l : (m,) T in the level frame, NaN where it is not to be believed
    north : T, east + i north, horizontal field of the Earth; sigma : rad
    returns : (seconds,) 1/rad^2
    """
    result = np.zeros(seconds, dtype=np.complex128)
    known = np.isfinite(field_l) & (np.abs(field_l) > 0.0)
    second = np.clip(np.floor(t_s[known]).astype(np.intp), 0, seconds - 1)
    direction = north * np.conj(field_l[known])
    np.add.at(result, second, direction / np.abs(direction))
    count = np.bincount(second, minlength=seconds)
    return result / np.maximum(count, 1) / sigma**2


def hard_iron(q_ls: Floats, field_s: Floats, rate_hz: float, vertical: float | None) -> HardIron:
    """The constant field of what turns with the box, from how the measured field turns with it in a level frame.

    Seen from the level frame the Earth's field stands still but for the slow drift of that frame, and what belongs to
    the box goes round with it. So after the mean of half a minute about each sample is taken off,

        horizontal of R_ls m  =  horizontal of R_ls b  +  noise,

    and, where the model of the Earth tells the vertical field, vertical of R_ls (m - b) = vertical + noise. Solved for
    b by least squares with Huber's weights. A drive without bends leaves b unknown, which the covariance shows.

    q_ls : (n, 4); field_s : (n, 3) T, sensor; rate_hz : of the samples, about regular
    vertical : T, positive up, or None
    """
    every = max(1, round(rate_hz / _IRON_HZ))
    q_ls, field_s, rate_hz = q_ls[::every], field_s[::every], rate_hz / every
    axes_l = np.stack([rotate(q_ls, axis) for axis in np.eye(3)], axis=2)
    field_l = rotate(q_ls, field_s)
    window = max(3, round(_TURN_S * rate_hz)) | 1
    rows = [axes_l[:, axis] - moving_average(axes_l[:, axis], window) for axis in (0, 1)]
    values = [field_l[:, axis] - moving_average(field_l[:, axis], window) for axis in (0, 1)]
    sigmas = [np.full(len(field_l), _HORIZONTAL_T)] * 2
    if vertical is not None:
        rows.append(axes_l[:, 2])
        values.append(field_l[:, 2] - vertical)
        sigmas.append(np.full(len(field_l), _VERTICAL_T))
    # neighbours in time tell the same: as many samples count as there are seconds
    independent = min(1.0, 1.0 / rate_hz)
    sigma = np.concatenate(sigmas) / np.sqrt(independent)
    return _robust(np.concatenate(rows), np.concatenate(values), sigma)


def _robust(rows: Floats, values: Floats, sigma: Floats) -> HardIron:
    """Least squares with Huber's weights and a weak prior; covariance of noise as large as the residuals are."""
    weight = 1.0 / sigma**2
    offset: Floats = np.zeros(3)
    information: Floats = np.eye(3)
    for _ in range(_ROUNDS):
        weighted = rows * weight[:, None]
        information = rows.T @ weighted + np.eye(3) / _PRIOR_T**2
        offset = np.asarray(np.linalg.solve(information, weighted.T @ values))
        size = np.abs(values - rows @ offset) / sigma
        weight = np.minimum(1.0, _HUBER / np.maximum(size, 1e-12)) / sigma**2
    return HardIron(offset, np.asarray(np.linalg.inv(information)))
