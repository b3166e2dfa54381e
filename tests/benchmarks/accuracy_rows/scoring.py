"""fuser.map on one simulated drive, held against the truth: a number for each column of the tables.

Errors of attitude are rotations about the axes of the anchor. Those of the sensor (vehicle attitude times estimated
mounting) are scored as those of the peers; those of the vehicle are about its heading, across and up.

    NEES per degree of freedom = mean over the knots of e^T P^-1 e / k

with the whole covariance P of the k = 3 components from the stream `knots`. A fix counts as an outlier where a burst of
multipath of more than OUTLIER m hits it, as good where none does, and as rejected where its weight is below a half.
"""

from __future__ import annotations

import time
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray
from peers.drives import Drive, Estimate
from peers.scores import Errors, Score, in_outage, score
from peers.simulated import simulated

from recon.driving import drive_of, solve
from recon.fixes import observe
from recon.knots import ATTITUDE, POSITION, VELOCITY, Knots
from recon.numerics.geodesy import Anchor, geodetic_to_enu, local_axes_e
from recon.numerics.rotation import Floats, conjugate, from_matrix, multiply, rotate, to_euler, to_rotvec
from recon.numerics.smoothing.state import ACCEL_BIAS, GYRO_BIAS
from recon.tables import Streams, matrix, time_ns, vector
from recon_fusers import map as fuser
from recon_simulators.drive import simulate_drive

from .cases import Job

OUTLIER: Final = 10.0
TWO_SIGMA: Final = 6.180
"""Square of the radius that holds 95.45 % of a Gaussian in the plane."""

Row = dict[str, float]


def scored(job: Job) -> Row:
    """Simulate, smooth and score: the columns of accuracy_rows.tables."""
    streams = simulate_drive(job.drive)
    drive, truth = simulated(job.drive.model_copy(update={"gnss_vector": True}))
    made, vehicle, found = smoothed(job, streams, drive, truth)
    true = _true_vehicle(truth, drive, vehicle.t_s)
    errors = _errors(vehicle, true)
    return {
        **_named("", found.drive),
        **_of_vehicle(errors[:, ATTITUDE], true.q_ns),
        **_named("outage_", found.outages),
        "outage_worst": found.worst,
        **_honesty(made, streams, errors, job),
        **_outliers(made["residuals"], streams),
        "steps": learnt(made)["steps"],
        "warnings": float(made["metrics"]["name"].to_pylist().count("warning")),
        "wall_s": found.wall_s,
    }


def smoothed(job: Job, streams: Streams, drive: Drive, truth: Estimate) -> tuple[Streams, Estimate, Score]:
    """What fuser.map makes of a drive, its trajectory with the attitude of the vehicle, and the score of the sensor's.

    drive, truth : of the same parameters as the streams
    """
    begin = time.perf_counter()
    made = fused(streams, job.fuser)
    wall_s = time.perf_counter() - begin
    vehicle = estimate_of(made["trajectory"], anchor_of(job), int(time_ns(streams["imu"])[0]))
    outage = in_outage(vehicle.t_s, drive.fix_t_s)
    return made, vehicle, score(of_sensor(vehicle, learnt(made)), truth, outage, wall_s)


def fused(streams: Streams, params: fuser.MapParams) -> Streams:
    """What fuser.map makes of imu and gnss."""
    return fuser.fuse_map(
        imu=streams["imu"], gnss=streams["gnss"], wheel=None, attitude=None, events=None, params=params
    )


def anchor_of(job: Job) -> Anchor:
    """Where the drive starts."""
    place = job.drive
    return Anchor(float(np.degrees(place.lat)), float(np.degrees(place.lon)), place.height)


def learnt(made: Streams) -> Row:
    """The numbers among the metrics, by name."""
    rows = made["metrics"].to_pylist()
    return {row["name"]: row["value"] for row in rows if row["value"] is not None}


def estimate_of(trajectory: pa.Table, anchor: Anchor, start_ns: int) -> Estimate:
    """A trajectory along the axes of an anchor; its attitude is that of the vehicle."""
    lat, lon, height = (vector(trajectory, name) for name in ("lat", "lon", "height"))
    axes_e = np.moveaxis(local_axes_e(lat, lon), -1, 0)
    turn = from_matrix(local_axes_e(anchor.lat, anchor.lon).T @ axes_e)
    return Estimate(
        np.asarray((time_ns(trajectory) - start_ns) * 1e-9),
        geodetic_to_enu(lat, lon, height, anchor),
        rotate(turn, matrix(trajectory, "vel")),
        multiply(turn, matrix(trajectory, "q")),
    )


def of_sensor(vehicle: Estimate, told: Row) -> Estimate:
    """The same motion with the attitude of the sensor, by the mounting that was found."""
    mount_q_vs = np.array([told[f"mount_q{name}"] for name in "wxyz"])
    return Estimate(vehicle.t_s, vehicle.pos_n, vehicle.vel_n, multiply(vehicle.q_ns, mount_q_vs))


def _named(prefix: str, errors: Errors) -> Row:
    lengths = {name: getattr(errors, name) for name in ("horizontal", "vertical", "velocity")}
    angles = {name: float(np.degrees(getattr(errors, name))) for name in ("tilt", "heading")}
    return {f"{prefix}{name}": value for name, value in {**lengths, **angles}.items()}


