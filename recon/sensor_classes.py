"""What to expect of a sensor of a class, before its noise is estimated from the drive.

| class         | IMU of the order of                        | typical use                          |
|---------------|--------------------------------------------|--------------------------------------|
| consumer_mems | Bosch BMI160, phones, dash cameras         | the default                          |
| automotive    | ST ASM330LHH, telematics boxes             | stability control, insurance         |
| industrial    | ADI ADIS16470                              | robots, test vehicles                |
| tactical      | Honeywell HG4930                           | survey, reference systems            |

The noise is that of a moving car, above that of the data sheet; sigma of bias and scale is a third to a half of its
tolerance. GNSS is a receiver of one frequency under an open sky.

References: data sheets of Bosch BMI160 (BST-BMI160-DS000-07, 2015), ST ASM330LHH (DocID031239 rev. 3, 2019), ADI
ADIS16470 (rev. C, 2019), Honeywell HG4930 (N61-1677-000-002, 2018).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Final, Literal, TypeAlias, get_args

from recon.units import parse_quantity, si_unit

SensorClass: TypeAlias = Literal["consumer_mems", "automotive", "industrial", "tactical"]
CLASSES: Final[tuple[str, ...]] = get_args(SensorClass)

_TABLE: Final[Mapping[str, tuple[str, str, str, str]]] = {
    "gyro_noise": (
        "0.01 deg/s/sqrt(Hz)", "0.008 deg/s/sqrt(Hz)", "0.004 deg/s/sqrt(Hz)", "0.001 deg/s/sqrt(Hz)"
    ),
    "accel_noise": ("150 ug/sqrt(Hz)", "100 ug/sqrt(Hz)", "50 ug/sqrt(Hz)", "30 ug/sqrt(Hz)"),
    "gyro_bias_walk": (
        "2.5e-4 deg/s/sqrt(s)", "2e-4 deg/s/sqrt(s)", "5e-5 deg/s/sqrt(s)", "5e-6 deg/s/sqrt(s)"
    ),
    "accel_bias_walk": ("30 ug/sqrt(s)", "15 ug/sqrt(s)", "5 ug/sqrt(s)", "1 ug/sqrt(s)"),
    "gyro_bias": ("1 deg/s", "0.5 deg/s", "0.2 deg/s", "0.02 deg/s"),
    "accel_bias": ("50 mg", "20 mg", "5 mg", "2 mg"),
    "gyro_scale": ("0.5 %", "0.3 %", "0.1 %", "0.03 %"),
    "accel_scale": ("0.4 %", "0.2 %", "0.1 %", "0.03 %"),
}  # fmt: skip

NAMES: Final = tuple(_TABLE)
"""The rows of the table."""


@cache
def typical(sensor_class: str, name: str) -> float:
    """One value in SI. Raises ValueError or KeyError for an unknown class or name."""
    text = _TABLE[name][CLASSES.index(sensor_class)]
    _, unit = text.split(maxsplit=1)
    return parse_quantity(text, si_unit(unit))
