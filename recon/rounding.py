"""Numbers as people read them: to what their sigma lets them mean, else to so many significant digits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

_WHOLE: Final = 1e15
"""Whole numbers from here on have an exponent, too."""


def rounded(value: float, sigma: float | None = None, digits: int = 4) -> str:
    """A number to two digits of its sigma where there is one, else to so many significant digits.

    Of numbers without a sigma whole ones stay whole, zeros behind the point go, and sizes below 1e-4 and from 1e7 on
    have an exponent.
    """
    value = float(value)
    if not math.isfinite(value):
        return str(value)
    if sigma and math.isfinite(sigma):
        text = f"{value:.{max(1 - math.floor(math.log10(abs(sigma))), 0)}f}"
    elif value.is_integer() and abs(value) < _WHOLE:
        text = f"{value:.0f}"
    elif value and not 1e-4 <= abs(value) < 1e7:
        text = f"{value:.{digits - 1}e}"
    else:
        places = digits - 1 - math.floor(math.log10(abs(value))) if value else 0
        text = f"{value:.{max(places, 0)}f}"
        text = text.rstrip("0").rstrip(".") if "." in text else text
    return text if float(text) else text.lstrip("-")


def counted(number: int, noun: str) -> str:
    """`1 row`, `1,234 rows`."""
    return f"{number:,} {noun}{'s' * (number != 1)}"


def occasions(count: int) -> str:
    """`once`, else `3 times`."""
    return "once" if count == 1 else f"{count} times"


def milliseconds(time: str) -> str:
    """An ISO time with nanoseconds as `2024-05-01 08:00:05.000`, in UTC."""
    return f"{time[:10]} {time[11:23]}"


def with_unit(text: str, unit: str | None) -> str:
    """`12 km/h`; a degree sign follows its number at once, and 1 and none are no unit."""
    return text if unit in (None, "", "1") else f"{text}{'' if unit == '°' else ' '}{unit}"


def in_a_sentence(row: Mapping[str, Any], key: str = "value") -> str:
    """A number of a row of metrics, `value`, `low` or `high`, to one digit of the row's sigma, without its unit."""
    return rounded(row[key], 10.0 * row["sigma"] if row["sigma"] else None, 3)


def with_interval(row: Mapping[str, Any], unit: str) -> str:
    """A row of metrics as `12.2 km/h (95 %: 12.0 to 12.4 km/h)`; unit : as it is to be shown."""
    text = with_unit(in_a_sentence(row), unit)
    if row["low"] is None or row["high"] is None:
        return text
    return f"{text} (95 %: {in_a_sentence(row, 'low')} to {with_unit(in_a_sentence(row, 'high'), unit)})"
