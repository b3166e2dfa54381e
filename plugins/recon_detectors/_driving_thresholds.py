"""Named, versioned limits of harsh driving, from the data file beside this module."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, Final

from recon.units import parse_quantity

KINDS: Final = ("harsh_acceleration", "harsh_braking", "harsh_cornering")
_UNITS: Final = {**dict.fromkeys(KINDS, "m/s^2"), "cutoff": "Hz", "min_duration": "s", "min_speed": "m/s", "merge": "s"}


@dataclass(frozen=True)
class Thresholds:
    """A set. limits : m/s^2 by kind of event; cutoff : Hz; min_duration, merge : s; min_speed : m/s"""

    name: str
    version: int
    source: str
    limits: Mapping[str, float]
    cutoff: float
    min_duration: float
    min_speed: float
    merge: float


@cache
def sets() -> Mapping[str, Thresholds]:
    """All sets by name."""
    import yaml

    text = (files("recon_detectors") / "driving_thresholds.yaml").read_text(encoding="utf-8")
    return {name: _of(name, entry) for name, entry in yaml.safe_load(text).items()}


def _of(name: str, entry: Mapping[str, Any]) -> Thresholds:
    found = {key: parse_quantity(entry[key], into=unit) for key, unit in _UNITS.items()}
    limits = {kind: found.pop(kind) for kind in KINDS}
    return Thresholds(name, entry["version"], entry["source"].strip(), limits, **found)
