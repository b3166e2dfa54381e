"""GPS time and UTC, in whole nanoseconds.

GPS time counts weeks since 1980-01-06 and the time in the week, without leap seconds; UTC has them.

References: IS-GPS-200, 20.3.3.5.2.4 (UTC from GPS time, epoch); IERS Bulletin C (leap seconds).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

NS: Final = 1_000_000_000
DAY_NS: Final = 86_400 * NS
WEEK_NS: Final = 7 * DAY_NS
GPS_EPOCH_NS: Final = 315_964_800 * NS
"""1980-01-06T00:00:00Z in ns since 1970."""

_LEAPS: Final = (
    "1981-07-01 1982-07-01 1983-07-01 1985-07-01 1988-01-01 1990-01-01 1991-01-01 1992-07-01 1993-07-01 1994-07-01 "
    "1996-01-01 1997-07-01 1999-01-01 2006-01-01 2009-01-01 2012-07-01 2015-07-01 2017-01-01"
)
"""Days from which on GPS was a second more ahead of UTC."""
_LEAPS_NS: Final = np.array(_LEAPS.split(), dtype="datetime64[ns]").astype(np.int64)


def leap_seconds(gps_ns: int) -> int:
    """GPS time minus UTC in s, at a time that GPS shows: ns since 1970 without leap seconds."""
    ahead = np.arange(1, len(_LEAPS_NS) + 1) * NS
    return int(np.count_nonzero(_LEAPS_NS + ahead <= gps_ns))


def gps_to_utc(gps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """UTC of times in the GPS scale, by the leap seconds of the first, so that times rise evenly over a leap second.

    gps_ns : (n,) ns since 1970 without leap seconds
    returns : (n,) ns since 1970, UTC
    """
    return np.asarray(gps_ns - leap_seconds(int(gps_ns[0])) * NS) if len(gps_ns) else gps_ns


def utc_to_gps(utc_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """The inverse of `gps_to_utc`: (n,) ns since 1970 without leap seconds."""
    return np.asarray(utc_ns + int(np.count_nonzero(utc_ns[0] >= _LEAPS_NS)) * NS) if len(utc_ns) else utc_ns
