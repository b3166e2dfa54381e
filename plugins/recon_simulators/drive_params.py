"""Parameters of simulator.drive: the drive and its place, the box, the car, the receiver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal, TypeAlias

from pydantic import ValidationInfo, field_validator

from recon import Params, quantity, setting
from recon.utc import start_ns

Triple: TypeAlias = tuple[float, float, float]
Pair: TypeAlias = tuple[float, float]

TAKES: Final[Mapping[str, tuple[str, ...]]] = {
    "rest": (),
    "straight": ("speed", "rest"),
    "circle": ("speed", "radius", "turns", "rest"),
    "spring": ("speed", "radius", "turns", "slope", "rest"),
    "roundabout": ("speed", "radius", "rest"),
    "s_curve": ("speed", "radius", "rest"),
    "hill": ("speed", "slope", "rest"),
    "city": ("route", "rest"),
    "country": ("route", "rest"),
    "mixed": ("route", "rest"),
    "nonstop": ("route", "rest"),
    "reverse": ("route", "rest"),
    "ferry": ("route", "rest"),
    "parking": ("rest",),
    "crash": ("speed", "delta_v", "pulse", "direction", "spin", "again", "rest"),
}
"""Parameters that shape each motion; duration belongs to all."""
_DAY_S: Final = 86_400.0


class _Motion(Params):
    motion: Literal[
        "rest", "straight", "circle", "spring", "roundabout", "s_curve", "hill", "city", "country", "mixed", "nonstop",
        "reverse", "ferry", "parking", "crash",
    ] = setting(
        "city",
        doc="What the vehicle does. A spring is a circle that climbs; country and mixed are long drives with fast "
        "roads and slopes, mixed with roundabouts, queues and parking; nonstop never stops once it moves; reverse "
        "only goes backwards; a ferry carries the vehicle half of the time.",
    )  # fmt: skip
    duration: float | None = quantity(
        None,
        "s",
        gt=0,
        le=_DAY_S,
        doc="Length of the record; none: 60 s at rest, 300 s in the city, 600 s on long drives, else the whole drive.",
    )
    begin: float = quantity(
        0.0, "s", ge=0, le=_DAY_S, doc="The record begins this long after the motion: it may begin at speed."
    )
    route: int = setting(0, ge=0, doc="Long drives: number of the route, a random row of what a driver does.")
    speed: float | None = quantity(
        None, "km/h", gt=0, doc="straight, circle, spring, roundabout, s_curve, hill, crash: of the cruise."
    )
    radius: float | None = quantity(None, "m", gt=0, doc="circle, spring, roundabout, s_curve: of the bend.")
    turns: float | None = setting(None, gt=0, doc="circle, spring: how often round.")
    slope: float | None = quantity(None, "deg", ge=-30, le=30, doc="spring, hill: of the road, positive uphill.")
    delta_v: float | None = quantity(None, "km/h", gt=0, doc="crash: change of speed in the impact.")
    pulse: float | None = quantity(None, "ms", gt=0, doc="crash: duration of the impact.")
    direction: float = quantity(
        0.0, "deg", gt=-180, le=180, doc="crash: of the force, clockwise from the front: 90 deg comes from the right."
    )
    spin: float = quantity(0.0, "deg", doc="crash: by how much the vehicle turns to the left in the second after it.")
    again: float | None = quantity(None, "s", gt=0, doc="crash: a second impact comes so long after the first.")
    rest: float | None = quantity(
        None, "s", gt=0, doc="All but rest: standing before the drive; none: 10 s, and 30 s on long drives."
    )

    lat: float = quantity(44.4949, "deg", ge=-89, le=89, doc="Latitude of the start.")
    lon: float = quantity(11.3426, "deg", ge=-180, le=180, doc="Longitude of the start.")
    height: float = quantity(100.0, "m", doc="Height of the start above the ellipsoid.")
    heading: float = quantity(90.0, "deg", doc="First heading, clockwise from true north.")
    start: str = setting("2024-05-01T08:00:00Z", doc="Time of the first record, ISO 8601; UTC where it names no zone.")
    seed: int = setting(0, ge=0, doc="Seed of noise, biases, scale errors, outliers and outages.")

    @field_validator(
        "route", "speed", "radius", "turns", "slope", "delta_v", "pulse", "direction", "spin", "again", "rest"
    )  # fmt: skip
    @classmethod
    def _belongs(cls, value: Any, info: ValidationInfo) -> Any:
        """Refuse what the motion does not have, lest it be believed to act."""
        name, motion = str(info.field_name), info.data.get("motion")
        if motion and name not in TAKES[motion] and value != cls.model_fields[name].default:
            takes = ", ".join(("duration", *TAKES[motion]))
            raise ValueError(f"the motion '{motion}' does not have it; it has {takes}")
        return value

    @field_validator("start")
    @classmethod
    def _is_a_time(cls, value: str) -> str:
        start_ns(value)
        return value


class _Box(_Motion):
    sensors: Literal[
        "perfect", "consumer_mems", "automotive", "rtk", "industrial", "tactical", "phone", "study_one", "study_two"
    ] = setting(
        "consumer_mems", doc="Preset of what below is none: rates, errors and, in the studies, the installation."
    )
    imu_rate: float | None = quantity(None, "Hz", gt=0, le=100_000, doc="Samples of the IMU per second.")
    imu_jitter: float = quantity(0.0, "ms", ge=0, doc="Samples are taken up to this early or late, and say so.")
    accel_noise: float | None = quantity(None, "ug/sqrt(Hz)", ge=0, doc="Density of white noise.")
    gyro_noise: float | None = quantity(None, "deg/s/sqrt(Hz)", ge=0, doc="Density of white noise.")
    accel_bias: float | None = quantity(None, "mg", ge=0, doc="Sigma of the constant bias of each axis.")
    gyro_bias: float | None = quantity(None, "deg/s", ge=0, doc="Sigma of the constant bias of each axis.")
    accel_bias_walk: float | None = quantity(None, "ug/sqrt(s)", ge=0, doc="Random walk of the bias.")
    gyro_bias_walk: float | None = quantity(None, "deg/s/sqrt(s)", ge=0, doc="Random walk of the bias.")
    accel_instability: float | None = quantity(None, "mg", ge=0, doc="Sigma of the slow change of the bias.")
    gyro_instability: float | None = quantity(None, "deg/h", ge=0, doc="Sigma of the slow change of the bias.")
    instability_time: float = quantity(300.0, "s", gt=0, doc="Correlation time of the slow change of the biases.")
    accel_scale: float | None = quantity(None, "%", ge=0, doc="Sigma of the scale error of each axis.")
    gyro_scale: float | None = quantity(None, "%", ge=0, doc="Sigma of the scale error of each axis.")
    accel_vibration: float | None = quantity(None, "m/s^2", ge=0, doc="Sigma at 54 km/h; it grows with the speed.")
    gyro_vibration: float | None = quantity(None, "deg/s", ge=0, doc="Sigma at 54 km/h; it grows with the speed.")
    vibration_band: Pair = quantity((8.0, 45.0), "Hz", doc="Lowest and highest frequency of the vibration.")
    accel_quantisation: float | None = quantity(None, "mg", ge=0, doc="Step of the output.")
    gyro_quantisation: float | None = quantity(None, "deg/s", ge=0, doc="Step of the output.")
    accel_full_scale: float | None = quantity(None, "g", gt=0, doc="The output is clipped to this on both sides.")
    gyro_full_scale: float | None = quantity(None, "deg/s", gt=0, doc="The output is clipped to this on both sides.")
    mount_roll: float | None = quantity(
        None, "deg", doc="Roll of the box in the vehicle (ISO 8855, yaw then pitch then roll); 180 deg: upside down."
    )
    mount_pitch: float | None = quantity(None, "deg", doc="Pitch of the box in the vehicle, positive nose down.")
    mount_yaw: float | None = quantity(None, "deg", doc="Yaw of the box in the vehicle, positive to the left.")


class _Car(_Box):
    rear_axle: Triple | None = quantity(
        None, "m", doc="From the IMU to the middle of the rear axle, which runs along the road: forward, left, up."
    )
    body_slip: float | None = quantity(None, "deg/(m/s^2)", doc="Angle into the bend by lateral acceleration.")
    body_pitch: float | None = quantity(None, "deg/(m/s^2)", doc="Rise of the nose by forward acceleration.")
    body_roll: float | None = quantity(
        None, "deg/(m/s^2)", doc="Lean out of the bend by lateral acceleration; of two wheels -5.84."
    )
    body_bounce: float | None = quantity(None, "deg", ge=0, doc="Sigma of roll and pitch by the road at 54 km/h.")
    body_heave: float | None = quantity(None, "mm", ge=0, doc="Sigma of the height of the body at 54 km/h.")
    wheel_rate: float | None = quantity(None, "Hz", gt=0, doc="Speeds of the wheels per second; none: no such sensor.")
    wheel_scale: float = quantity(1.0, "%", ge=0, doc="Sigma of the scale error of the wheels' speed.")
    wheel_noise: float = quantity(0.02, "m/s", ge=0, doc="Sigma of the wheels' speed, white.")
    steering: bool = setting(False, doc="Do the wheels tell the angle of the steering wheel, and the speed of each?")
    wheelbase: float = quantity(2.7, "m", gt=0, doc="Between the axles.")
    track: float = quantity(1.55, "m", gt=0, doc="Between the wheels of an axle.")
    steering_ratio: float = setting(16.0, gt=0, doc="Angle of the steering wheel by that of the front wheels.")
    understeer: float = quantity(0.1, "deg/(m/s^2)", doc="Angle of the front wheels by lateral acceleration.")
    steering_offset: float = quantity(1.0, "deg", ge=0, doc="Sigma of the angle of the steering wheel ahead.")
    steering_noise: float = quantity(0.1, "deg", ge=0, doc="Sigma of the angle of the steering wheel, white.")
    steering_wander: float = quantity(
        0.5, "deg", ge=0, doc="Sigma of what wind, bank and play do to the steering wheel, for some seconds each."
    )
    tyre_scale: float = quantity(0.2, "%", ge=0, doc="Sigma of the scale error of one wheel beside the others.")


class _Compass(_Car):
    mag_rate: float | None = quantity(
        None, "Hz", ge=0, doc="Samples of the magnetometer per second, along the axes of the IMU; 0 Hz: there is none."
    )
    mag_noise: float | None = quantity(None, "uT", ge=0, doc="Sigma of each sample.")
    mag_hard_iron: float | None = quantity(
        None, "uT", ge=0, doc="Sigma of the constant field of box and car, each axis."
    )
    mag_soft_iron: float | None = quantity(None, "%", ge=0, le=50, doc="Sigma of what bends the field, each element.")
    mag_disturbance_rate: float | None = quantity(None, "1/h", ge=0, doc="Bridges, trucks, rails on the way.")
    mag_disturbance: Pair | None = quantity(None, "uT", doc="Least and largest field of these.")
    mag_disturbance_length: Pair | None = quantity(None, "s", doc="Shortest and longest time for which one lasts.")
    earth_field: Triple | None = quantity(
        None, "uT", doc="Field of the Earth: east, north, up; none: that of the World Magnetic Model there and then."
    )


class _Air(_Compass):
    baro_rate: float | None = quantity(None, "Hz", gt=0, doc="Samples of a barometer per second; none: there is none.")
    baro_noise: float = quantity(0.3, "m", ge=0, doc="Sigma of each sample, as height.")
    baro_walk: float = quantity(0.02, "m/sqrt(s)", ge=0, doc="Random walk of the weather, as height.")
    baro_scale: float = quantity(2.0, "%", ge=0, doc="Sigma of the scale of climbs: the air is not standard.")
    baro_jump_rate: float = quantity(0.0, "1/h", ge=0, doc="Windows, fans and tunnels that move the pressure.")
    baro_jump: Pair = quantity((3.0, 15.0), "m", doc="Least and largest step of these, as height.")
    baro_jump_length: Pair = quantity((5.0, 60.0), "s", doc="Shortest and longest time for which one lasts.")


class DriveParams(_Air):
    """Parameters of simulator.drive. None leaves a value to the motion or to the preset of the sensors."""

    gnss_rate: float | None = quantity(None, "Hz", gt=0, doc="Fixes per second.")
    gnss_lag: float = quantity(0.0, "ms", ge=0, doc="A fix tells where the antenna was this long before.")
    gnss_velocity_lag: float | None = quantity(
        None, "ms", ge=0, doc="A fix tells how fast the antenna was this long before; none: as gnss_lag."
    )
    gnss_horizontal: float | None = quantity(None, "m", ge=0, doc="Sigma of the slow error, east and north each.")
    gnss_vertical: float | None = quantity(None, "m", ge=0, doc="Sigma of the slow error of the height.")
    gnss_correlation: float | None = quantity(
        None, "s", ge=0, doc="Time in which the slow error changes; 0 s for white noise."
    )
    gnss_white_horizontal: float | None = quantity(None, "m", ge=0, doc="Sigma of white noise, east and north each.")
    gnss_white_vertical: float | None = quantity(None, "m", ge=0, doc="Sigma of white noise of the height.")
    gnss_velocity: float | None = quantity(None, "m/s", ge=0, doc="Sigma of the velocity, east and north each.")
    gnss_velocity_vertical: float | None = quantity(None, "m/s", ge=0, doc="Sigma of the velocity upwards.")
    gnss_vector: bool = setting(True, doc="Are velocities told as vectors beside speed and course?")
    gnss_speed_step: float = quantity(0.0, "km/h", ge=0, doc="Step of the speed over ground.")
    gnss_course_step: float = quantity(0.0, "deg", ge=0, doc="Step of the course.")
    gnss_course_hold: float = quantity(0.0, "km/h", ge=0, doc="Below this speed the course stays what it was.")
    gnss_told_sigma: float = setting(
        1.0, ge=0, doc="Sigmas that fixes tell, by the true ones of good fixes; 0: they tell none."
    )
    lever_arm: Triple | None = quantity(None, "m", doc="From the IMU to the antenna: forward, left, up.")
    multipath: float | None = quantity(None, "%", ge=0, le=50, doc="Share of fixes in bursts of outliers.")
    multipath_size: Pair | None = quantity(None, "m", doc="Least and largest error of the position in a burst.")
    multipath_length: Pair | None = quantity(None, "s", doc="Shortest and longest burst.")
    multipath_single: float | None = quantity(None, "%", ge=0, le=100, doc="Share of bursts that hit one fix alone.")
    multipath_velocity: tuple[float, ...] | None = quantity(
        None, "m/s", doc="Sigmas of the velocity's error on each axis, of which each burst takes one."
    )
    outages: tuple[Pair, ...] | None = quantity(
        None,
        "s",
        doc="Spans without fixes, in time since the start: [[60 s, 90 s], [150 s, 155 s]]; none: those of the preset.",
    )
    outage_rate: float | None = quantity(
        None, "1/h", ge=0, doc="Further outages at random places; none: that of the preset unless outages are given."
    )
    outage_length: Pair = quantity((30.0, 60.0), "s", doc="Shortest and longest outage at a random place.")

    @field_validator("outages")
    @classmethod
    def _in_order(cls, value: tuple[Pair, ...] | None) -> tuple[Pair, ...] | None:
        for start, stop in value or ():
            if not start < stop:
                raise ValueError(f"an outage from {start:g} s to {stop:g} s ends before it begins")
        return value

    @field_validator(
        "vibration_band", "multipath_size", "multipath_length", "outage_length", "mag_disturbance",
        "mag_disturbance_length", "baro_jump", "baro_jump_length",
    )  # fmt: skip
    @classmethod
    def _rising(cls, value: Pair | None) -> Pair | None:
        if value is not None and not 0.0 < value[0] <= value[1]:
            raise ValueError(f"{value[0]:g} to {value[1]:g} is no range above zero")
        return value
