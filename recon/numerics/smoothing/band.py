"""Solution and covariances of a block-tridiagonal system with a border, as a chain of knots with globals makes it.

    [ A   B ] [ x ]   [ r ]                      A = L L^T,  W = A^-1 B,  S = C - B^T W
    [ B^T C ] [ y ] = [ s ],

    cov(y) = S^-1,   cov(x, y) = -W S^-1,   cov(x) = A^-1 + W S^-1 W^T

A has N knots of b unknowns; neighbours are coupled, and all with the g globals y. It is factored as a band, in place.
LAPACK stores element (i, j) of a lower band with kd = 2b subdiagonals at j (kd + 1) + i - j = 2b j + i, so a block row
[A_kk, A_k,k+1] is a plain array (b, 2b) of that memory, and nothing has to be packed. The blocks of the inverse follow
from the factor backwards,

    A^-1_kk = (L_kk L_kk^T)^-1 + G_k A^-1_k+1,k+1 G_k^T,    G_k = -L_kk^-T L_k+1,k^T,
    A^-1_kj = G_k A^-1_k+1,j  (k < j),

which is the covariance recursion of the Rauch-Tung-Striebel smoother.

Only banded LAPACK and stacked products are called: small LAPACK calls in a loop wait for the threads of the BLAS.

References
    Golub, Van Loan (2013), "Matrix Computations", 4th ed., section 4.3: band Cholesky.
    Takahashi, Fagan, Chin (1973), "Formation of a sparse bus impedance matrix and its application to short circuit
    study", 8th PICA conference: the recursion for elements of the inverse.
    Bierman (1977), "Factorization Methods for Discrete Sequential Estimation": globals as a border.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpbtrf, dtbtrs

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Factor:
    """Cholesky factor L of A.

    blocks : (N, b, 2b), [L_kk^T, L_k+1,k^T] of each knot; what stands below the diagonal of L_kk^T is zero
    band : (2b + 1, N b), the same memory as LAPACK sees it
    """

    blocks: Floats
    band: Floats

    @property
    def log_determinant(self) -> float:
        """log det A."""
        return float(2.0 * np.log(self.band[0]).sum())


@dataclass(frozen=True)
class Solution:
    """Solution of the bordered system; N knots of b unknowns, g globals.

    step : (N, b) x; step_global : (g,) y
    covariance_global : (g, g) S^-1
    reduced : (N b, g) L^-1 B, in the memory of a border that came in Fortran order
    log_determinant : of the whole matrix, log det A + log det S
    """

    step: Floats
    step_global: Floats
    covariance_global: Floats
    reduced: Floats
    log_determinant: float


@dataclass(frozen=True)
class Inverse:
    """The parts of the inverse from which every covariance follows.

    conditional : (N, b, b) A^-1_kk, the covariance of each knot if the globals were known
    gains : (N-1, b, b) G_k
    sensitivity : (N, b, g) W, by how much a global moves a knot
    covariance_global : (g, g) S^-1
    """

    conditional: Floats
    gains: Floats
    sensitivity: Floats
    covariance_global: Floats


def new_band(knots: int, size: int) -> tuple[Floats, Floats]:
    """Memory for A, all zero.

    knots : N; size : b unknowns of each
    returns : buffer (N b (2b + 1),) and a view of it, blocks (N, b, 2b). blocks[k] is the upper block row
        [A_kk, A_k,k+1] and may be written and added to by slices; below the diagonal of A_kk anything may stand,
        A_k,k+1 of the last knot must stay zero
    """
    buffer = np.zeros(knots * size * (2 * size + 1))
    return buffer, _blocks(buffer, knots, size)


def _blocks(buffer: Floats, knots: int, size: int) -> Floats:
    item = buffer.itemsize
    strides = (size * (2 * size + 1) * item, 2 * size * item, item)
    return np.ndarray((knots, size, 2 * size), np.float64, buffer, 0, strides)


def factor(buffer: Floats, knots: int, size: int) -> Factor:
    """Cholesky factor of A, written over the buffer.

    buffer : (N b (2b + 1),) from new_band
    raises : numpy.linalg.LinAlgError if A is not positive definite or not finite
    """
    blocks = _blocks(buffer, knots, size)
    blocks[:, :, :size] *= np.triu(np.ones((size, size)))
    band, info = dpbtrf(buffer.reshape(knots * size, 2 * size + 1).T, lower=1, overwrite_ab=1)
    if info or not np.isfinite(band[0]).all():  # LAPACK may let NaN pass
        row = info - 1 if info else int(np.isfinite(band[0]).argmin())
        raise np.linalg.LinAlgError(f"not positive definite at unknown {row % size} of knot {row // size}")
    return Factor(blocks, band)


def solve_bordered(factor: Factor, border: Floats, corner: Floats) -> Solution:
    """Solve with the border eliminated last: one pass forward over all columns, one backward over the solution.

    border : (N b, g + 1), [B, r]; in Fortran order it is not copied, and written over
    corner : (g + 1, g + 1), [[C, s], [s^T, any]]
    raises : numpy.linalg.LinAlgError if the whole matrix is not positive definite
    """
    knots, size = factor.blocks.shape[:2]
    count = len(corner) - 1
    reduced = _forward(factor, border)
    schur = corner - reduced.T @ reduced
    lower = np.linalg.cholesky(schur[:count, :count])
    root = np.linalg.inv(lower)
    covariance = root.T @ root
    step_global = covariance @ schur[:count, count]
    step = _backward(factor, reduced[:, count:] - reduced[:, :count] @ step_global[:, None])
    return Solution(
        step=step.reshape(knots, size),
        step_global=step_global,
        covariance_global=covariance,
        reduced=reduced[:, :count],
        log_determinant=factor.log_determinant + float(2.0 * np.log(np.diag(lower)).sum()),
    )


def _forward(factor: Factor, right: Floats) -> Floats:
    """L^-1 of the right sides (N b, m)."""
    return np.asarray(dtbtrs(factor.band, right, uplo="L", overwrite_b=1)[0])


def _backward(factor: Factor, right: Floats) -> Floats:
    """L^-T of the right sides (N b, m)."""
    return np.asarray(dtbtrs(factor.band, right, uplo="L", trans="T", overwrite_b=1)[0])


def selected_inverse(factor: Factor, solution: Solution) -> Inverse:
    """The parts of the inverse of the bordered matrix that covariances need, in one sweep from the last knot."""
    knots, size = factor.blocks.shape[:2]
    root = _inverse_upper(factor.blocks[:, :, :size])
    conditional = root @ root.swapaxes(1, 2)
    gains = -(root[:-1] @ factor.blocks[:-1, :, size:])
    sensitivity = root @ solution.reduced.reshape(knots, size, -1)
    transposed = gains.swapaxes(1, 2).copy()
    for k in range(knots - 2, -1, -1):
        conditional[k] += gains[k] @ conditional[k + 1] @ transposed[k]
        sensitivity[k] += gains[k] @ sensitivity[k + 1]
    return Inverse(conditional, gains, sensitivity, solution.covariance_global)


def _inverse_upper(u: Floats) -> Floats:
    """Inverse of upper triangular matrices (N, b, b), by halves: [[P, Q], [0, R]] -> [[P', -P' Q R'], [0, R']]."""
    size = u.shape[1]
    if size == 1:
        return np.asarray(1.0 / u)
    half = size // 2
    inverse = np.zeros(u.shape)
    inverse[:, :half, :half] = first = _inverse_upper(u[:, :half, :half])
    inverse[:, half:, half:] = second = _inverse_upper(u[:, half:, half:])
    inverse[:, :half, half:] = -(first @ u[:, :half, half:] @ second)
    return inverse


def marginals(inverse: Inverse, knots: NDArray[np.intp] | slice = slice(None)) -> Floats:
    """Covariance of every knot, or of some, (N, b, b)."""
    sensitivity = inverse.sensitivity[knots]
    moved = sensitivity @ inverse.covariance_global
    return np.asarray(inverse.conditional[knots] + moved @ sensitivity.swapaxes(1, 2))


def cross_covariances(inverse: Inverse) -> Floats:
    """cov(x_k, x_k+1) of neighbours, (N-1, b, b)."""
    moved = inverse.sensitivity[:-1] @ inverse.covariance_global
    chained = inverse.gains @ inverse.conditional[1:]
    return np.asarray(chained + moved @ inverse.sensitivity[1:].swapaxes(1, 2))


def global_covariances(inverse: Inverse) -> Floats:
    """cov(x_k, y) of every knot with the globals, (N, b, g)."""
    return np.asarray(-(inverse.sensitivity @ inverse.covariance_global))


def covariance_between(inverse: Inverse, i: int, j: int) -> Floats:
    """cov(x_i, x_j) of any two knots, (b, b): the gains from i to j, and what both share with the globals.

    cov(x_i, x_j) = G_i G_i+1 ... G_j-1 A^-1_jj + W_i S^-1 W_j^T,  i <= j
    """
    if i > j:
        return covariance_between(inverse, j, i).T
    chained = inverse.conditional[j]
    for k in range(j - 1, i - 1, -1):
        chained = inverse.gains[k] @ chained
    return np.asarray(chained + inverse.sensitivity[i] @ inverse.covariance_global @ inverse.sensitivity[j].T)
