"""Peer: the whole drive as one factor graph, solved by the GTSAM library (pip install gtsam, 4.3 or later).

Knots at the fixes, and every second where there is none. Factors: preintegrated IMU with random walk of the biases,
Coriolis and rotation of the Earth; position of the antenna; velocity of the antenna; a prior of the first attitude and
of the first biases. Nothing is known of the vehicle: no stops, no constraint of the wheels.

GNSS positions err slowly. GTSAM has no factor for that, so the positions count as noisier than they scatter: by half
of what white noise of the same power at low frequency would have, drift sqrt(2 tau / dt) / 2, while the robust loss
turns at the scatter of a single fix. The half is the best of 1, 1/2, 1/4 and of no such growth over ten drives of ten
minutes (horizontal error 1.65, 1.57, 1.68 and 1.87 m), to the good of the peer on just these drives; Cauchy's loss and
that of Geman and McClure differed by less than 2 % there.
`solve_scatter` leaves that out, as examples of the library and the study before this project do.
The factor of the velocity takes the turning lever arm, and each interval its gravity, from the solution before: the
graph is built three times, first with the sigma of the scatter, each with the biases, attitudes and places found then.

References
    Forster, Carlone, Dellaert, Scaramuzza (2017), "On-manifold preintegration for real-time visual-inertial odometry",
    IEEE T-RO 33(1).
    Barron (2019), "A general and adaptive robust loss function", CVPR, section 2 (Cauchy's loss, Geman and McClure's).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from recon.numerics.rotation import Floats, conjugate, from_rotvec, rotate, to_matrix
from recon.numerics.signals import interpolate

from .drives import Drive, Estimate
from .start import ATTITUDE_SIGMA, find_start, turned_by_gyro
from .steps import Steps, steps_between, with_none_longer

KNOT_S: Final = 1.0
_LOSS: Final = 2.4
"""Where Cauchy's loss turns, in sigma of the scatter: 95 % efficient for Gaussian errors."""
_GROWTHS: Final = (0.0, 0.5, 0.5)
"""Of each round: the part of the noise of equal power at low frequency that positions are given."""
_FIRST_POSITION, _FIRST_VELOCITY = 100.0, 10.0
"""m, m/s; sigma of priors that only keep the first knot from being free."""
_INTEGRATION_COVARIANCE: Final = 1e-6
"""m^2/s, a millimetre per root second: with much less, the normal equations lose their last digits."""


@dataclass(frozen=True)
class _Knots:
    """State at the knots: t_s (k,) s, q_ns (k, 4), pos_n and vel_n (k, 3), biases (k, 3)."""

    t_s: Floats
    q_ns: Floats
    pos_n: Floats
    vel_n: Floats
    gyro_bias: Floats
    accel_bias: Floats


def solve(drive: Drive) -> Estimate:
    """Maximum a posteriori trajectory at the knots."""
    return _solve(drive, _GROWTHS)


def solve_scatter(drive: Drive) -> Estimate:
    """The same where positions count as exactly as they scatter, as if their errors did not last."""
    return _solve(drive, (0.0, 0.0, 0.0))


def _solve(drive: Drive, growths: tuple[float, ...]) -> Estimate:
    knots = _first_guess(drive)
    steps = steps_between(drive, knots.t_s)
    for growth in growths:
        knots, graph = _optimised(drive, knots, steps, growth)
    return Estimate(knots.t_s, knots.pos_n, knots.vel_n, knots.q_ns, _sigmas(graph, knots))


def _first_guess(drive: Drive) -> _Knots:
    """Attitude by the gyro alone, positions and velocities of the fixes, outliers and all."""
    begin = find_start(drive)
    ends = np.concatenate([drive.t_s[:1], drive.fix_t_s, drive.t_s[-1:]])
    t_s = with_none_longer(np.unique(ends), KNOT_S)
    q_ns = turned_by_gyro(drive, begin.gyro_bias, t_s)
    held = np.clip(t_s, drive.fix_t_s[0], drive.fix_t_s[-1])
    antenna_n, vel_n = (interpolate(held, drive.fix_t_s, values) for values in (drive.fix_pos_n, drive.fix_vel_n))
    pos_n = antenna_n - rotate(q_ns, drive.lever_s)
    return _Knots(t_s, q_ns, pos_n, vel_n, np.tile(begin.gyro_bias, (len(t_s), 1)), np.zeros_like(pos_n))


