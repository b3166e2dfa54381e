"""GNSS rows as measurements in axes n, with how much trust.

A fix gives its position, and its velocity as a vector, as speed and course, or as speed alone. Of speed and course the
component along the course has the sigma of the speed, that across the speed times the sigma of the course; nothing is
said of the vertical. Below a low speed the course is not believed, and the fix says that the velocity is small: both
components zero with the sigma of the speed itself. Many receivers hold the course there, or set the speed to zero.

A reported sigma is that of the whole error. Most of the error of a position changes slowly and is the smoother's drift;
the rest is white.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.errors import DataError, NotEnoughData
from recon.numerics.geodesy import Anchor
from recon.numerics.smoothing import Fixes, level_rotation, positions_n
from recon.tables import Array, has, meta, seconds, vector, with_meta

_TWO_DIMENSIONAL: Final = 2
_FASTEST_S: Final = 0.1
"""s; fixes nearer to the one before tell nothing new."""
_OWN_S: Final = 0.5
"""s between fixes from which their errors are taken as their own."""
_LOW, _LOW_IF_HELD = 1.0, 2.0
"""m/s below which a course is not believed."""
_SLOW_SHARE, _WHITE_SHARE = 0.9, 0.4
"""Of a reported sigma: what changes slowly, and what is white."""
_UNKNOWN = (1e3, 1e2)
"""m, m/s; a larger sigma is what a receiver writes that knows none."""
_FEWEST_PLACES: Final = 10
"""Different ones, which tell whether they are rounded."""
_LEAST = (0.003, 0.01)
"""m and m/s; a sigma below is not believed."""


@dataclass(frozen=True)
class Trust:
    """Sigmas where none are reported: east, north, up. drift, white : m; velocity : m/s."""

    drift: tuple[float, float, float] = (2.5, 2.5, 3.5)
    white: tuple[float, float, float] = (1.0, 1.0, 1.5)
    velocity: tuple[float, float, float] = (0.1, 0.1, 0.15)


@dataclass(frozen=True)
class _Velocities:
    """What is said of velocities, local level: rows (3, 3, m) take one to what is measured, value and sigma (3, m) m/s.

    small : (m,) it only says that the velocity is small; kind : as in Observed
    """

    rows: Array
    value: Array
    sigma: Array
    small: NDArray[np.bool_]
    kind: str


@dataclass(frozen=True)
class Observed:
    """The fixes that are used, and where they came from.

    row : (m,) of the receiver's stream; drift : (3,) m, sigma of the slow error
    kind : what velocities are: "vector", "course", "speed" or "none"
    receiver : (m,) 0 for gnss, 1 and more for the others; None where there is one
    """

    fixes: Fixes
    row: NDArray[np.intp]
    anchor: Anchor
    drift: Array
    kind: str
    height: bool
    receiver: NDArray[np.intp] | None = None


def observe(gnss: pa.Table, start_ns: int, trust: Trust, reported: bool) -> Observed:
    """The measurements of a gnss stream. start_ns : time zero; reported : believe the receiver's own sigmas.

    raises : NotEnoughData where no row holds a position or a speed, DataError where a latitude is none
    """
    row = _new_rows(gnss, start_ns)
    t_s = seconds(gnss, since=start_ns)[row]
    place = np.array([_column(gnss, name, row) for name in ("lat", "lon", "height")])
    known = np.isfinite(place[:2]).all(axis=0) & place[:2].any(axis=0)  # 0, 0 is what many write before the first fix
    if (np.abs(place[0, known]) > 90.0).any():
        raise DataError("latitudes beyond 90 deg", "are lat and lon swapped, or not in degrees?")
    anchor = _own_anchor(gnss) or _first_place(place, known)
    level = np.isfinite(place[2])
    lat, lon = (np.where(known, value, origin) for value, origin in zip(place, (anchor.lat, anchor.lon), strict=False))
    pos_n = positions_n(lat, lon, np.where(level, place[2], anchor.height), anchor)
    white, drift = _position_sigmas(gnss, row, trust, reported)
    white = np.hypot(white, _rounded(place[:, known], anchor)[:, None])
    measured = np.array([known, known, known & level])
    to_n = level_rotation(pos_n, anchor).swapaxes(0, 1)
    said = _velocities(gnss, row, trust, reported)
    fixes = Fixes(
        t_s=t_s,
        pos_n=pos_n,
        pos_sigma=np.where(measured, white, np.inf),
        vel_rows=np.einsum("ijm,kjm->ikm", said.rows, to_n),
        vel=said.value,
        vel_sigma=said.sigma,
        small_only=said.small,
        speed_only=np.full(len(row), said.kind == "speed"),
        share=np.clip(np.gradient(t_s) / _OWN_S, 0.0, 1.0) if len(row) > 1 else np.ones(len(row)),
    )
    return Observed(fixes, row, anchor, drift, said.kind, bool(level.any()))


def about(gnss: pa.Table, anchor: Anchor) -> pa.Table:
    """The rows of GNSS with the origin of the local frame."""
    return with_meta(gnss, anchor=asdict(anchor), earth="wgs84")


def _new_rows(gnss: pa.Table, start_ns: int) -> NDArray[np.intp]:
    """Rows with something new to say: a fix that is not disowned, not repeated while moving, not too soon."""
    says = np.zeros(gnss.num_rows, dtype=bool)
    for name in ("lat", "speed", "vel_e"):
        if name in gnss.column_names:
            says |= np.isfinite(vector(gnss, name, gaps=True))
    if "fix" in gnss.column_names:
        says &= ~(vector(gnss, "fix", gaps=True) < _TWO_DIMENSIONAL)
    row = np.flatnonzero(says)
    names = [n for n in ("lat", "lon", "height", "speed", "course", "vel_e", "vel_n") if n in gnss.column_names]
    values = np.nan_to_num(np.array([vector(gnss, name, gaps=True)[row] for name in names]), nan=-1e9)
    same = np.zeros(len(row), dtype=bool)
    if len(row) > 1:
        same[1:] = (np.diff(values) == 0.0).all(axis=0)
    speed = _speed(gnss, row)
    row = row[~(same & (speed > _LOW))]
    tick = np.floor(seconds(gnss, since=start_ns)[row] / _FASTEST_S + 0.5).astype(np.int64)
    row = row[np.unique(tick, return_index=True)[1]]
    if len(row) < 2:
        raise NotEnoughData(
            "GNSS", needed="two rows with a position or a speed", found=f"{len(row)} of {gnss.num_rows}",
            hint="without GNSS the pipeline thesis still runs"
        )  # fmt: skip
    return row


def _column(gnss: pa.Table, name: str, row: NDArray[np.intp]) -> Array:
    """A column in some rows, NaN throughout where there is none."""
    return vector(gnss, name, gaps=True)[row] if name in gnss.column_names else np.full(len(row), np.nan)


def _speed(gnss: pa.Table, row: NDArray[np.intp]) -> Array:
    if has(gnss, "speed"):
        return np.nan_to_num(_column(gnss, "speed", row), nan=0.0)
    return np.nan_to_num(np.hypot(_column(gnss, "vel_e", row), _column(gnss, "vel_n", row)), nan=0.0)


def _own_anchor(gnss: pa.Table) -> Anchor | None:
    """Origin that the stream itself names, where it is on the ellipsoid."""
    facts = meta(gnss)
    return Anchor(**facts["anchor"]) if "anchor" in facts and facts.get("earth", "wgs84") == "wgs84" else None


def _first_place(place: Array, known: NDArray[np.bool_]) -> Anchor:
    """The first position; where there is none, a place at middle latitude, for gravity and the Earth's rate."""
    if not known.any():
        return Anchor(45.0, 0.0, 0.0)
    lat, lon, height = place[:, int(known.argmax())]
    heights = place[2][np.isfinite(place[2])]
    origin = height if np.isfinite(height) else (heights[0] if len(heights) else 0.0)
    return Anchor(float(lat), float(lon), float(origin))


