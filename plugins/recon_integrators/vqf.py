"""Attitude of the sensor by VQF, forwards and backwards in time.

VQF averages the specific force in a frame that turns with the gyroscope alone, where gravity stands still and the
accelerations of the vehicle cancel over `tau`; the level that it finds so corrects the gyroscope's, and a Kalman filter
estimates its bias. Run forwards and backwards it needs no time to settle.

The package vqf is the authors' own: C++ behind one call for a whole record, ENU, MIT, kept up. ahrs loops over samples
in Python (20 to 70 us each); qmt wraps the same vqf and brings nine more packages. Its magnetometer part is not used:
in a vehicle a magnetometer must first be freed of the iron that turns with it, which takes a levelled sensor, and
course and field together know more than the field; `_north` does that for all attitude filters. Neither is its detector
of rest: a vehicle that goes round a long bend at a steady rate looks at rest, and the bend would be learnt as bias.

References
    Laidig, Seel (2023), "VQF: highly accurate IMU orientation estimation with bias estimation and magnetic disturbance
    rejection", Information Fusion 91, 187-204.
"""

from __future__ import annotations

from collections.abc import Iterable

import pyarrow as pa

from recon import Integrator, Streams, hookimpl, quantity, setting
from recon.errors import PluginError
from recon.numerics.attitude import Blocks, first_level
from recon.numerics.rotation import conjugate, multiply, normalize, rotate
from recon_integrators._nine_axes import Level, NineAxesParams, attitude_by, declared

_RATE_HZ = 5.0


class VqfParams(NineAxesParams):
    """Parameters of integrator.vqf."""

    tau: float = quantity(
        10.0,
        "s",
        gt=0,
        le=1e4,
        doc="Time over which accelerations of the vehicle cancel.",
    )
    backwards: bool = setting(True, doc="Also run backwards and take the mean; false knows the past alone.")


def integrate_vqf(*, imu: pa.Table, mag: pa.Table | None, gnss: pa.Table | None, params: VqfParams) -> Streams:
    """Attitude of the sensor, sensor to local, at every row of imu.

    Raises as `attitude_by`, and PluginError where the package is not installed.
    """
    return attitude_by(lambda blocks: _level(blocks, params), _RATE_HZ, imu, mag, gnss, params)


def _level(blocks: Blocks, params: VqfParams) -> Level:
    try:
        from vqf import VQF, offlineVQF  # slow import: only when used
    except ImportError as error:
        raise PluginError(
            "integrator.vqf needs the package vqf, which has no ready build for this Python and machine",
            "pip install vqf with a C++ compiler, or use integrator.madgwick or integrator.mahony",
        ) from error
    count = len(blocks.t_s)
    step_s = float(blocks.t_s[-1] / (count - 1)) if count > 1 else 1.0 / _RATE_HZ
    q_start = first_level(blocks)  # VQF starts at the unit quaternion: a tilted box would begin with a false bias
    rate, force = rotate(q_start, blocks.turns / step_s), rotate(q_start, blocks.force_s)
    settings = {"tauAcc": params.tau, "restBiasEstEnabled": False}
    if params.backwards:
        found = offlineVQF(rate, force, None, step_s, settings)
    else:
        found = VQF(step_s, **settings).updateBatch(rate, force)
    return Level(normalize(multiply(found["quat6D"], q_start)), rotate(conjugate(q_start), found["bias"]))


@hookimpl
def declare_integrators() -> Iterable[Integrator]:
    """Declare integrator.vqf."""
    yield declared(
        "vqf",
        "Attitude of the sensor by VQF, its heading from magnetometer and course.",
        VqfParams,
        integrate_vqf,
        ("Laidig, Seel (2023), Information Fusion 91, 187-204",),
    )
