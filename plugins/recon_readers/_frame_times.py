"""Times of images, as their names or lists of them tell them, as whole nanoseconds; none goes through a double.

    1311868164.363181   1574762400123   1403636579763555584      s, ms, us or ns since 1970, told apart by their size
    20191126_101500123   2019-11-26T10-15-00.123Z   2019-11-26 10:15:00.123      date and clock time
    0.033333                                                     a time after the first one, in a list alone

What stands around a time in a name, such as IMG_ or .jpg, does not matter.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import PurePosixPath
from typing import Final

from recon.utc import LATEST_NS
from recon_readers._time_text import moments

SUFFIXES: Final = frozenset(
    (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".heic", ".heif", ".pgm", ".ppm", ".dng", ".raw")
)
"""Endings of images."""
UNITS: Final = {"s": 9, "ms": 6, "us": 3, "ns": 0}
"""Decimals down to a nanosecond."""
_EARLIEST_S: Final = 315_532_800
_LATEST_S: Final = 4_102_444_800
"""1980 and 2100."""

_NUMBER: Final = re.compile(r"(?<![\d.])\d{1,19}(?:\.\d+)?(?![\d])")
_DATED: Final = re.compile(
    r"(?<!\d)(?P<y>(?:19|20)\d\d)[-_/.]?(?P<m>[01]\d)[-_/.]?(?P<d>[0-3]\d)[T _-]?"
    r"(?P<H>[0-2]\d)[-_:.]?(?P<M>[0-5]\d)[-_:.]?(?P<S>[0-6]\d)(?:[-_.,]?(?P<F>\d{1,9}))?(?P<Z>[Zz]|[+-]\d\d:?\d\d)?(?!\d)"
)
_SEPARATORS: Final = re.compile(r"[,;\t]|\s+")


@dataclass(frozen=True)
class Told:
    """A time: ns since 1970 UTC, or since the zero of a list where it is not `absolute`; is it in a `zone`?

    unit : of a number, "" for a date
    """

    t_ns: int
    absolute: bool
    zone: bool
    unit: str = ""


@dataclass(frozen=True)
class Line:
    """A line of a list: its time, and the file that it names, "" for none."""

    told: Told
    file: str

    def fits(self, other: Line) -> bool:
        """Is it made as the other one? A line that was cut off is not."""
        kinds = [(line.told.absolute, line.told.unit, bool(line.file)) for line in (self, other)]
        return kinds[0] == kinds[1]


def told_by(text: str, unit: str, zone_ns: int, *, relative: bool = False) -> Told | None:
    """The time in a text, None where there is none that is certain.

    unit : s, ms, us, ns, or "auto"; zone_ns : local time minus UTC, for dates that name no zone
    relative : a number too small for a time since 1970 is one after another zero
    """
    dated = _DATED.search(text)
    if dated:
        found = dated.groupdict(default="")
        zone = found["Z"].upper() or ""
        iso = f"{found['y']}-{found['m']}-{found['d']}T{found['H']}:{found['M']}:{found['S']}.{found['F'] or 0}{zone}"
        (t_ns,), (good,) = moments([iso])
        if good:
            return Told(int(t_ns) - (0 if zone else zone_ns), True, bool(zone))
    numbers = _NUMBER.findall(text)
    for number in numbers:
        for name in UNITS if unit == "auto" else (unit,):
            t_ns = int(Decimal(number).scaleb(UNITS[name]))
            if _EARLIEST_S * 10**9 <= t_ns <= _LATEST_S * 10**9:
                return Told(t_ns, True, True, name)
    if relative and numbers == [text.strip()]:
        name = "s" if unit == "auto" else unit
        t_ns = int(Decimal(numbers[0]).scaleb(UNITS[name]))
        return Told(t_ns, False, True, name) if abs(t_ns) < LATEST_NS else None
    return None


def is_image(name: str) -> bool:
    """Is it the name of an image?"""
    return PurePosixPath(name.replace("\\", "/")).suffix.lower() in SUFFIXES


def line_of(text: str, unit: str, zone_ns: int) -> Line | None:
    """A line of a list: a time, a file or none, in any order. None where it holds no time."""
    parts = [part.strip("\"'") for part in _SEPARATORS.split(text.strip()) if part]
    files = [part for part in parts if is_image(part)]
    rest = " ".join(part for part in parts if part not in files)
    told = told_by(rest, unit, zone_ns, relative=True)
    if told is None and files:  # a list of names that tell the times themselves
        told = told_by(PurePosixPath(files[0]).stem, unit, zone_ns)
    return Line(told, files[0] if files else "") if told is not None else None


def lines_of(texts: Sequence[str], unit: str, zone_ns: int) -> list[tuple[int, Line | None]]:
    """The lines of a list with their numbers, from 1; comments, blanks and a header are left out.

    None stands for a line without a time, or of another make than the first.
    """
    numbered = [(number, text) for number, text in enumerate(texts, 1) if text.strip() and not text.startswith("#")]
    found = [(number, line_of(text, unit, zone_ns)) for number, text in numbered]
    found = found[1:] if found and found[0][1] is None else found
    first = next((line for _, line in found if line is not None), None)
    return [(number, line if line and first and line.fits(first) else None) for number, line in found]
