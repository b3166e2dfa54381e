"""A drive whose truth is known, as an IMU and a GNSS receiver log it.

The motion is one of recon.numerics.motion, turned to the first heading and set down at the start; the errors are those
of sensor_model, in the size that presets or the user give. The world is the plane that touches the ellipsoid below the
start, with normal gravity of that place everywhere, and does not rotate. The origin of the vehicle is the IMU.

Biases and scale errors are constant over a drive and drawn anew for each axis with the seed. The seed touches no
motion, and what changes in the IMU leaves the noise of GNSS as it was, and the reverse.

References
    NIMA TR8350.2 (2000), eq. 4-1 (normal gravity).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Any, Final, Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pydantic import ValidationInfo, field_validator

from recon import (
    GNSS,
    IMU,
    REFERENCE,
    Metric,
    Params,
    Simulator,
    Streams,
    build,
    hookimpl,
    metrics,
    quantity,
    setting,
    with_meta,
)
from recon.errors import DataError
from recon.numerics import motion as motions
from recon.numerics.geodesy import Anchor, enu_to_geodetic, normal_gravity
from recon.numerics.motion import Drive, MotionTruth
from recon.numerics.rotation import Floats, conjugate, from_euler, multiply, rotate, yaw_from_heading
from recon_simulators.presets import NAMES, preset_value
from recon_simulators.sensor_model import (
    GnssModel,
    ImuModel,
    TriadModel,
    gnss_measurements,
    gnss_times,
    imu_measurements,
    imu_times,
    in_outage,
)

_TAKES: Final[Mapping[str, tuple[str, ...]]] = {
    "rest": (),
    "straight": ("speed", "rest"),
    "circle": ("speed", "radius", "turns", "rest"),
    "spring": ("speed", "radius", "turns", "slope", "rest"),
    "roundabout": ("speed", "radius", "rest"),
    "s_curve": ("speed", "radius", "rest"),
    "hill": ("speed", "slope", "rest"),
    "city": ("route", "rest"),
    "parking": ("rest",),
    "crash": ("speed", "delta_v", "pulse", "rest"),
}
"""Parameters that shape each motion; duration belongs to all."""
_ROADS: Final[Mapping[str, Callable[..., Drive]]] = {
    "straight": motions.straight,
    "circle": motions.rounds,
    "spring": partial(motions.rounds, slope=0.1),
    "roundabout": motions.roundabout,
    "s_curve": motions.s_curve,
    "hill": motions.hill,
    "parking": motions.parking,
    "crash": motions.crash,
}
"""Motions whose length follows from their road."""
_ARGUMENTS: Final = {"pulse": "pulse_s", "rest": "rest_s"}
"""What the functions of recon.numerics.motion call them, where that differs."""

_FIX, _SATELLITES = 3, 12
_CLOCK = {"time_scale": "UTC", "clock": "absolute"}


class DriveParams(Params):
    """Parameters of simulator.drive. None leaves a value to the motion or to the preset of the sensors."""

    motion: Literal[
        "rest", "straight", "circle", "spring", "roundabout", "s_curve", "hill", "city", "parking", "crash"
    ] = setting("city", doc="What the vehicle does. A spring is a circle that climbs.")
    duration: float | None = quantity(
        None, "s", gt=0, doc="Length of the record; none: 60 s at rest, 300 s in the city, else the whole drive."
    )
    route: int = setting(0, ge=0, doc="city: number of the route, a random row of launches, bends, hills and stops.")
    speed: float | None = quantity(
        None, "km/h", gt=0, doc="straight, circle, spring, roundabout, s_curve, hill, crash: of the cruise."
    )
    radius: float | None = quantity(None, "m", gt=0, doc="circle, spring, roundabout, s_curve: of the bend.")
    turns: float | None = setting(None, gt=0, doc="circle, spring: how often round.")
    slope: float | None = quantity(None, "deg", ge=-30, le=30, doc="spring, hill: of the road, positive uphill.")
    delta_v: float | None = quantity(None, "km/h", gt=0, doc="crash: change of speed in the impact.")
    pulse: float | None = quantity(None, "ms", gt=0, doc="crash: duration of the impact.")
    rest: float | None = quantity(None, "s", gt=0, doc="All but rest: standing before the drive; none: 10 s.")

    lat: float = quantity(44.4949, "deg", ge=-90, le=90, doc="Latitude of the start.")
    lon: float = quantity(11.3426, "deg", ge=-180, le=180, doc="Longitude of the start.")
    height: float = quantity(100.0, "m", doc="Height of the start above the ellipsoid.")
    heading: float = quantity(90.0, "deg", doc="First heading, clockwise from true north.")
    start: str = setting("2024-05-01T08:00:00Z", doc="Time of the first record, ISO 8601; UTC where it names no zone.")
    seed: int = setting(0, ge=0, doc="Seed of noise, biases and scale errors.")

    sensors: Literal["perfect", "consumer_mems", "automotive"] = setting(
        "consumer_mems", doc="Preset of the rates and errors below."
    )
    imu_rate: float | None = quantity(None, "Hz", gt=0, doc="Samples of the IMU per second.")
    imu_jitter: float = quantity(0.0, "ms", ge=0, doc="Samples are taken up to this early or late, and say so.")
    accel_noise: float | None = quantity(None, "ug/sqrt(Hz)", ge=0, doc="Density of white noise.")
    gyro_noise: float | None = quantity(None, "deg/s/sqrt(Hz)", ge=0, doc="Density of white noise.")
    accel_bias: float | None = quantity(None, "mg", ge=0, doc="Sigma of the constant bias of each axis.")
    gyro_bias: float | None = quantity(None, "deg/s", ge=0, doc="Sigma of the constant bias of each axis.")
    accel_bias_walk: float | None = quantity(None, "ug/sqrt(s)", ge=0, doc="Random walk of the bias.")
    gyro_bias_walk: float | None = quantity(None, "deg/s/sqrt(s)", ge=0, doc="Random walk of the bias.")
    accel_scale: float | None = quantity(None, "%", ge=0, doc="Sigma of the scale error of each axis.")
    gyro_scale: float | None = quantity(None, "%", ge=0, doc="Sigma of the scale error of each axis.")
    accel_quantisation: float | None = quantity(None, "mg", ge=0, doc="Step of the output.")
    gyro_quantisation: float | None = quantity(None, "deg/s", ge=0, doc="Step of the output.")
    accel_full_scale: float | None = quantity(None, "g", gt=0, doc="The output is clipped to this on both sides.")
    gyro_full_scale: float | None = quantity(None, "deg/s", gt=0, doc="The output is clipped to this on both sides.")
    mount_roll: float = quantity(0.0, "deg", doc="Roll of the box in the vehicle (ISO 8855, yaw then pitch then roll).")
    mount_pitch: float = quantity(0.0, "deg", doc="Pitch of the box in the vehicle, positive nose down.")
    mount_yaw: float = quantity(0.0, "deg", doc="Yaw of the box in the vehicle, positive to the left.")

    gnss_rate: float | None = quantity(None, "Hz", gt=0, doc="Fixes per second.")
    gnss_lag: float = quantity(0.0, "ms", ge=0, doc="A fix tells where the antenna was this long before.")
    gnss_horizontal: float | None = quantity(None, "m", ge=0, doc="Sigma of the position, east and north each.")
    gnss_vertical: float | None = quantity(None, "m", ge=0, doc="Sigma of the height.")
    gnss_correlation: float | None = quantity(
        None, "s", ge=0, doc="Time in which the error of the position changes; 0 s for white noise."
    )
    gnss_velocity: float | None = quantity(None, "m/s", ge=0, doc="Sigma of the velocity of each axis.")
    lever_arm: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0), "m", doc="From the IMU to the antenna: forward, left, up."
    )
    outages: tuple[tuple[float, float], ...] = quantity(
        (), "s", doc="Spans without fixes, in time since the start: [[60 s, 90 s], [150 s, 155 s]]."
    )

    @field_validator("route", "speed", "radius", "turns", "slope", "delta_v", "pulse", "rest")
    @classmethod
    def _belongs(cls, value: Any, info: ValidationInfo) -> Any:
        """Refuse what the motion does not have, lest it be believed to act."""
        name, motion = str(info.field_name), info.data.get("motion")
        if motion and name not in _TAKES[motion] and value != cls.model_fields[name].default:
            takes = ", ".join(("duration", *_TAKES[motion]))
            raise ValueError(f"the motion '{motion}' does not have it; it has {takes}")
        return value

    @field_validator("start")
    @classmethod
    def _is_a_time(cls, value: str) -> str:
        _since_1970_ns(value)
        return value

    @field_validator("outages")
    @classmethod
    def _in_order(cls, value: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        for start, stop in value:
            if not start < stop:
                raise ValueError(f"an outage from {start:g} s to {stop:g} s ends before it begins")
        return value


def simulate_drive(params: DriveParams) -> Streams:
    """Imu in the sensor frame; gnss without rows in outages; reference, the truth at the times of imu; metrics.

    Raises DataError where the parameters contradict each other: a crash that loses more speed than there is, a city
    drive shorter than its rest, a jitter beyond half a sample.
    """
    device, imu_noise, gnss_noise = np.random.default_rng(params.seed).spawn(3)
    anchor = Anchor(np.degrees(params.lat), np.degrees(params.lon), params.height)
    try:
        motion, duration_s = _motion(params)
        imu_model, gnss_model = _models(params, float(normal_gravity(anchor.lat, anchor.height)), device)
    except ValueError as error:
        raise DataError(str(error), "change the parameters of simulator.drive") from error
    truth = _truth(motion, imu_times(0.0, duration_s, imu_model, imu_noise), params)
    accel_s, gyro_s = imu_measurements(truth, imu_model, imu_noise)
    time = _stamps(truth.t_s, params)
    return {
        "imu": with_meta(build(IMU, time=time, accel=accel_s, gyro=gyro_s), **_CLOCK),
        "gnss": _gnss(motion, duration_s, gnss_model, anchor, params, gnss_noise),
        "reference": _reference(truth, time, anchor),
        "metrics": metrics(_learnt(truth, imu_model, params)),
    }


def _motion(params: DriveParams) -> tuple[Drive, float]:
    """The motion and the length of the record in s; a record that outlasts its drive ends standing."""
    own = {name: getattr(params, name) for name in _TAKES[params.motion]}
    given = {_ARGUMENTS.get(name, name): value for name, value in own.items() if value is not None}
    if params.motion == "rest":
        drive = motions.rest(params.duration or 60.0)
    elif params.motion == "city":
        drive = _city(params.duration or 300.0, **given)
    else:
        drive = _ROADS[params.motion](**given)
    return drive, params.duration or drive.duration_s


def _city(duration_s: float, route: int, rest_s: float = 10.0) -> Drive:
    if duration_s <= rest_s:
        raise ValueError(f"a city drive of {duration_s:g} s that rests for {rest_s:g} s never moves")
    return motions.stop_and_go(duration_s, np.random.default_rng(route), rest_s)


def _models(params: DriveParams, gravity: float, rng: np.random.Generator) -> tuple[ImuModel, GnssModel]:
    """The sensors: each value as given, else that of the preset; biases and scale errors drawn from rng."""
    own = {name: getattr(params, name) for name in NAMES}
    values = {name: preset_value(params.sensors, name) if own[name] is None else own[name] for name in NAMES}
    q_vs = from_euler(params.mount_yaw, params.mount_pitch, params.mount_roll)
    imu_model = ImuModel(
        rate_hz=values["imu_rate"],
        jitter_s=params.imu_jitter,
        q_sv=tuple(conjugate(q_vs).tolist()),
        gravity=gravity,
        accel=_triad("accel", values, rng),
        gyro=_triad("gyro", values, rng),
    )
    gnss_model = GnssModel(
        rate_hz=values["gnss_rate"],
        horizontal_sigma=values["gnss_horizontal"],
        vertical_sigma=values["gnss_vertical"],
        correlation_s=values["gnss_correlation"],
        velocity_sigma=values["gnss_velocity"],
        lever_arm_v=params.lever_arm,
        lag_s=params.gnss_lag,
        outages=params.outages,
    )
    return imu_model, gnss_model


def _triad(sensor: str, values: Mapping[str, float], rng: np.random.Generator) -> TriadModel:
    bias, scale = (rng.normal(0.0, values[f"{sensor}_{error}"], 3).tolist() for error in ("bias", "scale"))
    return TriadModel(
        bias=tuple(bias),
        bias_walk=values[f"{sensor}_bias_walk"],
        noise_density=values[f"{sensor}_noise"],
        scale=tuple(scale),
        quantisation=values[f"{sensor}_quantisation"],
        full_scale=values[f"{sensor}_full_scale"],
    )


def _truth(motion: Drive, t_s: Floats, params: DriveParams) -> MotionTruth:
    """The motion, which begins eastwards, turned to the first heading."""
    turn = from_euler(yaw_from_heading(params.heading), 0.0, 0.0)
    truth = motion.at(t_s)
    pos_n, vel_n, acc_n = (rotate(turn, vector) for vector in (truth.pos_n, truth.vel_n, truth.acc_n))
    return MotionTruth(t_s, pos_n, vel_n, acc_n, multiply(turn, truth.q_nv), truth.gyro_v)


def _gnss(
    motion: Drive,
    duration_s: float,
    model: GnssModel,
    anchor: Anchor,
    params: DriveParams,
    rng: np.random.Generator,
) -> pa.Table:
    stamps_s = gnss_times(0.0, duration_s, model)
    fixes = gnss_measurements(_truth(motion, stamps_s - model.lag_s, params), model, rng)
    seen = ~in_outage(stamps_s, model)
    lat, lon, height = enu_to_geodetic(fixes.pos_n[seen], anchor)
    rows = int(seen.sum())
    pos_sigma = (model.horizontal_sigma, model.horizontal_sigma, model.vertical_sigma)
    table = build(
        GNSS,
        time=_stamps(stamps_s[seen], params),
        lat=lat,
        lon=lon,
        height=height,
        speed=fixes.speed[seen],
        course=fixes.course[seen],
        vel=fixes.vel_n[seen],
        pos_std=np.tile([sigma or np.nan for sigma in pos_sigma], (rows, 1)),
        vel_std=np.full((rows, 3), model.velocity_sigma or np.nan),
        fix=np.full(rows, _FIX, dtype=np.int32),
        satellites=np.full(rows, _SATELLITES, dtype=np.int32),
    )
    return with_meta(table, **_CLOCK, height_datum="ellipsoid", heading_kind="course_true")


def _reference(truth: MotionTruth, time: NDArray[np.int64], anchor: Anchor) -> pa.Table:
    lat, lon, height = enu_to_geodetic(truth.pos_n, anchor)
    table = build(
        REFERENCE,
        time=time,
        pos=truth.pos_n,
        vel=truth.vel_n,
        q=truth.q_nv,
        lat=lat,
        lon=lon,
        height=height,
        accel=rotate(conjugate(truth.q_nv), truth.acc_n),
        gyro=truth.gyro_v,
    )
    return with_meta(table, **_CLOCK, anchor=asdict(anchor), earth="wgs84", height_datum="ellipsoid")


def _learnt(truth: MotionTruth, model: ImuModel, params: DriveParams) -> list[Metric]:
    """What only a simulator knows."""
    axes = [
        Metric(f"true_{sensor}_{error}_{axis}", value, unit, note="sensor frame")
        for sensor, error, vector, unit in (
            ("accel", "bias", model.accel.bias, "m/s^2"),
            ("gyro", "bias", np.degrees(model.gyro.bias).tolist(), "deg/s"),
            ("accel", "scale", model.accel.scale, "1"),
            ("gyro", "scale", model.gyro.scale, "1"),
        )
        for axis, value in zip("xyz", vector, strict=True)
    ]
    mounting = {"roll": params.mount_roll, "pitch": params.mount_pitch, "yaw": params.mount_yaw}
    return [
        Metric("seed", float(params.seed)),
        Metric("distance", float(np.linalg.norm(np.diff(truth.pos_n, axis=0), axis=1).sum()), "m", method="truth"),
        Metric("true_gravity", model.gravity, "m/s^2"),
        *(Metric(f"true_mount_{name}", float(np.degrees(angle)), "deg") for name, angle in mounting.items()),
        *axes,
    ]


def _stamps(t_s: Floats, params: DriveParams) -> NDArray[np.int64]:
    """Times since the start as ns since 1970: (n,)."""
    return np.asarray(_since_1970_ns(params.start) + np.rint(t_s * 1e9).astype(np.int64))


def _since_1970_ns(text: str) -> int:
    moment = datetime.fromisoformat(text)
    aware = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return (aware - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1000


@hookimpl
def declare_simulators() -> Iterable[Simulator]:
    """Declare simulator.drive."""
    yield Simulator(
        name="drive",
        summary="A drive with known truth, as an IMU and a GNSS receiver log it.",
        params=DriveParams,
        run=simulate_drive,
        ideal={"sensors": "perfect"},
        writes={
            "imu": IMU.only("accel", "gyro"),
            "gnss": GNSS.only(
                "lat", "lon", "height", "speed", "course", "vel", "pos_std", "vel_std", "fix", "satellites"
            ),
            "reference": REFERENCE,
        },
    )
