"""A drive whose truth is known, as an IMU, a GNSS receiver, a magnetometer, a barometer and the wheels log it.

The motion is one of recon.numerics.motion, turned to the first heading and set down on the rotating ellipsoid at the
start. The rear axle runs along the road; the body leans and bounces on it; the IMU is the origin of the vehicle. The
errors are those of sensor_model, gnss_model, mag_model and baro_model, in the size that presets or the user give.

`reference` is the truth of the IMU at the times of imu. Its velocity and attitude are relative to East, North and Up of
the place where the vehicle is, as receivers tell them; its `pos` is seen from the anchor, where the motion starts.
`imu_truth` holds the biases, `events` the outages, the bursts of multipath and the crossing of a ferry, `metrics` what
else only a simulator knows.

Constant biases and scale errors are drawn anew for each axis with the seed. The seed touches no motion, and what
changes in the IMU leaves the noise of GNSS as it was, and the reverse.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    BARO,
    EVENTS,
    GNSS,
    IMU,
    MAG,
    REFERENCE,
    WHEEL,
    Event,
    Metric,
    Simulator,
    Streams,
    build,
    events,
    hookimpl,
    metrics,
    with_meta,
)
from recon.errors import DataError
from recon.numerics.geodesy import Anchor, geodetic_to_enu, normal_gravity
from recon.numerics.motion import EarthTruth, Springs
from recon.numerics.rotation import Floats, conjugate, rotate
from recon.schema import IMU_TRUTH, Schema
from recon.utc import iso_ns
from recon_simulators.baro_model import barometer
from recon_simulators.drive_models import chosen, gnss_model_of, imu_model_of
from recon_simulators.drive_params import DriveParams
from recon_simulators.gnss_model import (
    GnssFixes,
    GnssModel,
    gnss_measurements,
    in_outage,
)
from recon_simulators.mag_model import MagModel, magnetometer
from recon_simulators.presets import NAMES
from recon_simulators.route import Route, route_of
from recon_simulators.sensor_model import (
    TriadModel,
    TriadSamples,
    imu_measurements,
    imu_times,
    regular_times,
)
from recon_simulators.wheel_model import WHEELS, wheels

_FIX, _SATELLITES = 3, 12
_CLOCK: Final = {"time_scale": "UTC", "clock": "absolute"}
_FIXES: Final = ("lat", "lon", "height", "speed", "course", "vel", "pos_std", "vel_std", "fix", "satellites")
_WRITES: Final[Mapping[str, Schema]] = {
    "imu": IMU.only("accel", "gyro"),
    "imu_truth": IMU_TRUTH,
    "gnss": GNSS.only(*_FIXES),
    "reference": REFERENCE,
    "events": EVENTS,
}
_SHOWN: Final = {"accel": ("m/s^2", 1.0), "gyro": ("deg/s", np.pi / 180.0)}
"""Unit in which metrics tell a bias, and its size."""


def simulate_drive(params: DriveParams) -> Streams:
    """The streams that the module describes: imu in the sensor frame, gnss without rows in outages.

    Raises DataError where the parameters contradict each other: a crash that loses more speed than there is, a drive
    shorter than its rest, a jitter beyond half a sample.
    """
    device, imu_noise, gnss_noise, outage_places, wheel_noise, iron, air = np.random.default_rng(params.seed).spawn(7)
    values = {name: chosen(params, name) for name in NAMES}
    springs = Springs(*(values[f"body_{name}"] for name in ("slip", "pitch", "roll", "bounce", "heave")))
    try:
        route = route_of(params, springs, values["rear_axle"])
        imu_model = imu_model_of(params, values, device)
    except ValueError as error:
        raise DataError(str(error), "change the parameters of simulator.drive") from error
    gnss_model = gnss_model_of(params, values, route.duration_s, outage_places)
    truth = route.at(imu_times(0.0, route.duration_s, imu_model, imu_noise))
    accel, gyro = imu_measurements(truth, imu_model, imu_noise)
    inertial = {"accel": (imu_model.accel, accel), "gyro": (imu_model.gyro, gyro)}
    fixes, stamps_s = _fixes(route, gnss_model, gnss_noise)
    time = _stamps(truth.t_s - route.begin_s, params)
    found = list(_events(fixes, stamps_s, gnss_model, route, params))
    learnt = list(_learnt(truth, inertial, values, gnss_model, params))
    streams = {
        "imu": with_meta(build(IMU, time=time, accel=accel.output_s, gyro=gyro.output_s), **_CLOCK),
        "imu_truth": with_meta(build(IMU_TRUTH, time=time, accel_bias=accel.bias_s, gyro_bias=gyro.bias_s), **_CLOCK),
        "gnss": _gnss(fixes, stamps_s, gnss_model, params),
        "reference": _reference(truth, time, route.anchor),
        "events": events(found),
        "metrics": metrics(learnt),
    }
    if values["mag_rate"]:
        seen = magnetometer(route, values, params, imu_model.q_sv, iron)
        streams["mag"] = with_meta(build(MAG, time=_stamps(seen.t_s, params), mag=seen.field_s), **_CLOCK)
        streams["events"] = events([*found, *_disturbed(seen.model, params)])
        streams["metrics"] = metrics([*learnt, *seen.learnt])
    return {**streams, **_wheel_and_baro(route, params, wheel_noise, air)}


def _wheel_and_baro(
    route: Route, params: DriveParams, wheel_noise: np.random.Generator, air: np.random.Generator
) -> Streams:
    """The streams wheel and baro, where their rates ask for them."""
    streams: Streams = {}
    if params.wheel_rate is not None:
        t_s, rolled = wheels(route, params.wheel_rate, params, wheel_noise)
        wheel = build(WHEEL.only(*rolled), time=_stamps(t_s, params), **rolled)
        streams["wheel"] = with_meta(wheel, **_CLOCK)
    if params.baro_rate is not None:
        t_s, pressure = barometer(route, params.baro_rate, params, air)
        baro = build(BARO.only("pressure"), time=_stamps(t_s, params), pressure=pressure)
        streams["baro"] = with_meta(baro, **_CLOCK)
    return streams


def _fixes(route: Route, model: GnssModel, rng: np.random.Generator) -> tuple[GnssFixes, Floats]:
    """Fixes, those in outages among them, and their time stamps in s."""
    stamps_s = regular_times(0.0, route.duration_s, model.rate_hz)
    place, motion = (route.at(stamps_s - lag_s) for lag_s in (model.lag_s, model.velocity_lag_s))
    return gnss_measurements(place, motion, model, rng), stamps_s


def _gnss(fixes: GnssFixes, stamps_s: Floats, model: GnssModel, params: DriveParams) -> pa.Table:
    seen = ~in_outage(stamps_s, model)
    horizontal, vertical = np.hypot(model.slow_sigmas, model.white_sigmas)
    columns = {
        "lat": fixes.lat[seen],
        "lon": fixes.lon[seen],
        "height": fixes.height[seen],
        "speed": fixes.speed[seen],
        "course": fixes.course[seen],
        "vel": fixes.vel_n[seen],
        "pos_std": _told((horizontal, horizontal, vertical), seen, params),
        "vel_std": _told((model.velocity_sigmas[0], *model.velocity_sigmas), seen, params),
        "fix": np.full(seen.sum(), _FIX, dtype=np.int32),
        "satellites": np.full(seen.sum(), _SATELLITES, dtype=np.int32),
    }
    shown = {name: column for name, column in columns.items() if name != "vel" or params.gnss_vector}
    table = build(GNSS.only(*shown), time=_stamps(stamps_s[seen], params), **shown)
    return with_meta(table, **_CLOCK, height_datum="ellipsoid", heading_kind="course_true")


def _told(sigmas: tuple[float, ...], seen: NDArray[np.bool_], params: DriveParams) -> Floats:
    """The sigmas (m, k) that fixes tell of themselves; NaN where there is none."""
    told = params.gnss_told_sigma * np.array(sigmas)
    return np.tile(np.where(told > 0.0, told, np.nan), (int(seen.sum()), 1))


def _disturbed(model: MagModel, params: DriveParams) -> Iterable[Event]:
    """When foreign fields were about, with their largest strength."""
    for foreign in model.disturbances:
        start_ns, end_ns = _stamps(np.array([foreign.start_s, foreign.stop_s]), params).tolist()
        yield Event(start_ns, end_ns, "magnetic_disturbance", float(np.linalg.norm(foreign.field_n)), "T")


def _reference(truth: EarthTruth, time: NDArray[np.int64], anchor: Anchor) -> pa.Table:
    table = build(
        REFERENCE,
        time=time,
        pos=geodetic_to_enu(truth.lat, truth.lon, truth.height, anchor),
        vel=truth.vel_n,
        q=truth.q_nv,
        lat=truth.lat,
        lon=truth.lon,
        height=truth.height,
        accel=rotate(conjugate(truth.q_nv), truth.acc_n),
        gyro=truth.gyro_v,
    )
    return with_meta(table, **_CLOCK, anchor=asdict(anchor), earth="wgs84", height_datum="ellipsoid")


def _events(fixes: GnssFixes, stamps_s: Floats, model: GnssModel, route: Route, params: DriveParams) -> Iterable[Event]:
    """Outages; bursts of multipath from their first fix to their last, also those that fall into outages; crossings."""
    spans: list[tuple[str, float, float, float | None]] = [("outage", *span, None) for span in model.outages]
    spans += [("multipath", stamps_s[b.first], stamps_s[b.stop - 1], b.size) for b in fixes.bursts]
    spans += [("ferry", *route.carried, None)] if route.carried else []
    for kind, start_s, end_s, size in spans:
        start_ns, end_ns = _stamps(np.array([start_s, end_s]), params).tolist()
        yield Event(start_ns, end_ns, kind, size, "" if size is None else "m")


def _learnt(
    truth: EarthTruth,
    inertial: Mapping[str, tuple[TriadModel, TriadSamples]],
    values: Mapping[str, Any],
    gnss_model: GnssModel,
    params: DriveParams,
) -> Iterable[Metric]:
    """What only a simulator knows."""
    yield Metric("seed", float(params.seed))
    steps = np.linalg.norm(np.diff(truth.pos_n, axis=0), axis=1)
    yield Metric("distance", float(steps.sum()), "m", method="truth")
    yield Metric("true_gravity", float(normal_gravity(truth.lat[0], truth.height[0])), "m/s^2", note="at the start")
    for angle in ("roll", "pitch", "yaw"):
        yield Metric(f"true_mount_{angle}", float(np.degrees(values[f"mount_{angle}"])), "deg")
    for name in ("lever_arm", "rear_axle"):
        yield from _axes(f"true_{name}", values[name], "m", "vehicle frame")
    for name in ("slip", "pitch", "roll"):
        yield Metric(f"true_body_{name}", values[f"body_{name}"], "rad/(m/s^2)")
    yield Metric("true_gnss_lag", gnss_model.lag_s, "s")
    yield Metric("true_gnss_velocity_lag", gnss_model.velocity_lag_s, "s")
    for sensor, (model, samples) in inertial.items():
        unit, scale = _SHOWN[sensor]
        yield from _axes(f"true_{sensor}_bias", samples.bias_s[0] / scale, unit, "sensor frame, at the start")
        yield from _axes(f"true_{sensor}_bias_end", samples.bias_s[-1] / scale, unit, "sensor frame, at the end")
        yield from _axes(f"true_{sensor}_scale", model.scale, "1", "sensor frame")


def _axes(name: str, values: Iterable[float], unit: str, note: str) -> Iterable[Metric]:
    return (Metric(f"{name}_{axis}", float(value), unit, note=note) for axis, value in zip("xyz", values, strict=True))


def _stamps(t_s: Floats, params: DriveParams) -> NDArray[np.int64]:
    """Times since the start as ns since 1970: (n,)."""
    return np.asarray(iso_ns(params.start) + np.rint(t_s * 1e9).astype(np.int64))


def _plan(inputs: Mapping[str, Schema], params: DriveParams) -> dict[str, Schema]:
    """Fixes with vectors of velocity, a magnetometer, a barometer and wheels, only where they are asked for."""
    fixes = [name for name in _FIXES if name != "vel" or params.gnss_vector]
    steered = ("steering_angle", *(f"speed_{name}" for name, *_ in WHEELS)) if params.steering else ()
    wheel = {"wheel": WHEEL.only("speed", *steered)} if params.wheel_rate is not None else {}
    mag = {"mag": MAG} if chosen(params, "mag_rate") else {}
    baro = {"baro": BARO.only("pressure")} if params.baro_rate is not None else {}
    return {**_WRITES, "gnss": GNSS.only(*fixes), **mag, **baro, **wheel}


@hookimpl
def declare_simulators() -> Iterable[Simulator]:
    """Declare simulator.drive."""
    yield Simulator(
        name="drive",
        summary="A drive with known truth, as IMU, GNSS, magnetometer, barometer and wheels log it.",
        version=2,
        params=DriveParams,
        run=simulate_drive,
        ideal={"sensors": "perfect"},
        writes=_WRITES,
        plan=_plan,
    )
