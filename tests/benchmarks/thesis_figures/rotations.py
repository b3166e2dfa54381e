"""Section 2.2.4: what rotations cost as matrices and as quaternions, in operations and in time.

The quaternions are those of recon.numerics.rotation, component by component in NumPy; the matrices are made by the
formula of Rodrigues in the same way, but rotate and multiply in NumPy's own compiled loops, its fastest way.
Vectors come in blocks that fit the cache: with all at once, new memory costs several times what the operations do.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from recon.numerics.rotation import from_rotvec, multiply, rotate, to_matrix
from recon.tables import Array
from thesis_figures.style import BLUE, ORANGE, Number, legend_above_all, panels

COUNTS: Final = {"from axis-angle": (30, 6), "rotate": (15, 41), "compose": (45, 28)}
"""Operations of the thesis' table, A + M + F: matrix, quaternion."""
BLOCK, REPEATS = 4_000, 30
"""Vectors in a block; repeats, of which the shortest time counts."""
Work = Callable[[slice], object]
"""An operation on a block of the vectors."""


def times(vectors: int) -> tuple[Figure, list[Number]]:
    """Time of each operation on so many vectors beside the count of the thesis."""
    measured = _measure(vectors)
    measured["all three"] = tuple(map(sum, zip(*measured.values(), strict=True)))
    counted = {**COUNTS, "all three": tuple(map(sum, zip(*COUNTS.values(), strict=True)))}
    figure, rows = panels(2, 1, height=3.6, sharex=True)
    numbers = []
    for axes, costs, title, unit in (
        (rows[0], counted, "counted in the thesis", "operations"),
        (rows[1], measured, "measured", "ns"),
    ):
        _bars(axes, costs)
        axes.set(title=f"{title} (×: matrix over quaternion)", ylabel=f"{unit} per vector")
        for name, (matrix, quaternion) in costs.items():
            if unit == "ns":
                numbers += [Number(f"{name}, matrix", matrix, unit), Number(f"{name}, quaternion", quaternion, unit)]
            numbers.append(Number(f"{name}, matrix over quaternion, {title}", matrix / quaternion))
    legend_above_all(figure, rows[0], 2)
    return figure, numbers


def _bars(axes: Any, costs: dict[str, Any]) -> None:
    """A pair of bars for each operation, over it how many times dearer the matrix is."""
    place = np.arange(len(costs))
    pairs = np.array(list(costs.values()))
    for side, (name, color) in enumerate((("matrix", ORANGE), ("quaternion", BLUE))):
        axes.bar(place + (side - 0.5) * 0.36, pairs[:, side], 0.34, color=color, label=name)
    for x, (matrix, quaternion) in zip(place, pairs, strict=True):
        text = f"× {matrix / quaternion:.2g}"
        axes.annotate(text, (x, max(matrix, quaternion)), (0, 2), textcoords="offset points", ha="center", fontsize=7)
    axes.set_xticks(place, list(costs))
    axes.grid(visible=False, axis="x")
    axes.margins(y=0.15)


def _measure(vectors: int) -> dict[str, Any]:
    """ns per vector of each operation: matrix, quaternion."""
    rng = np.random.default_rng(0)
    axis, v = rng.normal(size=(2, vectors, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    angle = rng.uniform(-np.pi, np.pi, vectors)
    rotvec = angle[:, None] * axis
    rot, q = rodrigues(axis, angle), from_rotvec(rotvec)
    if not np.allclose(rot, to_matrix(q), atol=1e-12):
        raise AssertionError("the two representations are not of the same rotations")
    pairs: dict[str, tuple[Work, Work]] = {
        "from axis-angle": (lambda b: rodrigues(axis[b], angle[b]), lambda b: from_rotvec(rotvec[b])),
        "rotate": (lambda b: np.einsum("nij,nj->ni", rot[b], v[b]), lambda b: rotate(q[b], v[b])),
        "compose": (lambda b: rot[b] @ rot[b][::-1], lambda b: multiply(q[b], q[b][::-1])),
    }
    blocks = [slice(start, start + BLOCK) for start in range(0, vectors, BLOCK)]
    return {name: tuple(_best_ns(one, blocks) / vectors for one in pair) for name, pair in pairs.items()}


def _best_ns(work: Work, blocks: list[slice]) -> float:
    """Shortest time in ns of several for the work on all blocks."""
    found = []
    for _ in range(REPEATS):
        start = time.perf_counter_ns()
        for block in blocks:
            work(block)
        found.append(time.perf_counter_ns() - start)
    return float(min(found))


def rodrigues(axis: Array, angle: Array) -> Array:
    """Rotation matrices (n, 3, 3) with the 13 additions, 15 multiplications and 2 functions of the thesis.

    axis : (n, 3) unit; angle : (n,) rad
    """
    x, y, z = axis.T
    cos, sin = np.cos(angle), np.sin(angle)
    rest = 1.0 - cos
    rx, ry, rz, sx, sy, sz = rest * x, rest * y, rest * z, sin * x, sin * y, sin * z
    xy, xz, yz = rx * y, rx * z, ry * z
    rows = ((rx * x + cos, xy - sz, xz + sy), (xy + sz, ry * y + cos, yz - sx), (xz - sy, yz + sx, rz * z + cos))
    matrices = np.empty((len(angle), 3, 3))
    for row, entries in enumerate(rows):
        for column, entry in enumerate(entries):
            matrices[:, row, column] = entry
    return matrices
