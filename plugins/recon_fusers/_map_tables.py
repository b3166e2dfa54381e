"""What fuser.map found, as streams: trajectory, residuals, knots, events and metrics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import RESIDUALS, TRAJECTORY, Array, Event, Metric, build, meta, time_ns, with_meta
from recon.driving import mounting_metrics
from recon.fixes import Observed
from recon.numerics.signals import runs
from recon.numerics.smoothing import Estimate, between_knots, full_rate, geodetic, sigmas
from recon.numerics.smoothing.soa import matrix_to_quat, quat_multiply
from recon.numerics.smoothing.state import (
    ACCEL_BIAS,
    ACCEL_SCALE,
    BARO,
    CAMERA,
    CAMERA_LEVER,
    DRIFT,
    GYRO_BIAS,
    GYRO_SCALE,
    LAG,
    LEVER,
    MOUNT,
    PITCH,
    POSITION,
    REAR,
    ROLL,
    SLIP,
    VELOCITY,
    VELOCITY_LAG,
    WHEEL,
)

_STANDARD_FACTS: Final = ("time_scale", "clock")
_VELOCITIES: Final = {
    "vector": ("vel_e", "vel_n", "vel_u"), "course": ("vel_along", "vel_across", "vel_u"),
    "speed": ("speed", "vel_across", "vel_u"),
}  # fmt: skip
"""Names of the components of a velocity, by kind."""
_OUTAGE_S: Final = 3.0
_LEAST_OWN: Final = 0.1
"""Of the variance of a fix, what its residual keeps at least."""


def trajectory(found: Estimate, observed: Observed, imu: pa.Table, gnss: pa.Table, rate_hz: float | None) -> pa.Table:
    """At the times of the imu, or at about `rate_hz` of them."""
    solved, samples, drive = found.solved, found.smoother.drive.samples, found.smoother.drive
    state = solved.state
    kept = np.flatnonzero(samples.row >= 0)
    if rate_hz is not None:
        kept = kept[_thinned(samples.t_s[kept], rate_hz)]
    motion = full_rate(state, solved.ends, solved.increments, samples, drive.anchor)
    deviation = between_knots(sigmas(found), motion.u, samples.per_interval)
    q_sv = matrix_to_quat(state.rot_vs.T[..., None])
    q_lv = quat_multiply(motion.q_ls, q_sv)
    force_v, rate_v = _felt(found)
    gravity = np.sqrt((found.solved.ends.gravity_n[:, :1] ** 2).sum())
    columns = {
        "pos": motion.pos_n, "vel": motion.vel_l, "q": q_lv, "accel": force_v - gravity * _up(q_lv), "gyro": rate_v,
        "pos_std": deviation[:3], "vel_std": deviation[3:6], "att_std": deviation[6:],
    }  # fmt: skip
    if len(kept) < len(samples.row):
        chosen = slice(kept[0], kept[-1] + 1) if kept[-1] - kept[0] + 1 == len(kept) else kept
        columns = {name: values[:, chosen] for name, values in columns.items()}
    placed = bool(np.isfinite(drive.fixes.pos_sigma[:2]).any())
    lat, lon, height = geodetic(columns["pos"], drive.anchor) if placed else (np.full(len(kept), np.nan),) * 3
    known = np.r_[ACCEL_SCALE, MOUNT]
    table = build(
        TRAJECTORY,
        time=time_ns(imu)[samples.row[kept]],
        lat=lat,
        lon=lon,
        height=height if observed.height else np.full(len(kept), np.nan),
        **{name: values.T for name, values in columns.items()},
    )
    return with_meta(
        table,
        **_facts(imu, gnss, observed, placed),
        mounting=matrix_to_quat(state.rot_vs[..., None])[:, 0].tolist(),
        mounting_covariance=found.covariance_common[np.ix_(known, known)].tolist(),
    )


def _facts(imu: pa.Table, gnss: pa.Table, observed: Observed, placed: bool) -> dict[str, object]:
    clock = {name: meta(imu).get(name) for name in _STANDARD_FACTS}
    if not placed:
        return clock
    return {
        **clock,
        "anchor": asdict(observed.anchor),
        "earth": "wgs84",
        "height_datum": meta(gnss).get("height_datum"),
    }


def _thinned(t_s: Array, rate_hz: float) -> NDArray[np.intp]:
    """The first of each period."""
    return np.unique(np.floor((t_s - t_s[0]) * rate_hz + 1e-6), return_index=True)[1]


def _up(q: Array) -> Array:
    """Local up in the body of q (4, n): (3, n)."""
    w, x, y, z = q
    return np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)])


def _felt(found: Estimate) -> tuple[Array, Array]:
    """Specific force (3, n) m/s^2 and angular rate (3, n) rad/s in the vehicle, biases and scale errors removed."""
    state, samples = found.solved.state, found.smoother.drive.samples
    out = []
    for logged, bias, scale in (
        (samples.accel_s, state.accel_bias, state.common[ACCEL_SCALE]),
        (samples.gyro_s, state.gyro_bias, state.common[GYRO_SCALE]),
    ):
        turn = state.rot_vs * (1.0 - scale)
        value = np.einsum("ij,nj->in", turn, logged)  # a seventh of the time of turn @ logged.T
        each = value[:, :-1].reshape(3, samples.intervals, samples.per_interval)
        each -= (turn @ bias[:, :-1])[:, :, None]
        value[:, -1] -= turn @ bias[:, -1]
        out.append(value)
    return out[0], out[1]


def residuals(
    found: Estimate, observed: Observed, kinds: Mapping[str, str], receivers: Mapping[str, pa.Table]
) -> pa.Table:
    """What every fix says less what was found, axis by axis, with the weight that it got.

    Of positions the slow error that was found is taken off; sigma is that of the residual, the fix's white error less
    what the solution has taken of it. Velocities that only say that it is small are left out.

    kinds : of velocities, by name of the stream, in the order in which `observed.receiver` counts; receivers : rows
    """
    solved, fixes = found.solved, observed.fixes
    epochs = solved.epochs
    at = np.flatnonzero(epochs.fix >= 0)
    at = at[np.argsort(epochs.fix[at])]
    measured = (
        (solved.pos_residual, fixes.pos_sigma, solved.pos_weight, solved.noise.position, _explained_position(found)),
        (solved.vel_residual, np.where(fixes.small_only, np.inf, fixes.vel_sigma), solved.vel_weight,
         solved.noise.velocity, _explained_velocity(found)),
    )  # fmt: skip
    parts = []
    for number, (sensor, kind) in enumerate(kinds.items()):
        own = at if observed.receiver is None else at[observed.receiver[epochs.fix[at]] == number]
        fix = epochs.fix[own]
        stamps, share = time_ns(receivers[sensor])[observed.row[fix]], fixes.share[fix]
        knot = epochs.interval[own] + (solved.inside.u[own] > 0.5)
        for components, (residual, sigma, weight, scale, explained) in zip(
            (("pos_e", "pos_n", "pos_u"), _VELOCITIES.get(kind, ())), measured, strict=True
        ):
            for axis, component in enumerate(components):
                seen = np.isfinite(sigma[axis, fix])
                white = sigma[axis, fix[seen]] * scale[axis]
                kept = 1.0 - explained[knot[seen], axis] * share[seen] / white**2
                width = white * np.sqrt(np.maximum(kept, _LEAST_OWN))
                value = -residual[axis, own[seen]] / np.sqrt(share[seen]) * white
                parts.append((stamps[seen], sensor, component, value, width, weight[own[seen]]))
    return _residual_table(parts)


def _explained_position(found: Estimate) -> Array:
    """Variance of what the solution says that GNSS shows at each knot: (N, 3) m^2.

    Position, slow error, antenna and delay make up one for the other, so that their sum is known far better than each:

        y = pos + drift + rot_ns lever + vel lag
    """
    state, common = found.solved.state, np.r_[LEVER, LAG]
    by_common = np.concatenate([state.rot_ns.transpose(2, 0, 1), state.vel_n.T[:, :, None]], axis=2)
    own = sum(found.covariance[:, a, b] for a in (DRIFT, POSITION) for b in (DRIFT, POSITION))
    cross = (found.cross[:, DRIFT] + found.cross[:, POSITION])[..., common]
    shared = by_common @ found.covariance_common[np.ix_(common, common)]
    return np.asarray(np.diagonal(own, axis1=1, axis2=2) + ((2.0 * cross + shared) * by_common).sum(axis=2))


def _explained_velocity(found: Estimate) -> Array:
    """Variance of the velocity at each knot: (N, 3) m^2/s^2."""
    return np.asarray(np.diagonal(found.covariance[:, VELOCITY, VELOCITY], axis1=1, axis2=2))


def _residual_table(parts: list[tuple[NDArray[np.int64], str, str, Array, Array, Array]]) -> pa.Table:
    t_ns = np.concatenate([part[0] for part in parts])
    which = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
    order = np.lexsort((which, t_ns))
    value, sigma, weight = (np.concatenate([part[i] for part in parts])[order] for i in (3, 4, 5))
    sensor, component = (
        pa.array([part[i] for part in parts], pa.string()).take(pa.array(which[order])) for i in (1, 2)
    )
    return build(
        RESIDUALS,
        time=t_ns[order],
        sensor=sensor,
        component=component,
        value=value,
        sigma=sigma,
        weight=weight,
        accepted=pa.array(weight > 0.5),
    )


def happenings(found: Estimate, start_ns: int) -> list[Event]:
    """Standstills, and outages of GNSS within the log."""
    smoother = found.smoother
    blocks, half = smoother.blocks, 0.5 * smoother.blocks.duration
    spans = [
        ("standstill", blocks.t_s[first] - half, blocks.t_s[stop - 1] + half) for first, stop in runs(smoother.still)
    ]
    knots = smoother.drive.samples.knot_times
    seen = smoother.drive.fixes.t_s
    seen = np.concatenate([knots[:1], seen[(seen > knots[0]) & (seen < knots[-1])], knots[-1:]])
    step = np.diff(seen)
    long = np.flatnonzero(step > max(_OUTAGE_S, 2.5 * float(np.median(step))))
    spans += [("outage", seen[i], seen[i + 1]) for i in long]
    return [
        Event(start_ns + round(a * 1e9), start_ns + round(b * 1e9), kind, float(b - a), "s") for kind, a, b in spans
    ]


def estimates(found: Estimate, observed: Observed) -> list[Metric]:
    """Every number that was found, with its sigma."""
    solved, common = found.solved, found.solved.state.common
    deviation = np.sqrt(np.maximum(np.diag(found.covariance_common), 0.0))
    how = "maximum a posteriori"
    rows = mounting_metrics(found)
    lever_v, rear_v = (solved.state.rot_vs @ common[part] for part in (LEVER, REAR))
    for name, value, part in (("lever_arm", lever_v, LEVER), ("rear_axle", rear_v, REAR)):
        spread = solved.state.rot_vs @ found.covariance_common[part, part] @ solved.state.rot_vs.T
        rows += (
            [
                Metric(
                    f"{name}_{axis}",
                    float(v),
                    "m",
                    float(np.sqrt(max(c, 0.0))),
                    method=how,
                    note="vehicle, from the IMU",
                )
                for axis, v, c in zip("xyz", value, np.diag(spread), strict=True)
            ]
            if spread.any()
            else []
        )
    for name, index, unit, factor in (
        ("gnss_delay", LAG, "s", -1.0), ("gnss_velocity_delay", VELOCITY_LAG, "s", -1.0),
        ("side_slip_per_acceleration", SLIP, "s^2/m", 1.0), ("pitch_per_acceleration", PITCH, "s^2/m", 1.0),
        ("roll_per_acceleration", ROLL, "s^2/m", 1.0), ("wheel_speed_scale", WHEEL, "1", 1.0),
    ):  # fmt: skip
        if deviation[index] > 0.0 and (index != WHEEL or len(found.smoother.drive.wheel_t_s)):
            value = common[index] + (solved.moved_lag if index == LAG else 0.0)
            rows.append(Metric(name, factor * float(value), unit, float(deviation[index]), method=how))
    if deviation[BARO] > 0.0:
        note = "of the standard atmosphere's climbs"
        rows.append(Metric("baro_scale", 1.0 + float(common[BARO]), "1", float(deviation[BARO]), method=how, note=note))
    rows += _biases(found)
    for name, part, unit, factor in (
        ("gyro_scale", GYRO_SCALE, "1", 1.0), ("accel_scale", ACCEL_SCALE, "1", 1.0),
        ("camera_turned", CAMERA, "deg", np.degrees(1.0)), ("camera_lever", CAMERA_LEVER, "m", 1.0),
    ):  # fmt: skip
        rows += [
            Metric(f"{name}_{axis}", float(v) * factor, unit, float(s) * factor, method=how, note="sensor frame")
            for axis, v, s in zip("xyz", common[part], deviation[part], strict=True) if s > 0.0
        ]  # fmt: skip
    return rows + _noise(found, observed)


def _biases(found: Estimate) -> list[Metric]:
    state = found.solved.state
    rows = []
    for name, values, part, unit, factor in (
        ("gyro_bias", state.gyro_bias, GYRO_BIAS, "deg/s", np.degrees(1.0)),
        ("accel_bias", state.accel_bias, ACCEL_BIAS, "m/s^2", 1.0),
    ):
        deviation = np.sqrt(np.maximum(np.diagonal(found.covariance[:, part, part], axis1=1, axis2=2).min(axis=0), 0.0))
        rows += [
            Metric(
                f"{name}_{axis}", float(v.mean()) * factor, unit, float(s) * factor, float(v.min()) * factor,
                float(v.max()) * factor, "mean over the drive", "sensor frame; low and high are those of the drive"
            )
            for axis, v, s in zip("xyz", values, deviation, strict=True)
        ]  # fmt: skip
    return rows


def _noise(found: Estimate, observed: Observed) -> list[Metric]:
    noise, solved = found.solved.noise, found.solved
    fixes = observed.fixes
    rows = [
        Metric("gyro_noise", float(np.degrees(noise.gyro)), "deg/s/sqrt(Hz)", note="in the moving vehicle"),
        Metric("accel_noise", noise.accel, "m/s^2/sqrt(Hz)", note="in the moving vehicle"),
        Metric("gyro_bias_walk", float(np.degrees(noise.gyro_walk)), "deg/s/sqrt(s)"),
        Metric("accel_bias_walk", noise.accel_walk, "m/s^2/sqrt(s)"),
        Metric("motion_sideways", noise.sideways, "m/s", note="of the wheels, mean of a second"),
        Metric("motion_upwards", noise.upwards, "m/s", note="of the wheels, mean of a second"),
    ]
    if np.isfinite(fixes.pos_sigma).any():
        rows += [
            Metric("gnss_slow_error_horizontal", float(noise.drift[0]), "m", note="sigma of each axis"),
            Metric("gnss_slow_error_vertical", float(noise.drift[2]), "m"),
            Metric("gnss_slow_error_time", noise.drift_tau, "s", note="correlation time"),
            Metric("gnss_position_noise_factor", float(noise.position[0]), "1", note="on the white sigma"),
        ]
    if np.isfinite(fixes.vel_sigma).any():
        rows.append(Metric("gnss_velocity_noise_factor", float(noise.velocity[0]), "1", note="on the sigma"))
    used = solved.epochs.fix >= 0
    for name, sigma, weight in (
        ("positions", fixes.pos_sigma, solved.pos_weight),
        ("velocities", fixes.vel_sigma, solved.vel_weight),
    ):
        seen = used & np.isfinite(sigma[:, solved.epochs.fix]).any(axis=0)
        if seen.any():
            rows.append(Metric(f"gnss_{name}", float(seen.sum())))
            rows.append(Metric(f"gnss_{name}_rejected", float((seen & (weight < 0.5)).sum())))
    rows.append(Metric("steps", float(solved.steps), note="of Gauss and Newton to convergence"))
    return rows
