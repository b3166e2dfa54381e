"""Text logs of a speed: a line that names the format, a line that names the columns, then times and speeds.

    # $name 1
    time_s,speed_kmh
    1714550400.200,36.50

time_s     seconds since 1970, UTC but for the clock's offset
speed_kmh  km/h
"""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Decimal
from pathlib import Path
from typing import Final

import numpy as np

from recon import (
    GNSS,
    Params,
    Reader,
    ReadFailed,
    Sniff,
    Streams,
    build,
    hookimpl,
    metrics,
    quantity,
    warning,
    with_meta,
)

HEADER: Final = ("# $name 1", "time_s,speed_kmh")


class ReadParams(Params):
    """Parameters of reader.$name."""

    clock_offset: float = quantity(0.0, "s", doc="Clock of the box minus UTC.")


def read(*, path: Path, params: ReadParams) -> Streams:
    """The stream `gnss` of a log: speed m/s.

    A last line that was cut off while it was written is left out, with a warning.

    raises : ReadFailed, with the line, for what is no such log and for times that do not rise
    """
    *lines, cut = path.read_text(encoding="utf-8", errors="replace").split("\n")
    for number, expected in enumerate(HEADER, start=1):
        if lines[number - 1 : number] != [expected]:
            raise ReadFailed(path, f"this line should be '{expected}'", line=number)
    rows = [_row(path, number, line) for number, line in enumerate(lines, start=1) if number > len(HEADER)]
    t_ns = np.array([time for time, _ in rows], dtype=np.int64) - round(params.clock_offset * 1e9)
    falls = np.flatnonzero(np.diff(t_ns) <= 0)
    if len(falls):
        raise ReadFailed(path, "its time is not after that of the line above", line=len(HEADER) + 2 + int(falls[0]))
    gnss = build(GNSS, time=t_ns, speed=np.array([speed for _, speed in rows]) / 3.6)
    told = [warning("the last line is cut off and was left out")] if cut else []
    return {"gnss": with_meta(gnss, time_scale="UTC", clock="absolute"), "metrics": metrics(told)}


def _row(path: Path, number: int, line: str) -> tuple[int, float]:
    """Time in ns since 1970 and speed in km/h of one line. A double would not hold the time to the microsecond."""
    try:
        time, speed = line.split(",")
        return int(np.int64(int(Decimal(time) * 10**9))), float(speed)
    except (ValueError, ArithmeticError):  # no number, or one that is too large
        raise ReadFailed(path, f"'{line}' is not a time and a speed", line=number) from None


def sniff(path: Path, head: bytes) -> Sniff:
    """How sure it is that a file is one of these, by its first line."""
    known = head.startswith(HEADER[0].encode())
    return Sniff(0.9, "first line names the format") if known else Sniff(0.0, "another first line")


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """reader.$name."""
    yield Reader(
        name="$name",
        summary="Text logs of a speed.",
        params=ReadParams,
        run=read,
        sniff=sniff,
        writes={"gnss": GNSS.only("speed")},
    )
