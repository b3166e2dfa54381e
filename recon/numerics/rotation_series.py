"""Rotations that follow each other in time: signs without jumps, interpolation, composition of body increments.

Unit quaternions, scalar first, as in `recon.numerics.rotation`.

References
    Thesis, section 5.1 (composition of body increments).
    Shoemake (1985), "Animating rotation with quaternion curves", SIGGRAPH 85, 245-254.
    Blelloch (1990), "Prefix sums and their applications", CMU-CS-90-190, section 1.2 (blocked scan).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon.numerics.rotation import Floats, conjugate, from_rotvec, multiply, normalize, to_rotvec
from recon.numerics.signals import bracket

Complexes = NDArray[np.complex128]


def sign_continuous(q: ArrayLike) -> Floats:
    """The same rotations with signs such that neighbours lie on one half of the sphere; the first keeps its sign.

    q : (n, 4)
    returns : (n, 4)
    """
    q = np.asarray(q, dtype=np.float64)
    flips = np.where(np.einsum("ni,ni->n", q[1:], q[:-1]) < 0.0, -1.0, 1.0)[:, None]
    return np.concatenate((q[:1], q[1:] * np.cumprod(flips, axis=0)))


def slerp(t_new: ArrayLike, t: ArrayLike, q: ArrayLike, max_gap: float | None = None) -> Floats:
    """Attitude at other times: constant body rate between samples, along the shorter way. Shoemake 1985.

    As `interpolate`, it invents nothing: rows with a NaN are skipped, and it is NaN inside gaps longer than max_gap.

    t_new : (m,) s or int64 ns
    t : (n,) in the same unit and type, strictly increasing
    q : (n, 4) unit
    max_gap : in the unit of t
    returns : (m, 4) without jumps of sign, NaN outside the span of what is known
    raises : TypeError if the times are of two types, ValueError if no row is known
    """
    samples, q = np.asarray(t), np.asarray(q, dtype=np.float64)
    known = np.isfinite(q).all(axis=1)
    samples, q = samples[known], sign_continuous(q[known])
    left, right, fraction = bracket(t_new, samples)
    if max_gap is not None:
        far = np.asarray(samples[right] - samples[left]) > max_gap
        fraction[(fraction > 0.0) & (fraction < 1.0) & far] = np.nan
    out = q[np.where(fraction < 1.0, left, right)]
    out[np.isnan(fraction)] = np.nan
    between = np.flatnonzero((fraction > 0.0) & (fraction < 1.0))
    first, turn = q[left[between]], to_rotvec(multiply(conjugate(q[left[between]]), q[right[between]]))
    out[between] = multiply(first, from_rotvec(fraction[between, None] * turn))
    return np.asarray(out)


def compose(dq: ArrayLike, q0: ArrayLike) -> Floats:
    """Attitudes from body increments: q_k+1 = q_k (x) dq_k, thesis 5.1.

    A blocked scan (Blelloch 1990): some sqrt(n) blocks side by side, first their products, then the attitude at the
    start of each, then all attitudes.

    dq : (n, 4)
    q0 : (4,)
    returns : (n+1, 4) unit, beginning with q0
    """
    dq, q0 = np.asarray(dq, dtype=np.float64), np.asarray(q0, dtype=np.float64)
    n = len(dq)
    blocks = max(1, int(2.0 * np.sqrt(n)))
    length = -(-n // blocks)
    padded = np.tile((1.0, 0.0, 0.0, 0.0), (blocks * length, 1))
    padded[:n] = dq
    steps = np.ascontiguousarray(_as_pairs(padded).reshape(blocks, length, 2).transpose(1, 2, 0))
    identity = np.repeat([[1.0 + 0.0j], [0.0j]], blocks, axis=1)
    products = _scan(identity, steps)[-1]
    starts = _scan(_as_pairs(q0)[:, None], products.T[:, :, None])[:-1, :, 0].T
    pairs = np.ascontiguousarray(_scan(starts, steps)[1:].transpose(2, 0, 1))
    return normalize(np.concatenate((q0[None], pairs.view(np.float64).reshape(-1, 4)[:n])))


def _scan(start: Complexes, steps: Complexes) -> Complexes:
    """Running products start (x) steps_0 (x) steps_1 ... of m independent chains.

    A quaternion is a pair of complex numbers, q = (w + x i) + (y + z i) j, and j u = u* j, hence
        (u + v j) (x) (a + b j) = (u a - v b*) + (u b + v a*) j:
    four products of contiguous rows instead of sixteen.

    start : (2, m);  steps : (k, 2, m);  returns : (k+1, 2, m), beginning with start
    """
    result = np.empty((len(steps) + 1, *start.shape), dtype=np.complex128)
    result[0] = start
    for (u, v), (a, b), (next_u, next_v) in zip(result[:-1], steps, result[1:], strict=True):
        np.subtract(u * a, v * b.conj(), out=next_u)
        np.add(u * b, v * a.conj(), out=next_v)
    return result


def _as_pairs(q: Floats) -> Complexes:
    """(..., 4) quaternions as (..., 2) complex numbers w + x i and y + z i."""
    return np.ascontiguousarray(q).view(np.complex128)
