"""The best trajectory of a whole drive from IMU and GNSS, nothing told about how the box is mounted.

All unknowns of the drive at once, by robust nonlinear least squares (maximum a posteriori): attitude, velocity,
position and biases at knots two seconds apart, the slow error of GNSS, the mounting of the box, the levers to the
antenna and the rear axle, delays of GNSS, scale errors, and how the body leans and slips. Between knots the IMU is
summed up beforehand. The size of the noise is estimated first, then outliers are told apart. See
recon.numerics.smoothing for the model; plugins/recon_fusers/README.md for what it reaches.

    minimise  sum |e_imu|^2 + sum w |e_gnss|^2 + sum |e_wheels|^2 + sum |e_standing|^2 + sum |e_prior|^2

The trajectory is that of the origin of the IMU, at its rate; its attitude is that of the vehicle, in the local level
frame of the place; that of the box is vehicle times mounting (metrics mount_qw to mount_qz). Sigmas come from the
inverse of the normal equations. The roll of the mounting is known only as far as roads are level on average.

References
    Forster, Carlone, Dellaert, Scaramuzza (2017), "On-manifold preintegration for real-time visual-inertial odometry",
    IEEE T-RO 33(1), 1-21.
    Yang, Antonante, Tzoumas, Carlone (2020), "Graduated non-convexity for robust spatial perception", IEEE RA-L 5(2).
    Dissanayake, Sukkarieh, Nebot, Durrant-Whyte (2001), IEEE T-RA 17(5) (constraints of wheels).
    Groves (2013), "Principles of GNSS, inertial, and multisensor integrated navigation systems", 2nd ed.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from recon import (
    ATTITUDE,
    BARO,
    EVENTS,
    GNSS,
    GROUND,
    IMU,
    KNOTS,
    RESIDUALS,
    TRAJECTORY,
    VISUAL,
    WHEEL,
    Array,
    Fuser,
    Live,
    Params,
    Streams,
    hookimpl,
    matrix,
    metrics,
    quantity,
    setting,
    time_ns,
)
from recon import events as event_rows
from recon.numerics.rotation import from_euler
from recon.schema import FURTHER_GNSS
from recon.sensor_classes import NAMES, SensorClass, typical

if TYPE_CHECKING:
    from recon.fixes import Observed, Trust
    from recon.numerics.smoothing import Drive, Estimate, Model, Noise
    from recon.numerics.smoothing.aids import Speed
    from recon.rows import Metric


_OF_RECEIVERS = ("lat", "lon", "height", "speed", "course", "vel", "pos_std", "vel_std", "fix")


class MapParams(Params):
    """Parameters of fuser.map. None leaves a value to the class of the sensor, or to be estimated."""

    sensor_class: SensorClass = setting(
        "consumer_mems", doc="What kind of IMU it is: sizes of noise, biases and scale errors to start from."
    )
    estimate_noise: bool = setting(True, doc="Estimate the noise of IMU and GNSS from the drive; false: as given.")
    gyro_noise: float | None = quantity(None, "deg/s/sqrt(Hz)", gt=0, doc="Density of white noise in the moving car.")
    accel_noise: float | None = quantity(None, "ug/sqrt(Hz)", gt=0, doc="Density of white noise in the moving car.")
    gyro_bias_walk: float | None = quantity(None, "deg/s/sqrt(s)", gt=0, doc="Random walk of the bias.")
    accel_bias_walk: float | None = quantity(None, "ug/sqrt(s)", gt=0, doc="Random walk of the bias.")
    gyro_bias: float | None = quantity(None, "deg/s", gt=0, doc="Sigma of the bias at the start.")
    accel_bias: float | None = quantity(None, "mg", gt=0, doc="Sigma of the bias at the start.")
    gyro_scale: float | None = quantity(None, "%", ge=0, doc="Sigma of the scale error; 0 % for none.")
    accel_scale: float | None = quantity(None, "%", ge=0, doc="Sigma of the scale error; 0 % for none.")

    reported_sigmas: bool = setting(True, doc="Start from the sigmas that the receiver reports, where it does.")
    gnss_horizontal: float = quantity(2.5, "m", gt=0, doc="Slow error of positions, each axis, where none is reported.")
    gnss_vertical: float = quantity(3.5, "m", gt=0, doc="Slow error of heights, where none is reported.")
    gnss_correlation: float = quantity(100.0, "s", gt=0, doc="Time in which the slow error changes.")
    gnss_white_horizontal: float = quantity(1.0, "m", gt=0, doc="White error of positions, where none is reported.")
    gnss_white_vertical: float = quantity(1.5, "m", gt=0, doc="White error of heights, where none is reported.")
    gnss_velocity: float = quantity(0.1, "m/s", gt=0, doc="Error of each axis and of speed, where none is reported.")
    gnss_velocity_vertical: float = quantity(
        0.15, "m/s", gt=0, doc="Error of vertical velocity, where none is reported."
    )

    mounting: tuple[float, float, float] | None = quantity(
        None, "deg", doc="Roll, pitch, yaw of the box in the vehicle (ISO 8855); none: found from the drive."
    )
    mounting_sigma: float = quantity(1.0, "deg", gt=0, doc="How well the mounting is known, where it is given.")
    lever_arm: tuple[float, float, float] | None = quantity(
        None, "m", doc="From the IMU to the antenna: forward, left, up; none: found, as far as turns tell it."
    )
    lever_arm_sigma: float = quantity(0.05, "m", gt=0, doc="How well the lever arm is known, where it is given.")
    rear_axle: tuple[float, float, float] | None = quantity(
        None, "m", doc="From the IMU to the middle of the rear axle: forward, left, up; none: found."
    )
    rear_axle_sigma: float = quantity(0.1, "m", gt=0, doc="How well the rear axle is known, where it is given.")
    gnss_delay: float = quantity(100.0, "ms", ge=0, doc="Sigma of the delay of positions; 0 ms where stamps are right.")
    gnss_velocity_delay: float = quantity(100.0, "ms", ge=0, doc="Sigma of the further delay of velocities.")
    gnss_clock_drift: float = quantity(
        50.0, "ppm", ge=0, doc="Sigma of how fast the clocks of IMU and GNSS run apart; 0 ppm where both have one."
    )
    impact_error: float = quantity(
        1.0, "%", gt=0, doc="In events of kind crash: share of the change of velocity that the IMU may miss."
    )
    slip_time: float = quantity(
        10.0, "s", ge=0, doc="From a crash until the vehicle stands, at most so long, wheels may slip in any direction."
    )
    steering: bool = setting(True, doc="Take turn rates from the angle of the steering wheel, where wheel holds it.")
    wheels: bool = setting(True, doc="It rolls on wheels that hardly slip: motion across is small, roads are level.")
    baro_noise: float | None = quantity(
        None, "m", gt=0, doc="Error of a barometer's height, mean of two seconds; none: from its record."
    )
    baro_walk: float = quantity(0.02, "m/sqrt(s)", gt=0, doc="Random walk of the air's pressure, as height.")
    ground_level: float | None = quantity(
        None, "m", doc="Height of the box above the map of heights, in the datum of GNSS; none: as GNSS tells it."
    )
    camera_sigma: float = quantity(
        0.3, "deg", gt=0, doc="How well the camera's mounting in the box is known; the rest is found."
    )
    camera_lever: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0), "m", doc="From the IMU to the camera, in the axes of imu; found, as far as turns tell it."
    )
    camera_lever_sigma: float = quantity(0.3, "m", gt=0, doc="How well that is known.")
    first_attitude_sigma: float = quantity(2.0, "deg", gt=0, doc="How well the stream attitude is known, where given.")
    antenna_2: tuple[float, float, float] | None = quantity(
        None, "m", doc="From the antenna of gnss to that of gnss_2: forward, left, up; none: found from turns."
    )
    antenna_3: tuple[float, float, float] | None = quantity(None, "m", doc="The same of gnss_3.")
    antenna_4: tuple[float, float, float] | None = quantity(None, "m", doc="The same of gnss_4.")
    output_rate: float | None = quantity(None, "Hz", gt=0, doc="Rows of the trajectory per second; none: every record.")


def fuse_map(
    *,
    imu: pa.Table,
    gnss: pa.Table,
    wheel: pa.Table | None,
    attitude: pa.Table | None,
    baro: pa.Table | None = None,
    ground: pa.Table | None = None,
    visual: pa.Table | None = None,
    events: pa.Table | None = None,
    gnss_2: pa.Table | None = None,
    gnss_3: pa.Table | None = None,
    gnss_4: pa.Table | None = None,
    params: MapParams,
) -> Streams:
    """The trajectory with sigmas, residuals of every fix, standstills and outages, and every number estimated.

    imu : accel m/s^2 (specific force), gyro rad/s, any mounting; gnss : positions or speed
    wheel : speed, perhaps steering_angle
    attitude : its first row is taken as the attitude of the imu's axes at that time
    baro : pressure; ground : heights of a map along the way; visual : how a camera moved
    events : those of kind crash have knots at both ends, biases that stay, and wheels that may slip afterwards
    gnss_2 to gnss_4 : further receivers in the vehicle, each with an antenna, a clock and errors of its own
    raises : NotEnoughData and DataError where the log cannot tell, with what is missing
    """
    from recon.aiding import AidTrust, aids_of
    from recon.driving import drive_of, impacts_of, measured, solve
    from recon.fixes import observe
    from recon.receivers import with_further
    from recon_fusers import _map_tables as tables  # slow import: only when used
    from recon_fusers._map_doubts import doubts
    from recon_fusers._map_knots import knots
    from recon_fusers._map_metrics import estimates
    from recon_fusers._map_turned import mounted, turned, turnings

    imu = measured(imu)
    start_ns = int(time_ns(imu)[0]) if imu.num_rows else 0
    observed = observe(gnss, start_ns, trust_of(params), params.reported_sigmas)
    impacts = impacts_of(imu, events, params.impact_error, params.slip_time)
    trust = AidTrust(params.baro_noise, params.baro_walk, params.steering, params.ground_level)
    model, expected = model_of(params, attitude, baro, visual), noise_of(params, observed)

    def solved(imu: pa.Table, wheels: bool, noise: Noise) -> tuple[Estimate, list[Metric]]:
        drive = drive_of(imu, wheel, observed, start_ns, impacts)
        aids, learnt = aids_of(imu, baro, ground, visual, observed, start_ns, trust, wheel)
        drive = replace(drive, aids=(*aids, *_speed_alone(params, drive, model)))
        return solve(drive, replace(model, wheels=wheels), noise, params.estimate_noise), learnt

    fit = mounted(imu, solved, expected, params.wheels, may_turn=visual is None)
    further, antennas = _further(params, (gnss_2, gnss_3, gnss_4))
    every = with_further(fit.found, observed, further, antennas, start_ns, trust_of(params), params.reported_sigmas)
    trajectory = tables.trajectory(every.found, observed, fit.imu, gnss, params.output_rate)
    learnt = [*fit.learnt, *estimates(every.found, every.observed), *every.learnt, *turned(fit.turns)]
    return {
        "trajectory": trajectory,
        "knots": knots(every.found, fit.imu, trajectory),
        "residuals": tables.residuals(every.found, every.observed, every.kinds, {"gnss": gnss, **further}),
        "events": event_rows([*tables.happenings(every.found, start_ns), *turnings(fit.turns, start_ns)]),
        "metrics": metrics([*learnt, *doubts(fit.found, observed, trajectory, gnss, expected)]),
    }


def _further(
    params: MapParams, tables: tuple[pa.Table | None, ...]
) -> tuple[dict[str, pa.Table], dict[str, tuple[float, float, float] | None]]:
    """Further receivers that tell something, and where their antennas are as far as that is given; by stream."""
    held = zip(FURTHER_GNSS, tables, strict=True)
    further = {name: table for name, table in held if table is not None and table.num_rows}
    return further, {name: getattr(params, f"antenna_{name[-1]}") for name in further}


def _speed_alone(params: MapParams, drive: Drive, model: Model) -> list[Speed]:
    """What the wheel speed of a vehicle tells whose wheels bind nothing: how fast it is, in whatever direction."""
    from recon.numerics.smoothing.aids import Speed

    if params.wheels or len(drive.wheel_t_s) < 2:
        return []
    return [Speed(drive.wheel_t_s, np.abs(drive.wheel_speed), model.wheel_speed)]


def trust_of(params: MapParams) -> Trust:
    """What is believed of GNSS where it reports no sigma."""
    from recon.fixes import Trust

    across, up = params.gnss_horizontal, params.gnss_vertical
    return Trust(
        drift=(across, across, up),
        white=(params.gnss_white_horizontal, params.gnss_white_horizontal, params.gnss_white_vertical),
        velocity=(params.gnss_velocity, params.gnss_velocity, params.gnss_velocity_vertical),
    )


def _value(params: MapParams, name: str) -> float:
    """A parameter, or what is typical of the class."""
    given: float | None = getattr(params, name)
    return typical(params.sensor_class, name) if given is None else given


def model_of(
    params: MapParams, attitude: pa.Table | None, baro: pa.Table | None = None, visual: pa.Table | None = None
) -> Model:
    """How the vehicle moves, and what is known beforehand."""
    from recon.numerics.barometer import SCALE_SIGMA
    from recon.numerics.smoothing import Model

    value = {name: _value(params, name) for name in NAMES}
    known: dict[str, object] = {}
    if params.mounting is not None:
        roll, pitch, yaw = params.mounting
        known["mounting"] = _matrix(from_euler(yaw, pitch, roll))
        known["mounting_sigma"] = (params.mounting_sigma,) * 3
    for name, sigma in (("lever_arm", params.lever_arm_sigma), ("rear_axle", params.rear_axle_sigma)):
        if getattr(params, name) is not None:
            part = name.split("_")[0]
            known[part], known[f"{part}_sigma"] = getattr(params, name), (sigma,) * 3
    if attitude is not None and attitude.num_rows:
        known["first_attitude"] = _matrix(matrix(attitude, "q")[0])
        known["first_attitude_sigma"] = (params.first_attitude_sigma,) * 3
    if visual is not None and visual.num_rows > 1:
        known["camera"] = params.camera_sigma
        known["camera_lever"], known["camera_lever_sigma"] = params.camera_lever, params.camera_lever_sigma
    return Model(
        gyro_bias=value["gyro_bias"],
        accel_bias=value["accel_bias"],
        gyro_scale=value["gyro_scale"],
        accel_scale=value["accel_scale"],
        baro=SCALE_SIGMA if baro is not None and baro.num_rows > 1 else 0.0,
        lag=params.gnss_delay,
        velocity_lag=params.gnss_velocity_delay,
        clock=params.gnss_clock_drift,
        wheels=params.wheels,
        **known,  # type: ignore[arg-type]
    )


def _matrix(q: Array) -> Array:
    from recon.numerics.smoothing.soa import quat_to_matrix

    return np.asarray(quat_to_matrix(np.asarray(q)[:, None])[..., 0])


def noise_of(params: MapParams, observed: Observed) -> Noise:
    """The sizes of random errors to start from."""
    from recon.numerics.smoothing import Noise

    return Noise(
        gyro=_value(params, "gyro_noise"),
        accel=_value(params, "accel_noise"),
        gyro_walk=_value(params, "gyro_bias_walk"),
        accel_walk=_value(params, "accel_bias_walk"),
        drift=observed.drift,
        drift_tau=params.gnss_correlation,
        position=np.ones(3),
        velocity=np.ones(3),
    )


def live(params: MapParams, lag: float, saved: bytes | None) -> Live:
    """As `fuse_map`, for a drive that goes on."""
    from recon_fusers._map_live import LiveMap  # slow import: only when used

    return LiveMap(params, lag, saved)


@hookimpl
def declare_fusers() -> Iterable[Fuser]:
    """Declare fuser.map."""
    yield Fuser(
        name="map",
        summary="The best trajectory of a whole drive from IMU and GNSS, by robust batch smoothing.",
        version=13,
        params=MapParams,
        reads={
            "imu": IMU.need("accel", "gyro", quantity={"accel": "specific_force"}),
            "gnss": GNSS.need(maybe=_OF_RECEIVERS),
            **{name: GNSS.need(maybe=_OF_RECEIVERS, optional=True) for name in FURTHER_GNSS},
            "wheel": WHEEL.need("speed", maybe=["steering_angle"], optional=True),
            "attitude": ATTITUDE.need("q", optional=True),
            "baro": BARO.need("pressure", optional=True),
            "ground": GROUND.need("lat", "lon", "height", "slope_e", "slope_n", "height_std", optional=True),
            "visual": VISUAL.need(
                "end_time", "q", "rotation_std", maybe=["direction", "direction_std"], frame="sensor", optional=True
            ),
            "events": EVENTS.need("time", "end_time", "kind", optional=True),
        },
        writes={"trajectory": TRAJECTORY, "knots": KNOTS, "residuals": RESIDUALS, "events": EVENTS},
        run=fuse_map,
        live=live,
        references=("Forster et al. 2017", "Yang et al. 2020", "Dissanayake et al. 2001", "Groves 2013"),
    )
