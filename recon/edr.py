"""Tables of event data recorders: elements, units, resolutions and accuracies of 49 CFR part 563.

Rows count their time from time zero and are numbered by event, so these streams have no column `time`. Signs are those
of SAE J1698: forward, to the right and downwards positive, which is (x, -y, -z) of ISO 8855.

References
    49 CFR 563.7 table I and II (elements), 563.8 table III (range, accuracy, resolution); 71 FR 50998 (2006), 89 FR
    102810 (2024: pre-crash data of 20 s at 10 Hz), 91 FR 28432 (2026: phased in from 1 September 2028 on); SAE J1698-1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import pyarrow as pa

from recon.schema import Column, Schema

Rule: TypeAlias = Literal["2006", "2024"]


@dataclass(frozen=True)
class Element:
    """One element of a table: its name in the regulation, unit, resolution, and accuracy as share and as value."""

    name: str
    unit: str
    resolution: float
    share: float = 0.0
    least: float = 0.0


SPEED: Final = Element("Speed, vehicle indicated", "km/h", 1.0, least=1.0)
DELTA_V_LONG: Final = Element("Delta-V, longitudinal", "km/h", 1.0, share=0.1)
DELTA_V_LAT: Final = Element("Delta-V, lateral", "km/h", 1.0, share=0.1)
ACCELERATIONS: Final = tuple(
    Element(f"{axis} acceleration", "g", 0.5, share=0.1) for axis in ("Longitudinal", "Lateral", "Normal")
)
"""The regulation leaves them to the manufacturer; 0.5 g is what its first text had."""
ELEMENTS: Final[Mapping[str, Element]] = {
    element.name: element for element in (SPEED, DELTA_V_LONG, DELTA_V_LAT, *ACCELERATIONS)
}

PRE_CRASH: Final[Mapping[Rule, tuple[float, float]]] = {"2006": (5.0, 2.0), "2024": (20.0, 10.0)}
"""s before time zero, and samples per second, by rule."""
DELTA_V: Final = (0.25, 100.0)
"""s from time zero on, and samples per second."""
AFTER_END_S: Final = 0.03
"""s after the end of the event, where that is shorter."""
LONGEST_MAXIMUM_S: Final = 0.3
TIME_RESOLUTION_S: Final = 0.0025

NOT_TOLD: Final = (
    "engine throttle, service brake, ignition cycles, safety belts, airbag warning lamp and deployment are not known "
    "to an IMU and are left out"
)

_KEYS: Final = (
    Column("event", type=pa.int64(), doc="number of the event, from 1"),
    Column("t", "s", doc="after time zero"),
    Column("element", type=pa.string(), doc="name in 49 CFR part 563"),
    Column("unit", type=pa.string(), doc="of the element"),
)
EDR: Final = Schema((*_KEYS, Column("value"), Column("sigma")))
"""Streams edr_pre_crash and edr_crash, and recorded_pre_crash and recorded_crash of a recorder's own table."""
EDR_COMPARISON: Final = Schema(
    (
        *_KEYS,
        Column("recon", doc="as reconstructed"),
        Column("recon_std", quantity="sigma"),
        Column("edr", doc="as the recorder has it"),
        Column("edr_accuracy", doc="that the regulation asks of it"),
        Column("gnss", doc="with its delay taken off"),
        Column("agrees", type=pa.bool_(), doc="recon and edr, within accuracy and 95 %"),
    )
)
"""What is compared, row by row; `edr` is null where no recorder's table was read."""
