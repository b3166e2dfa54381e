"""Rates, errors and installation of typical sensors.

| preset        | IMU                                | GNSS receiver                                       |
|---------------|------------------------------------|-----------------------------------------------------|
| perfect       | no error                           | no error, and fast                                  |
| consumer_mems | of the order of Bosch BMI160       | one frequency, as u-blox NEO-M8                     |
| automotive    | of the order of ST ASM330LHH       | two frequencies, as u-blox ZED-F9P                  |
| rtk           | that of automotive                 | ZED-F9P with corrections of a base: centimetres     |
| industrial    | of the order of ADI ADIS16470      | as automotive                                       |
| tactical      | of the order of Honeywell HG4930   | as rtk                                              |
| phone         | as consumer_mems, jittery          | as consumer_mems; a magnetometer beside it          |
| study_one     | the error statistics under which the estimator was first studied: matched noise, no scale errors  |
| study_two     | those under which it was studied next: scale errors, vibration, quantisation, long bursts         |

The phone sits in a holder on the dashboard, in landscape, screen to the driver: its x axis (to the right of the screen)
points up, y (to the top of it) left, z (out of it) back. Its magnetometer feels the iron of phone and car, and what the
car passes.

A data sheet tells noise, resolution and range; the sigma of bias and scale is a third to a half of its tolerance. It is
silent on the random walk of the biases and the correlation time of positions: these are of the order that logs show.
The two studies also say how the box and the antenna are installed, how soft the car is, and where fixes fail; each was
made of drives of its own, `country` and `mixed`.

References: data sheets of Bosch BMI160 (BST-BMI160-DS000-07, 2015), ST ASM330LHH (DocID031239 rev. 3, 2019), ADI
ADIS16470 (rev. C, 2019), Honeywell HG4930 (N61-1677-000-002, 2018), u-blox NEO-M8 (UBX-15031086) and ZED-F9P
(UBX-17051259).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from recon.units import parse_quantity, si_unit

_PERFECT: Final[Mapping[str, Any]] = {
    "imu_rate": "100 Hz",
    "accel_noise": "0 ug/sqrt(Hz)",
    "gyro_noise": "0 deg/s/sqrt(Hz)",
    "accel_bias": "0 mg",
    "gyro_bias": "0 deg/s",
    "accel_bias_walk": "0 ug/sqrt(s)",
    "gyro_bias_walk": "0 deg/s/sqrt(s)",
    "accel_instability": "0 mg",
    "gyro_instability": "0 deg/h",
    "accel_scale": "0 %",
    "gyro_scale": "0 %",
    "accel_vibration": "0 m/s^2",
    "gyro_vibration": "0 deg/s",
    "accel_quantisation": "0 mg",
    "gyro_quantisation": "0 deg/s",
    "accel_full_scale": "1e6 g",
    "gyro_full_scale": "1e6 deg/s",
    "mount_roll": "0 deg",
    "mount_pitch": "0 deg",
    "mount_yaw": "0 deg",
    "rear_axle": ("0 m", "0 m", "0 m"),
    "body_slip": "0 deg/(m/s^2)",
    "body_pitch": "0 deg/(m/s^2)",
    "body_roll": "0 deg/(m/s^2)",
    "body_bounce": "0 deg",
    "body_heave": "0 m",
    "gnss_rate": "10 Hz",
    "gnss_horizontal": "0 m",
    "gnss_vertical": "0 m",
    "gnss_correlation": "0 s",
    "gnss_white_horizontal": "0 m",
    "gnss_white_vertical": "0 m",
    "gnss_velocity": "0 m/s",
    "gnss_velocity_vertical": "0 m/s",
    "lever_arm": ("0 m", "0 m", "0 m"),
    "multipath": "0 %",
    "multipath_size": ("10 m", "50 m"),
    "multipath_length": ("3 s", "15 s"),
    "multipath_single": "0 %",
    "multipath_velocity": ("1 m/s",),
    "outage_rate": "0 1/h",
    "mag_rate": "0 Hz",
    "mag_noise": "0 uT",
    "mag_hard_iron": "0 uT",
    "mag_soft_iron": "0 %",
    "mag_disturbance_rate": "0 1/h",
    "mag_disturbance": ("10 uT", "60 uT"),
    "mag_disturbance_length": ("2 s", "10 s"),
}
"""Every value that a preset gives, here without error; a preset names those that it has otherwise."""

_CONSUMER_IMU: Final = {
    "accel_noise": "180 ug/sqrt(Hz)",
    "gyro_noise": "0.007 deg/s/sqrt(Hz)",
    "accel_bias": "20 mg",
    "gyro_bias": "1 deg/s",
    "accel_bias_walk": "30 ug/sqrt(s)",
    "gyro_bias_walk": "0.0004 deg/s/sqrt(s)",
    "accel_scale": "0.5 %",
    "gyro_scale": "0.5 %",
    "accel_quantisation": "0.488 mg",
    "gyro_quantisation": "0.0153 deg/s",
    "accel_full_scale": "16 g",
    "gyro_full_scale": "500 deg/s",
}
_AUTOMOTIVE_IMU: Final = {
    "accel_noise": "60 ug/sqrt(Hz)",
    "gyro_noise": "0.005 deg/s/sqrt(Hz)",
    "accel_bias": "5 mg",
    "gyro_bias": "0.3 deg/s",
    "accel_bias_walk": "10 ug/sqrt(s)",
    "gyro_bias_walk": "0.0001 deg/s/sqrt(s)",
    "accel_scale": "0.2 %",
    "gyro_scale": "0.3 %",
    "accel_quantisation": "0.244 mg",
    "gyro_quantisation": "0.00875 deg/s",
    "accel_full_scale": "8 g",
    "gyro_full_scale": "250 deg/s",
}
_INDUSTRIAL_IMU: Final = {
    "imu_rate": "200 Hz",
    "accel_noise": "100 ug/sqrt(Hz)",
    "gyro_noise": "0.006 deg/s/sqrt(Hz)",
    "accel_bias": "2 mg",
    "gyro_bias": "0.1 deg/s",
    "accel_bias_walk": "3 ug/sqrt(s)",
    "gyro_bias_walk": "0.00003 deg/s/sqrt(s)",
    "accel_instability": "0.013 mg",
    "gyro_instability": "8 deg/h",
    "accel_scale": "0.1 %",
    "gyro_scale": "0.1 %",
    "accel_quantisation": "0.00002 g",
    "gyro_quantisation": "0.0001 deg/s",
    "accel_full_scale": "40 g",
    "gyro_full_scale": "2000 deg/s",
}
_TACTICAL_IMU: Final = {
    "imu_rate": "200 Hz",
    "accel_noise": "50 ug/sqrt(Hz)",
    "gyro_noise": "0.0007 deg/s/sqrt(Hz)",
    "accel_bias": "1 mg",
    "gyro_bias": "7 deg/h",
    "accel_bias_walk": "1 ug/sqrt(s)",
    "gyro_bias_walk": "0.000001 deg/s/sqrt(s)",
    "accel_instability": "0.025 mg",
    "gyro_instability": "0.25 deg/h",
    "accel_scale": "0.03 %",
    "gyro_scale": "0.03 %",
    "accel_full_scale": "20 g",
    "gyro_full_scale": "400 deg/s",
}
# gnss_horizontal is per axis: a data sheet's circle that holds half of the fixes has 1.18 times this radius.
_ONE_FREQUENCY: Final = {
    "gnss_rate": "1 Hz",
    "gnss_horizontal": "2 m",
    "gnss_vertical": "3.5 m",
    "gnss_correlation": "100 s",
    "gnss_velocity": "0.05 m/s",
    "gnss_velocity_vertical": "0.05 m/s",
}
_TWO_FREQUENCIES: Final = {
    "gnss_rate": "5 Hz",
    "gnss_horizontal": "1 m",
    "gnss_vertical": "1.5 m",
    "gnss_correlation": "100 s",
    "gnss_velocity": "0.03 m/s",
    "gnss_velocity_vertical": "0.03 m/s",
}
_CORRECTED: Final = {
    "gnss_rate": "5 Hz",
    "gnss_white_horizontal": "0.01 m",
    "gnss_white_vertical": "0.02 m",
    "gnss_velocity": "0.03 m/s",
    "gnss_velocity_vertical": "0.03 m/s",
}
_STUDY_ONE: Final = {
    "accel_noise": "150 ug/sqrt(Hz)",
    "gyro_noise": "0.01 deg/s/sqrt(Hz)",
    "accel_bias": "25 mg",
    "gyro_bias": "0.5 deg/s",
    "accel_bias_walk": "20 ug/sqrt(s)",
    "gyro_bias_walk": "0.0002 deg/s/sqrt(s)",
    "mount_yaw": "12 deg",
    "mount_pitch": "4 deg",
    "mount_roll": "-3 deg",
    "rear_axle": ("-1.2 m", "0.2 m", "-0.4 m"),
    "body_slip": "0.0025 rad/(m/s^2)",
    "body_pitch": "0.008 rad/(m/s^2)",
    "body_roll": "0.01 rad/(m/s^2)",
    "body_bounce": "0.15 deg",
    "body_heave": "4 mm",
    "gnss_rate": "1 Hz",
    "gnss_horizontal": "1.5 m",
    "gnss_vertical": "2.55 m",
    "gnss_correlation": "60 s",
    "gnss_white_horizontal": "0.8 m",
    "gnss_white_vertical": "1.5 m",
    "gnss_velocity": "0.1 m/s",
    "gnss_velocity_vertical": "0.15 m/s",
    "lever_arm": ("0.8 m", "-0.3 m", "1.1 m"),
    "multipath": "3 %",
    "multipath_size": ("10 m", "50 m"),
    "multipath_length": ("2 s", "7 s"),
    "multipath_single": "60 %",
    "multipath_velocity": ("0.3 m/s", "2 m/s"),
}
# Not told of the second study, and chosen here: the random walks (which after an hour are as large as the instability),
# the leaning in bends, and the velocity errors of bursts.
_STUDY_TWO: Final = {
    "accel_noise": "0.1 m/s/sqrt(h)",
    "gyro_noise": "0.2 deg/sqrt(h)",
    "accel_bias": "20 mg",
    "gyro_bias": "0.5 deg/s",
    "accel_bias_walk": "5 ug/sqrt(s)",
    "gyro_bias_walk": "0.00005 deg/s/sqrt(s)",
    "accel_instability": "0.3 mg",
    "gyro_instability": "10 deg/h",
    "accel_scale": "0.4 %",
    "gyro_scale": "0.5 %",
    "accel_vibration": "0.3 m/s^2",
    "gyro_vibration": "0.3 deg/s",
    "accel_quantisation": "1 mg",
    "gyro_quantisation": "0.0166666666666666667 deg/s",
    "mount_yaw": "12 deg",
    "mount_pitch": "4 deg",
    "mount_roll": "-3 deg",
    "rear_axle": ("-1.2 m", "-0.1 m", "0.6 m"),
    "body_slip": "0.00262 rad/(m/s^2)",
    "body_pitch": "0.00611 rad/(m/s^2)",
    "body_roll": "0.0087 rad/(m/s^2)",
    "gnss_rate": "1 Hz",
    "gnss_horizontal": "1.8 m",
    "gnss_vertical": "3 m",
    "gnss_correlation": "120 s",
    "gnss_white_horizontal": "1.1 m",
    "gnss_white_vertical": "1.8 m",
    "gnss_velocity": "0.1 m/s",
    "gnss_velocity_vertical": "0.15 m/s",
    "lever_arm": ("0.5 m", "-0.3 m", "-0.8 m"),
    "multipath": "5 %",
    "multipath_size": ("8 m", "35 m"),
    "multipath_length": ("3 s", "18 s"),
    "outage_rate": "8 1/h",
}
_PHONE: Final = {
    "mount_yaw": "4 deg",
    "mount_pitch": "-68 deg",
    "mount_roll": "3 deg",
    "mag_rate": "50 Hz",
    "mag_noise": "0.5 uT",
    "mag_hard_iron": "15 uT",
    "mag_soft_iron": "4 %",
    "mag_disturbance_rate": "20 1/h",
}

_PRESETS: Final[Mapping[str, Mapping[str, Any]]] = {
    "perfect": {},
    "consumer_mems": {**_CONSUMER_IMU, **_ONE_FREQUENCY},
    "automotive": {**_AUTOMOTIVE_IMU, **_TWO_FREQUENCIES},
    "rtk": {**_AUTOMOTIVE_IMU, **_CORRECTED},
    "industrial": {**_INDUSTRIAL_IMU, **_TWO_FREQUENCIES},
    "tactical": {**_TACTICAL_IMU, **_CORRECTED},
    "phone": {**_CONSUMER_IMU, **_ONE_FREQUENCY, **_PHONE},
    "study_one": _STUDY_ONE,
    "study_two": _STUDY_TWO,
}

PRESETS: Final = tuple(_PRESETS)
NAMES: Final = tuple(_PERFECT)
"""The parameters of simulator.drive that a preset gives."""

PLACED_OUTAGES: Final[Mapping[str, tuple[tuple[float, float], ...]]] = {"study_one": ((0.35, 30.0), (0.70, 60.0))}
"""Outages that stand at a fraction of the record, with their length in s."""


def preset_value(preset: str, name: str) -> Any:
    """One value in SI: a number, or a tuple of them.

    preset : one of PRESETS; name : one of NAMES. Raises KeyError for any other.
    """
    return _si(_PRESETS[preset].get(name, _PERFECT[name]))


def _si(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_si, value))
    _, unit = value.split(maxsplit=1)
    return parse_quantity(value, si_unit(unit))
