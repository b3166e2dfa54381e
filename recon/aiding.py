"""Streams beside IMU, GNSS and the wheels' speed as what the smoother takes in: barometer, map, camera, steering.

Of a barometer only climbs are told; their scale is an unknown of the smoother, their noise that of the record. The
level of a map comes from GNSS, for datums differ and boxes ride above the ground. Rotations that a camera saw are held
against the gyroscope's, which tells its bias; its directions of travel are taken as they are. So are turn rates of the
steering, whose ratio, offset and understeer are those that fit the gyroscope best over the drive.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import pyarrow as pa

from recon.fixes import Observed
from recon.numerics.barometer import pressure_height
from recon.numerics.rotation import conjugate, from_rotvec, multiply, rotate, to_rotvec
from recon.numerics.rotation_series import compose, slerp
from recon.numerics.smoothing import level_rotation, positions_n
from recon.numerics.smoothing.aids import Aid, Direction, Ground, Rate
from recon.numerics.smoothing.climbs import Climb
from recon.numerics.smoothing.soa import mtv
from recon.numerics.steering import grips, single_track
from recon.rows import Metric
from recon.tables import Array, has, matrix, seconds, select_rows, time_ns, vector

_LEAST_BARO, _USUAL_BARO = 0.1, 0.3
"""m; sigma of a mean of two seconds, for wind and the speed stir the air however fine the sensor is."""
_APART_M: Final = 100.0
"""m in which errors of maps are the same."""


@dataclass(frozen=True)
class AidTrust:
    """What is believed of the aids: m, None : that of its record; m/sqrt(s).

    ground_level : m, height of the box above the map, in the datum of GNSS; None to take it from the heights of GNSS
    """

    baro: float | None = None
    baro_walk: float = 0.02
    steering: bool = True
    ground_level: float | None = None


def aids_of(
    imu: pa.Table,
    baro: pa.Table | None,
    ground: pa.Table | None,
    visual: pa.Table | None,
    observed: Observed,
    start_ns: int,
    trust: AidTrust,
    wheel: pa.Table | None = None,
) -> tuple[tuple[Aid, ...], list[Metric]]:
    """The aids that the streams give, and what was learnt of them. start_ns : time zero."""
    aids: list[Aid] = []
    learnt: list[Metric] = []
    told = None if baro is None else np.isfinite(vector(baro, "pressure", gaps=True))
    if baro is not None and told is not None and told.sum() > 1:
        aids.append(_climb(select_rows(baro, told), start_ns, trust))
    if ground is not None and ground.num_rows > 1 and observed.height:
        plane, found = _ground(ground, observed, start_ns, trust)
        aids.append(plane)
        learnt += found
    if visual is not None and visual.num_rows > 1 and imu.num_rows:
        aids += [_rate(visual, imu, start_ns), *_direction(visual, start_ns)]
        learnt.append(Metric("visual_motions", float(visual.num_rows), note="that a camera saw"))
    if wheel is not None and trust.steering and has(wheel, "steering_angle") and has(wheel, "speed"):
        turns, found = _steering(wheel, imu, start_ns)
        aids += turns
        learnt += found
    return tuple(aids), learnt


def _heights(observed: Observed, t_s: Array) -> tuple[Array, Array]:
    """Heights of the fixes, axes n, and which of them lie inside the times."""
    fixes = observed.fixes
    known = np.isfinite(fixes.pos_sigma[2]) & (fixes.t_s >= t_s[0]) & (fixes.t_s <= t_s[-1])
    return fixes.pos_n[2], np.asarray(known)


def _climb(baro: pa.Table, start_ns: int, trust: AidTrust) -> Climb:
    t_s, height = seconds(baro, since=start_ns), pressure_height(np.maximum(vector(baro, "pressure"), 1.0))
    return Climb(t_s, height, _baro_noise(t_s, height) if trust.baro is None else trust.baro, trust.baro_walk)


def _baro_noise(t_s: Array, height: Array) -> float:
    """Sigma m of the mean of two seconds, from how three in a row are off a line: roads bend by less."""
    edge_s = np.arange(t_s[0], t_s[-1] + 2.0, 2.0)
    bend = np.diff(_means(t_s, height[None], edge_s)[0], 2)
    bend = bend[np.isfinite(bend)]
    return max(_LEAST_BARO, 1.4826 * float(np.median(np.abs(bend))) / np.sqrt(6.0)) if len(bend) else _USUAL_BARO


def _ground(ground: pa.Table, observed: Observed, start_ns: int, trust: AidTrust) -> tuple[Ground, list[Metric]]:
    t_s = seconds(ground, since=start_ns)
    lat, lon, height = (vector(ground, name) for name in ("lat", "lon", "height"))
    slope = np.array([vector(ground, "slope_e"), vector(ground, "slope_n")])
    pos_n = positions_n(lat, lon, height, observed.anchor)
    rot_nl = level_rotation(pos_n, observed.anchor).swapaxes(0, 1)
    length = np.sqrt(1.0 + (slope**2).sum(axis=0))
    normal_n = mtv(rot_nl.swapaxes(0, 1), np.vstack([-slope, np.ones((1, len(t_s)))]) / length)
    gnss, inside = _heights(observed, t_s)
    above = gnss[inside] - np.interp(observed.fixes.t_s[inside], t_s, pos_n[2])
    level = trust.ground_level if trust.ground_level is not None else float(np.median(above)) if len(above) else 0.0
    how = "median of the heights of GNSS less those of the map" if trust.ground_level is None else "given"
    learnt = [Metric("ground_level", level, "m", method=how, note="height of the box above the map")]
    raised = pos_n + level * rot_nl[:, 2]
    return Ground(t_s, raised, normal_n, vector(ground, "height_std"), _APART_M), learnt


def _rate(visual: pa.Table, imu: pa.Table, start_ns: int) -> Rate:
    """The mean rate of the gyroscope between images, and that of the camera, (3, m) rad/s."""
    t_ns, end_ns = time_ns(visual), time_ns(visual, "end_time")
    inside = (t_ns >= time_ns(imu)[0]) & (end_ns <= time_ns(imu)[-1]) & (end_ns > t_ns)
    t_ns, end_ns = t_ns[inside], end_ns[inside]
    gyro, imu_ns = matrix(imu, "gyro"), time_ns(imu)
    step = from_rotvec(0.5 * (gyro[1:] + gyro[:-1]) * (np.diff(imu_ns) * 1e-9)[:, None])
    turned = compose(step, np.array([1.0, 0.0, 0.0, 0.0]))
    first, last = (slerp(at, imu_ns, turned) for at in (t_ns, end_ns))
    span_s = (end_ns - t_ns) * 1e-9
    felt = to_rotvec(multiply(conjugate(first), last)) / span_s[:, None]
    seen = to_rotvec(matrix(visual, "q")[inside]) / span_s[:, None]
    sigma = vector(visual, "rotation_std")[inside] / span_s
    t_s = _middle_s(visual, start_ns)[inside]
    return Rate(t_s, span_s, felt.T, seen.T, None, _lasting(t_s, sigma))


def _steering(wheel: pa.Table, imu: pa.Table, start_ns: int) -> tuple[list[Rate], list[Metric]]:
    """Turn rates of the single-track model, second by second, about the axis along which the box feels gravity."""
    accel, gyro, imu_s = matrix(imu, "accel"), matrix(imu, "gyro"), seconds(imu, since=start_ns)
    up_s = np.median(accel, axis=0)
    up_s = up_s / np.linalg.norm(up_s)
    edge_s = np.arange(0.0, imu_s[-1], 1.0)
    felt = _means(imu_s, gyro.T, edge_s)
    rows = []
    for name in ("speed", "steering_angle"):
        value = vector(wheel, name, gaps=True)
        known = np.isfinite(value)
        rows.append(_means(seconds(wheel, since=start_ns)[known], value[None, known], edge_s)[0])
    speed, angle = rows
    rate = up_s @ felt
    heard = np.isfinite(speed) & np.isfinite(angle) & np.isfinite(rate)
    speed, angle, rate, felt = speed[heard], angle[heard], rate[heard], felt[:, heard]
    model = single_track(speed, angle, rate)
    if model is None:
        return [], [Metric("steering", note="not used: too few bends to tell its ratio")]
    turned, sigma = model.rate(speed, angle)
    held = grips(speed, rate)
    t_s = 0.5 * (edge_s[1:] + edge_s[:-1])[heard]
    axes = np.repeat(up_s[:, None], int(held.sum()), axis=1)
    aid = Rate(t_s[held], np.ones(len(t_s))[held], felt[:, held], axes * turned[held], axes, sigma[held])
    note = "ratio of the steering times wheelbase"
    return [aid], [
        Metric("steering_ratio_length", model.ratio_length, "m", model.ratio_length_sigma, note=note),
        Metric("steering_offset", float(np.degrees(model.offset)), "deg", float(np.degrees(model.offset_sigma))),
        Metric("steering_understeer", model.understeer, "s^2/m", note="of the single-track model, times the ratio"),
        Metric(
            "steering_error", float(np.degrees(model.sigma)), "deg", note=f"mean of a second; {model.lasts:.0f} s long"
        ),
    ]


def _means(t_s: Array, rows: Array, edge_s: Array) -> Array:
    """Means of rows (c, m) between the edges (n + 1,), NaN where there is none: (c, n)."""
    at = np.searchsorted(t_s, edge_s)
    total = np.concatenate([np.zeros((len(rows), 1)), np.cumsum(rows, axis=1)], axis=1)[:, at]
    count = np.diff(at)
    return np.asarray(np.where(count > 0, np.diff(total, axis=1) / np.maximum(count, 1), np.nan))


def _direction(visual: pa.Table, start_ns: int) -> list[Direction]:
    if not (has(visual, "direction") and has(visual, "direction_std")):
        return []
    sigma, way = vector(visual, "direction_std", gaps=True), matrix(visual, "direction", gaps=True)
    known = np.isfinite(sigma) & np.isfinite(way).all(axis=1)
    if not known.any():
        return []
    turn = to_rotvec(matrix(visual, "q")[known])
    ahead = rotate(from_rotvec(-0.5 * turn), way[known])  # in a bend a chord lies along its middle
    span_s = (time_ns(visual, "end_time") - time_ns(visual))[known, None] * 1e-9
    t_s = _middle_s(visual, start_ns)[known]
    return [Direction(t_s, ahead.T, _lasting(t_s, sigma[known]), (turn / span_s).T)]


def _lasting(t_s: Array, sigma: Array) -> Array:
    """Sigmas (m,) of which those within a second either side say together no more than one.

    A camera follows the same corners from image to image, and mistakes the same turn for a move.
    """
    near = np.searchsorted(t_s, t_s + 1.0, side="right") - np.searchsorted(t_s, t_s - 1.0)
    return np.asarray(sigma * np.sqrt(near))


def _middle_s(visual: pa.Table, start_ns: int) -> Array:
    """The middle between two images, s."""
    t_ns, end_ns = time_ns(visual), time_ns(visual, "end_time")
    return (t_ns - start_ns + (end_ns - t_ns) // 2) * 1e-9
