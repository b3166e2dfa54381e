"""The Kalman filter of position and velocity: accelerations push it, GNSS positions hold it.

On East, North and Up each, with the state (position, velocity), the acceleration a as the control, and positions z:

    p' = v,   v' = a + w,   z = p + r,    w of density accel_noise (Q), r of the fix's own sigma (R)

It knows no attitude, no bias and no vehicle: attitude and acceleration come from the steps above, and what they err by
is noise, of the size that makes the innovations likeliest where none is given. Between two fixes it predicts at the
rate of the imu, at a fix it is updated; with `smooth` every estimate also knows the fixes that follow (Rauch, Tung,
Striebel). In steps in which the imu is silent the acceleration is not known, and the sigmas grow accordingly.

Receivers err by much the same for minutes. No filter of positions averages that away: of the variance of a fix the
share `slow_share` is kept out of R and added to what the result claims; between two times it is alike as far as it has
not changed within `slow_time`. Its change looks like velocity, to whose sigma that is added. The sigmas of changes
follow from the stream `knots`, which a smoother alone can write.

fuser.map estimates attitude, biases, mounting and delays together with the motion, and is several times better.

References
    Kalman (1960), J. Basic Engineering 82(1), 35-45. Rauch, Tung, Striebel (1965), AIAA J. 3(8), 1445-1450.
    The numerics stand in recon.numerics.constant_velocity.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    ATTITUDE,
    EVENTS,
    GNSS,
    IMU,
    KNOTS,
    RESIDUALS,
    TRAJECTORY,
    Array,
    Change,
    Fuser,
    Metric,
    Params,
    Schema,
    Streams,
    build,
    events,
    has,
    hookimpl,
    matrix,
    meta,
    metrics,
    quantity,
    setting,
    time_ns,
    with_meta,
)
from recon.errors import NotEnoughData
from recon.numerics.constant_velocity import Fusion, Motion, drift_variance
from recon.numerics.constant_velocity_chain import chain
from recon.numerics.rotation_series import slerp
from recon.placing import geolocate, silence_warnings, silent_steps
from recon.tables import schema_of
from recon_fusers._cv_fixes import counts, outages, residuals
from recon_fusers._cv_knots import knots

SILENT_NOISE: Final = 2.0
"""m/s^1.5: an acceleration of 1 m/s^2 that is not known and lasts for two seconds."""
DENSITIES: Final = tuple(0.05 * 2.0**power for power in range(7, -1, -1))
"""m/s^1.5, between which the likeliest is sought: from a phone in a hand to a box that is glued to a car."""


class KalmanParams(Params):
    """Parameters of fuser.kalman_cv."""

    accel_noise: float | None = quantity(
        None,
        "m/s^2/sqrt(Hz)",
        gt=0,
        le=1000,
        doc="Q: density of what the acceleration errs by, attitude included; none: the likeliest, level and upwards.",
    )
    horizontal: float | None = quantity(
        None, "m", gt=0, le=1e4, doc="R: sigma of a fix, east and north each; none: as the receiver tells, else 3 m."
    )
    vertical: float | None = quantity(
        None, "m", gt=0, le=1e4, doc="R: sigma of the height of a fix; none: as the receiver tells, else 5 m."
    )
    slow_share: float = setting(
        0.5, ge=0, lt=1, doc="Share of the variance of a fix that lasts for minutes: no fix averages it away."
    )
    slow_time: float = quantity(100.0, "s", gt=0, le=1e6, doc="Time in which that share changes.")
    gate: float = setting(5.0, ge=1, le=1e6, doc="Sigmas from the prediction beyond which a fix counts less and less.")
    patience: float = quantity(
        10.0, "s", ge=0, le=1e6, doc="Where all fixes lie beyond the gate for longer, they are believed again."
    )
    smooth: bool = setting(False, doc="Estimate each row from all fixes, not only from those before it.")
    max_gap: float = quantity(0.5, "s", gt=0, le=3600, doc="Over a longer gap in imu the acceleration is not known.")
    longest_gap: float = quantity(10.0, "min", gt=0, le=1e6, doc="A log with a longer gap is refused: cut it there.")


_TYPICAL: Final = (3.0, 3.0, 5.0)
"""m, sigma of a fix that tells none."""


def kalman_cv(*, imu: pa.Table, gnss: pa.Table, attitude: pa.Table | None, params: KalmanParams) -> Streams:
    """Trajectory at the rows of imu from the first fix on, the innovations of the fixes, and outages of them.

    imu : accel m/s^2, local, without gravity; gnss : pos m, local; attitude : goes into the trajectory as it is
    Raises NotEnoughData where imu has less than two rows or no fix lies in its time, DataError where imu has a gap
    longer than longest_gap.
    """
    if imu.num_rows < 2:
        raise NotEnoughData("rows in imu", needed="2", found=str(imu.num_rows))
    t_ns, silent = time_ns(imu), silent_steps(imu, params.max_gap, params.longest_gap)
    rows, sigma, learnt = _fixes(imu, gnss, params)
    fix_ns = time_ns(gnss)[rows]
    fusion = _fusion(imu, silent, gnss, rows, sigma, params)
    density, told = _density(fusion, params.accel_noise)
    found, seen = fusion.estimate(density, smooth=params.smooth)
    kept = t_ns[len(t_ns) - len(found.pos) :]
    lasting = sigma * np.sqrt(params.slow_share)
    slow = lasting[np.searchsorted(fix_ns, kept, side="right") - 1]
    learnt += [
        *told,
        *silence_warnings(imu, silent, "the acceleration is taken as zero"),
        *counts(t_ns, kept, seen, params.gate),
    ]
    moved = _trajectory(kept, found, slow, attitude, params)
    trajectory = geolocate(with_meta(moved, **meta(imu), **_body(attitude)), gnss)
    streams = {
        "trajectory": trajectory,
        "residuals": residuals(fix_ns[1:], seen, params.gate),
        "events": events(outages(t_ns, fix_ns)),
        "metrics": metrics(learnt),
    }
    if params.smooth:
        streams["knots"] = _knots(fusion, density, t_ns, fix_ns, lasting, params.slow_time, attitude, trajectory)
    return streams


def _fusion(
    imu: pa.Table, silent: NDArray[np.bool_], gnss: pa.Table, rows: NDArray[np.intp], sigma: Array, params: KalmanParams
) -> Fusion:
    """Accelerations, and the fixes of some rows of gnss, whose sigmas (m, 3) m are known."""
    t_ns = time_ns(imu)
    return Fusion.of(
        (t_ns - t_ns[0]) * 1e-9,
        matrix(imu, "accel"),
        silent,
        (time_ns(gnss)[rows] - t_ns[0]) * 1e-9,
        matrix(gnss, "pos", gaps=True)[rows],
        sigma**2 * (1.0 - params.slow_share),
        held_density=SILENT_NOISE,
        gate=params.gate,
        patience=params.patience,
    )


def _trajectory(
    t_ns: NDArray[np.int64], found: Motion, slow: Array, attitude: pa.Table | None, params: KalmanParams
) -> pa.Table:
    """What was found at the times t_ns (n,) ns; slow : (n, 3) m, sigma of what fixes err by for minutes."""
    drift_var = drift_variance(found.pos_var, found.vel_var, slow, params.slow_time, smooth=params.smooth)
    return build(
        TRAJECTORY,
        time=t_ns,
        pos=found.pos,
        vel=found.vel,
        q=_attitude(t_ns, attitude),
        pos_std=np.sqrt(found.pos_var + slow**2),
        vel_std=np.sqrt(found.vel_var + drift_var),
    )


def _knots(
    fusion: Fusion,
    density: Array,
    t_ns: NDArray[np.int64],
    fix_ns: NDArray[np.int64],
    lasting: Array,
    tau_s: float,
    attitude: pa.Table | None,
    trajectory: pa.Table,
) -> pa.Table:
    """The smoother at fixes and at the last row, from which the sigmas of changes follow."""
    found = chain(fusion, density)
    times_ns = fix_ns[found.fix]
    if found.t_s[-1] > fusion.fix_s[-1]:
        times_ns[-1] = t_ns[-1]
    noise = np.sqrt(density[0] ** 2 + fusion.held_q2[found.fix])
    return knots(found, times_ns, _attitude(times_ns, attitude), lasting[found.fix], tau_s, noise, trajectory)


def _fixes(imu: pa.Table, gnss: pa.Table, params: KalmanParams) -> tuple[NDArray[np.intp], Array, list[Metric]]:
    """Rows of gnss with a position in the time of imu, their sigmas (m, 3) m, and where these are from."""
    t_ns, fix_ns = time_ns(imu), time_ns(gnss)
    placed = np.isfinite(matrix(gnss, "pos", gaps=True)).all(axis=1)
    rows = np.flatnonzero(placed & (fix_ns >= t_ns[0]) & (fix_ns <= t_ns[-1]))
    if not len(rows):
        raise NotEnoughData("gnss positions in the time of imu", needed="1", found=f"none of {len(fix_ns)} rows")
    told = np.full((len(rows), 3), np.nan)
    if has(gnss, "pos_std"):
        told = matrix(gnss, "pos_std", gaps=True)[rows]
        told[~(told > 0.0)] = np.nan  # receivers write 0 or -1 where they do not know
    known = np.isfinite(told)
    sigma = np.where(known, told, _TYPICAL)
    learnt = []
    for name, value, axes in (("horizontal", params.horizontal, [0, 1]), ("vertical", params.vertical, [2])):
        if value is not None:
            sigma[:, axes] = value
        source = "given" if value is not None else "told by the receiver" if known[:, axes].any() else "typical"
        learnt.append(Metric(f"sigma_{name}", float(np.median(sigma[:, axes])), "m", method=source))
    return rows, sigma, learnt


def _density(fusion: Fusion, given: float | None) -> tuple[Array, list[Metric]]:
    """Density of the noise of the acceleration on each axis: (3,) m/s^1.5, and where it is from."""
    level, up = (given, given) if given is not None else (fusion.likeliest(axes, DENSITIES) for axes in ([0, 1], [2]))
    method = "given" if given is not None else "likeliest, by the innovations"
    learnt = [
        Metric(f"accel_noise_{name}", value, "m/s^2/sqrt(Hz)", method=method)
        for name, value in (("horizontal", level), ("vertical", up))
    ]
    return np.array([level, level, up]), learnt


def _attitude(t_ns: NDArray[np.int64], attitude: pa.Table | None) -> Array:
    """At the times t_ns (n,) ns: (n, 4), NaN where not known."""
    if attitude is None or not attitude.num_rows:
        return np.full((len(t_ns), 4), np.nan)
    return slerp(t_ns, time_ns(attitude), matrix(attitude, "q"))


def _body(attitude: pa.Table | None) -> dict[str, str]:
    """The fact that tells whose attitude it is, where it is not the vehicle's."""
    frame = "" if attitude is None else schema_of(attitude)["qw"].frame
    return {"body": frame} if frame not in ("", "vehicle") else {}


