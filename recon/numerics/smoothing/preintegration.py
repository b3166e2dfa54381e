"""Increments of rotation, velocity and position between knots, integrated once: preintegration.

From the samples of an interval, in the axes of the sensor at its start, without gravity and without Earth rate,

    dR' = dR [w]x,    dV' = dR a,    dP' = dV,    w = (1 - k_g) (gyro - b_g),    a = (1 - k_a) (accel - b_a),

scale errors k axis by axis. Inside a step rate and specific force are linear in time; coning and sculling are carried
to second order. Only the product of quaternions runs from step to step. White noise stays white and isotropic when it
is turned, so all derivatives and covariances are integrals over the interval, of dR and of what is still to come,

    V_s = dV(T) - dV(s),    K_s = dP(T) - dP(s) - dV(s) (T - s),

and are taken by Simpson's rule on about fifty panels:

    rotation   b_g: -dR(T)^T int dR    k_g: -dR(T)^T int dR diag(w)
    velocity   b_g: int [V_s]x dR      b_a: -int dR              k_g, k_a: the same with diag(w), diag(a) behind dR
    position   b_g: int [K_s]x dR      b_a: -int dR (T - s)

The error of the rotation is to its right, dR exp(d). Covariances for unit density of the gyro noise:
C_RR = T, C_VR = -int [V_s]x dR(T), C_VV = int (|V_s|^2 - V_s V_s^T), C_PV and C_PP alike; of the accelerometer noise:
C_VV = T, C_PV = T^2 / 2, C_PP = T^3 / 3.

References
    Forster, Carlone, Dellaert, Scaramuzza (2017), "On-manifold preintegration for real-time visual-inertial odometry",
    IEEE T-RO 33(1), 1-21: eqs. 33 to 36 (increments), A.7 to A.9 (noise), section VI-C (derivatives to biases).
    Savage (1998), "Strapdown inertial navigation integration algorithm design", J. Guidance, Control and Dynamics
    21(1), 19-28 (coning), 21(2), 208-221 (sculling).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recon.numerics.smoothing.samples import Samples
from recon.numerics.smoothing.soa import (
    Floats,
    cross,
    mm,
    mtm,
    mv,
    quat_exp,
    quat_to_matrix,
    running_product,
    running_sum,
    skew,
)

_CHUNK = 40_000
"""Samples worked on at a time: their arrays stay in the cache."""

_PANELS = 50
"""Of Simpson's rule in an interval, or every step where there are fewer."""

_EVEN = 2.0
"""Two neighbouring panels that differ by more, beside a gap or the padded end, are left to the trapezoid."""


@dataclass(frozen=True)
class Increments:
    """What the IMU says from knot to knot, and how it depends on its errors. K intervals, n sample steps.

    All in the axes of the sensor at the knot before. A derivative is named increment_error: `velocity_gyro` is that of
    the velocity increment to the gyro bias, `velocity_gyro_scale` to the scale errors of the gyro. That of the rotation
    is the rotation vector d in rotation exp(d).

    duration : (K,) s
    rotation : (3, 3, K), sensor at the knot behind to sensor at the knot before
    velocity, position : (3, K) m/s, m
    *_gyro, *_accel : (3, 3, K) per rad/s, per m/s^2
    *_scale : (3, 3, K) per unit of scale error
    gyro_bias, accel_bias : (3, K) rad/s, m/s^2, of the linearisation
    scale : (6,) gyro, accelerometer, of the linearisation
    covariance_gyro, covariance_accel : (K, 9, 9) rotation, velocity, position; for a noise density of 1 rad/s/sqrt(Hz),
        1 m/s^2/sqrt(Hz)
    q, dv, dp : (4, n), (3, n), (3, n), increments from its knot to the start of each step
    """

    duration: Floats
    rotation: Floats
    velocity: Floats
    position: Floats
    rotation_gyro: Floats
    velocity_gyro: Floats
    velocity_accel: Floats
    position_gyro: Floats
    position_accel: Floats
    rotation_gyro_scale: Floats
    velocity_gyro_scale: Floats
    position_gyro_scale: Floats
    velocity_accel_scale: Floats
    position_accel_scale: Floats
    gyro_bias: Floats
    accel_bias: Floats
    scale: Floats
    covariance_gyro: Floats
    covariance_accel: Floats
    q: Floats
    dv: Floats
    dp: Floats

    def part(self, intervals: slice) -> Increments:
        """Those of some intervals."""
        m = self.q.shape[1] // len(self.duration)
        steps = slice(intervals.start * m, intervals.stop * m)
        kept = {name: value[..., intervals] for name, value in vars(self).items()}
        kept.update(scale=self.scale, q=self.q[:, steps], dv=self.dv[:, steps], dp=self.dp[:, steps])
        kept.update(covariance_gyro=self.covariance_gyro[intervals], covariance_accel=self.covariance_accel[intervals])
        return Increments(**kept)


