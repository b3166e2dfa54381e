"""What the header and the values of a column suggest: words, unit, kind of time. For the proposal of a mapping only."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
import pyarrow as pa

from recon.tables import Array
from recon.units import UnitError, parse_unit
from recon_readers._csv_sheet import Sheet, trimmed

_UNIT_WORDS: Final = {
    "mps2": "m/s^2", "ms2": "m/s^2", "mps": "m/s", "kmh": "km/h", "kph": "km/h", "dps": "deg/s", "degs": "deg/s",
    "rads": "rad/s", "rps": "rad/s", "ut": "uT", "deg": "deg", "rad": "rad", "g": "g", "mg": "mg", "m": "m", "s": "s",
    "ms": "ms", "us": "us", "ns": "ns", "sec": "s", "seconds": "s", "millis": "ms", "micros": "us", "nanos": "ns",
    "hpa": "hPa", "pa": "Pa",
}  # fmt: skip
"""Last word of a header that is a unit."""
_UNIX: Final = ((1e9, 2.3e9, "s"), (1e12, 2.3e12, "ms"), (1e15, 2.3e15, "us"), (1e18, 2.3e18, "ns"))
_TEXT_TIMES: Final = (
    ("iso", r"^\d{4}[-/.]\d{1,2}[-/.]\d{1,2}[T ]\d{1,2}:\d\d"),
    ("day_first", r"^\d{1,2}[-/.]\d{1,2}[-/.]\d{4}[T ]\d{1,2}:\d\d"),
    ("time_of_day", r"^\d{1,2}:\d\d:\d\d"),
)
_TEXT_DATES: Final = (
    ("iso", r"\d{4}[-/.]\d{1,2}[-/.]\d{1,2}"),
    ("day_first", r"\d{1,2}[-/.]\d{1,2}[-/.]\d{4}"),
)
_NO_ZONE: Final = 'zone: "+00:00"'
_LOOK_AT: Final = 100
_LARGEST: Final = 1e20
"""No sensor and no clock shows more."""
_ZONE: Final = r"(?:[Zz]|UTC|GMT|[+-]\d\d:?\d\d)$"


@dataclass(frozen=True)
class Look:
    """A column.

    title : its word in the header, "" where there is none; words : that taken apart, in lower case, without its unit
    texts : (n,) texts; values : (n,) doubles, NaN where blank, None where it does not hold numbers
    """

    index: int
    title: str
    words: tuple[str, ...]
    unit: str
    texts: pa.ChunkedArray
    values: Array | None

    @property
    def phrase(self) -> str:
        """Its words, parted by spaces."""
        return " ".join(self.words)

    @property
    def known(self) -> np.ndarray:
        """Rows that are not blank: (n,) bool."""
        return np.asarray(self.texts.is_valid())


@dataclass(frozen=True)
class TimeLook:
    """How a column may tell the time: the rest of its YAML, why, and a rank among several."""

    columns: tuple[Look, ...]
    yaml: str
    reason: str
    rank: float

    def seconds(self) -> float | None:
        """From the first to the last time, None where the column holds texts."""
        values, unit = self.columns[-1].values, re.search(r"unit: (\w+)", self.yaml)
        if values is None:
            return None
        scale = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}.get(unit[1], 1.0) if unit else 1.0
        return float(np.nanmax(values) - np.nanmin(values)) * scale


def look_at(sheet: Sheet) -> list[Look]:
    """Every column that holds something."""
    blocks = [cells.texts for cells in sheet.read((), range(sheet.width))]
    found = []
    for index in blocks[0]:
        texts = pa.chunked_array([chunk for block in blocks for chunk in block[index].chunks])
        if texts.null_count < len(texts):
            title = sheet.names[index] if sheet.names else ""
            words, unit = _words(title)
            found.append(Look(index, title, words, unit, texts, _numbers(sheet, texts)))
    return found


def _words(title: str) -> tuple[tuple[str, ...], str]:
    """The words of a header in lower case, and its unit, "" where it names none."""
    unit = ""
    for bracketed in re.findall(r"[(\[]([^()\[\]]{1,20})[)\]]", title):
        known = _UNIT_WORDS.get(bracketed.lower(), bracketed)
        try:
            unit = parse_unit(known).text
        except UnitError:
            continue
    plain = re.sub(r"[(\[][^()\[\]]*[)\]]", " ", title)
    plain = re.sub(r"(?<=[a-z])(?=[A-Z][a-z])|(?<=[a-z])(?=[XYZ]\b)", " ", plain)
    words = [word for word in re.split(r"[^a-z0-9]+", plain.lower()) if word]
    if len(words) > 1 and words[-1] in _UNIT_WORDS and not unit:
        unit = _UNIT_WORDS[words.pop()]
    return tuple(words), unit


def _numbers(sheet: Sheet, texts: pa.ChunkedArray) -> Array | None:
    from pyarrow import compute

    plain = compute.replace_substring(texts, ",", ".") if sheet.decimal == "comma" else texts
    try:
        values = np.asarray(trimmed(plain).cast(pa.float64()).to_numpy(), dtype=np.float64)
    except pa.ArrowInvalid:
        return None
    usable = np.abs(values) < _LARGEST
    return np.where(usable, values, np.nan) if usable.any() else None


def time_looks(looks: Sequence[Look]) -> list[TimeLook]:
    """Every way in which columns may tell the time."""
    found = [look for look in map(_time_look, looks) if look is not None]
    weeks = [look for look in looks if "week" in look.words and look.values is not None]
    seconds = [look for look in looks if {"sow", "tow"} & set(look.words) or look.phrase == "seconds of week"]
    if weeks and seconds and seconds[0].values is not None:
        unit = ", unit: ms" if np.nanmax(seconds[0].values) > 604_800 else ""
        found.append(TimeLook((weeks[0], seconds[0]), f"format: gps_week{unit}", "GPS week and seconds", 0.6))
    return [*_zoned(found), *_dated(looks)]


def _zoned(times: Sequence[TimeLook]) -> list[TimeLook]:
    """Texts that name no zone take the one in which they agree with a column of Unix times, where there is one."""
    unix = next((time for time in times if time.yaml == "format: unix"), None)
    if unix is None:
        return list(times)
    found = []
    for time in times:
        if time.yaml == f"format: iso, {_NO_ZONE}":
            zone = _agreeing_zone(time.columns[0], unix.columns[0])
            if zone:
                reason = f"check: so it agrees with {unix.columns[0].title or 'the column of Unix times'}"
                time = replace(time, yaml=f'format: iso, zone: "{zone}"', reason=reason)
        found.append(time)
    return found


def _agreeing_zone(local: Look, unix: Look) -> str:
    """Local time minus Unix time as +HH:MM, "" where that is no whole quarter of an hour give or take a minute."""
    row = int(np.argmax(local.known & unix.known))
    if unix.values is None or not (local.known & unix.known)[row]:
        return ""
    text = re.sub(r"[T ]+", "T", re.sub("[/.]", "-", local.texts[row].as_py()[:10]) + local.texts[row].as_py()[10:19])
    try:
        ahead = float((np.datetime64(text, "s") - np.datetime64(0, "s")).astype(np.int64)) - float(unix.values[row])
    except ValueError:
        return ""
    quarters = round(ahead / 900.0)
    if abs(ahead - 900.0 * quarters) > 60.0 or abs(quarters) > 56:
        return ""
    return f"{'-' if quarters < 0 else '+'}{abs(quarters) // 4:02d}:{abs(quarters) % 4 * 15:02d}"


def _dated(looks: Sequence[Look]) -> list[TimeLook]:
    """Times of day with a column of dates in front of them."""
    found = []
    for date, clock in pairwise(looks):
        time = _text_time(clock) if clock.values is None else None
        if time is None or time.yaml != "format: time_of_day" or date.values is not None:
            continue
        for name, pattern in _TEXT_DATES:
            if all(re.fullmatch(pattern, text) for text in date.texts.drop_null()[:_LOOK_AT].to_pylist()):
                scale = ", scale: GPS" if "gpst" in (*date.words, *clock.words) else f", {_NO_ZONE}"
                found.append(TimeLook((date, clock), f"format: {name}{scale}", "check: date and time", 0.45))
    return found


def _time_look(look: Look) -> TimeLook | None:
    if look.values is None:
        return _text_time(look)
    values = look.values[~np.isnan(look.values)]
    steps = np.diff(values)
    if len(values) < 2 or np.mean(steps >= 0) < 0.98 or values[-1] <= values[0]:
        return None
    same = float(np.mean(steps == 0))
    for low, high, unit in _UNIX:
        if low <= np.median(values) < high:
            shown = f"format: unix, unit: {unit}" if unit != "s" else "format: unix"
            return TimeLook((look,), shown, f"{values[0]:.6g} is a date as {unit} since 1970", 0.5 - same)
    named = set(look.words) & {
        "time",
        "timestamp",
        "t",
        "ts",
        "uptime",
        "elapsed",
        "stamp",
        "millis",
        "seconds",
        "date",
    }
    if look.title and not (named or look.words == () or any("time" in word for word in look.words)):
        return None
    if not look.title and same > 0:
        return None
    unit, reason = _relative_unit(look, float(np.median(steps[steps > 0])))
    return TimeLook((look,), f"format: relative, unit: {unit}", reason, 0.1 * bool(named) - same)


def _relative_unit(look: Look, step: float) -> tuple[str, str]:
    named = [_UNIT_WORDS[word] for word in look.words if word in _UNIT_WORDS]
    hint = look.unit or next(iter(named), "")
    if hint in ("s", "ms", "us", "ns"):
        return hint, f"its header says {hint}; 'start: 2026-06-08T14:54:08Z' would give the date"
    if re.search("nano", look.phrase):
        return "ns", "its header says nanoseconds"
    unit = "s" if step < 2 else "ms" if step < 2000 else "us" if step < 2e6 else "ns"
    return unit, f"check: median step {step:.4g}; a date is not told"


def _text_time(look: Look) -> TimeLook | None:
    from pyarrow import compute

    texts = look.texts.drop_null()
    for name, pattern in _TEXT_TIMES:
        if compute.all(compute.match_substring_regex(texts, pattern)).as_py():
            same = float(np.mean(np.asarray(compute.equal(texts[1:], texts[:-1])))) if len(texts) > 1 else 0.0
            zoned = compute.all(compute.match_substring_regex(texts, _ZONE)).as_py()
            zone = "" if zoned or name == "time_of_day" else f", {_NO_ZONE}"
            reason = "texts with their zone" if zoned else "check: the texts name no zone"
            if name == "day_first":
                reason = "check: day before month? no zone is named"
            if name == "time_of_day":
                reason = "check: 'start: 2026-06-08' would give the date"
            return TimeLook((look,), f"format: {name}{zone}", reason, 0.4 - same)
    return None
