"""What names a time of a log: seconds after its first row, ISO text, datetime, numpy.datetime64."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any, Final, TypeAlias

import numpy as np

from recon.errors import DataError
from recon.problems import shortened
from recon.units import parse_quantity
from recon.utc import iso_ns

Moment: TypeAlias = str | float | datetime | np.datetime64

LAST_NS: Final = 2**63 - 1
"""Greatest int64."""
HINT: Final = (
    "give seconds after the first row, text such as '100s', '#12' for a frame, ISO text, a datetime or a "
    "numpy.datetime64"
)
"""What a time may be."""


def moment_ns(one: Any, start: int, hint: str = HINT) -> int:
    """A time in ns since 1970, between -LAST_NS and LAST_NS.

    one : ISO text (UTC where it names no zone), datetime, numpy.datetime64, or after `start`: s, or text such as "100s"
    start : ns since 1970
    hint : what to do about what is no time, of which DataError is raised
    """
    try:
        found = _nanoseconds(one, start)
    except (TypeError, ValueError, OverflowError) as error:
        advice = f"with a unit it is one: '{one}s' after the first row" if _bare(one) else hint
        raise DataError(f"{shortened(repr(one))} is no time", advice) from error
    return min(max(found, -LAST_NS), LAST_NS)  # what int64 cannot hold is outside of every log


def _bare(one: Any) -> bool:
    """Is it the text of a number, without a unit?"""
    return isinstance(one, str) and one.replace(".", "", 1).isdecimal() and one.isascii()


def _nanoseconds(one: Any, start: int) -> int:
    if isinstance(one, np.timedelta64):  # passes for an integer: of ns, where it counts these
        raise TypeError("no time, but a duration")
    if isinstance(one, int | float | np.integer | np.floating):
        return start + round(float(one) * 1e9)
    if isinstance(one, str):
        try:
            return iso_ns(one)
        except ValueError:
            return start + round(parse_quantity(one, into="s") * 1e9)
    if isinstance(one, datetime):
        aware = one if one.tzinfo else one.replace(tzinfo=UTC)
        since = aware - datetime(1970, 1, 1, tzinfo=UTC)
        return (since.days * 86400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000
    moment = np.datetime64(one, "ns")
    if np.isnat(moment):
        raise ValueError("not a time")
    return int(moment.astype(np.int64))
