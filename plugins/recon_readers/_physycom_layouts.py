"""How a physycom file is known by its contents: columns of each format, words of headers, plausible times."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np

from recon.errors import DataError, ReadFailed
from recon.stages import Sniff
from recon.tables import Array
from recon_readers import _delimited, _text_blocks
from recon_readers._text_blocks import Text, plain

ACCEL: Final = ("ax", "ay", "az")
GYRO: Final = ("gx", "gy", "gz")
PLACE: Final = ("lat", "lon", "height", "heading", "speed")

EARLIEST_S: Final = 100_000_000
LATEST_S: Final = 1_200_000_000
"""Seconds since 2000 between which clocks that were set lie (2003 and 2038); Unix times are later than that."""
CENTURY_S: Final = 3_155_760_000
SAME_ABS_G: Final = 0.02
"""|a| interpolated between samples that differ by d across it exceeds that of the components by up to d^2 / 8:
0.02 g for d = 0.4 g."""


@dataclass(frozen=True)
class Layout:
    """A format: its name and its columns in order."""

    name: str
    columns: tuple[str, ...]


ACC: Final = Layout("acc", ("time", *ACCEL))
GYR: Final = Layout("gyro", ("time", *GYRO))
INERTIAL: Final = Layout("inertial", ("time", "speed", *ACCEL, *GYRO, "abs", "relative"))
FULLINERTIAL: Final = Layout("fullinertial", ("time", *PLACE, *ACCEL, *GYRO, "abs", "relative"))
WIDTHS: Final = (4, 10, 14)

_WORDS: Final = {
    "time": "timestamp time t",
    "lat": "lat latitude",
    "lon": "lon lng long longitude",
    "height": "alt altitude height",
    "heading": "heading head course",
    "speed": "speed velocity vel",
    **{f"a{axis}": f"a{axis} a_{axis} acc{axis} acc_{axis} accel_{axis}" for axis in "xyz"},
    **{f"g{axis}": f"g{axis} g_{axis} gyr_{axis} gyro_{axis} w{axis} w_{axis} omega_{axis}" for axis in "xyz"},
    "abs": "|a| abs_acc acc_abs",
    "relative": "timestamp_rel time_rel t_rel relative_time",
}
_WORDS_FOUND: Final = "header with the words of a physycom format"
_HEADER: Final = (0.9, 0.6)
_STRUCTURE: Final = (0.8, 0.55)
_WIDTH: Final = (0.6, 0.2)
"""Confidence with times of a clock that was set, and with others."""
_MOSTLY: Final = 0.9
_NAME_OF: Final = {word: name for name, words in _WORDS.items() for word in words.split()}


def header_names(header: Sequence[str]) -> tuple[str, ...]:
    """Names of the columns as the header tells them, "" for a word that says nothing; empty without a telling line."""
    lines = [tuple(_NAME_OF.get(word.lower(), "") for word in _split(line)) for line in header]
    return max(lines, key=lambda names: sum(map(bool, names)), default=())


def _split(line: str) -> list[str]:
    """Words of a header line. They are parted by #, or by tabs, or by spaces; units in brackets are left out."""
    plain = re.sub(r"\([^()]*\)|\[[^\[\]]*\]", "", line.strip().removeprefix("#"))
    mark = "#" if "#" in plain else "\t" if "\t" in plain.strip() else None
    return [word.strip() for word in plain.split(mark) if word.strip()]


def layout_of(found: _delimited.Survey, sensor: Literal["accelerometer", "gyroscope"] | None) -> Layout:
    """The format of a text. `sensor` is what four columns hold where the header does not tell.

    Raises DataError where neither does, ReadFailed where the header names the columns in another order.
    """
    names = header_names(found.header)
    if found.width == len(FULLINERTIAL.columns):
        layout = FULLINERTIAL
    elif found.width == len(INERTIAL.columns):
        layout = INERTIAL
    elif set(names) & set(ACCEL + GYRO):
        layout = ACC if set(names) & set(ACCEL) else GYR
    elif sensor is not None:
        layout = ACC if sensor == "accelerometer" else GYR
    else:
        raise DataError(
            f"{found.path}: nothing tells whether its four columns hold an accelerometer or a gyroscope",
            "set reader.physycom's parameter 'sensor' to accelerometer or gyroscope, "
            "or put the line '# timestamp ax ay az' or '# timestamp gx gy gz' on top",
        )
    if len(names) == found.width:
        for number, (name, wanted) in enumerate(zip(names, layout.columns, strict=True), start=1):
            if name and name != wanted:
                what = f"its header calls column {number} {name}, where the format {layout.name} has {wanted}"
                raise ReadFailed(found.path, what, hint=f"put the columns in the order {' '.join(layout.columns)}")
    return layout


