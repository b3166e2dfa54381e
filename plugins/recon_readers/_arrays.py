"""Arrays of numbers to streams: times in order, values that can be, references in local metres.

For formats that keep each sensor as arrays, with no text and no lines.
"""

from __future__ import annotations

from collections.abc import MutableMapping
from dataclasses import asdict
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike

from recon.numerics.geodesy import Anchor, geodetic_to_enu
from recon.rows import Metric
from recon.schema import REFERENCE
from recon.tables import Array, build, with_meta
from recon_readers._columns import at_rows
from recon_readers._time_order import Mask, Times, in_order, repeating

NS: Final = 1_000_000_000
LONGEST_S: Final = 1e8
"""s; no recorder runs for three years."""
FRONT_RIGHT_DOWN: Final = np.array((1.0, -1.0, -1.0))
"""Turns vectors of forward, right, down into forward, left, up: half a turn about x."""


def in_time(t_s: Array, zero_ns: int = 0) -> tuple[Times, Mask]:
    """Times, and the rows among which they rise: (n,) ns since 1970, (n,) bool.

    Rows without a time, out of order, or of a time that was there before are left out.

    t_s : (n,) s after zero_ns
    """
    missing = ~(np.abs(t_s) < LONGEST_S)
    t_ns = zero_ns + np.round(np.where(missing, 0.0, t_s) * NS).astype(np.int64)
    usable = in_order(t_ns, missing)
    return t_ns, usable & ~repeating(t_ns, [usable])


def left_out(rows: Mask, name: str) -> list[Metric]:
    """How many rows of a sensor `in_time` left out, where it did. rows : (n,) bool, those that stay"""
    note = f"of {len(rows)} rows of {name}: times that are missing, repeated or out of order"
    return [] if rows.all() else [Metric("rows_left_out", float((~rows).sum()), note=note)]


def interleave(parts: MutableMapping[str, tuple[Times, Array]]) -> tuple[Times, dict[str, Array]]:
    """Sensors at their own times as one stream: the union of times (n,) ns, values (n,) or (n, m), NaN between.

    parts : by name, times (k,) that rise and values (k,) or (k, m); emptied, so that they and the result are not there
        at once
    """
    first, *others = (times for times, _ in parts.values())
    if all(np.array_equal(first, times) for times in others):
        return first, {name: np.asarray(parts.pop(name)[1], dtype=np.float64) for name in list(parts)}
    distinct = {id(times): times for times in (first, *others)}
    t_ns = np.unique(np.concatenate(list(distinct.values())))
    rows = {key: np.searchsorted(t_ns, times) for key, times in distinct.items()}
    spread = {}
    for name in list(parts):
        times, values = parts.pop(name)
        spread[name] = at_rows(values, rows[id(times)], len(t_ns))
    return t_ns, spread


def unit_quaternions(q: ArrayLike) -> Array:
    """Quaternions of length one, NaN for those that are none: (n, 4). Recorders round; they do not scale by 1 %."""
    q = np.asarray(q, dtype=np.float64)
    q = np.where(np.abs(q) <= 1.01, q, np.nan)
    length = np.linalg.norm(q, axis=1, keepdims=True)
    return np.asarray(q / np.where(np.abs(length - 1.0) < 0.01, length, np.nan))


def first_place(place: Array) -> Anchor | None:
    """The anchor at the first row of (n, 3) lat, lon deg, height m that has all three; None where no row has."""
    known = np.isfinite(place).all(axis=1)
    return Anchor(*place[known][0].tolist()) if known.any() else None


def reference(t_ns: Times, place: Array, anchor: Anchor, vel_n: Array, q: Array) -> pa.Table:
    """The stream reference.

    t_ns : (n,) ns; place : (n, 3) lat, lon deg, height m above the ellipsoid; vel_n : (n, 3) m/s, local;
    q : (n, 4) body to local; NaN where unknown
    """
    lat, lon, height = place.T
    table = build(
        REFERENCE.only("pos", "vel", "q", "lat", "lon", "height"),
        time=t_ns, pos=geodetic_to_enu(lat, lon, height, anchor), vel=vel_n, q=q, lat=lat, lon=lon, height=height,
    )  # fmt: skip
    return with_meta(table, anchor=asdict(anchor), earth="wgs84", height_datum="ellipsoid")
