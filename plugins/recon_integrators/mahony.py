"""Attitude of the sensor by Mahony's explicit complementary filter with bias correction.

    d bias / dt = -k_i (f x up),    d q / dt = q (x) (omega - bias + k_p (f x up)) / 2

with f the direction of the specific force. The step is our own (recon.numerics.attitude.mahony): of the packages ahrs
loops over samples in Python, 20 to 70 us each, qmt's C++ comes with nine other packages, and imufusion has left this
filter behind. It runs on five blocks in two seconds and installs everywhere. As in integrator.vqf the heading is
found in `_north`.

References
    Mahony, Hamel, Pflimlin (2008), "Nonlinear complementary filters on the special orthogonal group", IEEE Trans.
    Automatic Control 53(5), 1203-1218.
"""

from __future__ import annotations

from collections.abc import Iterable

import pyarrow as pa

from recon import Integrator, Streams, hookimpl, quantity
from recon.numerics.attitude import Blocks, mahony
from recon_integrators._nine_axes import Level, NineAxesParams, attitude_by, declared

_RATE_HZ = 2.5


class MahonyParams(NineAxesParams):
    """Parameters of integrator.mahony."""

    gain: float = quantity(0.06, "1/s", ge=0, le=2, doc="k_p: rate at which the level goes to the accelerometer's.")
    bias_gain: float = quantity(0.0004, "1/s^2", ge=0, le=1, doc="k_i: at which the gyroscope's bias is learnt.")


def integrate_mahony(*, imu: pa.Table, mag: pa.Table | None, gnss: pa.Table | None, params: MahonyParams) -> Streams:
    """Attitude of the sensor, sensor to local, at every row of imu. Raises as `attitude_by`."""
    return attitude_by(lambda blocks: _level(blocks, params), _RATE_HZ, imu, mag, gnss, params)


def _level(blocks: Blocks, params: MahonyParams) -> Level:
    return Level(*mahony(blocks, params.gain, params.bias_gain))


@hookimpl
def declare_integrators() -> Iterable[Integrator]:
    """Declare integrator.mahony."""
    yield declared(
        "mahony",
        "Attitude of the sensor by Mahony's filter, its heading from magnetometer and course.",
        MahonyParams,
        integrate_mahony,
        ("Mahony, Hamel, Pflimlin (2008), IEEE Trans. Automatic Control 53(5), 1203-1218",),
    )
