"""Does the truth of a simulated crash lie in the intervals of analyzer.crash as often as they promise, 95 times of 100?

    python tests/benchmarks/crash_coverage.py pulses 2000     # errors drawn on pulses in vehicle axes: the propagation
    python tests/benchmarks/crash_coverage.py drives 200      # whole drives through detector.crash and fuser.map

The truth is what the same definitions give for the true acceleration, with the time zero that is found in it. Nothing
but the sensors' output reaches the stages.
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

from recon.numerics.rotation import from_rotvec, rotate
from recon.schema import IMU, Change
from recon.sensor_classes import typical
from recon.tables import Array, build, matrix, time_ns
from recon_analyzers._pulse import LINEARITY, motion_of, pulse_at
from recon_analyzers.crash import CrashParams, analyze_crash, measures
from recon_detectors.crash import CrashParams as DetectorParams
from recon_detectors.crash import crash as detect
from recon_fusers.map import MapParams, fuse_map
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams

VEHICLE = Change({"accel": "vehicle", "gyro": "vehicle"}, {"accel": "acceleration"}).apply(IMU)
KM_H = 1.0 / 3.6
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
        again=float(rng.uniform(0.6, 1.5)) if rng.random() < 0.3 else None,
        mount_yaw=rng.uniform(-np.pi, np.pi),
        mount_roll=rng.normal(0.0, 0.3),
        mount_pitch=rng.normal(0.0, 0.3),
        accel_full_scale=4000.0 if rng.random() < 0.8 else 16 * 9.80665,
        heading=rng.uniform(0.0, 6.0),
        seed=seed,
    )
    log = simulate_drive(params)
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
    rows, reference = rows_of(found["metrics"]), log["reference"]
    truth = truth_of(time_ns(reference), matrix(reference, "accel"), matrix(reference, "gyro"))
    if truth and "delta_v_long_max" in rows:
        zero = next(row for row in events.to_pylist() if row["kind"] == "crash")["time"]
        impacts = [row for row in found["events"].to_pylist() if row["kind"] == "impact"]
        zero = max(impacts, key=lambda row: row["value"])["time"] if impacts else zero
        vel = matrix(reference, "vel")
        row = int(np.searchsorted(time_ns(reference), pa.scalar(zero, pa.timestamp("ns", "UTC")).value))
        truth["speed_before"] = float(np.hypot(*vel[row, :2])) / KM_H
    return rows, truth


def with_events(events: pa.Table) -> dict[str, Any]:
    return {"events": events, "params": MapParams()}


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
