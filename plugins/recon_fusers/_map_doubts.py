"""What the result of fuser.map shows of itself that a user must know before he trusts it."""

from __future__ import annotations

from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import Array, Metric, has, seconds, time_ns, vector, warning
from recon.agreement import agreement, as_metrics
from recon.fixes import Observed
from recon.numerics.signals import runs
from recon.numerics.smoothing import Estimate, Noise
from recon.numerics.smoothing.silences import jolts
from recon.numerics.smoothing.state import ACCEL_SCALE, CLOCK, GYRO_SCALE, REAR

_REJECTED: Final = 0.2
"""Share of fixes put aside, beyond which the rest is in doubt, too."""
_MOST_REJECTED: Final = 0.4
"""The same, beyond which it is not to be trusted."""
_LARGE_RESIDUAL: Final = 2.0
"""Root mean square of accepted residuals in sigmas."""
_LARGE_DRIFT: Final = (20.0, 5.0)
"""m, and times what was expected: a slow error of positions that is larger than both is none of a receiver."""
_LARGE_NOISE: Final = {"gyro": 50.0, "accel": 50.0, "gyro_walk": 100.0, "accel_walk": 100.0}
"""Times what was expected of the IMU, beyond which it is the model that does not fit: a rough road makes thirty."""
_LARGE_SCALE: Final = 4.0
"""Sigmas of the class of a sensor, beyond which its scale error is none of that class."""
_MOST_NOISE: Final = 300.0
"""The same of the white noise, beyond which hardly anything is left of what the IMU says."""
_SLIDING: Final = 0.1
"""m/s across the track of the wheels, mean of a second: cars show 0.01 to 0.05, a box that turns in its mount more."""
_SLIDING_MOST: Final = 0.29
"""m/s; the most that is learnt are 0.3, and what the wheels tell is then hardly heard."""
_APART: Final = (3.0, 0.05)
"""Sigmas of the drift of clocks, and s in the whole drive, beyond which it is more than a clock's."""
_JOLT: Final = 6.0
"""Sigmas of what driving does in a silence of the IMU: of a thousand in simulated drives none came to more than 5."""
_STEEP: Final = np.radians(6.0)
"""rad, sigma of the bank of a road; those of real roads come out below 2 deg."""
_FAR: Final = np.array([np.inf, 2.0, 3.0])
"""m, forward, left and up, beyond which the middle of the rear axle is in no vehicle,"""
_SURELY: Final = 3.0
"""if it is by so many sigmas."""
_LEANING: Final = (np.radians(12.0), 60.0)
"""rad and s: a vehicle that leans by more for most of so long behind an impact stands on no road."""
_ASK: Final = "'recon doctor' looks for wrong units, axes, signs and clocks"
_UNSURE_HEADING: Final = np.radians(5.0)
_REVERSING: Final = 7.0
"""m/s; whoever drives faster drives forward."""


def doubts(found: Estimate, observed: Observed, trajectory: pa.Table, gnss: pa.Table, expected: Noise) -> list[Metric]:
    """Warnings, and how the speed of the trajectory compares with that of the receiver. An honest result has none.

    expected : noise before any was estimated
    """
    solved, fixes = found.solved, observed.fixes
    notes = []
    if not solved.converged:
        notes.append(f"the solution has not converged in {solved.steps} steps: do not trust it; {_ASK}")
    if has(gnss, "lat") and not np.isfinite(fixes.pos_sigma[:2]).any():
        notes.append("no GNSS positions: latitude and longitude are 0 or missing in every row, as without a fix")
    notes += _misfit("positions", fixes.pos_sigma, solved.pos_weight, solved.pos_residual, found)
    notes += _misfit("velocities", fixes.vel_sigma, solved.vel_weight, solved.vel_residual, found)
    drift, usual = float(solved.noise.drift[0]), float(observed.drift[0])
    if drift > max(_LARGE_DRIFT[0], _LARGE_DRIFT[1] * usual):
        notes.append(
            f"GNSS positions stray by {drift:.0f} m from where the motion leads, {usual:.1f} m were expected: "
            f"do not trust the positions; are lat and lon right? {_ASK}"
        )
    notes += [*_misfit_of_imu(solved.noise, expected), *_scales(found)]
    notes += [*_apart(found), *_spun(found), *_jolted(found), *_leaning(found)]
    sideways = solved.noise.sideways
    if found.smoother.model.wheels and sideways > _SLIDING:
        verdict = "do not trust" if sideways > _SLIDING_MOST else "take care of"
        notes.append(
            f"the wheels seem to slide sideways by {sideways:.2f} m/s in the mean of a second, where 0.05 "
            f"is much: {verdict} heading and mounting; has the box turned in its mount (then run the parts before "
            "and after by themselves, with --to and --from)? does it roll on wheels?"
        )
    elif found.smoother.model.wheels:
        notes += _loose(found)
    return [*map(warning, notes + _directions(found, trajectory)), *_compared(found, observed, trajectory, gnss)]