def _optimised(drive: Drive, knots: _Knots, steps: Steps, growth: float) -> tuple[_Knots, Any]:
    graph = gtsam.NonlinearFactorGraph()
    _add_priors(graph, drive, knots)
    _add_imu(graph, drive, knots, steps)
    _add_velocities(graph, drive, knots, steps)
    _add_positions(graph, drive, knots, growth)
    found = gtsam.LevenbergMarquardtOptimizer(graph, _values(knots)).optimize()
    number = range(len(knots.t_s))
    poses = [found.atPose3(X(i)) for i in number]
    biases = [found.atConstantBias(B(i)) for i in number]
    solved = _Knots(
        t_s=knots.t_s,
        q_ns=np.array([_quaternion(pose.rotation()) for pose in poses]),
        pos_n=np.array([pose.translation() for pose in poses]),
        vel_n=np.array([found.atVector(V(i)) for i in number]),
        gyro_bias=np.array([bias.gyroscope() for bias in biases]),
        accel_bias=np.array([bias.accelerometer() for bias in biases]),
    )
    return solved, graph


def _sigmas(graph: Any, knots: _Knots) -> Floats:
    """Of the positions, (k, 3) m: marginals of the graph. A pose's covariance is told in its own axes."""
    values = _values(knots)
    try:
        marginals = gtsam.Marginals(graph, values)
        body = np.array([marginals.marginalCovariance(X(i))[3:, 3:] for i in range(len(knots.t_s))])
    except RuntimeError:
        body = _scaled_marginals(graph, values, len(knots.t_s))
    turn = to_matrix(knots.q_ns)
    return np.sqrt(np.diagonal(turn @ body @ turn.transpose(0, 2, 1), axis1=1, axis2=2))


def _scaled_marginals(graph: Any, values: Any, count: int) -> Floats:
    """Covariances of the positions of all poses, (count, 3, 3) m^2, from equations whose unknowns are of one size.

    GTSAM's marginals factor the normal equations in m, rad and rad/s, whose condition on a real minute is 2.6e15, as
    much as a double holds, though that of the scaled ones is 1e10: nothing there is unobservable. Its QR factorization,
    which would do, is not offered to Python.
    """
    order = gtsam.Ordering()
    for symbol in (X, V, B):
        for i in range(count):
            order.push_back(symbol(i))
    jacobian, _ = graph.linearize(values).jacobian(order)
    size = np.linalg.norm(jacobian, axis=0)
    inverse = np.linalg.inv((jacobian / size).T @ (jacobian / size)) / np.outer(size, size)
    return np.array([inverse[6 * i + 3 : 6 * i + 6, 6 * i + 3 : 6 * i + 6] for i in range(count)])


def _quaternion(rotation: Any) -> list[float]:
    q = rotation.toQuaternion()
    return [q.w(), q.x(), q.y(), q.z()]


def _values(knots: _Knots) -> Any:
    values = gtsam.Values()
    for i in range(len(knots.t_s)):
        values.insert(X(i), gtsam.Pose3(gtsam.Rot3.Quaternion(*knots.q_ns[i]), knots.pos_n[i]))
        values.insert(V(i), knots.vel_n[i])
        values.insert(B(i), gtsam.imuBias.ConstantBias(knots.accel_bias[i], knots.gyro_bias[i]))
    return values


