"""Texts of dates and times of day, and decimal seconds, as whole nanoseconds; none goes through a double."""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.numerics.gnss_time import DAY_NS, NS
from recon_readers._time_order import Mask, Times

TIME_TYPE: Final = pa.decimal128(38, 18)
"""Seconds as decimals; `whole_ns` makes nanoseconds of them."""
_LARGEST_NS: Final = Decimal(9 * 10**18)
CLOCK: Final = r"(?P<H>\d{1,2}):?(?P<M>\d{2})(?::?(?P<S>\d{2})(?:[.,](?P<F>\d+))?)?"
ZONE: Final = r"\s*(?:(?P<Z>[Zz]|UTC|GMT)?(?P<sign>[+-])?(?P<zh>\d{2})?:?(?P<zm>\d{2})?)"
ISO_DATE: Final = r"(?P<y>\d{4})[-/.]?(?P<m>\d{1,2})[-/.]?(?P<d>\d{1,2})"
_MOMENT: Final = rf"^{ISO_DATE}[T ]\s*{CLOCK}{ZONE}$"


def match(texts: Any, pattern: str) -> dict[str, pa.Array]:
    """The named groups of a pattern as arrays of text, "" where a group or the whole is not there."""
    from pyarrow import compute

    plain = texts.combine_chunks() if isinstance(texts, pa.ChunkedArray) else texts
    found = compute.extract_regex(pa.array(plain), pattern)
    names = [found.type.field(index).name for index in range(found.type.num_fields)]
    return {name: part.fill_null("") for name, part in zip(names, found.flatten(), strict=True)}


def whole(texts: Any, empty: int = 0) -> NDArray[np.int64]:
    """Texts of digits as whole numbers: (n,)."""
    from pyarrow import compute

    blank = compute.equal(texts, "")
    return np.asarray(compute.if_else(blank, str(empty), texts).cast(pa.int64()))


def moment(found: Mapping[str, Any], zone: int = 0) -> tuple[Times, Mask]:
    """ns since 1970 of texts that were taken apart, (n,); and whether each is a time, (n,) bool.

    zone : ns ahead of UTC, where a text names none
    """
    date, good = days(*(whole(found[name], 1) for name in "ymd"))
    clock, of_day = time_of_day(found)
    good &= of_day & (np.asarray(found["y"]) != "")
    signed = np.asarray(found["sign"])
    minutes = 60 * whole(found["zh"]) + whole(found["zm"])
    good &= (signed != "") | (minutes == 0)
    named = (signed != "") | (np.asarray(found["Z"]) != "")
    offset = np.where(signed == "-", -1, 1) * minutes * 60 * NS
    return date * DAY_NS + clock - np.where(named, offset, zone), good


def days(years: Times, months: Times, of_month: Times) -> tuple[Times, Mask]:
    """Days since 1970, (n,), 0 where there is no such date; and whether there is, 1900 to 2200, (n,) bool."""
    possible = (years >= 1900) & (years <= 2200) & (months >= 1) & (months <= 12) & (of_month >= 1) & (of_month <= 31)
    whole_years = np.where(possible, years, 1970)
    month = (whole_years - 1970).astype("datetime64[Y]").astype("datetime64[M]") + (np.where(possible, months, 1) - 1)
    date = month.astype("datetime64[D]") + (np.where(possible, of_month, 1) - 1)
    good = possible & (date.astype("datetime64[M]") == month)
    return np.where(good, date.astype(np.int64), 0), good


def short_dates(texts: Any) -> Times:
    """Days since 1970 of texts like 080625 for the 8th of June 2025, (n,), -1 where there is none.

    Years 80 to 99 are of the last century.
    """
    from pyarrow import compute

    number = digits(compute.if_else(compute.match_substring_regex(texts, r"^\d{6}$"), texts, ""))
    year = number % 100
    date, known = days(np.where(year >= 80, 1900, 2000) + year, number // 100 % 100, number // 10_000)
    return np.where(known, date, -1)


def digits(texts: Any) -> Times:
    """Whole numbers of up to nine digits, (n,), 0 where a text is none."""
    from pyarrow import compute

    return whole(compute.if_else(compute.match_substring_regex(texts, r"^\d{1,9}$"), texts, ""))


def time_of_day(found: Mapping[str, Any]) -> tuple[Times, Mask]:
    """ns since midnight of texts that were taken apart, (n,); and whether each is a time, (n,) bool."""
    from pyarrow import compute

    hours, minutes, seconds = (whole(found[name]) for name in "HMS")
    fraction = compute.utf8_slice_codeunits(compute.utf8_rpad(found["F"], 9, "0"), 0, 9)
    good = (hours < 24) & (minutes < 60) & (seconds <= 60) & (np.asarray(found["H"]) != "")
    return ((hours * 60 + minutes) * 60 + seconds) * NS + whole(fraction), good


def clocks(texts: Any) -> tuple[Times, Mask]:
    """ns since midnight of texts like 145408.10 or 14:54:08.1, (n,); and whether each is a time, (n,) bool."""
    return time_of_day(match(texts, rf"^\s*{CLOCK}\s*$"))


def moments(texts: Any) -> tuple[Times, Mask]:
    """ns since 1970 of texts like 2026-06-08T14:54:08.1Z or 2026/06/08 14:54:08, (n,); whether each is one, (n,) bool.

    UTC where a text names no zone.
    """
    return moment(match(texts, _MOMENT))


def over_midnight(clock_ns: Times) -> Times:
    """Times of day in the order of a log with the days that begin on the way: (n,) ns.

    Where they fall by more than half a day, the next day has begun.
    """
    days_on = np.cumsum(np.diff(clock_ns, prepend=clock_ns[:1]) < -DAY_NS // 2)
    return np.asarray(clock_ns + days_on * DAY_NS)


def whole_ns(times: pa.ChunkedArray, digits: int = 9) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Decimal seconds as whole nanoseconds; what is below a nanosecond is cut off.

    times : (n,) decimals, in s; in ms where digits is 6, in us for 3, in ns for 0
    returns : (n,) ns, 0 where a time is null, clipped to 9e9 s; (n,) bool, true where a time is null
    """
    from pyarrow import compute

    limit = pa.scalar(_LARGEST_NS.scaleb(-digits), TIME_TYPE)
    bounded = compute.if_else(compute.greater(compute.abs(times), limit), limit, times)
    exact = bounded.cast(pa.decimal128(20, digits), safe=False)
    if digits:
        exact = compute.multiply(exact, pa.scalar(Decimal(10**digits)))
    return np.asarray(exact.cast(pa.int64()).fill_null(0)), np.asarray(times.is_null())
