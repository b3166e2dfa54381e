"""What fuser.map warns of where its result shows that the log was no drive as it takes it for."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from map_drives import drive, fused

from recon.numerics.rotation import conjugate, from_rotvec, multiply, rotate
from recon.rows import warnings_of
from recon.tables import Streams, matrix, replace, seconds

DOUBTS = ("loose in the vehicle", "slide sideways")


def swinging(imu: pa.Table, seed: int) -> pa.Table:
    """From 20 s on the box swings about all axes by some 8 deg, a fifth of a time to once a second."""
    rng, t_s = np.random.default_rng(seed), seconds(imu)
    tones = [(rng.normal(0.0, 1.0, 3), rng.uniform(0.0, 2.0 * np.pi, 3), tone_hz) for tone_hz in (0.2, 0.5, 1.1)]
    turn = sum(size * np.sin(2.0 * np.pi * tone_hz * t_s[:, None] + phase) for size, phase, tone_hz in tones)
    q = from_rotvec(np.radians(7.0) * turn * np.clip(t_s - 20.0, 0.0, 1.0)[:, None])
    step = multiply(conjugate(q[:-1]), q[1:])
    rate = 2.0 * step[:, 1:] / np.diff(t_s)[:, None]
    gyro = rotate(conjugate(q), matrix(imu, "gyro")) + np.vstack([rate, rate[-1:]])
    return replace(imu, accel=rotate(conjugate(q), matrix(imu, "accel")), gyro=gyro)


def told(streams: Streams) -> list[str]:
    return [doubt for doubt in DOUBTS if any(doubt in note for note in warnings_of(fused(streams)["metrics"]))]


@pytest.mark.parametrize(("part", "times", "doubted"), [
    ("accel", 1.0, False), ("accel", 1.05, True), ("accel", 0.95, True), ("gyro", 1.05, True),
])  # fmt: skip
def test_a_scale_that_no_sensor_of_the_class_has_is_warned_of(part: str, times: float, doubted: bool) -> None:
    log = drive("city", "consumer_mems", seed=3, duration=240.0)
    imu = replace(log["imu"], **{part: times * matrix(log["imu"], part)})
    notes = [note for note in warnings_of(fused({**log, "imu": imu})["metrics"]) if "the scale of" in note]
    assert len(notes) == doubted
    assert all(f"the scale of {part} comes out" in note for note in notes)


@pytest.mark.parametrize("seed", range(6))
def test_a_box_that_swings_in_the_vehicle_is_warned_of(seed: int) -> None:
    log = drive("city", seed=seed, duration=120.0)
    assert not told(log)
    assert told({**log, "imu": swinging(log["imu"], seed)})
