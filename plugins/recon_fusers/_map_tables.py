"""What fuser.map found, as streams: trajectory, residuals and events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import RESIDUALS, TRAJECTORY, Array, Event, build, meta, time_ns, with_meta
from recon.fixes import Observed
from recon.numerics.signals import runs
from recon.numerics.smoothing import Estimate, between_knots, full_rate, geodetic, sigmas
from recon.numerics.smoothing.soa import matrix_to_quat
from recon.numerics.smoothing.state import ACCEL_SCALE, CLOCK, DRIFT, GYRO_SCALE, LAG, LEVER, MOUNT, POSITION, VELOCITY

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
    _where_missed(deviation, found, motion.u)
    accel_v, rate_v = _felt(found)
    accel_v -= np.sqrt((solved.ends.gravity_n[:, :1] ** 2).sum()) * _up(motion.q_lv)
    columns = {
        "pos": motion.pos_n, "vel": motion.vel_l, "q": motion.q_lv, "accel": accel_v, "gyro": rate_v,
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


def _where_missed(deviation: Array, found: Estimate, u: Array) -> None:
    """Raise the sigmas (9, n + 1) between knots where the IMU was silent or an impact beyond it.

    Nothing says when in the interval what it missed came about.

    As of white noise that is pinned down at both knots: Barfoot, Tong, Sarkka (2014), RSS X, eq. 20. u : (n,)
    """
    turns, moves = found.smoother.disturbed.missed()
    k = np.flatnonzero((turns > 0.0) | (moves > 0.0))
    inside = deviation[:, :-1].reshape(9, len(turns), -1)
    u = np.clip(u.reshape(len(turns), -1)[k], 0.0, 1.0)
    bend, length = u * (1.0 - u), found.smoother.length[k, None]
    moved, turned = moves[k, None] * length, turns[k, None] * length
    for rows, variance in (
        (slice(0, 3), moved * length**2 * bend**3 / 3.0),
        (slice(3, 6), moved * bend * (1.0 - 3.0 * bend)),
        (slice(6, 9), turned * bend),
    ):
        inside[rows, k] = np.hypot(inside[rows, k], np.sqrt(variance))


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

        y = pos + drift + rot_ns lever + vel (lag + clock since the middle)
    """
    state, common, smoother = found.solved.state, np.r_[LEVER, LAG, CLOCK], found.smoother
    moves = state.vel_n.T[:, :, None]
    since_s = (smoother.drive.samples.knot_times - smoother.epochs.middle_s)[:, None, None]
    by_common = np.concatenate([state.rot_ns.transpose(2, 0, 1), moves, moves * since_s], axis=2)
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
    within = ((kind, *np.clip((a, b), knots[0], knots[-1])) for kind, a, b in spans)
    return [
        Event(start_ns + round(a * 1e9), start_ns + round(b * 1e9), kind, float(b - a), "s") for kind, a, b in within
    ]
