"""Moves a dead-reckoned trajectory to where GNSS says that it is.

The offset between the two is known at each fix; between fixes it is interpolated, before the first and after the last
it is held. With f the part of the way from one fix to the next,

    pos = pos_reckoned + (1 - f) offset_k + f offset_(k+1),    sigma^2 = (1 - f)^2 sigma_k^2 + f^2 sigma_(k+1)^2

which takes the errors of two fixes to be independent, and the reckoning to be exact between them.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pyarrow as pa

from recon import (
    GNSS,
    SAME,
    TRAJECTORY,
    Array,
    Fuser,
    Params,
    Streams,
    has,
    hookimpl,
    matrix,
    quantity,
    replace,
    seconds,
    time_ns,
)
from recon.errors import NotEnoughData


class FollowParams(Params):
    """Parameters of fuser.$name."""

    sigma: float = quantity(5.0, "m", gt=0, doc="Sigma of a position, each axis, where the receiver tells none.")


def follow(*, trajectory: pa.Table, gnss: pa.Table, params: FollowParams) -> Streams:
    """The trajectory with new positions and their sigmas.

    trajectory : pos m, local; gnss : pos m, local, pos_std m where there is one
    raises : NotEnoughData without a row of each, DataError on missing values
    """
    if not trajectory.num_rows or not gnss.num_rows:
        raise NotEnoughData("trajectory and fixes", needed="a row of each", found="none")
    t_s = seconds(trajectory)
    t_fix = seconds(gnss, since=int(time_ns(trajectory)[0]))
    pos, fix = matrix(trajectory, "pos"), matrix(gnss, "pos")
    sigma = matrix(gnss, "pos_std") if has(gnss, "pos_std") else np.full_like(fix, params.sigma)
    left, f = _between(t_s, t_fix)
    right = np.minimum(left + 1, len(t_fix) - 1)
    offset = fix - np.column_stack([np.interp(t_fix, t_s, pos[:, axis]) for axis in range(3)])
    moved = pos + (1.0 - f) * offset[left] + f * offset[right]
    return {"trajectory": replace(trajectory, pos=moved, pos_std=np.hypot((1.0 - f) * sigma[left], f * sigma[right]))}


def _between(t_s: Array, t_fix: Array) -> tuple[Array, Array]:
    """The fix before each time, (n,), and the part of the way to the next, (n, 1) from 0 to 1."""
    position = np.interp(t_s, t_fix, np.arange(float(len(t_fix))))
    left = np.floor(position).astype(np.intp)
    return left, (position - left)[:, None]


@hookimpl
def declare_fusers() -> Iterable[Fuser]:
    """fuser.$name."""
    yield Fuser(
        name="$name",
        summary="Moves a trajectory to where GNSS says that it is.",
        params=FollowParams,
        run=follow,
        reads={"trajectory": TRAJECTORY.need("pos"), "gnss": GNSS.need("pos", maybe=["pos_std"])},
        writes={"trajectory": SAME},
        budget=1.5,
    )
