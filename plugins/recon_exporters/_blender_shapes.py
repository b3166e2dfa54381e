"""What stands still in the film of a drive: path, ground, tube of doubt, GNSS fixes. All in m about the origin.

    path_position   (p, 3) the way, a point each `spacing` m, from keys of the vehicle
    path_row        (p,) the key that each point is
    path_drawn      (p,) bool, is the piece from this point to the next drawn? In an outage only every other dash is
    strip           (s, 2, 3) right and left edge of a strip of ground below the path, which goes on at its ends
    tube            (p, 12, 3) ellipses across the path; half axes: std to the side and up. Where a std is known
    ground_x, ground_y, ground_z   (a,), (b,), (a, b) a smooth ground through the path's heights, flat far away
    fixes           (m, 3) GNSS fixes at the height of the path: what they say themselves of height is weak

The ground is the mean of the heights of the path, weighted with 1 / (distance^2 + 1 m^2)^2 (Shepard 1968), but nowhere
above the strip. It serves the eye only: no log knows the land.

References
    Shepard (1968), "A two-dimensional interpolation function for irregularly-spaced data".
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.numerics.geodesy import Anchor
from recon.placing import about_anchor
from recon.tables import Array, time_ns

Arrays = dict[str, NDArray[Any]]

SPACING: Final = 0.5
"""m between points of a path; more where it would have more than POINTS."""
POINTS: Final = 20_000
DASH: Final = 4
"""Points of a dash, and of the space after it."""
STRIP: Final = 3.5
"""m to each side."""
RUN_OUT: Final = 40.0
"""m by which the strip goes on where the path ends."""
CORNERS: Final = 12
"""Of the ellipses of a tube."""
BELOW: Final = 0.25
"""m by which the ground lies lower than the strip, at least."""
_GRID: Final = 128
"""Lines of the ground across the path, in each direction, at the most; they are 1 m apart at least."""
_ACROSS: Final = 15
"""Points across the strip, SPACING apart, that the ground lies under."""
_FAR: Final = np.array([30.0, 80.0, 200.0, 600.0, 2000.0, 6000.0])
"""m beyond the path where the ground has further lines."""
_SUPPORT: Final = 400
"""Points of the path, at the most, whose heights the ground is the mean of."""


def path_of(position: Array, heading: Array, std: Array, lost: NDArray[np.bool_]) -> Arrays:
    """The path with its strip and, where a std is known and not zero, its tube.

    position : (n, 3) m; heading : (n,) rad from east to the left; lost : (n,) in an outage?
    std : (n, 3) m to the east, to the north and up
    """
    way = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))))
    spacing = max(SPACING, way[-1] / POINTS)
    number = np.floor(way / spacing)
    row = np.flatnonzero(np.concatenate(([True], np.diff(number) > 0)))
    point = position[row]
    side = _sides(point)
    found: Arrays = {
        "path_position": point,
        "path_row": row,
        "path_drawn": ~lost[row] | (number[row] % (2 * DASH) < DASH),
        "strip": _strip(point, side, heading[row]),
    }
    wide = np.sqrt((side**2 * std[row] ** 2).sum(axis=1))
    if np.isfinite(std[row]).all() and wide.any():
        angle = np.arange(CORNERS) * (2.0 * np.pi / CORNERS)
        up = np.array([0.0, 0.0, 1.0])
        across = np.cos(angle)[:, None] * (wide[:, None] * side)[:, None, :]
        upwards = np.sin(angle)[:, None] * (std[row, 2, None] * up)[:, None, :]
        found["tube"] = point[:, None, :] + across + upwards
    return found


def _strip(point: Array, side: Array, heading: Array) -> Array:
    """(s, 2, 3) edges along the path, and RUN_OUT before and after it as the vehicle points there."""
    ahead = np.column_stack((np.cos(heading), np.sin(heading), np.zeros(len(heading))))
    further = np.arange(SPACING, RUN_OUT + SPACING, SPACING)[:, None]
    middle = np.concatenate((point[:1] - further[::-1] * ahead[:1], point, point[-1:] + further * ahead[-1:]))
    side = np.concatenate((np.repeat(side[:1], len(further), 0), side, np.repeat(side[-1:], len(further), 0)))
    return np.asarray(middle[:, None, :] + STRIP * np.array([-1.0, 1.0])[:, None] * side[:, None, :])


def _sides(point: Array) -> Array:
    """(p, 3) level unit vectors across the path, to its left at the start; they never jump to the other side."""
    if len(point) < 2:
        return np.tile([0.0, 1.0, 0.0], (len(point), 1))
    along = np.gradient(point[:, :2], axis=0)
    length = np.linalg.norm(along, axis=1, keepdims=True)
    along = np.divide(along, length, out=np.tile([1.0, 0.0], (len(point), 1)), where=length > 1e-9)
    turns = np.where((along[1:] * along[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    sign = np.concatenate(([1.0], np.cumprod(turns)))
    return np.column_stack((-along[:, 1] * sign, along[:, 0] * sign, np.zeros(len(point))))


def ground_of(point: Array, strip: Array) -> Arrays:
    """The ground around a path of points (p, 3) m and under its strip (s, 2, 3) m."""
    support = point[:: len(point) // _SUPPORT + 1]
    lines = [_lines(point[:, axis]) for axis in (0, 1)]
    x, y = np.meshgrid(*lines, indexing="ij")
    distance2 = (x[..., None] - support[:, 0]) ** 2 + (y[..., None] - support[:, 1]) ** 2
    weight = 1.0 / (distance2 + 1.0) ** 2
    z = (weight @ support[:, 2]) / weight.sum(axis=-1) - BELOW
    share = np.linspace(0.0, 1.0, _ACROSS)[:, None, None]
    above = (strip[:, 0] + share * (strip[:, 1] - strip[:, 0])).reshape(-1, 3)
    i, j = (np.searchsorted(line, above[:, axis], side="right") for axis, line in enumerate(lines))
    for corner in ((i, j), (i - 1, j), (i, j - 1), (i - 1, j - 1)):  # of the square of the ground under each point
        np.minimum.at(z, corner, above[:, 2] - BELOW)
    return {"ground_x": lines[0], "ground_y": lines[1], "ground_z": z}


def _lines(values: Array) -> Array:
    low, high = float(values.min()) - 10.0, float(values.max()) + 10.0
    across = np.linspace(low, high, min(_GRID, int(high - low)))
    return np.concatenate((low - _FAR[::-1], across, high + _FAR))


def fixes_of(
    gnss: pa.Table | None,
    shows: Callable[[NDArray[np.int64]], NDArray[np.bool_]],
    t_ns: NDArray[np.int64],
    position: Array,
    origin: Array,
    anchor: Anchor | None,
    datum: str,
) -> Arrays:
    """GNSS fixes that the film shows, at the height of the path: (m, 3); empty where none has a place.

    t_ns, position : (n,), (n, 3) the path; origin : (3,) m about the anchor, whose height is above the datum
    """
    if gnss is None:
        return {"fixes": np.zeros((0, 3))}
    place = about_anchor(gnss, anchor, datum) - origin
    told = time_ns(gnss)
    known = np.isfinite(place[:, :2]).all(axis=1) & shows(told)
    height = np.interp(told[known] - t_ns[0], t_ns - t_ns[0], position[:, 2])
    return {"fixes": np.column_stack((place[known, :2], height))}