def _position_sigmas(gnss: pa.Table, row: NDArray[np.intp], trust: Trust, reported: bool) -> tuple[Array, Array]:
    """White sigma of each fix (3, m) m and that of the slow error (3,) m."""
    white, drift = np.tile(np.array(trust.white)[:, None], (1, len(row))), np.array(trust.drift)
    for axis, name in enumerate(("pos_std_e", "pos_std_n", "pos_std_u")):
        sigma = _column(gnss, name, row)
        told = (sigma > 0.0) & (sigma < _UNKNOWN[0])
        if reported and told.any():
            usual = float(np.median(sigma[told]))
            drift[axis] = max(_SLOW_SHARE * usual, _LEAST[0])
            none = np.isnan(sigma) | (sigma <= 0.0)
            white[axis] = np.maximum(_WHITE_SHARE * np.where(none, usual, sigma), _LEAST[0])
    return white, drift


def _rounded(place: Array, anchor: Anchor) -> Array:
    """Root mean square of the errors of places that are rounded to steps, east, north and up: (3,) m, step / sqrt(12).

    Some values of rounded ones come again; those of who moves steadily are in equal distances, too.

    place : (3, m) deg, deg, m
    """
    again = [_FEWEST_PLACES <= len(np.unique(axis)) < len(axis) for axis in place]
    lat, lon, height = (_step(axis) if twice else 0.0 for axis, twice in zip(place, again, strict=True))
    corner = np.array([[anchor.lat + lat], [anchor.lon + lon], [anchor.height + height]])
    step = np.abs(positions_n(corner[0], corner[1], corner[2], anchor)[:, 0])
    return np.asarray(step / np.sqrt(12.0))


