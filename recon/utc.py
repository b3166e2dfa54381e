"""Times in text as whole nanoseconds since 1970 UTC: every digit that is written counts.

Reference: ISO 8601-1:2019, 5.4 (date and time of day), 4.3.13 (shift from UTC).
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from typing import Final

LATEST_NS: Final = 2**62
"""ns since 1970 beyond which, or as far before, no log begins: the year 2116."""
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_FRACTION: Final = re.compile(r"([\dW-]+\D\d\d:?\d\d:?\d\d)[.,](\d+)(.*)")
"""A date, a separator and a time of day to the second; the digits behind it; the zone."""
_ZONE: Final = re.compile(r"([+-])(\d\d):?([0-5]\d)")


def iso_ns(text: str, zone: int = 0) -> int:
    """Time of an ISO 8601 text, ns since 1970 UTC; digits behind the ninth are left out. Raises ValueError.

    zone : local time minus UTC in ns, of a text that names no zone
    """
    found = _FRACTION.fullmatch(text)
    if found is None and ("." in text or "," in text):
        raise ValueError("only seconds may have a fraction")  # Python takes that of a minute for one of a second
    moment = datetime.fromisoformat(found[1] + found[3] if found else text)
    since = moment.replace(tzinfo=moment.tzinfo or UTC) - _EPOCH
    fraction = int(found[2][:9].ljust(9, "0")) if found else since.microseconds * 1000
    return (since.days * 86_400 + since.seconds) * 1_000_000_000 + fraction - (0 if moment.tzinfo else zone)


def start_ns(text: str, zone: int = 0) -> int:
    """As `iso_ns`, of the time at which a log begins: within 146 years of 1970, so that sums with it fit into 64 bits.

    Raises ValueError for another time, too.
    """
    found = iso_ns(text, zone)
    if abs(found) >= LATEST_NS:
        raise ValueError(f"'{text:.40}' is too far from 1970 for the clock of a log")
    return found


def zone_ns(text: str) -> int:
    """Local time minus UTC in ns, of "+02:00" or "-0330". Raises ValueError for another text."""
    found = _ZONE.fullmatch(text)
    if found is None:
        raise ValueError(f"the zone '{text:.20}' cannot be read; write it as +02:00")
    return int(f"{found[1]}1") * (60 * int(found[2]) + int(found[3])) * 60_000_000_000
