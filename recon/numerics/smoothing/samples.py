"""The samples of a log on a grid of intervals: every interval has the same number of steps, so intervals are a reshape.

Steps keep the times of the log, jitter and drifting rates included. Only what a reshape cannot carry is changed: gaps
are bridged by further samples, and the last interval is padded with steps of no length. A gap of more than an interval
gets an interval of its own, the one before it padded, lest what is not known of the gap is spread over what was logged.
Likewise an impact, whose errors are of another size: knots stand where it begins and where it ends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain, pairwise

import numpy as np
from numpy.typing import NDArray

from recon.numerics.smoothing.soa import Floats

GAP_S = 0.1
GAP_STEPS = 3.5
"""A step longer than both, the second in median steps, is a gap."""

LONG_GAP_S = 10.0
"""Nothing that was measured at the ends of a longer gap says how the box turned inside."""

_FEWEST_STEPS = 10
_FINE_RATE_HZ = 50.0
_LEAST_FILL = 0.1
_FEWEST_CUT = 4
"""Steps between two cuts."""


@dataclass(frozen=True)
class Samples:
    """The samples of a drive, n = K m steps in K intervals of m; every m-th sample is a knot.

    t_s : (n+1,) s, not decreasing; equal only where padded
    gyro_s : (n+1, 3) rad/s, sensor
    accel_s : (n+1, 3) m/s^2, sensor, specific force
    filled : (n,), steps that bridge a gap of the log
    row : (n+1,), row of the log, -1 where a sample was filled in or padded
    per_interval : m, even
    """

    t_s: Floats
    gyro_s: Floats
    accel_s: Floats
    filled: NDArray[np.bool_]
    row: NDArray[np.int64]
    per_interval: int

    @property
    def intervals(self) -> int:
        """Number of intervals, K; knots are one more."""
        return len(self.filled) // self.per_interval

    @property
    def knot_times(self) -> Floats:
        """Times of the knots: (K+1,) s."""
        return self.t_s[:: self.per_interval]


def regular_samples(
    t_s: Floats, gyro_s: Floats, accel_s: Floats, knot_s: float = 2.0, cuts_s: tuple[float, ...] = ()
) -> Samples:
    """The log in intervals of about `knot_s`, gaps bridged.

    A gap is bridged by samples at the nominal rate, interpolated. One longer than an interval is bridged by an interval
    of longer steps, in more than 10 s at rest on the mean specific force of both ends. The last interval before it and
    that of the log are padded by repeating the last sample at its time; a rest of less than a tenth of an interval is
    dropped instead.

    t_s : (N,) s, strictly increasing
    gyro_s : (N, 3) rad/s, sensor
    accel_s : (N, 3) m/s^2, sensor
    cuts_s : s, at whose nearest samples there are to be knots
    raises : ValueError if the times do not increase, or fill less than two intervals
    """
    step = np.diff(t_s)
    if not np.all(step > 0.0):
        raise ValueError("times of samples must strictly increase")
    if len(step) < _FEWEST_STEPS:
        raise ValueError(f"{len(t_s)} samples are too few to smooth: two intervals of {_FEWEST_STEPS} steps are needed")
    nominal = float(np.median(step))
    m = _steps_per_interval(1.0 / nominal, knot_s)
    log = Samples(t_s, gyro_s, accel_s, np.zeros(len(step), bool), np.arange(len(t_s)), m)
    cuts = np.flatnonzero(step > max(m * nominal, GAP_S)) + 1
    pieces = [_cut(log, first, stop) for first, stop in zip([0, *cuts], [*cuts, len(t_s)], strict=True)]
    whole = [_cut_intervals(_bridged(piece, nominal), cuts_s) for piece in pieces]
    joined = _joined([piece for piece in whole if piece.intervals])
    if joined is None or joined.intervals < 2:
        raise ValueError(f"{t_s[-1] - t_s[0]:.3g} s of samples are too short: two intervals of {m} steps are needed")
    return joined


def _steps_per_interval(rate_hz: float, knot_s: float) -> int:
    """An even number of steps near knot_s; a multiple of fifty where the rate allows, for panels of whole steps."""
    unit = 50 if rate_hz >= _FINE_RATE_HZ else 2
    return max(unit * round(knot_s * rate_hz / unit), unit, _FEWEST_STEPS)


def _cut(samples: Samples, first: int, stop: int) -> Samples:
    """Some rows, one behind the other."""
    rows, steps = slice(first, stop), slice(first, stop - 1)
    return Samples(
        samples.t_s[rows], samples.gyro_s[rows], samples.accel_s[rows], samples.filled[steps], samples.row[rows],
        samples.per_interval,
    )  # fmt: skip


def _bridged(samples: Samples, nominal_s: float) -> Samples:
    """Gaps within an interval filled with samples at the nominal step."""
    t_s, gyro_s, accel_s = samples.t_s, samples.gyro_s, samples.accel_s
    step = np.diff(t_s)
    gaps = np.flatnonzero(step > max(GAP_S, GAP_STEPS * nominal_s))
    if not len(gaps):
        return samples
    steps = np.rint(step[gaps] / nominal_s).astype(int)
    before = np.repeat(gaps, steps - 1)
    first = np.repeat(np.cumsum(steps - 1) - steps, steps - 1)
    part = (np.arange(len(before)) - first) / np.repeat(steps, steps - 1)
    row = np.insert(samples.row, before + 1, -1)
    return Samples(
        t_s=np.insert(t_s, before + 1, _between(t_s, before, part)),
        gyro_s=np.insert(gyro_s, before + 1, _between(gyro_s, before, part[:, None]), axis=0),
        accel_s=np.insert(accel_s, before + 1, _between(accel_s, before, part[:, None]), axis=0),
        filled=(row[:-1] < 0) | (row[1:] < 0),
        row=row,
        per_interval=samples.per_interval,
    )


def _between(x: Floats, before: NDArray[np.int64], part: Floats) -> Floats:
    return np.asarray(x[before] + part * (x[before + 1] - x[before]))


def _cut_intervals(samples: Samples, cuts_s: tuple[float, ...]) -> Samples:
    """Whole intervals from cut to cut; cuts so near to an end or to each other that hardly a step is left are none."""
    last = len(samples.t_s) - 1
    at = np.searchsorted(samples.t_s, sorted(cuts_s))
    rows = [0]
    for row in at.tolist():
        if row - rows[-1] >= _FEWEST_CUT and last - row >= _FEWEST_CUT:
            rows.append(row)
    pieces = [_cut(samples, first, stop + 1) for first, stop in pairwise([*rows, last])] or [samples]
    open_ended = [replace(piece, row=np.append(piece.row[:-1], -1)) for piece in pieces[:-1]]  # the next one has it
    parts = [_whole_intervals(piece, keep=True) for piece in open_ended]
    parts.append(_whole_intervals(pieces[-1], keep=len(rows) > 1))
    if len(parts) == 1:
        return parts[0]
    first = parts[:-1]
    return Samples(
        t_s=np.concatenate([*(part.t_s[:-1] for part in first), parts[-1].t_s]),
        gyro_s=np.concatenate([*(part.gyro_s[:-1] for part in first), parts[-1].gyro_s]),
        accel_s=np.concatenate([*(part.accel_s[:-1] for part in first), parts[-1].accel_s]),
        filled=np.concatenate([part.filled for part in parts]),
        row=np.concatenate([*(part.row[:-1] for part in first), parts[-1].row]),
        per_interval=samples.per_interval,
    )


def _whole_intervals(samples: Samples, *, keep: bool) -> Samples:
    """The last interval padded with steps of no length, or, unless all is kept, dropped where it has hardly any."""
    m = samples.per_interval
    whole, rest = divmod(len(samples.filled), m)
    steps = m * (whole + (rest >= (1 if keep else _LEAST_FILL * m)))
    pad = max(steps - len(samples.filled), 0)

    def fit(x: Floats) -> Floats:
        return np.concatenate([x, np.repeat(x[-1:], pad, axis=0)]) if pad else x[: steps + 1]

    return Samples(
        t_s=fit(samples.t_s),
        gyro_s=fit(samples.gyro_s),
        accel_s=fit(samples.accel_s),
        filled=np.pad(samples.filled[:steps], (0, pad)),
        row=np.pad(samples.row[: steps + 1], (0, pad), constant_values=-1),
        per_interval=m,
    )


def _joined(pieces: list[Samples]) -> Samples | None:
    """Whole intervals with one more between each two of them; None of none."""
    if len(pieces) < 2:
        return pieces[0] if pieces else None
    bridges = [_bridge(one, other) for one, other in pairwise(pieces)]
    parts = [pieces[0], *chain.from_iterable(zip(bridges, pieces[1:], strict=True))]
    return Samples(
        t_s=np.concatenate([part.t_s for part in parts]),
        gyro_s=np.concatenate([part.gyro_s for part in parts]),
        accel_s=np.concatenate([part.accel_s for part in parts]),
        filled=np.concatenate([part.filled for part in parts]),
        row=np.concatenate([part.row for part in parts]),
        per_interval=pieces[0].per_interval,
    )


def _bridge(one: Samples, other: Samples) -> Samples:
    """The samples between two pieces; its steps are those to and from these, too."""
    m = one.per_interval
    part = np.arange(1, m) / m
    length = float(other.t_s[0] - one.t_s[-1])
    long = length > LONG_GAP_S

    def line(a: Floats, b: Floats, share: Floats) -> Floats:
        return np.asarray(a + share[:, None] * (b - a))

    return Samples(
        t_s=one.t_s[-1] + part * length,
        gyro_s=np.zeros((m - 1, 3)) if long else line(one.gyro_s[-1], other.gyro_s[0], part),
        accel_s=line(one.accel_s[-1], other.accel_s[0], np.full(m - 1, 0.5) if long else part),
        filled=np.ones(m, bool),
        row=np.full(m - 1, -1),
        per_interval=m,
    )
