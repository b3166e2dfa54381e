"""Initial attitude: the direction in which the vehicle first moves is the one in which it faces.

With psi(t) the yaw integrated from the gyroscope since the first record, and dp_k the displacements between GNSS
positions until the first that is `distance` away from the initial one, the track

    P_k = sum over j <= k of R(-psi_j) dp_j

is that which the vehicle would have driven without turning: a straight line in the direction of its initial yaw,
whatever bends it drove. The line is fitted to all its points, which halves the error that the noise of the two
outermost ones alone would leave. Roll and pitch are zero: the vehicle is taken to start on level ground.

The scatter about the line shows what is new in every fix. Receivers err by much the same for minutes as well, which
hardly scatters, but turns the line: half of the variance that the receiver tells is taken to last for 100 s.

References
    Thesis, section 5.2. Gelb (1974), "Applied Optimal Estimation", ch. 3.6 (Gauss-Markov process).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, NamedTuple, TypeAlias

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    ATTITUDE,
    GNSS,
    IMU,
    Aligner,
    Metric,
    Params,
    Streams,
    build,
    has,
    hookimpl,
    meta,
    metrics,
    quantity,
    seconds,
    time_ns,
    vector,
    warning,
    with_meta,
)
from recon.errors import NotEnoughData
from recon.numerics.integration import cumulative
from recon.numerics.rotation import Floats, from_euler, heading_from_yaw, yaw_from_heading
from recon.tables import vector_or_nan

Complexes: TypeAlias = NDArray[np.complex128]

TYPICAL_M: Final = 3.0
"""Horizontal sigma of a fix, each axis, where the receiver tells none."""
LASTING_SHARE, LASTING_S = 0.5, 100.0
"""Of the variance of a fix what lasts, and for how long."""


class FirstMotionParams(Params):
    """Parameters of aligner.first_motion."""

    distance: float = quantity(
        10.0, "m", gt=0, le=10_000, doc="How far from the first position the direction is taken."
    )
    heading: float | None = quantity(
        None,
        "deg",
        ge=-360,
        le=360,
        doc="Heading at the first record, clockwise from true north; none finds it from GNSS positions.",
    )


class Heading(NamedTuple):
    """Yaw at the first record and its standard deviation, rad; how it was found."""

    yaw: float
    sigma: float | None
    method: str

    def as_metric(self) -> Metric:
        """The row that tells the user: clockwise from true north."""
        heading = float(np.degrees(heading_from_yaw(self.yaw)))
        sigma = None if self.sigma is None else float(np.degrees(self.sigma))
        return Metric("initial_heading", heading, "deg", sigma=sigma, method=self.method)


def initial_attitude(*, imu: pa.Table, gnss: pa.Table | None, params: FirstMotionParams) -> Streams:
    """Attitude of the vehicle at the first row of imu. Raises NotEnoughData where imu is empty."""
    if not imu.num_rows:
        raise NotEnoughData("rows in imu", needed="1", found="0")
    notes = []
    if params.heading is not None:
        found = Heading(float(yaw_from_heading(params.heading)), None, "given")
    elif (moved := _first_motion(imu, gnss, params.distance)) is not None:
        found = moved
    else:
        found = Heading(float(yaw_from_heading(0.0)), None, "none")
        why = f"the GNSS positions never move {params.distance:g} m" if _positioned(gnss) else "no GNSS positions"
        notes = [warning(f"{why}: integrated in a local frame from heading 0")]
    table = build(ATTITUDE, time=time_ns(imu)[:1], q=from_euler(found.yaw, 0.0, 0.0)[None])
    return {"attitude": with_meta(table, **meta(imu)), "metrics": metrics([found.as_metric(), *notes])}


def _positioned(gnss: pa.Table | None) -> bool:
    return has(gnss, "pos_e") and has(gnss, "pos_n")


def _first_motion(imu: pa.Table, gnss: pa.Table | None, distance: float) -> Heading | None:
    """Heading at the first row of imu; None where GNSS does not tell."""
    if gnss is None or not _positioned(gnss):
        return None
    t_s, fix_s = seconds(imu), seconds(gnss, since=int(time_ns(imu)[0]))
    pos_n = np.column_stack([vector(gnss, name, gaps=True) for name in ("pos_e", "pos_n")])
    told = np.hypot(*(vector_or_nan(gnss, f"pos_std_{axis}") for axis in "en")) / np.sqrt(2.0)
    usable = np.isfinite(pos_n).all(axis=1) & (fix_s >= 0.0) & (fix_s <= t_s[-1])
    fix_s, pos_n, told = fix_s[usable], pos_n[usable], told[usable]
    far = np.flatnonzero(np.hypot(*(pos_n - pos_n[:1]).T) >= distance)
    if not len(far):
        return None
    until = slice(0, far[0] + 1)
    turned = cumulative(t_s, vector(imu, "gyro_z"), "trapezoid")
    sigma = np.where(told[until] > 0.0, told[until], TYPICAL_M)
    return _fit(fix_s[until], _unturned(fix_s[until], pos_n[until], t_s, turned), np.sqrt(LASTING_SHARE) * sigma)


def _unturned(fix_s: Floats, pos_n: Floats, t_s: Floats, turned: Floats) -> Complexes:
    """The track without the turns made on the way.

    fix_s : (m,) s; pos_n : (m, 2) m, east and north; t_s : (n,) s; turned : (n,) rad, yaw since the first record
    returns : (m,) m, east + i north, beginning with 0
    """
    middle = (fix_s[1:] + fix_s[:-1]) / 2.0
    step_e, step_n = np.diff(pos_n, axis=0).T
    steps = (step_e + 1j * step_n) * np.exp(-1j * np.interp(middle, t_s, turned))
    return np.concatenate(([0.0], np.cumsum(steps)))


def _fit(fix_s: Floats, track: Complexes, lasting: Floats) -> Heading:
    """Direction of the line through the track, by least squares across it, towards its last point.

    fix_s : (m,) s; track : (m,) m; lasting : (m,) m, sigma of the error of each that lasts
    """
    centred = track - track.mean()
    yaw = float(np.angle(np.sum(centred**2))) / 2.0
    if (track[-1] * np.exp(-1j * yaw)).real < 0.0:
        yaw += np.pi
    seen = centred * np.exp(-1j * yaw)
    free, along = len(track) - 2, seen.real
    scatter = float(np.sum(seen.imag**2)) / free if free else 0.0
    turning = along / float(along @ along)
    variance = scatter * float(turning @ turning) + _lasting_variance(fix_s, turning * lasting)
    return Heading(yaw, float(np.sqrt(variance)), "first motion")


def _lasting_variance(fix_s: Floats, pulls: Floats) -> float:
    """Variance of the sum of errors that last: sum over i, j of p_i p_j exp(-|t_i - t_j| / LASTING_S).

    fix_s : (m,) s, rising; pulls : (m,), sigma of each
    """
    kept = np.exp(-np.diff(fix_s, prepend=fix_s[0]) / LASTING_S)
    variance, before = 0.0, 0.0
    for pull, share in zip(pulls.tolist(), kept.tolist(), strict=True):
        before *= share
        variance += pull * (pull + 2.0 * before)
        before += pull
    return variance


@hookimpl
def declare_aligners() -> Iterable[Aligner]:
    """Declare aligner.first_motion."""
    yield Aligner(
        name="first_motion",
        version=2,
        summary="Initial heading from the first GNSS displacement, which is taken to be forward.",
        params=FirstMotionParams,
        reads={"imu": IMU.need("gyro", frame="vehicle"), "gnss": GNSS.need(maybe=["pos", "pos_std"], optional=True)},
        writes={"attitude": ATTITUDE},
        run=initial_attitude,
        references=("Thesis, section 5.2",),
    )