def _spun(found: Estimate) -> list[str]:
    """Did it turn faster than the gyroscope tells?"""
    spins = [impact for impact in found.smoother.drive.impacts if impact.turn > 0.0]
    return [
        f"{spin.start_s:.0f} s after the start the gyroscope was at the end of its range for "
        f"{spin.end_s - spin.start_s:.2f} s: it may have turned {np.degrees(2.0 * spin.turn):.0f} deg further, and the "
        "heading behind it is only known as far as motion on wheels tells it"
        for spin in spins
    ]


def _apart(found: Estimate) -> list[str]:
    """Do the clocks run apart by more than clocks do?"""
    drift, usual = float(found.solved.state.common[CLOCK]), found.smoother.model.clock
    lasts_s = float(np.ptp(found.smoother.drive.samples.knot_times))
    if abs(drift) <= _APART[0] * usual or abs(drift) * lasts_s <= _APART[1]:
        return []
    return [
        f"the clocks of IMU and GNSS run apart by {abs(drift) * lasts_s:.2f} s in {lasts_s:.0f} s, "
        f"{1e6 * abs(drift):.0f} ppm, where {1e6 * usual:.0f} are usual: take care; does one of them jump? {_ASK}"
    ]


def _jolted(found: Estimate) -> list[str]:
    """Did the velocity change in a silence of the IMU as it does not in driving?"""
    sigmas = jolts(found)
    if not sigmas.max(initial=0.0) > _JOLT:
        return []
    near = float(found.smoother.drive.samples.knot_times[int(sigmas.argmax())])
    return [
        f"in silences of the imu near {near:.0f} s after the start the velocity changed as it does not in driving: a "
        "crash or a jolt may lie in one of them: do not trust what is told around it"
    ]


def _leaning(found: Estimate) -> list[str]:
    """Does it lean behind an impact, as a vehicle that lies on its side does, or a box that left its mount?"""
    knots, impacts = found.smoother.drive.samples.knot_times, found.smoother.drive.impacts
    up = found.solved.state.rot_vs @ found.solved.state.rot_ns[2]
    notes = []
    for impact in impacts:
        behind = (knots >= impact.end_s) & (knots <= impact.end_s + _LEANING[1])
        axis = np.median(up[:, behind], axis=1)
        lean = float(np.arctan2(np.hypot(*axis[:2]), axis[2]))
        if lean > _LEANING[0]:
            notes.append(
                f"behind the impact {impact.start_s:.0f} s after the start the vehicle leans by {np.degrees(lean):.0f} "
                "deg: unless it lay so, the box left its mount, and what is told of attitude, heading and motion along "
                "and across is that of the box from then on"
            )
    return notes


def _loose(found: Estimate) -> list[str]:
    """Does the vehicle come out as none is, as where its box swings?"""
    state = found.solved.state
    rear = state.rot_vs @ state.common[REAR]
    sigma = np.sqrt(np.diag(state.rot_vs @ found.covariance_common[REAR, REAR] @ state.rot_vs.T))
    off = (np.abs(rear) > _FAR) & (np.abs(rear) > _SURELY * sigma)
    seen = [
        f"the rear axle comes out {abs(rear[axis]):.1f} m {sides[0] if rear[axis] > 0.0 else sides[1]} the box"
        for axis, sides in ((1, ("to the left of", "to the right of")), (2, ("above", "below")))
        if off[axis]
    ]
    bank = found.solved.noise.bank
    seen += [f"the road banks by {np.degrees(bank):.0f} deg in the mean"] if bank > _STEEP else []
    if not seen:
        return []
    return [
        f"{' and '.join(seen)}, as of a box that is loose in the vehicle: do not trust the heading, nor what is told "
        "along and across; fix it, or run a part of the drive in which it stayed, with --from and --to"
    ]


def contradiction(noise: Noise, expected: Noise) -> tuple[str, float]:
    """Which noise of the IMU comes out larger than any is, and how many times what was expected; "" where none does."""
    sizes = {name: getattr(noise, name) / getattr(expected, name) for name in _LARGE_NOISE}
    worst = max(sizes, key=lambda name: sizes[name] / _LARGE_NOISE[name])
    return (worst, sizes[worst]) if sizes[worst] > _LARGE_NOISE[worst] else ("", 0.0)


