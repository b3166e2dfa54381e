"""How noisy the IMU is while the vehicle stands, next to the classes of sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from recon.numerics.doctor.finding import Finding, Floats, confirmed, contradicted, unknown
from recon.numerics.doctor.log import Claims
from recon.numerics.smoothing.stops import Blocks, find_stops, still_noise

_TIMES: Final = 3.0
"""Noise above that of a class by so much is that of a worse one; an idling engine doubles it."""


def noise_class(
    blocks: Blocks | None,
    fix_t_s: Floats,
    fix_speed: Floats,
    classes: Sequence[tuple[str, float, float]],
    claims: Claims,
) -> Finding:
    """The best class whose noise the standing IMU does not exceed.

    classes : name, density of the gyroscope rad/s/sqrt(Hz), of the accelerometer m/s^2/sqrt(Hz), from coarse to fine
    """
    code = "noise_class"
    if blocks is None:
        return unknown(code, "The IMU has too few rows to tell its noise.")
    still = find_stops(blocks, fix_t_s, fix_speed).still
    gyro, accel = still_noise(blocks, still)
    if gyro is None or accel is None:
        return unknown(
            code,
            "The vehicle never stands for twelve seconds in a row, so the noise of the sensors alone does not show.",
        )
    numbers = {
        "gyro_deg_s_sqrthz": float(np.degrees(gyro)),
        "accel_ug_sqrthz": accel / 9.80665e-6,
        "standing_s": float(still.sum() * blocks.duration),
    }
    fits = [name for name, g, a in classes if gyro <= g and accel <= a]
    value = fits[-1] if fits else classes[0][0]
    expected: Mapping[str, tuple[float, float]] = {name: (g, a) for name, g, a in classes}
    most = expected.get(claims.sensor_class, expected[classes[0][0]])
    said = (
        f"Standing, the gyroscope has a noise of {np.degrees(gyro):.2g} deg/s/sqrt(Hz) and the accelerometer "
        f"{accel / 9.80665e-6:.0f} ug/sqrt(Hz)"
    )
    times = max(gyro / most[0], accel / most[1])
    numbers["times"] = times
    if times > _TIMES:
        text = (
            f"{said}, {times:.1f} times what a sensor of the class {claims.sensor_class} has: it is noisier, or the "
            "engine shakes it."
        )
        return contradicted(code, round(times, 1), text, **numbers)
    return confirmed(code, value, f"{said}: no noisier than the class {value}.", **numbers)