def _velocities(gnss: pa.Table, row: NDArray[np.intp], trust: Trust, reported: bool) -> _Velocities:
    count, none_small = len(row), np.zeros(len(row), dtype=bool)
    sigma = np.tile(np.array(trust.velocity)[:, None], (1, count))
    for axis, name in enumerate(("vel_std_e", "vel_std_n", "vel_std_u")):
        said = _column(gnss, name, row)
        told = (said > 0.0) & (said < _UNKNOWN[1])
        if reported:
            sigma[axis] = np.where(told, np.maximum(said, _LEAST[1]), sigma[axis])
    if has(gnss, "vel_e") and has(gnss, "vel_n"):
        vel = np.array([_column(gnss, name, row) for name in ("vel_e", "vel_n", "vel_u")])
        measured = np.isfinite(vel)
        measured[:2] = measured[:2].all(axis=0)
        same = np.tile(np.eye(3)[..., None], count)
        value, width = np.where(measured, vel, 0.0), np.where(measured, sigma, np.inf)
        return _Velocities(same, value, width, none_small, "vector")
    speed, course = _column(gnss, "speed", row), _true_course(gnss, row)
    if not np.isfinite(speed).any():
        same = np.tile(np.eye(3)[..., None], count)
        return _Velocities(same, np.zeros((3, count)), np.full((3, count), np.inf), none_small, "none")
    if not np.isfinite(course).any():
        return _speed_alone(speed, sigma)
    return _along_course(speed, course, sigma)


def _true_course(gnss: pa.Table, row: NDArray[np.intp]) -> Array:
    """Course over ground from true north; a magnetic one is left out."""
    if "magnetic" in str(meta(gnss).get("heading_kind", "")):
        return np.full(len(row), np.nan)
    return _column(gnss, "course", row)


def _speed_alone(speed: Array, sigma: Array) -> _Velocities:
    count = len(speed)
    known = np.isfinite(speed)
    rows = np.tile(np.eye(3)[..., None], count)
    vel, width = np.zeros((3, count)), np.full((3, count), np.inf)
    vel[0] = np.where(known, speed, 0.0)
    width[0] = np.where(known, np.hypot(sigma[0], _step(speed) / np.sqrt(12.0)), np.inf)
    low = known & (speed < _LOW)
    vel[0, low] = 0.0
    width[:2, low] = np.hypot(sigma[0, low], speed[low])
    return _Velocities(rows, vel, width, low, "speed")


def _along_course(speed: Array, course: Array, sigma: Array) -> _Velocities:
    known = np.isfinite(speed)
    speed_sigma = np.hypot(sigma[0], _step(speed) / np.sqrt(12.0))
    low = known & ((speed < _lowest_believed(speed, course)) | ~np.isfinite(course))
    east, north = (np.where(low, rest, f(np.nan_to_num(course))) for f, rest in ((np.sin, 1.0), (np.cos, 0.0)))
    none, one = np.zeros_like(east), np.ones_like(east)
    rows = np.array([[east, north, none], [-north, east, none], [none, none, one]])
    vel = np.array([np.where(low, 0.0, np.nan_to_num(speed)), none, none])
    across = np.hypot(sigma[0], np.nan_to_num(speed) * _step(course) / np.sqrt(12.0))
    doubt = np.hypot(sigma[0], np.nan_to_num(speed))
    width = np.array([np.where(low, doubt, speed_sigma), np.where(low, doubt, across), np.full_like(east, np.inf)])
    return _Velocities(rows, vel, np.where(known, width, np.inf), low, "course")


def _step(values: Array) -> float:
    """Step in which values are written, 0 where there is none to be seen."""
    different = np.unique(np.round(values[np.isfinite(values)], 9))
    if len(different) < 3:
        return 0.0
    step = float(np.diff(different).min())
    return step if np.abs(np.diff(different) / step - np.round(np.diff(different) / step)).max() < 0.02 else 0.0


def _lowest_believed(speed: Array, course: Array) -> float:
    """Higher where the receiver is seen to hold or drop the course, or to set low speeds to zero."""
    slow = np.isfinite(speed) & (speed < _LOW_IF_HELD)
    creeping = slow & (speed > 0.0)
    same = np.append(False, np.diff(course) == 0.0) | ~np.isfinite(course)
    held = creeping.sum() > 3 and float((same & creeping).sum()) > 0.3 * float(creeping.sum())
    zeroed = (speed == 0.0).any() and not (creeping & (speed < 0.5 * _LOW)).any()
    return _LOW_IF_HELD if held or zeroed else _LOW
