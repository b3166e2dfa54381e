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
from recon_readers import _delimited

ACCEL: Final = ("ax", "ay", "az")
GYRO: Final = ("gx", "gy", "gz")
PLACE: Final = ("lat", "lon", "height", "heading", "speed")

EARLIEST_S: Final = 100_000_000
LATEST_S: Final = 1_200_000_000
"""Seconds since 2000 between which clocks that were set lie (2003 and 2038); Unix times are later than that."""
CENTURY_S: Final = 3_155_760_000


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
    """Sure of a header with the words of the format, fairly sure of rows of its width with plausible times."""
    if not head:
        return Sniff(0.0, "no file with contents")
    fault = _delimited.not_text(head)
    if fault:
        return Sniff(0.0, fault[0])
    text = head.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if text.lstrip()[:1] in (b"[", b"{"):
        return _sniff_json(text)
    if len(head) >= _delimited.HEAD_BYTES:
        text = text[: text.rfind(b"\n") + 1]
    try:
        found = _delimited.survey(path, text, WIDTHS)
        table = _delimited.parse(found, [str(index) for index in range(found.width)])
    except ReadFailed as error:
        return Sniff(0.0, error.message)
    t_ns, missing = _delimited.whole_ns(table.column(0))
    if missing.any() or (np.diff(t_ns) < 0).any():
        return Sniff(0.0, "its first column is no time that rises")
    names = set(header_names(found.header))
    if "time" in names and (names >= set(ACCEL) or names >= set(GYRO)):
        return _by_time(0.9, float(t_ns[0]) * 1e-9, "header with the words of a physycom format")
    return _by_time(0.6, float(t_ns[0]) * 1e-9, f"{found.width} columns of numbers, the first seconds since 2000")


def _sniff_json(text: bytes) -> Sniff:
    if text.lstrip()[:1] == b"{" and b'"gnss_record_' not in text:
        return Sniff(0.0, "JSON without gnss_record_ keys")
    missing = [key for key in ("lat", "lon", "timestamp", "speed") if b'"%s"' % key.encode() not in text]
    if missing:
        return Sniff(0.0, f"JSON without {missing[0]}")
    time = re.search(rb'"timestamp"\s*:\s*"?(\d{1,18}(?:\.\d{0,18})?)', text)
    return _by_time(0.9, float(time[1]) if time else -1.0, "JSON records with lat, lon, timestamp and speed")


def _by_time(confidence: float, first_s: float, reason: str) -> Sniff:
    if EARLIEST_S <= first_s <= LATEST_S:
        return Sniff(confidence, reason)
    if 0 <= first_s <= CENTURY_S:
        return Sniff(0.3 * confidence, f"{reason}, but its clock was not set or does not count from 2000")
    return Sniff(0.0, "its times are not between 2000 and 2100")
