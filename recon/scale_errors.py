"""What scale errors of the IMU do to a trajectory between two knots that stay where they are.

With sensor axes R_ls, angular rate omega_s and specific force f_s, scale errors g of the gyroscope and a of the
accelerometer turn the attitude by d and move velocity and position by

    d' = -R_ls diag(omega_s) g,    v' = d x f_l - R_ls diag(f_s) a,    p' = v

less what such errors at both knots make inside: d in proportion to the time, position by the cubic of recon.knots. What
is even in time leaves nothing: it counts where a vehicle brakes, is hit or spins in a part of an interval.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pyarrow as pa

from recon.knots import ATTITUDE, POSITION, SIZE, VELOCITY, cubic_share
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.integration import cumulative
from recon.numerics.rotation import cross_matrix, to_matrix
from recon.tables import Array, has, matrix, meta, time_ns

COUNT: Final = 6
"""Scale errors: of the gyroscope, then of the accelerometer, along the axes of the sensor."""
_UP: Final = np.array([0.0, 0.0, STANDARD_GRAVITY])


def between_knots(trajectory: pa.Table, knots_ns: np.ndarray, t_ns: np.ndarray) -> Array:
    """Position, velocity and attitude at a time by each scale error: (n, 9, 6) m, m/s and rad, local.

    Nought where the trajectory tells no accelerations and rates, or no mounting of the sensor.

    trajectory : accel m/s^2, gyro rad/s, q, and the fact `mounting`; knots_ns : (N,) ns; t_ns : (n,) ns
    """
    t_ns = np.clip(t_ns, knots_ns[0], knots_ns[-1])
    found = np.zeros((len(t_ns), SIZE, COUNT))
    mounting = meta(trajectory).get("mounting")
    if mounting is None or not (has(trajectory, "accel") and has(trajectory, "gyro")):
        return found
    own_ns = time_ns(trajectory)
    interval = np.clip(np.searchsorted(knots_ns, t_ns, side="right") - 1, 0, len(knots_ns) - 2)
    for knot in np.unique(interval):
        first, stop = np.searchsorted(own_ns, knots_ns[knot : knot + 2], side="right") - [1, 0]
        rows = trajectory.slice(max(first, 0), stop + 1 - max(first, 0))
        here = interval == knot
        found[here] = _inside(rows, mounting, knots_ns[knot : knot + 2], t_ns[here])
    return found


def _inside(rows: pa.Table, mounting: Any, ends_ns: np.ndarray, t_ns: np.ndarray) -> Array:
    """As `between_knots` of one interval: (n, 9, 6). rows : those inside, and one to either side."""
    grid_ns = np.unique(np.concatenate([ends_ns, t_ns, time_ns(rows)]))
    grid_ns = grid_ns[(ends_ns[0] <= grid_ns) & (grid_ns <= ends_ns[1])]
    step_s = (grid_ns - ends_ns[0]) * 1e-9
    turned, pushed, force = (_at(grid_ns, rows, values) for values in _rates(rows, mounting))
    length_s = step_s[-1:]
    turn = -_integral(step_s, turned)
    speed = -_integral(step_s, np.concatenate([cross_matrix(force) @ turn, pushed], axis=2))
    moved = np.stack([_integral(step_s, speed), speed], axis=1)
    moved -= np.einsum("nij,jkl->nikl", cubic_share(step_s, np.full_like(step_s, length_s)), moved[-1])
    whole = np.zeros((len(step_s), SIZE, COUNT))
    whole[:, POSITION], whole[:, VELOCITY] = moved[:, 0], moved[:, 1]
    whole[:, ATTITUDE, :3] = turn - (step_s / length_s)[:, None, None] * turn[-1]
    return np.asarray(whole[np.searchsorted(grid_ns, t_ns)])


def _rates(rows: pa.Table, mounting: Any) -> tuple[Array, Array, Array]:
    """R_ls diag(omega_s) (m, 3, 3), R_ls diag(f_s) (m, 3, 3) and f_l (m, 3)."""
    rot_lv = to_matrix(matrix(rows, "q", gaps=True))
    rot_ls = rot_lv @ to_matrix(np.asarray(mounting))
    rate = np.einsum("nij,nj->ni", rot_lv, matrix(rows, "gyro", gaps=True))
    force = np.einsum("nij,nj->ni", rot_lv, matrix(rows, "accel", gaps=True)) + _UP
    turned, pushed = (rot_ls * np.einsum("nji,nj->ni", rot_ls, value)[:, None] for value in (rate, force))
    return turned, pushed, force


def _at(grid_ns: np.ndarray, rows: pa.Table, values: Array) -> Array:
    """Values (m, ...) of the rows, linear at other times; nought where they are not known."""
    since_ns = time_ns(rows)[0]
    known_s, grid_s = (time_ns(rows) - since_ns) * 1e-9, (grid_ns - since_ns) * 1e-9
    columns = np.nan_to_num(values).reshape(len(values), -1).T
    return np.stack([np.interp(grid_s, known_s, column) for column in columns], axis=1).reshape(-1, *values.shape[1:])


def _integral(step_s: Array, values: Array) -> Array:
    """From the first time to each: as values (m, ...)."""
    return cumulative(step_s, values, "trapezoid")