def sniff(path: Path, head: bytes) -> Sniff:
    """Sure of a header with the words of a format, or of rows that are made like its rows.

    Faults of single rows do not matter: the reader names them better. A clock that was not set leaves less certainty.
    """
    if not head:
        return Sniff(0.0, "no file with contents")
    fault = _text_blocks.not_text(head)
    if fault:
        return Sniff(0.0, ": ".join(fault))
    text = plain(head)
    if text.lstrip()[:1] in (b"[", b"{"):
        return _sniff_json(text)
    if len(head) >= _text_blocks.HEAD_BYTES and b"\n" in text:
        text = text[: text.rfind(b"\n") + 1]
    told = False
    try:
        told = _tells(header_names(_delimited.header_of(path, text)))
        found = _delimited.survey(path, Text.of(path, text), WIDTHS)
    except ReadFailed as error:
        return Sniff(_HEADER[0], _WORDS_FOUND) if told else Sniff(0.0, error.what)
    return _sniff_rows(_delimited.values(found), told)


def _tells(names: Sequence[str]) -> bool:
    """Do the words of a header name the columns of a format, in whatever order?"""
    return len(names) in WIDTHS and "time" in names and (set(names) >= set(ACCEL) or set(names) >= set(GYRO))


def _sniff_rows(rows: Array, told: bool) -> Sniff:
    """What the first rows show. rows : (n, k), NaN where there is no number; told : does the header name a format?"""
    time = rows[~np.isnan(rows[:, 0]), 0]
    if told:
        return _by_time(_HEADER, time, _WORDS_FOUND)
    falls = np.diff(time) < 0
    if len(time) <= len(rows) / 2 or np.count_nonzero(falls) > (1 - _MOSTLY) * len(falls):
        return Sniff(0.0, "its first column is no time that rises")
    if not 0 <= np.median(time) <= CENTURY_S:
        return Sniff(0.0, "its times are not between 2000 and 2100")
    about = f"{rows.shape[1]} columns of numbers"
    if _holds_size(rows):
        return _by_time(_STRUCTURE, time, f"{about}, |a| where the format has it")
    return _by_time(_WIDTH, time, about)


def _holds_size(rows: Array) -> bool:
    """Is the column before the last the size of the acceleration, as in formats of 10 and 14 columns?"""
    if rows.shape[1] == len(ACC.columns):
        return False
    accel, size = rows[:, -8:-5], rows[:, -2]
    same = np.abs(np.linalg.norm(accel, axis=1) - size) <= SAME_ABS_G
    return bool(np.mean(same & (size > 0)) >= _MOSTLY)


def _sniff_json(text: bytes) -> Sniff:
    if text.lstrip()[:1] == b"{" and b'"gnss_record_' not in text:
        return Sniff(0.0, "JSON without gnss_record_ keys")
    missing = [key for key in ("lat", "lon", "timestamp", "speed") if b'"%s"' % key.encode() not in text]
    if missing:
        return Sniff(0.0, f"JSON without {missing[0]}")
    times = re.findall(rb'"timestamp"\s*:\s*"?(\d{1,18}(?:\.\d{0,18})?)\b', text)
    if not times:
        return Sniff(0.0, "JSON whose timestamps are no numbers")
    return _by_time(_HEADER, np.array(times, dtype=np.float64), "JSON records with lat, lon, timestamp and speed")


def _by_time(sure: tuple[float, float], time_s: Array, reason: str) -> Sniff:
    """Less sure where most times are those of a clock that was not set or does not count from 2000.

    sure : with times as they should be, and with others; time_s : (n,) s
    """
    if not len(time_s) or EARLIEST_S <= np.median(time_s) <= LATEST_S:
        return Sniff(sure[0], reason)
    return Sniff(sure[1], f"{reason}, but its clock was not set or does not count from 2000")
