"""The normal equations of one Gauss-Newton step: a band over the knots, bordered by what all knots have in common.

    [ A   B ] [ dx ]   [ r   ]
    [ B^T C ] [ dg ] = [ r_g ],    A = sum J^T W J,  r = -sum J^T W e,

block-tridiagonal A, for a factor sees two neighbouring knots at most. Factors come as tall Jacobians whose last column
is the negative residual, all rows of an interval together: one Gram product gives every block, the right side and
the cost.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.smoothing.band import new_band
from recon.numerics.smoothing.soa import Floats
from recon.numerics.smoothing.state import COMMON_SIZE, KNOT_SIZE

ROWS_AT_ONCE: Final = 2304
"""Rows of Jacobians that are built and multiplied at once: with 40 columns 0.7 MB, which a core's cache holds."""


class Normal:
    """Sums of Gram products.

    buffer, blocks : as from band.new_band: blocks[k] is the upper block row [A_kk, A_k,k+1], (N, 18, 36)
    border : (22, N, 18), rows B^T and, last, r; corner : (22, 22), C with r_g in the last column and row
    cost : sum of squared weighted residuals
    """

    def __init__(self, knots: int) -> None:
        self.buffer, self.blocks = new_band(knots, KNOT_SIZE)
        self.border = np.zeros((COMMON_SIZE + 1, knots, KNOT_SIZE))
        self.corner = np.zeros((COMMON_SIZE + 1, COMMON_SIZE + 1))

    @property
    def cost(self) -> float:
        """Sum of squared weighted residuals of the factors added."""
        return float(self.corner[-1, -1])

    @property
    def knots(self) -> int:
        """How many there are."""
        return int(self.border.shape[1])

    def clear(self) -> None:
        """Forget all factors, keep the memory."""
        self.buffer.fill(0.0)
        self.border.fill(0.0)
        self.corner.fill(0.0)

    def add(self, scale: float, other: Normal) -> None:
        """Add another sum, multiplied."""
        self.buffer += scale * other.buffer
        self.border += scale * other.border
        self.corner += scale * other.corner

    def add_intervals(
        self,
        jacobian: Callable[[slice], Floats],
        rows: int,
        here: slice,
        there: slice,
        common: slice,
    ) -> None:
        """Add factors of both knots of each interval.

        jacobian : of a slice of intervals, (n, rows, columns): `here` of the knot before, `there` of the knot behind,
            `common`, and the negative residual
        rows : of each interval
        """
        first, second = here.stop - here.start, there.stop - there.start
        both = first + second
        border = [*range(common.start, common.stop), COMMON_SIZE]
        corner = np.ix_(border, border)
        at_once = max(1, ROWS_AT_ONCE // rows)
        for start in range(0, self.knots - 1, at_once):
            a = slice(start, min(self.knots - 1, start + at_once))
            b = slice(a.start + 1, a.stop + 1)
            tall = jacobian(a)
            gram = np.matmul(tall.swapaxes(1, 2), tall)
            self.blocks[a, here, here] += gram[:, :first, :first]
            self.blocks[a, here, KNOT_SIZE + there.start : KNOT_SIZE + there.stop] += gram[:, :first, first:both]
            self.blocks[b, there, there] += gram[:, first:both, first:both]
            across = gram[:, both:, :].transpose(1, 0, 2)
            self._add_border(border, a, here, across[..., :first])
            self._add_border(border, b, there, across[..., first:both])
            self.corner[corner] += gram[:, both:, both:].sum(axis=0)

    def _add_border(self, rows: Sequence[int], knots: slice, columns: slice, values: Floats) -> None:
        """Rows of the border are a run and the last one; two slices are faster than an index."""
        run = slice(rows[0], rows[0] + len(rows) - 1)
        self.border[run, knots, columns] += values[:-1]
        self.border[-1, knots, columns] += values[-1]

    def add_knots(
        self, columns: slice, common: slice, tall: Floats, knots: NDArray[np.intp] | slice = slice(None)
    ) -> None:
        """Add factors of single knots: tall (n, rows, columns), then `common`, then the negative residual.

        knots : the n knots, each once
        """
        own = columns.stop - columns.start
        border = [*range(common.start, common.stop), COMMON_SIZE]
        gram = np.matmul(tall.swapaxes(1, 2), tall)
        self.blocks[knots, columns, columns] += gram[:, :own, :own]
        for index, row in enumerate(border):
            self.border[row, knots, columns] += gram[:, own + index, :own]
        self.corner[np.ix_(border, border)] += gram[:, own:, own:].sum(axis=0)

    def add_pairs(self, columns: slice, common: slice, tall: Floats, k: NDArray[np.intp]) -> None:
        """Add relations of the same components of knots k and k + 1, each k once.

        tall : (n, rows, columns), those of k, those of k + 1, `common`, then the negative residual
        """
        own = columns.stop - columns.start
        both, gram = 2 * own, np.matmul(tall.swapaxes(1, 2), tall)
        self.blocks[k, columns, columns] += gram[:, :own, :own]
        self.blocks[k + 1, columns, columns] += gram[:, own:both, own:both]
        self.blocks[k, columns, KNOT_SIZE + columns.start : KNOT_SIZE + columns.stop] += gram[:, :own, own:both]
        border = [*range(common.start, common.stop), COMMON_SIZE]
        for index, row in enumerate(border):
            self.border[row, k, columns] += gram[:, both + index, :own]
            self.border[row, k + 1, columns] += gram[:, both + index, own:both]
        self.corner[np.ix_(border, border)] += gram[:, both:, both:].sum(axis=0)

    def add_walk(self, columns: slice, steps: Floats, variance: Floats, kept: Floats | float = 1.0) -> None:
        """Add x_k+1 = kept x_k + white noise, component by component.

        steps : (3, N-1), x_k+1 - kept x_k now; variance : (3, N-1); kept : (N-1,)
        """
        i = np.arange(columns.start, columns.stop)
        weight = (1.0 / np.broadcast_to(variance, steps.shape)).T
        kept = np.broadcast_to(kept, steps.shape[1])[:, None]
        self.blocks[:-1, i, i] += kept**2 * weight
        self.blocks[1:, i, i] += weight
        self.blocks[:-1, i, i + KNOT_SIZE] -= kept * weight
        self.border[-1, :-1, columns] += kept * weight * steps.T
        self.border[-1, 1:, columns] -= weight * steps.T
        self.corner[-1, -1] += float((weight * steps.T**2).sum())

    def add_values(self, knots: object, columns: slice, errors: Floats, weight: Floats) -> None:
        """Add direct observations of components of single knots: errors and weight (n, components)."""
        i = np.arange(columns.start, columns.stop)
        index = np.atleast_1d(np.asarray(knots))[:, None]
        self.blocks[index, i, i] += weight
        self.border[-1, index, i] -= weight * errors
        self.corner[-1, -1] += float((weight * errors**2).sum())

    def add_common(self, where: slice, errors: Floats, weight: Floats) -> None:
        """Add direct observations of what is common: errors (n,), weight (n,) or (n, n)."""
        weight = np.diag(weight) if weight.ndim == 1 else weight
        self.corner[where, where] += weight
        self.corner[where, -1] -= weight @ errors
        self.corner[-1, where] -= weight @ errors
        self.corner[-1, -1] += float(errors @ weight @ errors)
