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

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from recon.numerics.rotation import (
    Floats,
    conjugate,
    from_rotvec,
    multiply,
    normalize,
    rotate,
    shortest_arc,
    to_matrix,
    to_rotvec,
)
from recon.numerics.rotation_series import compose, sign_continuous
from recon.numerics.smoothing.soa import cross, quat_exp, quat_multiply, running_product

_UP = np.array([0.0, 0.0, 1.0])
_FIRST_S = 2.0
"""Of the record, whose mean specific force shows where up is at its start."""
_LEARN_S = 2.0
"""Blocks of the round that learns the bias."""
_LOT = 2**15
"""Rows that are worked on at a time: what belongs to them stays in the cache."""


class Blocks(NamedTuple):
    """A record of inertial sensors in blocks of rows.

    t_s : (m,) s since the first row, time at the end of each block
    q_gs : (m, 4) attitude of the sensor then in the drifting frame, which is that of the sensor at the first row
    force_g : (m, 3) m/s^2, mean specific force of each block, drifting frame
    """

    t_s: Floats
    q_gs: Floats
    force_g: Floats

    @property
    def step_s(self) -> Floats:
        """Time from the end of the block before, of the first from its first row: (m,) s."""
        return np.diff(self.t_s, prepend=0.0)

    @property
    def turns(self) -> Floats:
        """By how much the sensor turns from the end of the block before, as it sees it: (m, 3) rad."""
        return to_rotvec(multiply(conjugate(self.q_before), self.q_gs))

    @property
    def q_before(self) -> Floats:
        """Attitude of the sensor at the end of the block before, drifting frame: (m, 4)."""
        return np.concatenate(([[1.0, 0.0, 0.0, 0.0]], self.q_gs[:-1]))

    @property
    def force_s(self) -> Floats:
        """Mean specific force of each block in the axes that the sensor has at its end: (m, 3) m/s^2."""
        return rotate(conjugate(self.q_gs), self.force_g)

    def merged(self, times: int) -> Blocks:
        """The same in blocks of so many times the rows."""
        starts = np.arange(0, len(self.t_s), times)
        ends = np.append(starts[1:], len(self.t_s)) - 1
        mean_g = np.add.reduceat(self.force_g, starts, axis=0) / (ends + 1 - starts)[:, None]
        return Blocks(self.t_s[ends], self.q_gs[ends], mean_g)

    def lasting(self, seconds: float) -> Blocks:
        """The same in blocks of about so many seconds."""
        usual = float(np.median(self.step_s))
        return self.merged(max(1, round(seconds / usual)) if usual > 0.0 else 1)


class Rows(NamedTuple):
    """The rows of a record within its blocks.

    q_es : (4, size, m) attitude of the sensor at each row of each block in the axes that it had at the end of the block
        before; where the last block is not full, the last row again
    rows : n, of the record
    """

    q_es: Floats
    rows: int

    def attitude(self, blocks: Blocks, q_ls: Floats) -> Floats:
        """Attitude at every row from that at the end of each block: (4, n) from (m, 4)."""
        size, many = self.q_es.shape[1:]
        correction = sign_continuous(multiply(q_ls, conjugate(blocks.q_gs)))
        before = np.concatenate((correction[:1], correction[:-1]))
        # (c_0 + f (c_1 - c_0)) (x) q is linear in f as well
        first = np.ascontiguousarray(multiply(before, blocks.q_before).T)
        change = np.ascontiguousarray(multiply(correction - before, blocks.q_before).T)
        fraction = np.arange(1, size + 1)[:, None] / size
        result = np.empty((4, many, size))
        for part in _parts(many, size):
            start = first[:, None, part] + fraction * change[:, None, part]
            q_part = quat_multiply(start, self.q_es[..., part])
            q_part /= np.sqrt(np.einsum("ijk,ijk->jk", q_part, q_part))
            result[:, part] = q_part.swapaxes(1, 2)
        return result.reshape(4, -1)[:, : self.rows]


def blocks_of(t_s: Floats, gyro_s: Floats, accel_s: Floats, rate_hz: float) -> tuple[Blocks, Rows]:
    """A record in blocks of as many rows as come nearest to `rate_hz` blocks a second, at least one.

    t_s : (n,) s since the first row, strictly increasing, n >= 1
    gyro_s : (3, n) rad/s, accel_s : (3, n) m/s^2 specific force, sensor
    """
    count = len(t_s)
    step_s = float(np.median(np.diff(t_s))) if count > 1 else 1.0 / rate_hz
    size = max(1, round(1.0 / (rate_hz * step_s)))
    many = -(-count // size)
    q_es, force_e = np.empty((4, size, many)), np.empty((3, many))
    for part in _parts(many, size):
        rows = slice(part.start * size, min(part.stop * size, count))
        q_es[..., part] = _within(_turns(t_s, gyro_s, rows), size)
        force = _folded(accel_s[:, rows], size)
        force_e[:, part] = _rotated(q_es[..., part], force).sum(axis=1)
    ends = np.minimum(np.arange(1, many + 1) * size, count) - 1
    q_gs = np.ascontiguousarray(running_product(q_es[:, -1]).T)
    blocks = Blocks(t_s[ends], q_gs, (force_e / np.diff(ends, prepend=-1)).T)
    return blocks._replace(force_g=rotate(blocks.q_before, blocks.force_g)), Rows(q_es, count)


def _parts(many: int, size: int) -> Iterator[slice]:
    """So many blocks of this size in lots that a processor's cache holds."""
    lot = max(1, _LOT // size)
    return (slice(start, min(start + lot, many)) for start in range(0, many, lot))


def _turns(t_s: Floats, gyro_s: Floats, rows: slice) -> Floats:
    """By how much the sensor turns from row to row: (3, r) rad, nothing at the first row of all. Bortz 1971."""
    turns = np.zeros((3, rows.stop - rows.start))
    known = slice(max(rows.start - 1, 0), rows.stop)
    step, rate = np.diff(t_s[known]), gyro_s[:, known]
    found = 0.5 * step * (rate[:, 1:] + rate[:, :-1]) + step**2 / 12.0 * cross(rate[:, :-1], rate[:, 1:])
    turns[:, turns.shape[1] - found.shape[1] :] = found
    return turns


def _folded(values: Floats, size: int) -> Floats:
    """Rows beside each other by their place in a block: (k, size, m) of (k, n), zero where the last is not full."""
    short = -values.shape[1] % size
    if short:
        values = np.pad(values, ((0, 0), (0, short)))
    return np.ascontiguousarray(values.reshape(len(values), -1, size).swapaxes(1, 2))


def _within(turns: Floats, size: int) -> Floats:
    """Turns from row to row (3, r) summed within blocks: (4, size, m)."""
    return running_product(quat_exp(_folded(turns, size)))


def _rotated(q: Floats, v: Floats) -> Floats:
    """Vectors taken by q: (3, ...) of (4, ...) and (3, ...)."""
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

    The record is gone through twice: what a first round, in blocks of some seconds, learnt of the bias the second one
    begins with.

    gain : k_p, 1/s;  bias_gain : k_i, 1/s^2
    returns : q_ls (m, 4) at the end of each block; bias (m, 3) rad/s, sensor
    """
    learnt = _carried(blocks.lasting(_LEARN_S), gain, bias_gain, np.zeros(3))[-1, 3:]
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
