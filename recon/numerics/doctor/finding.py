"""What was found of one convention: confirmed, contradicted, or not to be told, with the number that says so."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Status = Literal["confirmed", "contradicted", "unknown"]

SURE: Final = 0.999
"""Confidence of what needs no statistics: a count, a comparison of two numbers far apart."""
_UNITS: Final[Mapping[str, str]] = {
    **dict.fromkeys(("gnss_position_lag", "gnss_velocity_lag", "leap_seconds", "gaps", "jitter"), "s"),
    "mounting": "deg",
    "clock_drift": "ppm",
    "time_zone": "h",
    "height_datum": "m",
    "duplicates": "of the rows",
    "reversals": "rows",
    "gnss_sigma": "times",
    "noise_class": "times",
}
"""Of the values that are numbers, by code, where a finding does not say another."""


@dataclass(frozen=True)
class Curve:
    """A line, or points, of evidence over time. t_s : (n,) s; values : (n,); name : for the legend."""

    name: str
    t_s: Floats
    values: Floats
    points: bool = False


@dataclass(frozen=True)
class Picture:
    """What shows the evidence over time, in one unit."""

    title: str
    unit: str
    curves: tuple[Curve, ...]


@dataclass(frozen=True)
class Finding:
    """One convention and what the data say of it.

    value : what the data show, in the words or the unit of the code, None where nothing
    confidence : 0 to 1, that the status is right
    statistic : the numbers that it rests on, by name, units in the names
    explanation : for somebody who knows his vehicle and no navigation
    yaml : what to write into a pipeline, "" where nothing need be done
    unit : of a value that is a number, or what is counted; else ""
    """

    code: str
    status: Status
    value: float | str | None
    confidence: float
    statistic: Mapping[str, float]
    explanation: str
    yaml: str = ""
    picture: Picture | None = field(default=None, compare=False)
    unit: str = ""

    def __post_init__(self) -> None:
        if not self.unit and isinstance(self.value, float | int):
            object.__setattr__(self, "unit", _UNITS.get(self.code, ""))

    def shown_by(self, picture: Picture) -> Finding:
        """With the evidence."""
        return replace(self, picture=picture)


def confirmed(
    code: str, value: float | str | None, explanation: str, confidence: float = SURE, **statistic: float
) -> Finding:
    """The data agree with the convention."""
    return Finding(code, "confirmed", value, confidence, statistic, explanation)


def contradicted(
    code: str,
    value: float | str | None,
    explanation: str,
    confidence: float = SURE,
    **statistic: float,
) -> Finding:
    """The data contradict the convention."""
    return Finding(code, "contradicted", value, confidence, statistic, explanation)


def unknown(code: str, explanation: str, **statistic: float) -> Finding:
    """The data cannot tell."""
    return Finding(code, "unknown", None, 0.0, statistic, explanation)


def confidence_of(deviations: float) -> float:
    """That a normal error is not so many standard deviations large; 0.999 at most, for models are never exact."""
    return min(math.erf(abs(deviations) / math.sqrt(2.0)), SURE)
