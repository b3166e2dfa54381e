"""Standstills by the quiet of the box, and by GNSS speed where there is one: strictly, for what is built on them.

A second in which nothing moves is told by how little the means of 0.1 s vary in rotation and force; the limits are
learnt from the drive itself (see recon.numerics.smoothing.stops):

    std(mean gyro) <= limit,    std(mean accel) <= limit    in every second that holds the moment,
    speed <= limit                                          where a fix is near

Motion that is called a stop spoils whatever takes it for one, a missed stop hardly harms: so a vehicle that creeps, a
smooth ship or train in an outage of GNSS, and a log that may be either, have no standstill.

References
    Skog, Haendel, Nilsson, Rantakokko (2010), "Zero-velocity detection - an algorithm evaluation", IEEE T-BME 57(11).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    EVENTS,
    GNSS,
    IMU,
    Array,
    Detector,
    Event,
    Metric,
    Params,
    Streams,
    events,
    has,
    hookimpl,
    matrix,
    metrics,
    quantity,
    seconds,
    time_ns,
    vector,
    warning,
)
from recon.numerics.signals import runs
from recon.numerics.smoothing.samples import Samples, regular_samples
from recon.numerics.smoothing.stops import Blocks, Limits, Mask, block_means, find_stops, still_noise

BLOCK_S: Final = 0.1


class StandstillParams(Params):
    """Parameters of detector.standstill."""

    min_duration: float = quantity(1.0, "s", gt=0, le=86_400, doc="Shortest standstill that counts.")


def standstill(*, imu: pa.Table, gnss: pa.Table | None, params: StandstillParams) -> Streams:
    """Events of kind standstill; the limits, and the white noise of the sensors in them, as metrics.

    imu : gyro rad/s, accel m/s^2, any frame; rows without one of them are left out
    gnss : speed m/s or, where that is missing, vel m/s local; neither is needed
    """
    gyro, accel = matrix(imu, "gyro", gaps=True), matrix(imu, "accel", gaps=True)
    known = np.isfinite(gyro).all(axis=1) & np.isfinite(accel).all(axis=1)
    t_ns = time_ns(imu)[known]
    fix_t_s, fix_speed = _speeds(gnss, int(t_ns[0]) if len(t_ns) else 0)
    notes = [] if len(fix_speed) else [warning("gnss tells no speed: only a car with clear stops is seen to stand")]
    try:
        samples = regular_samples(np.asarray((t_ns - t_ns[:1]) * 1e-9), gyro[known], accel[known])
    except ValueError as error:
        notes.append(warning(f"no standstill: {error}"))
        return {"events": events([]), "metrics": metrics(notes)}
    blocks = block_means(samples, _samples_per_block(samples))
    stops = find_stops(blocks, fix_t_s, fix_speed)
    still, limits = stops.still, stops.limits
    spans = _spans(t_ns, samples, blocks, still, params.min_duration)
    if not len(spans):
        notes.append(warning("no standstill: nothing is both quiet and slow enough for certain"))
    return {
        "events": events(Event(int(start), int(end), "standstill") for start, end in spans),
        "metrics": metrics([*_learnt(limits, blocks, still, spans), *notes]),
    }


def _speeds(gnss: pa.Table | None, since_ns: int) -> tuple[Array, Array]:
    """Times of fixes with a speed, s after `since_ns`, and their speeds over ground, m/s; (f,) each."""
    if gnss is None or not (has(gnss, "speed") or has(gnss, "vel")):
        return np.zeros(0), np.zeros(0)
    speed = np.full(gnss.num_rows, np.nan)
    if has(gnss, "vel"):
        vel = matrix(gnss, "vel", gaps=True)
        speed = np.hypot(vel[:, 0], vel[:, 1])
    if has(gnss, "speed"):
        reported = vector(gnss, "speed", gaps=True)
        speed = np.where(np.isfinite(reported), reported, speed)
    known = np.isfinite(speed)
    return seconds(gnss, since=since_ns)[known], speed[known]


def _samples_per_block(samples: Samples) -> int:
    step = float(np.median(np.diff(samples.t_s)))
    return max(1, round(BLOCK_S / step))


def _spans(
    t_ns: NDArray[np.int64], samples: Samples, blocks: Blocks, still: Mask, min_duration: float
) -> NDArray[np.int64]:
    """First and last row of the log in each run of still blocks that is long enough: (m, 2) ns since 1970."""
    rows = runs(still) * blocks.size - [0, 1]
    found = t_ns[samples.row[rows]]
    return np.asarray(found[found[:, 1] - found[:, 0] >= min_duration * 1e9])


def _learnt(limits: Limits | None, blocks: Blocks, still: Mask, spans: NDArray[np.int64]) -> Iterable[Metric]:
    yield Metric("standstills", float(len(spans)))
    yield Metric("still_time", float((spans[:, 1] - spans[:, 0]).sum()) * 1e-9, "s")
    if limits is None:
        return
    method = "root sum square over the axes of 0.1 s means, in 1 s"
    yield Metric("gyro_limit", float(np.degrees(limits.gyro)), "deg/s", method=method)
    yield Metric("accel_limit", limits.accel, "m/s^2", method=method)
    yield Metric("speed_limit", limits.speed, "m/s")
    yield Metric("imu_decides_alone", float(limits.alone), note="1 if quiet alone is believed where no fix is near")
    gyro, accel = still_noise(blocks, still)
    if gyro is not None and accel is not None:
        method = "Allan variance over 1 s in standstills"
        yield Metric("gyro_noise", float(np.degrees(gyro)), "deg/s/sqrt(Hz)", method=method)
        yield Metric("accel_noise", accel, "m/s^2/sqrt(Hz)", method=method)


@hookimpl
def declare_detectors() -> Iterable[Detector]:
    """detector.standstill."""
    yield Detector(
        name="standstill",
        summary="Standstills by the quiet of the box, and by GNSS speed where there is one.",
        params=StandstillParams,
        reads={"imu": IMU.need("gyro", "accel"), "gnss": GNSS.need(maybe=("speed", "vel"), optional=True)},
        writes={"events": EVENTS},
        run=standstill,
    )
