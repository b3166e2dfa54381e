"""Which rows of a log bring a new measurement of which sensor, where several sensors share the rows.

Loggers fill a row's columns of the sensors that did not report in three ways: they interpolate, they repeat the last
values, or they leave the fields blank. Only what a sensor reported may become a row of its stream.

Blank fields speak for themselves. Repeated values are told from measured ones by counting *news*, rows in which a
sensor's values differ from the last ones:

- Two sensors *alternate* if they hardly ever bring news in one row (in at most a tenth of the rows of the rarer one)
  and yet at least half of all rows bring news of some sensor. Coarse sensors at rest, which repeat values by chance,
  do not look like that: with independent shares p and q of news the first condition needs max(p, q) <= 0.1 and the
  second 1 - (1 - p)(1 - q) >= 0.5, which exclude each other.
- A GNSS receiver is *held* if the median distance between its news is more than one row.

A held receiver that stands still may report the same values again, which is no gap. There, rows are taken at its
period after the last news. While it moves its values change with every report, so longer silence is an outage and is
left as a gap.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.signals import changes
from recon.tables import Array
from recon_readers._time_order import Mask, Times

_FEWEST_NEWS: Final = 3
_MOST_TOGETHER: Final = 0.1
_LEAST_WITH_NEWS: Final = 0.5
_BLOCK_ROWS: Final = 1 << 18


@dataclass(frozen=True)
class Seen:
    """What the columns of one sensor show: (n,) bool each.

    known : rows with a number; news : rows with another number than the last one in that column
    """

    known: Mask
    news: Mask


def see(columns: Sequence[Array]) -> Seen:
    """Look at the columns of one sensor: (n,) each in any unit, NaN where blank."""
    known = np.zeros(len(columns[0]), dtype=bool)
    news = known.copy()
    news[:1] = True
    for values in columns:
        blank = np.isnan(values)
        known |= ~blank
        if blank.any():
            news |= changes(values)
        else:
            news[1:] |= values[1:] != values[:-1]
    return Seen(known, news & known)


@dataclass(frozen=True)
class GnssRows:
    """Rows of a GNSS receiver.

    fresh : (n,) bool, rows that it reported
    held : are its values repeated on the rows between?
    period_ns : median time between its reports, None where nothing tells it
    """

    fresh: Mask
    held: bool
    period_ns: int | None


def imu_rows(sensors: Mapping[str, Seen], gnss: Seen | None) -> tuple[dict[str, Mask], str]:
    """Rows that accelerometer and gyroscope reported, (n,) bool by name, and how the others are filled, as a phrase."""
    seen = [*sensors.values(), *([gnss] if gnss else [])]
    full = np.logical_and.reduce([sensor.known for sensor in seen])
    any_news = np.logical_or.reduce([sensor.news for sensor in seen])
    imu_news = np.logical_or.reduce([sensor.news for sensor in sensors.values()])
    known = {name: sensor.known for name, sensor in sensors.items()}
    first, *rest = [sensor.news for sensor in sensors.values()]
    if rest and _alternate(first, rest[0], any_news, full):
        fresh = {name: known[name] & (sensor.news | ~full) for name, sensor in sensors.items()}
        return fresh, "repeated: each row updates one sensor, the other one is null"
    if gnss and _alternate(imu_news, gnss.news, any_news, full):
        fresh = {name: known[name] & (imu_news | ~full) for name in sensors}
        return fresh, "repeated: rows that update GNSS alone are left out"
    some = np.logical_or.reduce(list(known.values()))
    if all(np.array_equal(mask, some) for mask in known.values()):
        return known, "every row updates every sensor"
    return known, "blank where a sensor did not report"


def _alternate(one: Mask, other: Mask, any_news: Mask, full: Mask) -> bool:
    """Do two sensors bring news in different rows?

    one, other, any_news : (n,) bool, rows with news of these two and of any sensor
    full : (n,) bool, rows in which all are known; the first of them does not count, it is news of all
    """
    later = full.copy()
    later[np.argmax(full)] = False
    rarer = min(np.count_nonzero(one & later), np.count_nonzero(other & later))
    if rarer < _FEWEST_NEWS:
        return False
    together = np.count_nonzero(one & other & later)
    some = np.count_nonzero(any_news & later)
    return bool(together <= _MOST_TOGETHER * rarer and some >= _LEAST_WITH_NEWS * np.count_nonzero(later))


def gnss_rows(t_ns: Times, gnss: Seen, standing: Mask) -> GnssRows:
    """Rows that a GNSS receiver reported.

    t_ns : (n,) ns, never falling
    standing : (n,) bool, speed so low that equal values are no sign of an outage
    """
    rows = np.flatnonzero(gnss.known)
    steps = np.diff(np.flatnonzero(gnss.news[rows]))
    if len(rows) < 3 or (len(steps) and np.median(steps) <= 1):
        gaps = np.diff(t_ns[rows])
        return GnssRows(gnss.known, held=False, period_ns=int(np.median(gaps)) if len(gaps) else None)
    news = np.flatnonzero(gnss.news)
    period_ns = _period(t_ns[news], standing[news])
    fresh = gnss.news
    if period_ns:
        fresh = fresh | (gnss.known & _repeats(t_ns, news, standing[news], period_ns))
    return GnssRows(fresh, held=True, period_ns=period_ns)


def _period(t_ns: Times, standing: Mask) -> int | None:
    """Median time between news, of those in motion where there are enough: at rest some reports are no news."""
    gaps = np.diff(t_ns)
    moving = gaps[~standing[:-1]]
    chosen = moving if len(moving) >= _FEWEST_NEWS else gaps
    return int(np.median(chosen)) if len(gaps) >= _FEWEST_NEWS else None


def _repeats(t_ns: Times, news: NDArray[np.intp], standing: Mask, period: int) -> Mask:
    """Rows at whole periods after news of a standing vehicle and before the next news: (n,) bool.

    A row counts if it lies within half a period of its due time, so that gaps of the log stay gaps.

    news : (m,) row numbers; standing : (m,) bool
    """
    until = np.append(t_ns[news[1:]], t_ns[-1] + period // 2)
    found = np.zeros(len(t_ns), dtype=bool)
    before = 0
    for start in range(0, len(t_ns), _BLOCK_ROWS):
        t = t_ns[start : start + _BLOCK_ROWS]
        latest = np.searchsorted(news, np.arange(start, start + len(t)), side="right") - 1
        since = t - t_ns[news[latest]]
        due = since // period * period
        first = (due > 0) & (np.append(before, since[:-1]) < due)
        in_time = (since - due <= period // 2) & (t - since + due <= until[latest] - period // 2)
        found[start : start + len(t)] = first & in_time & (latest >= 0) & standing[latest]
        before = since[-1]
    return found