def _true_vehicle(truth: Estimate, drive: Drive, t_s: Floats) -> Estimate:
    """The rows of the truth at some of its times, with the attitude of the vehicle."""
    at = np.searchsorted(truth.t_s, t_s)
    q_nv = multiply(truth.q_ns[at], conjugate(drive.mount_q_vs))
    return Estimate(truth.t_s[at], truth.pos_n[at], truth.vel_n[at], q_nv)


def _errors(vehicle: Estimate, true: Estimate) -> Floats:
    """Position, velocity and attitude less the truth at the same times, as recon.knots orders them: (n, 9), axes n."""
    turn_n = to_rotvec(multiply(vehicle.q_ns, conjugate(true.q_ns)))
    return np.hstack([vehicle.pos_n - true.pos_n, vehicle.vel_n - true.vel_n, turn_n])


def _of_vehicle(turn_n: Floats, q_nv: Floats) -> Row:
    """Root mean squares in deg of errors of attitude (n, 3) about the vehicle's level axes ahead and left, and up."""
    yaw = to_euler(q_nv)[0]
    east, north, up = np.degrees(turn_n).T
    ahead, left = east * np.cos(yaw) + north * np.sin(yaw), north * np.cos(yaw) - east * np.sin(yaw)
    about = {"roll": ahead, "pitch": left, "heading": up}
    return {f"vehicle_{name}": float(np.sqrt((angle**2).mean())) for name, angle in about.items()}


def _honesty(made: Streams, streams: Streams, errors: Floats, job: Job) -> Row:
    """NEES and coverage at the knots."""
    knots = Knots.of(made["knots"])
    at = np.clip(np.searchsorted(time_ns(made["trajectory"]), knots.t_ns), 0, len(errors) - 1)
    error = errors[at]
    covariance = knots.root @ knots.root.swapaxes(1, 2) + knots.shared @ knots.shared.swapaxes(1, 2)
    row = {
        f"nees_{name}": _nees(error[:, part], covariance[:, part, part])
        for name, part in (("position", POSITION), ("velocity", VELOCITY), ("attitude", ATTITUDE))
    }
    level = slice(0, 2)
    row["coverage"] = 100.0 * float((_squared(error[:, level], covariance[:, level, level]) < TWO_SIGMA).mean())
    sure = _bias_covariances(streams, job.fuser)
    for sensor in ("gyro", "accel"):
        true = matrix(streams["imu_truth"], f"{sensor}_bias")[at]
        row[f"nees_{sensor}_bias"] = _nees(matrix(made["knots"], f"{sensor}_bias") - true, sure[sensor])
    return row


def _bias_covariances(streams: Streams, params: fuser.MapParams) -> dict[str, Floats]:
    """Of the biases at the knots, (N, 3, 3): the stream `knots` does not tell them, so the drive is solved again."""
    start_ns = int(time_ns(streams["imu"])[0])
    observed = observe(streams["gnss"], start_ns, fuser.trust_of(params), params.reported_sigmas)
    drive = drive_of(streams["imu"], None, observed, start_ns)
    found = solve(drive, fuser.model_of(params, None), fuser.noise_of(params, observed), params.estimate_noise)
    return {"gyro": found.covariance[:, GYRO_BIAS, GYRO_BIAS], "accel": found.covariance[:, ACCEL_BIAS, ACCEL_BIAS]}


def _squared(error: Floats, covariance: Floats) -> Floats:
    """e^T P^-1 e: (n,)."""
    return np.asarray((error * np.linalg.solve(covariance, error[..., None])[..., 0]).sum(axis=1))


def _nees(error: Floats, covariance: Floats) -> float:
    return float(_squared(error, covariance).mean() / error.shape[1])


def _outliers(residuals: pa.Table, streams: Streams) -> Row:
    """How many outliers, good positions and good velocities there were, and how many of each were rejected."""
    hit, far = _struck(streams)
    fix_ns = time_ns(streams["gnss"])
    component = residuals["component"].to_numpy(zero_copy_only=False)
    at, out = np.searchsorted(fix_ns, time_ns(residuals)), vector(residuals, "weight") < 0.5
    row: Row = {}
    for name, components, of in (
        ("outliers", ("pos_e",), far),
        ("positions", ("pos_e",), ~hit),
        ("velocities", ("vel_e", "vel_along", "speed"), ~hit),
    ):
        chosen = np.isin(component, components) & of[at]
        row[name], row[f"{name}_rejected"] = float(chosen.sum()), float((chosen & out).sum())
    return row


def _struck(streams: Streams) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Fixes that a burst of multipath hits, and those that one of more than OUTLIER m does: (m,) each."""
    fix_ns = time_ns(streams["gnss"])
    hit, far = np.zeros((2, len(fix_ns)), dtype=bool)
    events = streams["events"]
    bursts = events.filter(pc.equal(events["kind"], "multipath"))
    for first, last, size in zip(time_ns(bursts), time_ns(bursts, "end_time"), vector(bursts, "value"), strict=True):
        inside = (fix_ns >= first) & (fix_ns <= last)
        hit |= inside
        far |= inside & (size > OUTLIER)
    return hit, far