def _plan(schemas: Mapping[str, Schema], params: KalmanParams) -> dict[str, Schema]:
    """The attitude in the trajectory is that of the body whose attitude is given."""
    given = TRAJECTORY.only("pos", "vel", "q", "lat", "lon", "height", "pos_std", "vel_std", "att_std")
    frame = schemas["attitude"]["qw"].frame if "attitude" in schemas else "vehicle"
    trajectory = Change(frames={"q": frame}).apply(given)
    streams = {"trajectory": trajectory, "residuals": RESIDUALS, "events": EVENTS}
    return {**streams, "knots": KNOTS} if params.smooth else streams


@hookimpl
def declare_fusers() -> Iterable[Fuser]:
    """Declare fuser.kalman_cv."""
    yield Fuser(
        name="kalman_cv",
        summary="Kalman filter of position and velocity: accelerations push it, GNSS positions hold it.",
        params=KalmanParams,
        reads={
            "imu": IMU.need("accel", frame="local", quantity={"accel": "acceleration"}),
            "gnss": GNSS.need("pos", maybe=["pos_std"]),
            "attitude": ATTITUDE.need("q", optional=True),
        },
        writes={"trajectory": TRAJECTORY, "residuals": RESIDUALS, "events": EVENTS},
        version=2,
        run=kalman_cv,
        plan=_plan,
        budget=1.0,
        references=("Kalman (1960)", "Rauch, Tung, Striebel (1965)"),
    )
