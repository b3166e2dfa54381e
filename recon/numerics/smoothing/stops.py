"""Standstills, strictly: motion called a stop is worse than a stop that is missed.

What tells a standstill is how much the means of 0.1 s blocks vary within 1 s. These means leave out the vibration of an
idling engine, which may exceed that of driving, and keep what wheels do to a body: pitch, roll, yaw and heave. A
block is still only if every window of 1 s that holds it is quiet in rotation and in force and if the fixes around are
slow.

The limits come from the drive itself: twice what is usual in windows with slow fixes, and never more than what a body
on wheels exceeds as soon as it rolls. In an outage of GNSS the IMU decides alone, but only where it has proved that it
can: where windows with fast fixes are practically never quiet, as on a smooth ship or train they are, and few of those
that creep steadily in a queue, as in a soft car they are. What is quiet in an outage may also wait for a trajectory
that tells how fast it is there. A receiver that errs does not end a standstill: what is quiet beside one, and not
pushed, stands whatever fixes tell. Without any speed standing and moving must be told apart by more: few windows may be
nearly quiet, and motion must vibrate.

References
    Skog, Haendel, Nilsson, Rantakokko (2010), "Zero-velocity detection - an algorithm evaluation", IEEE T-BME 57(11):
    tests on the variance of force and rate.
    IEEE Std 952, annex C: Allan variance; of white noise of density N it is N^2 / tau.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.moving_window import rolling_std
from recon.numerics.smoothing.samples import Samples
from recon.numerics.smoothing.whole_stops import unmoved, without_creep

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

WINDOW_S: Final = 1.0
"""s in which blocks vary."""
SLOW: Final = 0.4
"""m/s; fixes under it may belong to a standstill, and its limits are learnt there."""
SLOWEST_LIMIT: Final = 0.2
"""m/s; a limit of the speed of a standing receiver is not made tighter."""
HIGHEST_LIMIT: Final = 0.6
"""m/s; a faster fix never belongs to a standstill."""
MOVING: Final = 3.0
"""m/s; fixes over it for a while belong to motion for certain, unless they are outliers."""
LEAST_LIMITS: Final = (np.radians(0.02), 0.005)
"""rad/s, m/s^2; below the noise of boxes in vehicles, for data that are too clean."""
MOST_LIMITS: Final = (np.radians(0.3), 0.3)
"""rad/s, m/s^2; root sum square over the axes. Rolling cars show 0.37 deg/s and more, standing ones 0.05 to 0.25."""
_MEAN_SHARE: Final = 0.5
"""Fixes of a standing receiver are half as fast on average as one alone may be."""
NEAR_S: Final = 1.5
"""s; a fix tells the speed this far to both sides."""
FEWEST: Final = 3.0
"""s of windows from which limits are learnt."""
PROOF_S: Final = 20.0
"""s of certain motion from which it is learnt whether the IMU may decide alone."""
MISTAKEN: Final = 0.005
"""Share of windows in motion that may look quiet where the IMU decides alone."""
CREEPING: Final = 0.15
"""Of quiet windows, by those with slow fixes: how many may have fixes that creep. Outliers alone make 0.1 at most. And
of windows that creep: how many may be quiet."""
CREEP_S: Final = 5.0
STEADY: Final = 1.0
"""s of creeping at speeds within so many m/s, from which it is learnt whether a creeping vehicle is quiet."""


@dataclass(frozen=True)
class Blocks:
    """Means over `size` samples, B of them, one behind the other.

    t_s : (B,) s, middle; measured : (B,) nothing in it is filled or padded
    gyro : (3, B) rad/s, sensor; accel : (3, B) m/s^2, sensor
    vibration : (B,) rad/s, standard deviation of the rotation inside the block, root sum square over the axes
    """

    size: int
    t_s: Floats
    gyro: Floats
    accel: Floats
    vibration: Floats
    measured: Mask

    @property
    def duration(self) -> float:
        """Of one block, s."""
        return float(np.median(np.diff(self.t_s))) if len(self.t_s) > 1 else float("nan")


@dataclass(frozen=True)
class Limits:
    """What a standing vehicle does not exceed.

    gyro : rad/s, accel : m/s^2, root sum square over the axes of the standard deviation of block means in a window
    speed : m/s over ground by GNSS
    alone : the IMU decides where no fix is near
    """

    gyro: float
    accel: float
    speed: float
    alone: bool


@dataclass(frozen=True)
class Stops:
    """Where the vehicle stands: (B,) blocks.

    told : it does, by fixes, or by the IMU of a log without any speed; quiet : these, and those far from any fix, and
        between these and slow ones, that look as quiet
    limits : None where nothing is known to stand
    """

    told: Mask
    quiet: Mask
    limits: Limits | None

    @property
    def alone(self) -> bool:
        """Does the IMU decide where no fix is near?"""
        return self.limits is not None and self.limits.alone

    @property
    def still(self) -> Mask:
        """Where it stands for all that fixes tell and the IMU may decide: (B,)."""
        return self.quiet if self.alone else self.told


@dataclass(frozen=True)
class _Windows:
    """A window of 1 s about each block.

    gyro, accel : (B,) as in `Limits`; vibration : (B,) rad/s of the block; measured : (B,)
    speed : (B,) m/s, NaN where no fix is near
    half : blocks to each side of the middle; fewest : windows in FEWEST seconds
    """

    gyro: Floats
    accel: Floats
    vibration: Floats
    measured: Mask
    speed: Floats
    half: int
    fewest: float

    def quiet(self, gyro: float, accel: float) -> Mask:
        """(B,) is all of the window measured and under the limits?"""
        return self.measured & (self.gyro <= gyro) & (self.accel <= accel)


def block_means(samples: Samples, size: int) -> Blocks:
    """Means of `size` samples each; padding, and samples at the end that fill no block, are left out.

    raises : ValueError if size is not positive
    """
    if size < 1:
        raise ValueError(f"a block needs samples, not {size}")
    logged = int(np.searchsorted(samples.t_s, samples.t_s[-1])) + 1
    count = logged // size
    rows = slice(0, count * size)
    mean = np.full(size, 1.0 / size)  # one product is faster than a mean over a short axis
    rates, forces = (y[rows].T.reshape(3, count, size) for y in (samples.gyro_s, samples.accel_s))
    gyro = rates @ mean
    square = np.einsum("aij,aij->i", rates, rates) / size
    return Blocks(
        size=size,
        t_s=samples.t_s[rows].reshape(count, size).mean(axis=1),
        gyro=gyro,
        accel=forces @ mean,
        vibration=np.sqrt(np.maximum(square - (gyro**2).sum(axis=0), 0.0)),
        measured=np.asarray((samples.row[rows] >= 0).reshape(count, size).all(axis=1)),
    )


def find_stops(blocks: Blocks, fix_t_s: Floats, fix_speed: Floats) -> Stops:
    """Where the vehicle stands.

    fix_t_s : (f,) s, rising; fix_speed : (f,) m/s over ground. Both may be empty
    """
    nothing = np.zeros(len(blocks.t_s), dtype=bool)
    if len(blocks.t_s) < 2 or len(blocks.t_s) * blocks.duration < FEWEST:
        return Stops(nothing, nothing, None)
    windows = _windows(blocks, fix_t_s, fix_speed)
    heard = bool(np.isfinite(windows.speed).any())
    limits = _limits(windows) if heard else _limits_without_speed(windows)
    if limits is None:
        return Stops(nothing, nothing, None)
    quiet = _standing(windows, ~(windows.speed > limits.speed), limits)
    if not heard:
        return Stops(quiet, quiet, limits)
    told = _standing(windows, windows.speed <= limits.speed, limits)
    still = _throughout(windows.quiet(limits.gyro, limits.accel), windows.half)
    told = unmoved(blocks.accel, blocks.duration, told, still, windows.speed)
    return Stops(told, quiet | told, limits)


def _standing(windows: _Windows, allowed: Mask, limits: Limits) -> Mask:
    """Blocks whose windows are all quiet and allowed, and whose fixes do not creep."""
    still = _throughout(windows.quiet(limits.gyro, limits.accel) & allowed, windows.half)
    size = 2 * windows.half * round(CREEP_S / WINDOW_S)
    return without_creep(still, windows.speed, size, _MEAN_SHARE * limits.speed)


def _limits(windows: _Windows) -> Limits | None:
    """Limits by windows with slow fixes, and whether windows with fast ones exceed them."""
    slow = windows.measured & (windows.speed < SLOW)
    if slow.sum() < windows.fewest:
        return None
    gyro, accel = _doubled(windows, slow, 20.0)
    quiet = windows.quiet(gyro, accel)
    if (quiet & slow).sum() < windows.fewest:
        return None
    usual = float(np.median(windows.speed[quiet & slow]))
    if 2.0 * usual > HIGHEST_LIMIT:
        return None  # at its slowest it creeps
    moving = windows.measured & _throughout(windows.speed > MOVING, 2 * windows.half)
    creeping = windows.measured & _throughout(windows.speed > HIGHEST_LIMIT, windows.half)
    steady = creeping & (windows.speed < MOVING) & _steady(windows.speed, 4 * windows.half)
    proved = (
        moving.sum() * FEWEST > PROOF_S * windows.fewest
        and (quiet & moving).sum() <= MISTAKEN * moving.sum()
        and (quiet & creeping).sum() <= CREEPING * (quiet & slow).sum()
        and steady.sum() * FEWEST > CREEP_S * windows.fewest
        and (quiet & steady).sum() <= CREEPING * steady.sum()
    )
    return Limits(gyro, accel, float(np.clip(4.0 * usual, SLOWEST_LIMIT, HIGHEST_LIMIT)), bool(proved))


def _limits_without_speed(windows: _Windows) -> Limits | None:
    """Limits between standing and moving, if hardly a window lies between them and only motion vibrates."""
    if windows.measured.sum() < windows.fewest:
        return None
    gyro, accel = _doubled(windows, windows.measured, 5.0)
    quiet = windows.quiet(gyro, accel)
    moving = windows.measured & ~windows.quiet(2.0 * gyro, 2.0 * accel)
    between = windows.measured & ~quiet & ~moving
    if min(quiet.sum(), moving.sum()) < windows.fewest or between.sum() > 0.2 * quiet.sum():
        return None
    if np.median(windows.vibration[moving]) < 2.0 * np.median(windows.vibration[quiet]):
        return None
    return Limits(gyro, accel, HIGHEST_LIMIT, alone=True)


def _steady(speed: Floats, half: int) -> Mask:
    """(B,) the speed of fixes hardly changes up to `half` blocks away: neither braking nor pulling away."""
    known = np.pad(np.nan_to_num(speed, nan=np.inf), half, mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(known, 2 * half + 1)
    return np.asarray(around.max(axis=1) < around.min(axis=1) + STEADY)


def _doubled(windows: _Windows, chosen: Mask, percent: float) -> tuple[float, float]:
    """Limits of rate and force, twice a percentile of the windows chosen, within sense."""
    usual = (float(np.percentile(values[chosen], percent)) for values in (windows.gyro, windows.accel))
    pairs = zip(usual, LEAST_LIMITS, MOST_LIMITS, strict=True)
    gyro, accel = (min(max(2.0 * value, least), most) for value, least, most in pairs)
    return gyro, accel


def _windows(blocks: Blocks, fix_t_s: Floats, fix_speed: Floats) -> _Windows:
    half = max(1, round(0.5 * WINDOW_S / blocks.duration))
    gyro, accel = (np.sqrt((rolling_std(y.T, 2 * half + 1) ** 2).sum(axis=1)) for y in (blocks.gyro, blocks.accel))
    measured = _throughout(blocks.measured, half)
    speed = _speed_near(blocks.t_s, fix_t_s, fix_speed)
    return _Windows(gyro, accel, blocks.vibration, measured, speed, half, FEWEST / blocks.duration)


def _speed_near(t_s: Floats, fix_t_s: Floats, fix_speed: Floats) -> Floats:
    """Speed between fixes or of the nearest one, NaN where none is near. Arguments as in `find_stops`."""
    known = np.isfinite(fix_speed)
    fix_t_s, fix_speed = fix_t_s[known], fix_speed[known]
    if not len(fix_t_s):
        return np.full(len(t_s), np.nan)
    after = np.clip(np.searchsorted(fix_t_s, t_s), 1, max(len(fix_t_s) - 1, 1))
    before, after = after - 1, np.minimum(after, len(fix_t_s) - 1)
    nearest = np.where(t_s - fix_t_s[before] < fix_t_s[after] - t_s, before, after)
    between = fix_t_s[after] - fix_t_s[before] <= 2.0 * NEAR_S
    speed = np.where(between, np.interp(t_s, fix_t_s, fix_speed), fix_speed[nearest])
    return np.where(np.abs(t_s - fix_t_s[nearest]) <= NEAR_S, speed, np.nan)


def _throughout(mask: Mask, half: int) -> Mask:
    """(n,) True where the mask is True at all places up to `half` away."""
    false = np.concatenate(([0], np.cumsum(~mask)))
    place = np.arange(len(mask))
    first, stop = np.maximum(place - half, 0), np.minimum(place + half + 1, len(mask))
    return np.asarray(false[stop] == false[first])


def still_spans(blocks: Blocks, still: Mask, start_s: Floats, stop_s: Floats) -> Mask:
    """Spans that lie in a standstill: every block that touches them is still. False for those outside the blocks.

    still : (B,); start_s, stop_s : (n,) s, start_s <= stop_s
    """
    if len(blocks.t_s) < 2:
        return np.zeros(len(start_s), dtype=bool)
    # From the middle of a block to its ends, and a sample more: a knot where two blocks meet touches both.
    reach = 0.5 * blocks.duration * (1.0 + 1.5 / blocks.size)
    first = np.searchsorted(blocks.t_s, start_s - reach)
    stop = np.searchsorted(blocks.t_s, stop_s + reach, side="right")
    moving = np.concatenate(([0], np.cumsum(~still)))
    return np.asarray((stop > first) & (moving[stop] == moving[first]))


def still_noise(blocks: Blocks, still: Mask) -> tuple[float | None, float | None]:
    """White noise of gyro and accelerometer, root mean square over the axes, by the Allan variance over 1 s in stops.

    still : (B,)
    returns : rad/s/sqrt(Hz), m/s^2/sqrt(Hz); None where stops hold less than ten pairs of neighbouring seconds
    """
    count = max(1, round(WINDOW_S / blocks.duration)) if len(blocks.t_s) > 1 else 1
    standing = np.concatenate(([0], np.cumsum(still)))
    if len(still) < 2 * count:
        return None, None
    within = standing[2 * count :] - standing[: -2 * count] == 2 * count
    if within.sum() < 10 * count:  # pairs overlap: one begins with every block
        return None, None
    gyro, accel = (_allan_density(y, count, within, count * blocks.duration) for y in (blocks.gyro, blocks.accel))
    return gyro, accel


def _allan_density(y: Floats, count: int, chosen: Mask, tau_s: float) -> float:
    """N = sigma(tau) sqrt(tau) of the overlapping Allan variance of y (3, B) over tau, at the pairs chosen."""
    total = np.concatenate((np.zeros((3, 1)), np.cumsum(y - y[:, :1], axis=1)), axis=1)
    mean = (total[:, count:] - total[:, :-count]) / count
    change = (mean[:, count:] - mean[:, :-count])[:, chosen]
    return float(np.sqrt(0.5 * (change**2).mean() * tau_s))
