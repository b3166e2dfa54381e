"""Does the truth of a simulated crash lie in the intervals of analyzer.crash as often as they promise, 95 times of 100?

    python tests/benchmarks/crash_coverage.py pulses 2000     # errors drawn on pulses in vehicle axes: the propagation
    python tests/benchmarks/crash_coverage.py drives 200      # whole drives through detector.crash and fuser.map

The truth is what the same definitions give for the true acceleration, sampled far more often than the box did, with
the time zero that is found in it. Nothing but the sensors' output reaches the stages.

The sensor errs as the intervals are told that it may: biases, their walks and scale errors are those of its class, the
noise as well while the car moves, and where accelerations are those of an impact the scale errs by LINEARITY more,
which no drive before it shows.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping
from functools import partial
from multiprocessing import get_context
from typing import Any

import numpy as np
import pyarrow as pa

sys.path.insert(0, str(os.path.join(os.path.dirname(__file__), "..")))  # noqa: PTH118, PTH120

import crash_pulses as pulses

from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.rotation import from_rotvec, rotate
from recon.numerics.signals import median_rate
from recon.schema import IMU, Change
from recon.sensor_classes import NAMES, typical
from recon.tables import Array, Streams, build, matrix, replace, time_ns
from recon_analyzers._crash_measures import measures
from recon_analyzers._pulse import LINEARITY, motion_of, pulse_at
from recon_analyzers.crash import CrashParams, analyze_crash
from recon_detectors.crash import CrashParams as DetectorParams
from recon_detectors.crash import crash as detect
from recon_fusers.map import MapParams, fuse_map
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams

VEHICLE = Change({"accel": "vehicle", "gyro": "vehicle"}, {"accel": "acceleration"}).apply(IMU)
KM_H = 1.0 / 3.6
TRUE_HZ = 2000.0
BENT_AT = STANDARD_GRAVITY
"""Where half of the further scale error has come."""
NOISES = ("accel_noise", "gyro_noise")
STILL = 1.0 / 1.5
"""Of the noise of a class, which is that of a moving car, what is left of it where the car stands."""
Told = tuple[dict[str, Any], dict[str, float]]
"""Metrics rows by name, and the truth."""


def truth_of(t_ns: Array, accel: Array, gyro: Array) -> dict[str, float]:
    """The numbers of the true motion, vehicle axes, gravity removed; empty where it is no crash."""
    imu = build(VEHICLE, time=t_ns, accel=accel, gyro=gyro)
    rows = [row for row in detect(imu=imu, params=DetectorParams())["events"].to_pylist() if row["kind"] == "crash"]
    motion = motion_of(None, imu)
    if not rows or motion is None:
        return {}
    found: dict[str, float] = {}
    for row in rows:
        zero_ns = row["time"].value if hasattr(row["time"], "value") else int(row["time"].timestamp() * 1e9)
        pulse = pulse_at(motion, int(zero_ns), None, None)
        assert pulse is not None
        here = measures(pulse.accel[None], pulse.gyro[None, :, 2], pulse=pulse, ahead=0.0)
        told = {name: float(value[0]) for name, value in here.items()}
        if not found or told["delta_v_resultant_max"] > found["delta_v_resultant_max"]:
            found = told
    return found


def a_pulse(seed: int) -> Told:
    """A random pulse seen through an IMU whose errors are of the size that the class of the sensor says."""
    rng = np.random.default_rng(seed)
    t_s = pulses.times(float(rng.choice([200.0, 400.0, 1000.0])))
    size, angle = rng.uniform(12.0, 60.0) * KM_H, rng.uniform(-np.pi, np.pi)
    shape = str(rng.choice(["haversine", "half_sine", "triangle", "trapezoid"]))
    true = pulses.crash(t_s, (-size * np.cos(angle), size * np.sin(angle)), rng.uniform(0.06, 0.16), shape)
    true = true - pulses.at_rest(t_s)
    true[:, 2] += pulses.pulse(t_s, pulses.ZERO_S, 0.1) * rng.normal(0.0, 0.5)
    gyro = np.zeros_like(true)
    gyro[:, 2] = pulses.pulse(t_s, pulses.ZERO_S, 0.8) * rng.normal(0.0, 0.4)
    value = partial(typical, "consumer_mems")
    tilt = rng.normal(0.0, np.radians(1.0), 3)
    seen = (1.0 + rng.normal(0.0, np.hypot(value("accel_scale"), LINEARITY), 3)) * rotate(from_rotvec(tilt), true)
    seen += rng.normal(0.0, value("accel_bias"), 3) + rng.normal(0.0, rng.uniform(0.05, 0.5), true.shape)
    turn = (1.0 + rng.normal(0.0, value("gyro_scale"))) * gyro + rng.normal(0.0, value("gyro_bias"), 3)
    imu = build(VEHICLE, time=np.rint(t_s * 1e9).astype(np.int64), accel=seen, gyro=turn)
    events = detect(imu=imu, params=DetectorParams())["events"]
    found = analyze_crash(trajectory=None, imu=imu, knots=None, events=events, metrics=None, params=CrashParams())
    return rows_of(found["metrics"]), truth_of(np.rint(t_s * 1e9).astype(np.int64), true, gyro)


def a_drive(seed: int) -> Told:
    """A whole drive that ends in a crash, from a box of unknown mounting, reconstructed by fuser.map."""
    rng = np.random.default_rng(seed + 10_000)
    speed = rng.uniform(30.0, 90.0) * KM_H
    params = DriveParams(
        motion="crash",
        sensors="consumer_mems",
        imu_rate=float(rng.choice([100.0, 200.0, 400.0])),
        speed=speed,
        delta_v=rng.uniform(0.3, 0.9) * speed,
        pulse=rng.uniform(0.07, 0.15),
        direction=float(rng.choice([0.0, rng.uniform(-np.pi, np.pi)])),
        spin=float(rng.choice([0.0, rng.normal(0.0, 0.7)])),
        accel_full_scale=4000.0,
        again=float(rng.uniform(0.6, 1.5)) if rng.random() < 0.3 else None,
        mount_yaw=rng.uniform(-np.pi, np.pi),
        mount_roll=rng.normal(0.0, 0.3),
        mount_pitch=rng.normal(0.0, 0.3),
        **{name: typical("consumer_mems", name) * (STILL if name in NOISES else 1.0) for name in NAMES},
        heading=rng.uniform(0.0, 6.0),
        seed=seed,
    )
    log = driven(simulate_drive(params), 4000.0 if rng.random() < 0.8 else 16 * STANDARD_GRAVITY, rng)
    events = detect(imu=log["imu"], params=DetectorParams())["events"]
    fused = fuse_map(imu=log["imu"], gnss=log["gnss"], wheel=None, attitude=None, events=events, params=MapParams())
    found = analyze_crash(
        trajectory=fused["trajectory"],
        imu=log["imu"],
        knots=fused["knots"],
        events=events,
        metrics=fused["metrics"],
        params=CrashParams(),
    )
    rows = rows_of(found["metrics"])
    reference, crashes = log["reference"], [row for row in events.to_pylist() if row["kind"] == "crash"]
    truth = truth_about(crashes[0]["time"], int(time_ns(reference)[0]), params) if crashes else {}
    if truth and "delta_v_long_max" in rows:
        zero = crashes[0]["time"]
        impacts = [row for row in found["events"].to_pylist() if row["kind"] == "impact"]
        zero = max(impacts, key=lambda row: row["value"])["time"] if impacts else zero
        vel = matrix(reference, "vel")
        row = int(np.searchsorted(time_ns(reference), pa.scalar(zero, pa.timestamp("ns", "UTC")).value))
        truth["speed_before"] = float(np.hypot(*vel[row, :2])) / KM_H
    return rows, truth


def truth_about(zero: Any, start_ns: int, params: DriveParams) -> dict[str, float]:
    """The numbers of the true motion about a crash that was found at a time."""
    begin_s = (pa.scalar(zero, pa.timestamp("ns", "UTC")).value - start_ns) * 1e-9 - 3.0
    near = {"imu_rate": TRUE_HZ, "begin": begin_s, "duration": 6.0}
    reference = simulate_drive(params.model_copy(update=near))["reference"]
    return truth_of(time_ns(reference), matrix(reference, "accel"), matrix(reference, "gyro"))


def driven(log: Streams, full_scale: float, rng: np.random.Generator) -> Streams:
    """As a moving car shakes its sensors, with a scale error that only impacts have, and the end of the range."""
    imu, speed = log["imu"], np.linalg.norm(matrix(log["reference"], "vel"), axis=1)
    moving = (speed > 0.5)[:, None] * np.sqrt((1.0 - STILL**2) * median_rate(time_ns(imu)))
    accel, gyro = (
        matrix(imu, part) + moving * typical("consumer_mems", noise) * rng.standard_normal((imu.num_rows, 3))
        for part, noise in (("accel", "accel_noise"), ("gyro", "gyro_noise"))
    )
    large = accel**2 / (accel**2 + BENT_AT**2)
    accel = accel * (1.0 + large * rng.normal(0.0, LINEARITY, 3))
    return {**log, "imu": replace(imu, accel=np.clip(accel, -full_scale, full_scale), gyro=gyro)}


def rows_of(metrics: pa.Table) -> dict[str, Any]:
    return {row["name"]: row for row in metrics.to_pylist()}


def tally(cases: list[Told]) -> Mapping[str, tuple[int, int, float, float]]:
    """By number: how often there was one, how often the truth lay inside, root mean square of error and of sigma."""
    found: dict[str, list[tuple[bool, float, float]]] = {}
    for rows, truth in cases:
        for name, true in truth.items():
            row = rows.get(name)
            if row is None or row["value"] is None or row["low"] is None or not np.isfinite(true):
                continue
            off = row["value"] - true
            if name == "pdof":
                off = (off + 180.0) % 360.0 - 180.0
            inside = row["low"] - row["value"] <= -off <= row["high"] - row["value"]
            found.setdefault(name, []).append((inside, off, row["sigma"]))
    return {
        name: (
            len(all_),
            sum(i for i, _, _ in all_),
            *(float(np.sqrt(np.mean(np.square(c)))) for c in zip(*[a[1:] for a in all_], strict=True)),
        )
        for name, all_ in found.items()
    }


def run(case: Callable[[int], Told], count: int, first: int) -> list[Told]:
    with get_context("spawn").Pool(int(os.environ.get("JOBS", "1"))) as pool:
        return pool.map(case, range(first, first + count), chunksize=4)


if __name__ == "__main__":
    kind, count = sys.argv[1], int(sys.argv[2])
    first = int(sys.argv[3]) if len(sys.argv) > 3 else 0
    cases = run({"pulses": a_pulse, "drives": a_drive}[kind], count, first)
    print(
        f"{len(cases)} cases, {sum(bool(truth) and 'delta_v_long_max' in rows for rows, truth in cases)} crashes found"
    )
    for name, (n, inside, error, sigma) in tally(cases).items():
        print(f"{name:28s} {n:5d}  {100 * inside / n:6.1f} %   rms error {error:8.4f}   rms sigma {sigma:8.4f}")
