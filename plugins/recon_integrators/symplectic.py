"""Attitude and trajectory by integrators that keep the geometry of a motion: see recon.numerics.geometric.

    q_nv[k+1] = q_nv[k] (x) exp(phi_k / 2),    v_k+1/2 = v_k + h/2 a_k,    p_k+1 = p_k + h v_k+1/2

with the Magnus phi_k of order 4 and the kicks and drifts of Stoermer and Verlet, of order 2. The attitude is integrated
anew from the first row of `attitude`. Stops are not used: this is the plain integral, for the study of integration and
for short motions; `integrator.motion` also takes off what stops show.

What a vehicle does in a gap longer than `max_gap` is unknown: attitude and velocity are held, and a warning tells
where.

References
    Thesis, chapter 9.1. Iserles et al. (2000), Acta Numerica 9, 215-365. Hairer, Lubich, Wanner (2003), Acta Numerica
    12, 399-450.
"""

from __future__ import annotations

from collections.abc import Iterable

import pyarrow as pa

from recon import (
    ATTITUDE,
    GNSS,
    IMU,
    TRAJECTORY,
    Integrator,
    Params,
    Streams,
    build,
    hookimpl,
    matrix,
    meta,
    metrics,
    quantity,
    seconds,
    time_ns,
    warning,
    with_meta,
)
from recon.errors import NotEnoughData
from recon.numerics.geometric import magnus_turns, verlet_position, verlet_velocity
from recon.numerics.rotation import from_rotvec, rotate
from recon.numerics.rotation_series import compose
from recon.placing import anchor_of, geolocate, silence_warnings, silent_steps
from recon_integrators.attitude import first_attitude
from recon_integrators.motion import through_first, through_first_velocity


class SymplecticParams(Params):
    """Parameters of integrator.symplectic."""

    max_gap: float = quantity(0.5, "s", gt=0, le=3600, doc="Over a longer gap in imu attitude and velocity are held.")
    longest_gap: float = quantity(10.0, "min", gt=0, le=1e6, doc="A log with a longer gap is refused: cut it there.")


def integrate_symplectic(
    *, imu: pa.Table, attitude: pa.Table | None, gnss: pa.Table | None, params: SymplecticParams
) -> Streams:
    """Attitude of the vehicle and trajectory of the origin of the IMU at every row of imu.

    attitude : its first row is where the integration starts; None starts level and facing north
    gnss : its first position and velocity are passed through
    Raises NotEnoughData where imu is empty, DataError where attitude does not start with imu or where imu has a gap
    longer than longest_gap.
    """
    if not imu.num_rows:
        raise NotEnoughData("rows in imu", needed="1", found="0")
    silent = silent_steps(imu, params.max_gap, params.longest_gap)
    q_start, learnt = first_attitude(imu, attitude)
    learnt += silence_warnings(imu, silent, "attitude and velocity are held")
    t_s, accel_v, gyro_v = seconds(imu), matrix(imu, "accel"), matrix(imu, "gyro")
    turns = magnus_turns(t_s, gyro_v)
    turns[silent] = 0.0
    q_nv = compose(from_rotvec(turns), q_start)
    acc_n = rotate(q_nv, accel_v)
    vel_n, notes = through_first_velocity(imu, verlet_velocity(t_s, acc_n, silent), gnss)
    learnt += notes
    pos_n = through_first(imu, verlet_position(t_s, vel_n, acc_n, silent), gnss, "pos")
    if anchor_of(gnss) is None:
        learnt.append(warning("local frame: no place on the Earth is known, so lat, lon and height are null"))
    facts = meta(imu)
    turned = with_meta(build(ATTITUDE, time=time_ns(imu), q=q_nv), **facts)
    moved = build(TRAJECTORY, time=time_ns(imu), pos=pos_n, vel=vel_n, q=q_nv, accel=accel_v, gyro=gyro_v)
    return {
        "attitude": turned,
        "trajectory": geolocate(with_meta(moved, **facts), gnss),
        "metrics": metrics(learnt),
    }


@hookimpl
def declare_integrators() -> Iterable[Integrator]:
    """Declare integrator.symplectic."""
    yield Integrator(
        name="symplectic",
        summary="Attitude by a Magnus integrator and trajectory by Stoermer-Verlet, without use of stops.",
        params=SymplecticParams,
        reads={
            "imu": IMU.need("accel", "gyro", frame="vehicle", quantity={"accel": "acceleration"}),
            "attitude": ATTITUDE.need("q", frame="vehicle", optional=True),
            "gnss": GNSS.need(maybe=["pos", "vel"], optional=True),
        },
        writes={"attitude": ATTITUDE, "trajectory": TRAJECTORY},
        run=integrate_symplectic,
        order=2,
        references=("Iserles et al. (2000), Acta Numerica 9", "Hairer, Lubich, Wanner (2003), Acta Numerica 12"),
    )
