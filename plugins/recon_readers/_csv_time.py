"""Times of `reader.csv`, in any of its formats, as whole nanoseconds since 1970 UTC; none goes through a double.

Of the GPS time scale, which counts no leap seconds, those of the first row are taken off all rows, so that times rise
evenly over a leap second.

References: IS-GPS-200, 20.3.3.5.2.4 (UTC from GPS time, epoch 1980-01-06); IERS Bulletin C (leap seconds); ISO 8601-1.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import ROUND_DOWN, Context, Decimal, InvalidOperation
from typing import Final

import numpy as np
import pyarrow as pa

from recon.numerics.gnss_time import DAY_NS, GPS_EPOCH_NS, NS, WEEK_NS, leap_seconds
from recon.rows import Metric, warning
from recon_readers._csv_sheet import Cells, Sheet
from recon_readers._mapping_parts import Time
from recon_readers._time_order import Mask, Times
from recon_readers._time_text import CLOCK, ISO_DATE, TIME_TYPE, ZONE, match, moment, time_of_day, whole_ns

DIGITS: Final = {"s": 9, "ms": 6, "us": 3, "ns": 0}
"""Decimals of each unit down to a nanosecond."""
_EARLIEST_NS: Final = 315_532_800 * NS
_LATEST_NS: Final = 4_102_444_800 * NS
"""1980 and 2100: what clocks that were set show."""
_LARGEST_NS: Final = 4_200_000_000 * NS
"""Of two such numbers the sum does not overflow."""
_SMALLEST: Final = Decimal(1).scaleb(-18)
_CONTEXT: Final = Context(prec=38)

_DATES: Final = {
    "iso": ISO_DATE,
    "day_first": r"(?P<d>\d{1,2})[-/.](?P<m>\d{1,2})[-/.](?P<y>\d{4})",
    "month_first": r"(?P<m>\d{1,2})[-/.](?P<d>\d{1,2})[-/.](?P<y>\d{4})",
}


@dataclass(frozen=True)
class Clock:
    """The time of every row of a stream.

    t_ns : (n,) ns since 1970 UTC, or since the log's own zero where it is not `absolute`; missing : (n,) bool
    """

    t_ns: Times
    missing: Mask
    absolute: bool
    learnt: tuple[Metric, ...]


def read_times(sheet: Sheet, time: Time, cells: Cells) -> tuple[Times, Mask]:
    """The times of a block of rows: (n,) ns as they stand, (n,) bool, true where missing.

    Raises ReadFailed at what is no time.
    """
    indices = [index for index in map(sheet.find, time.references) if index is not None]
    if time.format in _DATES:
        t_ns, missing = _of_texts(sheet, time, indices, cells)
    elif time.format == "time_of_day":
        t_ns, missing = _of_day(sheet, indices[0], cells)
    elif time.format == "gps_week":
        weeks, no_week = _of_numbers(sheet, indices[0], cells, "ns")
        seconds, no_second = _of_numbers(sheet, indices[1], cells, time.unit)
        _refuse_beyond(sheet, indices[0], cells, weeks, _LARGEST_NS // WEEK_NS)
        t_ns, missing = GPS_EPOCH_NS + weeks * WEEK_NS + seconds, no_week | no_second
    else:
        t_ns, missing = _of_numbers(sheet, indices[0], cells, time.unit)
    _refuse_beyond(sheet, indices[0], cells, t_ns, _LARGEST_NS)
    return t_ns, missing


def clock_of(time: Time, t_ns: Times, missing: Mask) -> Clock:
    """The clock of a stream from all its times as they stand, (n,) ns, and where these are missing, (n,) bool."""
    if time.format == "time_of_day":
        t_ns = t_ns + _days_begun(t_ns, missing)
    absolute = time.format not in ("relative", "time_of_day") or bool(time.start)
    learnt = [Metric("assumed_time", note=_about(time))]
    later_ns = time.start_ns
    if time.scale == "GPS" or time.format == "gps_week":
        first = int(t_ns[np.argmin(missing)]) + later_ns if len(t_ns) else 0
        leaps = leap_seconds(first) if absolute else 0
        later_ns -= leaps * NS
        learnt.append(Metric("leap_seconds", float(leaps), "s", note="taken off the GPS time scale"))
    t_ns = t_ns + later_ns if later_ns else t_ns
    known = t_ns[~missing] if missing.any() else t_ns
    return Clock(t_ns, missing, absolute, (*learnt, *_doubts(known, absolute)))


def _about(time: Time) -> str:
    unit = "" if time.format in (*_DATES, "time_of_day") else f" in {time.unit}"
    zone = f", {time.zone} where a text names no zone" if time.format in _DATES else ""
    start = f" from {time.start}" if time.start else ""
    return f"{', '.join(map(str, time.references))}: {time.format}{unit}{start}, {time.scale}{zone}"


def _doubts(t_ns: Times, absolute: bool) -> list[Metric]:
    if not absolute or not len(t_ns) or (t_ns.min() >= _EARLIEST_NS and t_ns.max() <= _LATEST_NS):
        return []
    first = np.datetime_as_string(t_ns[:1].view("datetime64[ns]"), unit="s")[0]
    return [warning(f"times from {first} on lie outside 1980 to 2100: check format and unit of the time")]


def _refuse_beyond(sheet: Sheet, index: int, cells: Cells, values: Times, limit: int) -> None:
    beyond = np.abs(values) > limit
    if beyond.any():
        what = f"{sheet.title(index)} is beyond any clock"
        hint = "check format and unit of the time, or repair the line"
        raise sheet.refused(cells.first + int(beyond.argmax()), index, what, hint)


# --- numbers --------------------------------------------------------------------------------------------------------


def _of_numbers(sheet: Sheet, index: int, cells: Cells, unit: str) -> tuple[Times, Mask]:
    """Decimal texts of a unit as ns, (n,), 0 where missing; (n,) bool, true where missing."""
    plain = cells.texts[index]
    if sheet.decimal == "comma":
        from pyarrow import compute

        plain = compute.replace_substring(plain, ",", ".")
    try:
        decimals = plain.cast(TIME_TYPE)
    except pa.ArrowInvalid:
        decimals = _one_by_one(sheet, index, cells.first, plain)
    t_ns, missing = whole_ns(decimals, DIGITS[unit])
    _refuse_beyond(sheet, index, cells, t_ns, _LARGEST_NS)
    return t_ns, missing


def _one_by_one(sheet: Sheet, index: int, first: int, texts: pa.ChunkedArray) -> pa.ChunkedArray:
    """What has more digits than a decimal of Arrow holds, cut; raises ReadFailed at what is no number."""
    found: list[Decimal | None] = []
    for row, text in enumerate(texts.to_pylist(), first):
        try:
            value = None if text is None else Decimal(text)
            if value is not None and abs(value) >= Decimal(10**19):
                raise InvalidOperation
            found.append(None if value is None else value.quantize(_SMALLEST, ROUND_DOWN, _CONTEXT))
        except InvalidOperation:
            raise sheet.no(row, index, text, "number") from None
    return pa.chunked_array([pa.array(found, TIME_TYPE)])


# --- texts ----------------------------------------------------------------------------------------------------------


def _of_texts(sheet: Sheet, time: Time, indices: list[int], cells: Cells) -> tuple[Times, Mask]:
    from pyarrow import compute

    parts = [cells.texts[index] for index in indices]
    texts = parts[0] if len(parts) == 1 else compute.binary_join_element_wise(*parts, " ")
    found = match(texts, rf"^{_DATES[time.format]}[T ]\s*{CLOCK}{ZONE}$")
    t_ns, good = moment(found, time.zone_ns)
    return _complete(sheet, indices[-1], cells.first, texts, t_ns, good, _EXAMPLES[time.format])


def _of_day(sheet: Sheet, index: int, cells: Cells) -> tuple[Times, Mask]:
    clock, good = time_of_day(match(cells.texts[index], rf"^{CLOCK}$"))
    return _complete(sheet, index, cells.first, cells.texts[index], clock, good, _EXAMPLES["time_of_day"])


def _days_begun(clock_ns: Times, missing: Mask) -> Times:
    """Where times of day fall by more than half a day, the next day has begun: (n,) ns."""
    rows = np.flatnonzero(~missing)
    days = np.zeros(len(clock_ns), dtype=np.int64)
    days[rows[1:]] = np.cumsum(np.diff(clock_ns[rows]) < -DAY_NS // 2)
    return days * DAY_NS


_EXAMPLES: Final = {
    "iso": "time like 2026-06-08T14:54:08.1Z",
    "day_first": "time like 08/06/2026 14:54:08",
    "month_first": "time like 06/08/2026 14:54:08",
    "time_of_day": "time of day like 14:54:08.1",
}


def _complete(
    sheet: Sheet, index: int, first: int, texts: pa.ChunkedArray, t_ns: Times, good: Mask, example: str
) -> tuple[Times, Mask]:
    missing = np.asarray(texts.is_null())
    wrong = ~good & ~missing
    if wrong.any():
        row = int(wrong.argmax())
        raise sheet.no(
            first + row, index, texts[row].as_py(), example, "check the format of the time, or repair the line"
        )
    return np.where(missing, 0, t_ns), missing
