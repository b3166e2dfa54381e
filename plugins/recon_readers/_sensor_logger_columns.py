"""Columns of tables of Sensor Logger to columns of streams: times, units, and what negative numbers leave out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, TypeAlias

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.tables import Array, vector
from recon_readers._phone_streams import CIRCLE
from recon_readers._time_order import Mask, Times

XYZ: Final = ("x", "y", "z")
PLACE: Final = ("latitude", "longitude", "altitude", "speed", "bearing")
ACCURACY: Final = ("horizontalAccuracy", "verticalAccuracy", "speedAccuracy", "bearingAccuracy")
_KPA: Final = 200.0
"""Below this a pressure cannot be in mbar where people drive."""

Made: TypeAlias = Callable[[Mapping[str, Array]], Mapping[str, Array]]
"""Makes columns of a stream of those of a table."""


def timed(table: pa.Table, clock: Callable[[Any], tuple[Times, Mask]], made: Made) -> dict[Any, NDArray[Any]]:
    """Times, whether there is none, and what is made of the other columns of some rows."""
    t_ns, good = clock(table["time"])
    values = {name: vector(table, name, gaps=True) for name in table.column_names if name != "time"}
    return {"time": t_ns, "missing": ~good, **made(values)}


def xyz(group: str, factor: float = 1.0) -> Made:
    """Makes a group of a stream of the columns x, y, z."""
    return lambda values: {f"{group}_{axis}": factor * values[axis] for axis in XYZ}


def whole_ns(texts: pa.ChunkedArray) -> tuple[Times, Mask]:
    """Whole nanoseconds since 1970 of texts of digits, (n,), and which are such, (n,) bool."""
    from pyarrow import compute

    plain_texts = compute.fill_null(texts, "")
    good = compute.match_substring_regex(plain_texts, r"^\d{1,18}$|^[1-8]\d{18}$")
    t_ns = compute.if_else(good, plain_texts, "0").cast(pa.int64())
    return np.asarray(t_ns.combine_chunks()), np.asarray(good.combine_chunks())


def pascals(pressure: Array) -> Array:
    """Pressures (n,) in Pa of such in mbar, or in kPa where their median cannot be mbar."""
    known = pressure[np.isfinite(pressure)]
    return np.asarray(pressure * (1000.0 if len(known) and np.median(known) < _KPA else 100.0))


def place(values: Mapping[str, Array]) -> dict[str, Array]:
    """Columns of gnss; what is negative where it cannot be is missing."""
    named = {"latitude": "lat", "longitude": "lon", "altitude": "height", "speed": "speed", "bearing": "course"}
    found = {column: values[name] for name, column in named.items() if name in values}
    accuracy = {name: np.where(values[name] > 0.0, values[name], np.nan) for name in ACCURACY if name in values}
    with np.errstate(invalid="ignore"):
        if "height" in found and "verticalAccuracy" in values:
            found["height"] = np.where(values["verticalAccuracy"] < 0.0, np.nan, found["height"])
        if "speed" in found:
            found["speed"] = np.where(found["speed"] < 0.0, np.nan, found["speed"])
        if "course" in found:
            told = (found["course"] >= 0.0) & np.isfinite(accuracy.get("bearingAccuracy", found["course"]))
            found["course"] = np.where(told, np.radians(found["course"]), np.nan)
    if "horizontalAccuracy" in accuracy:
        wide = accuracy["horizontalAccuracy"] / CIRCLE
        found |= {"pos_std_e": wide, "pos_std_n": wide}
        found["pos_std_u"] = accuracy.get("verticalAccuracy", np.full(len(wide), np.nan))
    if "speedAccuracy" in accuracy:
        fast = accuracy["speedAccuracy"]
        found |= {"vel_std_e": fast, "vel_std_n": fast, "vel_std_u": np.full(len(fast), np.nan)}
    return found
