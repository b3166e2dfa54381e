"""Heading of a levelled sensor by its magnetometer.

It is first freed of hard iron, found from how the field turns with the box. Samples whose strength or vertical part
differ from the usual are disturbed and left out; so is all of it where the usual field cannot be that of the Earth, for
on a straight road nothing else shows the iron about a phone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import pyarrow as pa

from recon import Array, Metric, matrix, time_ns, warning
from recon.numerics.heading import Complexes, field_evidence, hard_iron, horizontal
from recon.numerics.rotation import rotate
from recon.numerics.signals import interpolate
from recon_integrators._levelled import Levelled
from recon_integrators._north import North

_MAG_GAP_S: Final = 1.0
_FIELD_SIGMA: Final = 1.2
"""rad, of a second of a calibrated magnetometer in a vehicle: 0.15 rad of soft iron and rest of hard iron, which stay
the same for about a minute, as long as the heading does.
"""
_STRENGTH, _VERTICAL = 0.15, 0.2
"""Share of the usual strength by which the strength, and the vertical part, of the field may differ."""
_MISLED: Final = np.radians(25.0)
"""By which iron may turn the heading, of the field that it adds, before the magnetometer is left out."""


def field_of(
    pieces: Sequence[Levelled], mag: pa.Table, north: North, given: tuple[float, float, float] | None
) -> tuple[list[Complexes], list[Metric]]:
    """Evidence of each piece from the calibrated and undisturbed field, and what was found out about it."""
    fields = [_at_blocks(piece, mag) for piece in pieces]
    iron, sigma_t, learnt = _iron(pieces, fields, north, given)
    strength = [np.linalg.norm(field_s - iron, axis=1) for field_s in fields]
    levelled = [rotate(piece.q_ls, field_s - iron) for piece, field_s in zip(pieces, fields, strict=True)]
    all_strength, all_up = np.concatenate(strength), np.concatenate([field_l[:, 2] for field_l in levelled])
    nothing = [np.zeros(piece.seconds, dtype=np.complex128) for piece in pieces]
    if not np.isfinite(all_strength).any():
        return nothing, [warning("mag holds no field at the times of imu")]
    usual, usual_up = float(np.nanmedian(all_strength)), float(np.nanmedian(all_up))
    flat = max(np.sqrt(max(usual**2 - usual_up**2, 0.0)), 0.05 * usual)
    learnt.append(Metric("magnetic_strength", usual, "T", note="usual strength of the field, hard iron taken off"))
    refuted = _refuted(float(flat), usual_up, north)
    if refuted:
        return nothing, [*learnt, *refuted]
    sigma = float(np.hypot(_FIELD_SIGMA, sigma_t / flat))
    found, disturbed, measured_rows = [], 0, 0
    for piece, size, field_l in zip(pieces, strength, levelled, strict=True):
        known = np.isfinite(size)
        wrong = known & (
            (np.abs(size - usual) > _STRENGTH * usual) | (np.abs(field_l[:, 2] - usual_up) > _VERTICAL * usual)
        )
        disturbed, measured_rows = disturbed + int(wrong.sum()), measured_rows + int(known.sum())
        believed = np.where(known & ~wrong, horizontal(field_l), np.nan)
        found.append(field_evidence(piece.blocks.t_s, believed, north.direction, sigma, piece.seconds))
    share = disturbed / max(measured_rows, 1)
    learnt.append(_disturbance(share))
    if share > 0.3:
        learnt.append(warning(f"mag is disturbed in {100.0 * share:.0f} % of the time: its heading deserves doubt"))
    return found, learnt


def _refuted(flat: float, up: float, north: North) -> list[Metric]:
    """Said where the usual field, T level and upwards, cannot be the Earth's; empty where it can, or that is not known.

    Level and upwards do not depend on the heading, so what they are off by is iron, a unit or the wrong axes, and would
    turn the heading by about its share of the level field.
    """
    if north.strength is None or north.vertical is None:
        return []
    off = float(np.hypot(flat - north.strength, up - north.vertical))
    if off <= np.sin(_MISLED) * north.strength:
        return []
    note = (
        f"mag measures {flat * 1e6:.0f} uT level and {up * 1e6:.0f} uT upwards where the Earth has "
        f"{north.strength * 1e6:.0f} and {north.vertical * 1e6:.0f}: it is left out "
        "(iron about it that the drive does not show, or other axes or another unit than it says?)"
    )
    return [_disturbance(1.0), warning(note)]


def _disturbance(share: float) -> Metric:
    return Metric("magnetic_disturbance", 100.0 * share, "%", note="of the time, in which mag is rejected")


def _at_blocks(piece: Levelled, mag: pa.Table) -> Array:
    """The field in the sensor at the ends of the blocks: (m, 3) T, NaN where mag is silent."""
    mag_s = piece.since_start_s(time_ns(mag))
    return interpolate(piece.blocks.t_s, mag_s, matrix(mag, "mag", gaps=True), _MAG_GAP_S)


def _iron(
    pieces: Sequence[Levelled], fields: Sequence[Array], north: North, given: tuple[float, float, float] | None
) -> tuple[Array, float, list[Metric]]:
    """Hard iron (3,) T, the sigma of what is left of it horizontally, and metrics."""
    if given is not None:
        return np.array(given), 0.0, []
    longest = int(np.argmax([np.isfinite(f).all(axis=1).sum() for f in fields]))
    known = np.isfinite(fields[longest]).all(axis=1)
    if known.sum() < 3:
        return np.zeros(3), 0.0, []
    piece = pieces[longest]
    rate_hz = len(piece.blocks.t_s) / max(float(piece.blocks.t_s[-1]), 1.0)
    found = hard_iron(piece.q_ls[known], fields[longest][known], rate_hz, north.vertical)
    axes_l = np.stack([rotate(piece.q_ls[known][0], axis) for axis in np.eye(3)], axis=1)
    across = (axes_l @ found.covariance @ axes_l.T)[:2, :2]
    sigma = float(np.sqrt(np.linalg.eigvalsh(across)[-1]))
    spread = np.sqrt(np.diag(found.covariance))
    note = "field that turns with the box, found from the drive, taken off"
    learnt = [
        Metric(f"hard_iron_{axis}", float(value), "T", float(s), note=note)
        for axis, value, s in zip("xyz", found.offset_s, spread, strict=True)
    ]
    size = north.strength or float(np.median(np.linalg.norm(fields[longest][known], axis=1)))
    if sigma < 0.3 * size:
        return found.offset_s, sigma, learnt
    note = "the drive has too few bends to find the hard iron about the magnetometer: none is taken off"
    return np.zeros(3), 0.5 * size, [warning(note)]
