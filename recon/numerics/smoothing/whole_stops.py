"""Standstills as a whole: a vehicle that creeps throughout does not stand; one that stands does so until it is pushed.

Beside reflecting walls a receiver may tell a speed for many seconds. Inside a standstill, with the IMU at rest, that is
the receiver's error: to move, the vehicle must have been pushed (Newton's first law), and a push shows in the force,
whose rest, tilt and bias included, the standstill itself tells.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from recon.numerics.signals import runs

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_KNOWN_S: Final = 5.0
"""s of a standstill at least that tell its force, """
_FAR_S: Final = 120.0
"""s at most, and for how long it stays so."""
_GAINED: Final = 0.1
"""m/s by which what the force gives may be wrong, or else"""
_SHARE: Final = 1.0 / 3.0
"""of the speed that fixes tell, so that they contradict it."""


def without_creep(still: Mask, speed: Floats, size: int, most: float) -> Mask:
    """Standstills whose fixes are slow on average, and of others what is so throughout `size` blocks: (B,).

    A receiver may begin to err while the vehicle stands.

    still : (B,); speed : (B,) m/s, as fixes tell it, NaN where none is near; most : m/s
    """
    standing = still.copy()
    for first, stop in runs(still):
        told = speed[first:stop]
        if np.isfinite(told).any() and float(np.nanmean(told)) > most:
            standing[first:stop] = _all_below(told, size, most)
    return standing


def _all_below(speed: Floats, size: int, most: float) -> Mask:
    """(n,) where every mean of `size` neighbours is known and at most so high."""
    if len(speed) < size:
        return np.zeros(len(speed), dtype=bool)
    above = ~(sliding_window_view(speed, size).mean(axis=1) <= most)
    return np.asarray(np.convolve(above, np.ones(size)) < 0.5)


def unmoved(accel: Floats, duration: float, told: Mask, quiet: Mask, speed: Floats) -> Mask:
    """Where a standstill goes on, before and behind, whatever fixes tell, for it is quiet and not pushed: (B,).

    Far from any fix nothing is added: there the trajectory tells.

    accel : (3, B) m/s^2, means of blocks of `duration` s; told : (B,) stands for certain; quiet : (B,) looks as if
    speed : (B,) m/s, as fixes tell it, NaN where none is near
    """
    stands = told.copy()
    far, least = round(_FAR_S / duration), round(_KNOWN_S / duration)
    for first, stop in runs(quiet):
        for start, end in first + runs(told[first:stop]):
            if end - start >= least:
                behind = slice(max(start, end - far), min(stop, end + far))
                stands[end : end + _rest(accel[:, behind], speed[behind], end - behind.start, duration)] = True
                before = slice(max(first, start - far), min(end, start + far))
                turned = accel[:, before][:, ::-1], speed[before][::-1]
                stands[start - _rest(*turned, before.stop - start, duration) : start] = True
    return stands


def _rest(accel: Floats, speed: Floats, told: int, duration: float) -> int:
    """How many blocks a standstill lasts on, of which the first ones are told, until it is pushed.

    The slower half of what is told tells its force. A steady push that began in it is known by the speed that rises.
    """
    slower = speed[:told] <= np.median(speed[:told])
    push = accel[:, told:] - accel[:, :told][:, slower].mean(axis=1, keepdims=True)
    gained = np.linalg.norm(np.cumsum(push, axis=1), axis=0) * duration
    gained += _rise(speed[:told], duration) * duration * np.arange(1, len(gained) + 1)
    moves = ~(gained < np.maximum(_SHARE * speed[told:], _GAINED))  # or nobody knows its speed
    return int(np.argmax(moves)) if moves.any() else len(moves)


def _rise(speed: Floats, duration: float) -> float:
    """m/s^2 by which speeds rise or fall at most, by least squares and two sigmas, as if one came each second."""
    t_s = (np.arange(len(speed)) - 0.5 * (len(speed) - 1)) * duration
    squares = float(t_s @ t_s)
    slope = float(t_s @ speed) / squares
    left = speed - speed.mean() - slope * t_s
    return abs(slope) + 2.0 * float(np.sqrt((left @ left) / len(speed) / (squares * duration)))