def _misfit_of_imu(noise: Noise, expected: Noise) -> list[str]:
    """Does the IMU contradict the motion by more than any noise explains?"""
    worst, times = contradiction(noise, expected)
    if not worst:
        return []
    sensor = worst.split("_")[0]
    walks = worst.endswith("walk")
    what = "random walk of the bias" if walks else "noise"
    verdict = "take care" if walks or times < _MOST_NOISE else "do not trust the result"
    return [
        f"{sensor} and GNSS contradict each other: the {what} comes out {times:.0f} times what was expected: "
        f"{verdict}; does it roll on wheels? {_ASK}"
    ]


def _scales(found: Estimate) -> list[str]:
    """Does a scale error come out as no sensor of its class has one?"""
    model, state = found.smoother.model, found.solved.state
    notes = []
    for sensor, part, usual in (("accel", ACCEL_SCALE, model.accel_scale), ("gyro", GYRO_SCALE, model.gyro_scale)):
        worst = float(np.abs(state.common[part]).max())
        if worst > _LARGE_SCALE * usual > 0.0:
            notes.append(
                f"the scale of {sensor} comes out {worst:.1%} off, where {usual:.1%} is the sigma of its class: the "
                f"intervals are too small; is its range or its unit another? else --set fuser.map.{sensor}_scale="
                f"'{100.0 * worst:.1f} %' makes them larger"
            )
    return notes


def _misfit(name: str, sigma: Array, weight: Array, residual: Array, found: Estimate) -> list[str]:
    """Of one kind of measurement: sigma (3, m) of the fixes, weight (E,) and residual (3, E) at the epochs."""
    epochs = found.solved.epochs
    finite = np.isfinite(sigma[:, epochs.fix]) & (epochs.fix >= 0)
    seen = finite.any(axis=0)
    if not seen.any():
        return []
    notes = []
    share = float((weight[seen] < 0.5).mean())
    if share > _REJECTED:
        verdict = "do not trust the result" if share > _MOST_REJECTED else "take care"
        notes.append(
            f"{share:.0%} of the GNSS {name} do not fit the IMU and were put aside: {verdict}; "
            "check units, axes and clocks"
        )
    good = finite & (weight > 0.5)
    size = float(np.sqrt((residual[good] ** 2).mean())) if good.any() else 0.0
    if size > _LARGE_RESIDUAL:
        notes.append(f"GNSS {name} miss the trajectory by {size:.1f} of their sigmas: the sigmas are too small")
    return notes


def _directions(found: Estimate, trajectory: pa.Table) -> list[str]:
    """Is the heading known, and which end of the vehicle is in front?"""
    notes = []
    heading = np.degrees(float(np.median(vector(trajectory, "att_std_yaw"))))
    if heading > np.degrees(_UNSURE_HEADING):
        known = f"only known to {heading:.0f} deg" if heading < 90.0 else "unknown"
        notes.append(f"the heading is {known}: there is hardly any motion on wheels to tell it")
    else:
        notes += _unsure_part(trajectory)
    fastest = float(np.sqrt((found.solved.state.vel_n**2).sum(axis=0)).max())
    if found.smoother.model.mounting is None and fastest < _REVERSING:
        notes.append(
            f"it moves at {fastest:.1f} m/s at most, so it may all be in reverse: which end is in front is a guess; "
            "give the parameter mounting"
        )
    return notes


def _unsure_part(trajectory: pa.Table) -> list[str]:
    """Where is a heading that is known elsewhere not? The longest such part."""
    sigma = vector(trajectory, "att_std_yaw")
    unsure = sigma > _UNSURE_HEADING
    if not unsure.any():
        return []
    first, stop = max(runs(unsure), key=lambda part: part[1] - part[0])
    t_s, worst = seconds(trajectory), min(float(np.degrees(sigma[first:stop].max())), 180.0)
    return [
        f"from {t_s[first]:.0f} to {t_s[stop - 1]:.0f} s the heading is hardly known: its sigma of {worst:.0f} deg may "
        "be too small, and those of the motion there, too; the IMU was silent, or too little motion tells the heading"
    ]


def _compared(found: Estimate, observed: Observed, trajectory: pa.Table, gnss: pa.Table) -> list[Metric]:
    """The speed of the trajectory and that of the receiver, but for fixes put aside where these are few."""
    if not has(gnss, "speed"):
        return []
    told = np.array(vector(gnss, "speed", gaps=True))
    aside = _put_aside(found)
    if len(aside) <= _REJECTED * len(observed.row):
        told[observed.row[aside]] = np.nan
    speed = np.hypot(vector(trajectory, "vel_e"), vector(trajectory, "vel_n"))
    apart = agreement(time_ns(trajectory), speed, time_ns(gnss), told)
    return as_metrics(apart, "the speed of the trajectory", "gnss speed")


def _put_aside(found: Estimate) -> NDArray[np.intp]:
    """Fixes whose velocity is not believed."""
    epochs = found.solved.epochs
    return np.asarray(epochs.fix[(epochs.fix >= 0) & (found.solved.vel_weight < 0.5)])