def _add_priors(graph: Any, drive: Drive, knots: _Knots) -> None:
    pose = gtsam.Pose3(gtsam.Rot3.Quaternion(*drive.start_q_ns), knots.pos_n[0])
    noise = drive.noise
    graph.add(gtsam.PriorFactorPose3(X(0), pose, _diagonal([ATTITUDE_SIGMA] * 3 + [_FIRST_POSITION] * 3)))
    graph.add(gtsam.PriorFactorVector(V(0), knots.vel_n[0], _diagonal([_FIRST_VELOCITY] * 3)))
    sigmas = _diagonal([noise.accel_bias] * 3 + [noise.gyro_bias] * 3)
    graph.add(gtsam.PriorFactorConstantBias(B(0), gtsam.imuBias.ConstantBias(), sigmas))


def _add_imu(graph: Any, drive: Drive, knots: _Knots, steps: Steps) -> None:
    """GTSAM takes the force of a step along the axes of its beginning: here it is turned by half the step."""
    gravity_n = drive.world.gravity_at(knots.pos_n)
    force_s = rotate(from_rotvec(0.5 * steps.rate_s * steps.dt_s[:, None]), steps.force_s)
    for i in range(len(knots.t_s) - 1):
        bias = gtsam.imuBias.ConstantBias(knots.accel_bias[i], knots.gyro_bias[i])
        measured = gtsam.PreintegratedCombinedMeasurements(_imu_parameters(drive, gravity_n[i]), bias)
        for j in range(steps.first[i], steps.first[i + 1]):
            measured.integrateMeasurement(force_s[j], steps.rate_s[j], steps.dt_s[j])
        graph.add(gtsam.CombinedImuFactor(X(i), V(i), X(i + 1), V(i + 1), B(i), B(i + 1), measured))


def _imu_parameters(drive: Drive, gravity_n: Floats) -> Any:
    noise = drive.noise
    parameters = gtsam.PreintegrationCombinedParams(gravity_n)
    parameters.setGyroscopeCovariance(noise.gyro**2 * np.eye(3))
    parameters.setAccelerometerCovariance(noise.accel**2 * np.eye(3))
    parameters.setBiasOmegaCovariance(noise.gyro_walk**2 * np.eye(3))
    parameters.setBiasAccCovariance(noise.accel_walk**2 * np.eye(3))
    parameters.setIntegrationCovariance(_INTEGRATION_COVARIANCE * np.eye(3))
    parameters.setOmegaCoriolis(drive.world.earth_rate_n)
    return parameters


def _add_velocities(graph: Any, drive: Drive, knots: _Knots, steps: Steps) -> None:
    at = np.searchsorted(knots.t_s, drive.fix_t_s)
    earth_s = rotate(conjugate(knots.q_ns[at]), drive.world.earth_rate_n)
    rate_s = steps.edge_rate_s[at] - knots.gyro_bias[at] - earth_s
    vel_n = drive.fix_vel_n - rotate(knots.q_ns[at], np.cross(rate_s, drive.lever_s))
    loss = _robust(drive.noise.velocity_n, _LOSS)
    for knot, measured_n in zip(at, vel_n, strict=True):
        graph.add(gtsam.PriorFactorVector(V(knot), measured_n, loss))


def _add_positions(graph: Any, drive: Drive, knots: _Knots, growth: float) -> None:
    noise, interval_s = drive.noise, float(np.median(np.diff(drive.fix_t_s)))
    scatter_n = np.hypot(noise.drift_n, noise.white_n)
    sigma_n = np.maximum(scatter_n, growth * noise.drift_n * np.sqrt(2.0 * noise.drift_s / interval_s))
    loss = _robust(sigma_n, _LOSS * float((scatter_n / sigma_n).mean()))
    for knot, measured_n in zip(np.searchsorted(knots.t_s, drive.fix_t_s), drive.fix_pos_n, strict=True):
        graph.add(gtsam.GPSFactorArm(X(knot), measured_n, drive.lever_s, loss))


def _robust(sigma_n: Floats, turns_at: float) -> Any:
    return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(turns_at), _diagonal(sigma_n))


def _diagonal(sigmas: Any) -> Any:
    return gtsam.noiseModel.Diagonal.Sigmas(np.asarray(sigmas, dtype=np.float64))
