"""Attitude from gyroscope and accelerometer: strapdown with exact turns, and the filter of Mahony.

The turns between samples are composed without any correction to q_gs, the attitude of the sensor in a frame g that
drifts with the gyroscope's bias and with nothing else. There the specific force of a box that is turned about is
nearly constant, so it is averaged over blocks of rows without harm. A filter that levels the box then works on blocks,
some ten a second: it finds q_ls[j] at the end of block j, in a level frame l (z up, heading unknown), hence the slow
correction c = q_ls (x) q_gs*. With c between the ends of blocks along the straight line, every row gets

    q_ls[k] = c(t_k) (x) q_gs[k].

References
    Bortz (1971), "A new mathematical formulation for strapdown inertial navigation", IEEE Trans. AES 7(1), 61-66.
    Mahony, Hamel, Pflimlin (2008), "Nonlinear complementary filters on the special orthogonal group", IEEE Trans.
    Automatic Control 53(5), 1203-1218: the explicit complementary filter with bias correction, eq. 32.
    Laidig, Seel (2023), "VQF: highly accurate IMU orientation estimation with bias estimation and magnetic disturbance
    rejection", Information Fusion 91, 187-204, section 3: specific force averaged in a drifting frame.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from recon.numerics.rotation import (
    Floats,
    compose,
    conjugate,
    from_rotvec,
    multiply,
    normalize,
    rotate,
    shortest_arc,
    sign_continuous,
    to_matrix,
    to_rotvec,
)
from recon.numerics.smoothing.soa import cross, quat_exp, quat_multiply, running_product

_UP = np.array([0.0, 0.0, 1.0])
_FIRST_S = 2.0
"""Of the record, whose mean specific force shows where up is at its start."""
_LEARN_S = 1.0
"""Blocks of the round that learns the bias."""


class Blocks(NamedTuple):
    """A record of inertial sensors, and the same in blocks of rows.

    q_gs : (4, n) attitude of the sensor at each row in the drifting frame, which is that of the sensor at the first row
    size : rows of a block; the last may hold fewer
    t_s : (m,) s, time at the end of each block
    force_g : (m, 3) m/s^2, mean specific force of each block, drifting frame
    """

    q_gs: Floats
    size: int
    t_s: Floats
    force_g: Floats

    @property
    def q_end(self) -> Floats:
        """Attitude of the sensor at the end of each block in the drifting frame: (m, 4)."""
        rows = self.q_gs.shape[1]
        return np.ascontiguousarray(self.q_gs[:, np.minimum(np.arange(1, len(self.t_s) + 1) * self.size, rows) - 1].T)

    @property
    def step_s(self) -> Floats:
        """Time from the end of the block before, of the first from its first row: (m,) s."""
        return np.diff(self.t_s, prepend=0.0)

    @property
    def turns(self) -> Floats:
        """By how much the sensor turns from the end of the block before, as it sees it: (m, 3) rad."""
        q_end = self.q_end
        before = np.concatenate(([[1.0, 0.0, 0.0, 0.0]], q_end[:-1]))
        return to_rotvec(multiply(conjugate(before), q_end))

    @property
    def force_s(self) -> Floats:
        """Mean specific force of each block in the axes that the sensor has at its end: (m, 3) m/s^2."""
        return rotate(conjugate(self.q_end), self.force_g)

    def merged(self, times: int) -> Blocks:
        """The same in blocks of so many times the rows."""
        starts = np.arange(0, len(self.t_s), times)
        count = np.diff(np.append(starts, len(self.t_s)))[:, None]
        mean_g = np.add.reduceat(self.force_g, starts, axis=0) / count
        return Blocks(self.q_gs, self.size * times, self.t_s[np.append(starts[1:], len(self.t_s)) - 1], mean_g)

    def attitude(self, q_ls: Floats) -> Floats:
        """Attitude at every row from that at the end of each block: (4, n) from (m, 4)."""
        correction = sign_continuous(multiply(q_ls, conjugate(self.q_end))).T
        before = np.concatenate((correction[:, :1], correction[:, :-1]), axis=1)
        fraction = np.arange(1, self.size + 1) / self.size
        between = before[..., None] + (correction - before)[..., None] * fraction
        q_ls = quat_multiply(between.reshape(4, -1)[:, : self.q_gs.shape[1]], self.q_gs)
        q_ls /= np.sqrt(np.einsum("ij,ij->j", q_ls, q_ls))
        return q_ls


def blocks_of(t_s: Floats, gyro_s: Floats, accel_s: Floats, rate_hz: float) -> Blocks:
    """A record in blocks of as many rows as come nearest to `rate_hz` blocks a second, at least one.

    t_s : (n,) s since the first row, strictly increasing, n >= 1
    gyro_s : (3, n) rad/s, accel_s : (3, n) m/s^2 specific force, sensor
    """
    rows = len(t_s)
    step = np.diff(t_s)
    step_s = float(np.median(step)) if rows > 1 else 1.0 / rate_hz
    size = max(1, round(1.0 / (rate_hz * step_s)))
    turns = 0.5 * step * (gyro_s[:, 1:] + gyro_s[:, :-1]) + step**2 / 12.0 * cross(gyro_s[:, :-1], gyro_s[:, 1:])
    q_gs = np.empty((4, rows))
    q_gs[:, 0] = 1.0, 0.0, 0.0, 0.0
    q_gs[:, 1:] = running_product(quat_exp(turns))
    starts = np.arange(0, rows, size)
    count = np.diff(np.append(starts, rows))
    mean_g = np.add.reduceat(_rotated(q_gs, accel_s), starts, axis=1) / count
    return Blocks(q_gs, size, t_s[np.append(starts[1:], rows) - 1], np.ascontiguousarray(mean_g.T))


def _rotated(q: Floats, v: Floats) -> Floats:
    """Vectors taken by q: (3, n) of (4, n) and (3, n)."""
    twice = 2.0 * cross(q[1:], v)
    return np.asarray(v + q[0] * twice + cross(q[1:], twice))


def first_level(blocks: Blocks) -> Floats:
    """Attitude of the sensor at the first row that puts its mean specific force of the first seconds upwards: (4,).

    The heading is that of the shortest turn.
    """
    early = blocks.t_s <= max(_FIRST_S, blocks.t_s[0])
    return shortest_arc(blocks.force_g[early].mean(axis=0), _UP)


def mahony(blocks: Blocks, gain: float, bias_gain: float) -> tuple[Floats, Floats]:
    """Attitude in a level frame by the explicit complementary filter with bias correction. Mahony 2008, eq. 32.

        error = f x up,    d bias / dt = -k_i error,    d q / dt = q (x) (omega - bias + k_p error) / 2

    with f the direction of the specific force and all vectors in the sensor, carried on from block to block. Only up
    feeds back: the loop carries that and the bias, and the attitude is composed of its corrections afterwards.

    The record is gone through twice: what a first round, in blocks of about a second, learnt of the bias the second one
    begins with.

    gain : k_p, 1/s;  bias_gain : k_i, 1/s^2
    returns : q_ls (m, 4) at the end of each block; bias (m, 3) rad/s, sensor
    """
    coarse = blocks.merged(max(1, round(_LEARN_S / float(np.median(blocks.step_s)))) if len(blocks.t_s) > 1 else 1)
    learnt = _carried(coarse, gain, bias_gain, np.zeros(3))[-1, 3:]
    found = _carried(blocks, gain, bias_gain, learnt)
    return _composed(blocks, gain, found), found[:, 3:]


def _carried(blocks: Blocks, gain: float, bias_gain: float, first_bias: Floats) -> Floats:
    """Up as the sensor sees it and the bias, at the end of each block: (m, 6).

    Plain numbers: arrays of three take ten times as long.
    """
    turned = to_matrix(conjugate(from_rotvec(blocks.turns))).reshape(-1, 9)
    x, y, z = rotate(conjugate(first_level(blocks)), _UP).tolist()
    bx, by, bz = first_bias.tolist()
    found: list[float] = []
    columns = np.vstack((normalize(blocks.force_s).T, blocks.step_s, turned.T)).tolist()
    for fx, fy, fz, step, xx, xy, xz, yx, yy, yz, zx, zy, zz in zip(*columns, strict=True):
        x, y, z = xx * x + xy * y + xz * z, yx * x + yy * y + yz * z, zx * x + zy * y + zz * z
        ex, ey, ez = fy * z - fz * y, fz * x - fx * z, fx * y - fy * x
        learnt = bias_gain * step
        bx, by, bz = bx - learnt * ex, by - learnt * ey, bz - learnt * ez
        hx, hy, hz = step * (gain * ex - bx), step * (gain * ey - by), step * (gain * ez - bz)
        x, y, z = x + y * hz - z * hy, y + z * hx - x * hz, z + x * hy - y * hx
        size = (x * x + y * y + z * z) ** 0.5
        x, y, z = x / size, y / size, z / size
        found += (x, y, z, bx, by, bz)
    return np.array(found).reshape(-1, 6)


def _composed(blocks: Blocks, gain: float, found: Floats) -> Floats:
    """The attitude (m, 4) of what `_carried` found: all corrections one after the other, and up as it was carried."""
    q_start, turns, up_s, bias_s = first_level(blocks), from_rotvec(blocks.turns), found[:, :3], found[:, 3:]
    before_s = np.concatenate((rotate(conjugate(q_start), _UP)[None], up_s[:-1]))
    error_s = np.cross(normalize(blocks.force_s), rotate(conjugate(turns), before_s))
    steps = multiply(turns, from_rotvec(blocks.step_s[:, None] * (gain * error_s - bias_s)))
    q_ls = compose(steps, q_start)[1:]
    return multiply(q_ls, shortest_arc(up_s, rotate(conjugate(q_ls), _UP)))