@dataclass(frozen=True)
class _Path:
    """Increments at p + 1 nodes of n intervals, with what each node counts for in an integral.

    s : (p+1, n) s; weight : (p+1, n) s; angle, push : (3, p+1, n) rad, m/s, integrals of rate and force about a node
    rotation : (3, 3, p+1, n); velocity, position : (3, p+1, n)
    """

    s: Floats
    weight: Floats
    angle: Floats
    push: Floats
    rotation: Floats
    velocity: Floats
    position: Floats


def preintegrate(samples: Samples, gyro_bias: Floats, accel_bias: Floats, scale: Floats) -> Increments:
    """Increments of all intervals, with derivatives and covariances.

    gyro_bias, accel_bias : (3, K) rad/s, m/s^2, constant over each interval
    scale : (6,) scale errors of gyro and accelerometer
    """
    m, intervals = samples.per_interval, samples.intervals
    partial = np.empty((10, intervals, m))
    width = max(_CHUNK // m, 1)
    results = []
    for k in range(0, intervals, width):
        some = slice(k, min(k + width, intervals))
        rows = slice(some.start * m, some.stop * m + 1)
        rate = _true(samples.gyro_s[rows], gyro_bias[:, some], scale[:3])
        force = _true(samples.accel_s[rows], accel_bias[:, some], scale[3:])
        step = np.ascontiguousarray(np.diff(samples.t_s[rows]).reshape(-1, m).T)
        results.append(_integrals(_integrate(rate, force, step, partial[:, some]), scale))
    whole = {name: np.concatenate([part[name] for part in results], axis=-1) for name in results[0]}
    for name in ("covariance_gyro", "covariance_accel"):
        whole[name] = np.ascontiguousarray(np.moveaxis(whole[name], -1, 0))
    q, dv, dp = np.split(partial.reshape(10, -1), (4, 7))
    return Increments(gyro_bias=gyro_bias, accel_bias=accel_bias, scale=scale, q=q, dv=dv, dp=dp, **whole)


def _true(measured: Floats, bias: Floats, scale: Floats) -> Floats:
    """Samples freed of bias and scale error: (3, m+1, n), the first of the next interval at the end of each.

    measured : (n m + 1, 3); bias : (3, n); scale : (3,)
    """
    n = bias.shape[1]
    m = (len(measured) - 1) // n
    true = np.empty((3, m + 1, n))
    true[:, :m] = measured[:-1].reshape(n, m, 3).transpose(2, 1, 0)
    true[:, m] = measured[m::m].T
    true -= bias[:, None]
    true *= (1.0 - scale)[:, None, None]
    return true


def _integrate(rate: Floats, force: Floats, step: Floats, partial: Floats) -> _Path:
    """Increments at the nodes; those at the start of every step are written to `partial`.

    rate, force : (3, m+1, n) rad/s, m/s^2; step : (m, n) s; partial : (10, n, m) quaternion, velocity, position
    """
    m, n = step.shape
    angle, push = (0.5 * step * (x[:, :-1] + x[:, 1:]) for x in (rate, force))
    turn, dv, dp = _steps(rate, force, angle, push, step)
    q = np.empty((4, m + 1, n))
    q[:, 0] = np.array([1.0, 0.0, 0.0, 0.0])[:, None]
    q[:, 1:] = running_product(quat_exp(turn))
    rotation = quat_to_matrix(q)
    velocity = running_sum(mv(rotation[:, :, :-1], dv))
    position = running_sum(mv(rotation[:, :, :-1], dp) + velocity[:, :-1] * step)
    for part, x in zip(np.split(partial, (4, 7)), (q, velocity, position), strict=True):
        part[...] = x[:, :-1].swapaxes(1, 2)
    stride = _stride(m)
    s = running_sum(step[None])[0, ::stride]
    return _Path(
        s=s,
        weight=_simpson(s),
        angle=_about_nodes(angle, stride),
        push=_about_nodes(push, stride),
        rotation=rotation[:, :, ::stride],
        velocity=velocity[:, ::stride],
        position=position[:, ::stride],
    )


def _steps(rate: Floats, force: Floats, angle: Floats, push: Floats, step: Floats) -> tuple[Floats, Floats, Floats]:
    """Rotation vector, velocity and position of each step, in the axes at its start. Savage 1998.

    rate, force : (3, m+1, n) rad/s, m/s^2; angle, push : (3, m, n) rad, m/s, their trapezoids; step : (m, n) s
    returns : (3, m, n) rad, m/s, m
    """
    rate_0, rate_1, force_0, force_1 = rate[:, :-1], rate[:, 1:], force[:, :-1], force[:, 1:]
    twelfth = step**2 / 12.0
    turn = cross(rate_0, rate_1)
    turn *= twelfth
    turn += angle
    bend = cross(turn, push)
    dp = force_0 - force_1
    dp *= twelfth
    dp += (0.5 * step) * push
    dp += (step / 6.0) * bend
    dv = cross(rate_0, force_1)
    dv -= cross(rate_1, force_0)
    dv *= twelfth
    dv += push
    dv += 0.5 * bend
    dv += cross(turn, bend) / 6.0
    return turn, dv, dp


def _stride(m: int) -> int:
    """Steps in a panel of Simpson's rule; the panels are an even number."""
    return next(stride for stride in range(max(m // _PANELS, 1), 0, -1) if m % (2 * stride) == 0)


def _simpson(s: Floats) -> Floats:
    """Weights of Simpson's rule for unequal panels: s (p+1, n) s, p even; returns (p+1, n) s, none negative."""
    first, second = s[1::2] - s[:-1:2], s[2::2] - s[1::2]
    even = (first < _EVEN * second) & (second < _EVEN * first)
    ratio = np.divide(second, first, out=np.ones_like(first), where=even)
    pair = first + second
    left = np.where(even, pair * (2.0 - ratio) / 6.0, 0.5 * first)
    right = np.where(even, pair * (2.0 - 1.0 / ratio) / 6.0, 0.5 * second)
    weight = np.zeros_like(s)
    weight[:-1:2] = left
    weight[2::2] += right
    weight[1::2] = pair - left - right
    return weight


def _about_nodes(x: Floats, stride: int) -> Floats:
    """Half of what is summed in the panel before each node, and half of that behind: (3, m, n) to (3, p+1, n).

    So each sample counts, and vibration is not sampled too coarsely.
    """
    panel = 0.5 * x.reshape(3, -1, stride, x.shape[-1]).sum(axis=2)
    about = np.zeros((3, panel.shape[1] + 1, x.shape[-1]))
    about[:, :-1] = panel
    about[:, 1:] += panel
    return about


def _integrals(path: _Path, scale: Floats) -> dict[str, Floats]:
    """Increments over the whole intervals, derivatives, and covariances (9, 9, n)."""
    to_go = path.s[-1] - path.s
    # Copies: a view would keep the path of every chunk alive.
    duration, rotation = path.s[-1].copy(), path.rotation[:, :, -1].copy()
    velocity, position = path.velocity[:, -1].copy(), path.position[:, -1].copy()
    v_left = velocity[:, None] - path.velocity
    p_left = position[:, None] - path.position - path.velocity * to_go
    plain, turning, pushing = (path.rotation * x for x in (path.weight, path.angle, path.push))
    # The corrected rate is (1 - scale) (gyro - bias): its derivatives are -(1 - scale) and -rate / (1 - scale).
    gain_gyro, gain_accel = (1.0 - scale)[:3, None], (1.0 - scale)[3:, None]
    turned = mtm(rotation, plain.sum(axis=2))
    return {
        "duration": duration,
        "rotation": rotation,
        "velocity": velocity,
        "position": position,
        "rotation_gyro": -turned * gain_gyro,
        "velocity_gyro": cross(v_left[:, None], plain).sum(axis=2) * gain_gyro,
        "velocity_accel": -plain.sum(axis=2) * gain_accel,
        "position_gyro": cross(p_left[:, None], plain).sum(axis=2) * gain_gyro,
        "position_accel": -(plain * to_go).sum(axis=2) * gain_accel,
        "rotation_gyro_scale": -mtm(rotation, turning.sum(axis=2)) / gain_gyro,
        "velocity_gyro_scale": cross(v_left[:, None], turning).sum(axis=2) / gain_gyro,
        "position_gyro_scale": cross(p_left[:, None], turning).sum(axis=2) / gain_gyro,
        "velocity_accel_scale": -pushing.sum(axis=2) / gain_accel,
        "position_accel_scale": -(pushing * to_go).sum(axis=2) / gain_accel,
        "covariance_gyro": _covariance_gyro(duration, rotation, v_left, p_left, path.weight),
        "covariance_accel": _covariance_accel(duration),
    }


def _covariance_gyro(duration: Floats, rotation: Floats, v_left: Floats, p_left: Floats, weight: Floats) -> Floats:
    """For white noise of density 1 on each rate: (9, 9, n)."""
    covariance = np.zeros((9, 9, len(duration)))
    unit = np.eye(3)[:, :, None]
    covariance[:3, :3] = duration * unit
    arms = ((slice(3, 6), v_left), (slice(6, 9), p_left))
    for one, arm in arms:
        covariance[one, :3] = -mm(skew((arm * weight).sum(axis=1)), rotation)
        covariance[:3, one] = covariance[one, :3].swapaxes(0, 1)
        for other, second in arms:
            moment = np.einsum("amn,bmn->abn", second * weight, arm)
            covariance[one, other] = np.einsum("aan->n", moment) * unit - moment
    return covariance


def _covariance_accel(duration: Floats) -> Floats:
    """For white noise of density 1 on each specific force: (9, 9, n)."""
    covariance = np.zeros((9, 9, len(duration)))
    unit = np.eye(3)[:, :, None]
    velocity, position = slice(3, 6), slice(6, 9)
    covariance[velocity, velocity] = duration * unit
    covariance[velocity, position] = covariance[position, velocity] = duration**2 / 2.0 * unit
    covariance[position, position] = duration**3 / 3.0 * unit
    return covariance
