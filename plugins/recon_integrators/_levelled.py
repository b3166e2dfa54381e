"""A record that a filter has levelled, and what GNSS shows of the vehicle's acceleration in it."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon import Array
from recon.numerics.attitude import Blocks
from recon.numerics.rotation import conjugate, multiply, rotate
from recon_integrators._north import Velocities

_FIX_GAP_S: Final = 2.5


class Levelled(NamedTuple):
    """A piece of the record: time of its first row, its blocks, attitude (m, 4) in its level frame at their ends."""

    start_ns: int
    blocks: Blocks
    q_ls: Array

    @property
    def seconds(self) -> int:
        """Seconds that hold all of it."""
        return int(np.floor(self.blocks.t_s[-1])) + 1

    @property
    def q_lg(self) -> Array:
        """Takes the drifting frame of the blocks to the level one at their ends: (m, 4)."""
        return multiply(self.q_ls, conjugate(self.blocks.q_gs))

    def since_start_s(self, t_ns: NDArray[np.int64]) -> Array:
        """Times after the first row of the piece: (n,) s."""
        return np.asarray((t_ns - self.start_ns) * 1e-9, dtype=np.float64)


def acceleration_g(piece: Levelled, turn: Array, t_s: Array, velocities: Velocities) -> Array:
    """Horizontal acceleration of the vehicle that GNSS shows at times of a piece: (k, 3) m/s^2, drifting frame; else 0.

    Without it a levelled sensor leans in every bend and whenever the vehicle brakes.

    turn : (m,) rad, of the level frame against East-North-Up at the ends of the blocks; t_s : (k,) s
    """
    fix_s, vel = piece.since_start_s(velocities.t_ns), velocities.vel_n
    if len(fix_s) < 2:
        return np.zeros((len(t_s), 3))
    span = np.diff(fix_s)
    mean = np.where(span <= _FIX_GAP_S, np.diff(vel) / span, 0.0)
    left = np.searchsorted(fix_s, t_s) - 1
    inside = (left >= 0) & (left < len(mean))
    acc_n = np.where(inside, mean[np.clip(left, 0, len(mean) - 1)], 0.0)
    acc_l = acc_n * np.exp(-1j * np.interp(t_s, piece.blocks.t_s, turn))
    block = np.minimum(np.searchsorted(piece.blocks.t_s, t_s), len(turn) - 1)
    return rotate(conjugate(piece.q_lg)[block], np.column_stack([acc_l.real, acc_l.imag, np.zeros(len(t_s))]))
