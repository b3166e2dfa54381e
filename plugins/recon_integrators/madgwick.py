"""Attitude of the sensor by Madgwick's complementary filter.

The gyroscope's turns are corrected towards the measured direction of gravity at the rate `gain`; while specific force
and filter disagree by more than `rejection` the accelerometer is not heard, so that bends and braking do not tilt the
box. This is the revised filter of Madgwick's thesis, which has replaced the gradient descent of 2010.

The package imufusion is the author's own: C, ENU, MIT, 60 kB, kept up, built for every Python and machine. It takes one
sample at a time, 1 to 2 us each from Python, so it runs on five blocks in two seconds (see recon.numerics.attitude).
ahrs has the filter of 2010 in Python, 20 to 70 us a sample. The filter knows no bias of the gyroscope; a constant one,
as Mahony's filter finds it, is taken off before. As in integrator.vqf the heading is found in `_north`.

References
    Madgwick (2014), "AHRS algorithms and calibration solutions to facilitate new applications using low-cost MEMS",
    PhD thesis, University of Bristol, chapter 7.
    Madgwick, Harrison, Vaidyanathan (2011), "Estimation of IMU and MARG orientation using a gradient descent
    algorithm", IEEE International Conference on Rehabilitation Robotics.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pyarrow as pa

from recon import Integrator, Streams, hookimpl, quantity
from recon.numerics.attitude import Blocks, first_level, mahony
from recon.numerics.rotation import normalize
from recon_integrators._nine_axes import Level, NineAxesParams, attitude_by, declared

_RATE_HZ = 2.5
_BIAS_BLOCKS, _BIAS_GAINS = 2, (0.06, 0.0004)
_G = 9.80665


class MadgwickParams(NineAxesParams):
    """Parameters of integrator.madgwick."""

    gain: float = quantity(0.06, "1/s", ge=0, le=100, doc="Rate at which the level goes to the accelerometer's.")
    rejection: float = quantity(
        10.0, "deg", gt=0, le=90, doc="Disagreement beyond which the accelerometer is not heard."
    )
    patience: float = quantity(10.0, "s", gt=0, le=3600, doc="Time after which it is heard again, whatever it says.")


def integrate_madgwick(
    *, imu: pa.Table, mag: pa.Table | None, gnss: pa.Table | None, params: MadgwickParams
) -> Streams:
    """Attitude of the sensor, sensor to local, at every row of imu. Raises as `attitude_by`."""
    return attitude_by(lambda blocks: _level(blocks, params), _RATE_HZ, imu, mag, gnss, params)


def _level(blocks: Blocks, params: MadgwickParams) -> Level:
    from imufusion import CONVENTION_ENU, Ahrs, AhrsSettings  # only when used

    count = len(blocks.t_s)
    step_s = float(blocks.t_s[-1] / (count - 1)) if count > 1 else 1.0 / _RATE_HZ
    filter_ = Ahrs()
    filter_.set_settings(
        AhrsSettings(
            1.0 / step_s, CONVENTION_ENU, params.gain, 0.0, float(np.degrees(params.rejection)), 0.0, params.patience
        )
    )
    filter_.set_quaternion(first_level(blocks))
    filter_.skip_startup()
    update, get = filter_.update_no_magnetometer, filter_.get_quaternion
    bias = mahony(blocks.merged(_BIAS_BLOCKS), *_BIAS_GAINS)[1][-1]
    rates, forces = np.degrees(blocks.turns / step_s - bias), blocks.force_s / _G
    q_ls = np.empty((count, 4))
    for block, (rate, force) in enumerate(zip(rates, forces, strict=True)):
        update(rate, force)
        q_ls[block] = get()
    return Level(normalize(q_ls), bias[None])


@hookimpl
def declare_integrators() -> Iterable[Integrator]:
    """Declare integrator.madgwick."""
    yield declared(
        "madgwick",
        "Attitude of the sensor by Madgwick's filter, its heading from magnetometer and course.",
        MadgwickParams,
        integrate_madgwick,
        ("Madgwick (2014), PhD thesis, University of Bristol, chapter 7",),
    )
