"""Rates and errors of typical sensors, as their data sheets give them.

| preset        | IMU                              | GNSS receiver                         |
|---------------|----------------------------------|---------------------------------------|
| perfect       | no error                         | no error, and fast                    |
| consumer_mems | of the order of Bosch BMI160     | one frequency, as u-blox NEO-M8       |
| automotive    | of the order of ST ASM330LHH     | two frequencies, as u-blox ZED-F9P    |

A data sheet tells noise, resolution and range; the sigma of bias and scale is a third to a half of its tolerance. It is
silent on the random walk of the biases and the correlation time of positions: these are of the order that logs show.

References: data sheets of Bosch BMI160 (BST-BMI160-DS000-07, 2015), ST ASM330LHH (DocID031239 rev. 3, 2019), u-blox
NEO-M8 (UBX-15031086) and ZED-F9P (UBX-17051259).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from recon.units import parse_quantity, si_unit

PRESETS: Final = ("perfect", "consumer_mems", "automotive")
"""The columns of the table."""

# gnss_horizontal is per axis: a data sheet's circle that holds half of the fixes has 1.18 times this radius.
_TABLE: Final[Mapping[str, tuple[str, str, str]]] = {
    "imu_rate": ("100 Hz", "100 Hz", "100 Hz"),
    "accel_noise": ("0 ug/sqrt(Hz)", "180 ug/sqrt(Hz)", "60 ug/sqrt(Hz)"),
    "gyro_noise": ("0 deg/s/sqrt(Hz)", "0.007 deg/s/sqrt(Hz)", "0.005 deg/s/sqrt(Hz)"),
    "accel_bias": ("0 mg", "20 mg", "5 mg"),
    "gyro_bias": ("0 deg/s", "1 deg/s", "0.3 deg/s"),
    "accel_bias_walk": ("0 ug/sqrt(s)", "30 ug/sqrt(s)", "10 ug/sqrt(s)"),
    "gyro_bias_walk": ("0 deg/s/sqrt(s)", "0.0004 deg/s/sqrt(s)", "0.0001 deg/s/sqrt(s)"),
    "accel_scale": ("0 %", "0.5 %", "0.2 %"),
    "gyro_scale": ("0 %", "0.5 %", "0.3 %"),
    "accel_quantisation": ("0 mg", "0.488 mg", "0.244 mg"),
    "gyro_quantisation": ("0 deg/s", "0.0153 deg/s", "0.00875 deg/s"),
    "accel_full_scale": ("1e6 g", "16 g", "8 g"),
    "gyro_full_scale": ("1e6 deg/s", "500 deg/s", "250 deg/s"),
    "gnss_rate": ("10 Hz", "1 Hz", "5 Hz"),
    "gnss_horizontal": ("0 m", "2 m", "1 m"),
    "gnss_vertical": ("0 m", "3.5 m", "1.5 m"),
    "gnss_correlation": ("0 s", "100 s", "100 s"),
    "gnss_velocity": ("0 m/s", "0.05 m/s", "0.03 m/s"),
}

NAMES: Final = tuple(_TABLE)
"""The rows of the table."""


def preset_value(preset: str, name: str) -> float:
    """One value in SI. Raises ValueError or KeyError for an unknown preset or name."""
    text = _TABLE[name][PRESETS.index(preset)]
    _, unit = text.split(maxsplit=1)
    return parse_quantity(text, si_unit(unit))
