"""Turns the box into the vehicle by the mounting that makes the whole drive fit.

The batch smoother looks for the trajectory and, with it, for the rotation R_vs that takes the axes of the box to those
of the vehicle: wheels hardly move sideways or up, so the velocity of the rear axle lies along x of the vehicle, and
roads are level across on average, which tells the roll.

    v_rear = R_vs R_sn (v_n + w x r) = (v, 0, 0),    up_v = (., 0, .) on average

No stop and no straight road are asked for, as aligner.level_at_stops and aligner.forward do; GNSS is. The sigmas are
those of maximum a posteriori. See recon.numerics.smoothing for the model.

References
    Dissanayake, Sukkarieh, Nebot, Durrant-Whyte (2001), "The aiding of a low-cost strapdown inertial measurement unit
    using vehicle model constraints for land vehicle applications", IEEE T-RA 17(5) (constraints of wheels).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from recon import (
    GNSS,
    IMU,
    Aligner,
    Change,
    Metric,
    Params,
    Streams,
    hookimpl,
    matrix,
    metrics,
    replace,
    setting,
    time_ns,
    warning,
)
from recon.errors import NotEnoughData
from recon.numerics.rotation import rotate
from recon.sensor_classes import NAMES, SensorClass, typical

if TYPE_CHECKING:
    from recon.numerics.smoothing import Estimate

_UNSURE = np.radians(5.0)
"""Sigma from which a mounting is not known; before the drive it is ten degrees about a first guess."""
_SLOW_ERROR_S = 100.0
"""Correlation time of the error of GNSS positions."""


class MountParams(Params):
    """Parameters of aligner.mount."""

    sensor_class: SensorClass = setting("consumer_mems", doc="What kind of IMU it is: its noise, biases, scale errors.")


def mount(*, imu: pa.Table, gnss: pa.Table, params: MountParams) -> Streams:
    """Turn accel and gyro into the vehicle.

    raises : NotEnoughData and DataError where the log does not tell the mounting
    """
    from recon.driving import mounting_metrics  # slow import: only when used
    from recon.numerics.smoothing.soa import matrix_to_quat

    found = _found(imu, gnss, params.sensor_class)
    _refuse_unsure(found)
    q_vs = matrix_to_quat(found.solved.state.rot_vs[..., None])[:, 0]
    turned = {group: rotate(q_vs, matrix(imu, group)) for group in ("accel", "gyro")}
    return {"imu": replace(imu, **turned), "metrics": metrics([*mounting_metrics(found), *_doubts(found)])}


def _found(imu: pa.Table, gnss: pa.Table, sensor_class: str) -> Estimate:
    from recon.driving import drive_of, measured, solve
    from recon.fixes import Trust, observe
    from recon.numerics.smoothing import Model, Noise

    imu = measured(imu)
    start_ns = int(time_ns(imu)[0]) if imu.num_rows else 0
    observed = observe(gnss, start_ns, Trust(), reported=True)
    expected = {name: typical(sensor_class, name) for name in NAMES}
    model = Model(
        gyro_bias=expected["gyro_bias"],
        accel_bias=expected["accel_bias"],
        gyro_scale=expected["gyro_scale"],
        accel_scale=expected["accel_scale"],
    )
    noise = Noise(
        gyro=expected["gyro_noise"],
        accel=expected["accel_noise"],
        gyro_walk=expected["gyro_bias_walk"],
        accel_walk=expected["accel_bias_walk"],
        drift=observed.drift,
        drift_tau=_SLOW_ERROR_S,
        position=np.ones(3),
        velocity=np.ones(3),
    )
    return solve(drive_of(imu, None, observed, start_ns), model, noise, learn_noise=True)


def _refuse_unsure(found: Estimate) -> None:
    from recon.numerics.smoothing.state import MOUNT

    sigma = float(np.sqrt(np.diag(found.covariance_common)[MOUNT].max()))
    if sigma > _UNSURE:
        raise NotEnoughData(
            "motion to tell the mounting", needed=f"a sigma below {np.degrees(_UNSURE):.0f} deg",
            found=f"{np.degrees(sigma):.0f} deg", hint="give a log of a drive in which GNSS tells positions or speeds",
        )  # fmt: skip


def _doubts(found: Estimate) -> list[Metric]:
    return [] if found.solved.converged else [warning("the mounting has not converged: do not trust it")]


@hookimpl
def declare_aligners() -> Iterable[Aligner]:
    """Declare aligner.mount."""
    yield Aligner(
        name="mount",
        summary="Turns imu into the vehicle by the mounting that makes the whole drive fit GNSS and wheels.",
        params=MountParams,
        reads={
            "imu": IMU.need("accel", "gyro", frame="sensor", quantity={"accel": "specific_force"}),
            "gnss": GNSS.need(maybe=["lat", "lon", "height", "speed", "course", "vel", "pos_std", "vel_std", "fix"]),
        },
        writes={"imu": Change(frames={"accel": "vehicle", "gyro": "vehicle"})},
        run=mount,
        rotation=True,
        references=("Dissanayake et al. 2001",),
    )
