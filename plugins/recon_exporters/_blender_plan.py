"""A drive as a film: what moves, at which frame, as data that Blender's builder script turns into a scene.

`scene.json` holds names, counts and places, `scene.npz` the arrays below. Axes are those of the local frame, x east,
y north, z up, in m about `origin`, which is the first key: single precision, all that Blender knows, is fine there.

    time            (n,) ns since 1970 of the keys: rows of the trajectory, the first of each frame, and the last row
    frame           (n,) where each key stands in the film; the frame of a row is a fraction
    elapsed         (n,) s after the start of the trajectory
    position, q     (n, 3) m; (n, 4) scalar first, vehicle to local, sign-continuous
    speed           (n,) m/s, magnitude of the velocity
    wheel_angle     (n,) rad, forward speed integrated over the radius of a wheel
    steering        (n,) rad, to the left, of a bicycle of that wheelbase with that yaw rate and speed
    follow          (n, 3) m, a camera behind and above, that turns as the heading does, smoothed
    path_*, strip, tube, fixes, ground_*    see _blender_shapes
    ghost_*         (k,) frame, (k, 3) m position, (k, 4) q of a second trajectory

References
    Rajamani (2012), "Vehicle Dynamics and Control", 2.2: kinematic bicycle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.errors import DataError, NothingToExport
from recon.manifest import RunInfo
from recon.numerics.integration import cumulative
from recon.numerics.moving_window import moving_average
from recon.numerics.rotation import conjugate, rotate, to_euler
from recon.numerics.rotation_series import sign_continuous
from recon.numerics.signals import differentiate, median_rate
from recon.placing import about_anchor, anchor_of
from recon.rows import spans
from recon.tables import Array, matrix, matrix_or_nan, meta, time_ns
from recon_exporters._blender_events import Json, captions, force, happenings, markers
from recon_exporters._blender_film import Film, SceneParams, Times, film_of, keyed_rows
from recon_exporters._blender_shapes import fixes_of, ground_of, path_of
from recon_exporters._text_columns import iso_8601

VERSION: Final = 1
WHEELBASE: Final = 2.65
"""m; with the radius that of a usual passenger car, since no log tells its own."""
WHEEL_RADIUS: Final = 0.32
"""m"""
LARGEST_STEERING: Final = np.radians(38.0)
"""rad of the front wheels, as far as those of a car turn."""
SLOW: Final = 1.0
"""m/s below which a yaw rate says less and less about the wheels."""
SMOOTHING: Final = 0.5
"""s over which yaw is averaged before its rate is taken."""
FOLLOWING: Final = 1.5
"""s over which the camera behind averages place and heading."""
BEHIND: Final = (-8.5, 2.0, 3.2)
"""m forward, to the left and up from the vehicle to the camera that follows it."""
_NS: Final = 1e9


@dataclass(frozen=True)
class Motion:
    """Rows of a trajectory whose place, attitude and velocity are known.

    t_ns : (n,); position : (n, 3) m; q : (n, 4); velocity : (n, 3) m/s, local; std : (n, 3) m, NaN if unknown
    """

    t_ns: Times
    position: Array
    q: Array
    velocity: Array
    std: Array


def plan(
    trajectory: pa.Table,
    gnss: pa.Table | None,
    events: pa.Table | None,
    ghost: pa.Table | None,
    streams: Mapping[str, pa.Table],
    about: RunInfo,
    params: SceneParams,
) -> tuple[Json, dict[str, NDArray[Any]]]:
    """The scene: what `scene.json` and `scene.npz` hold.

    Raises NothingToExport where the film would show no row of the trajectory, DataError where it would show none of
    the ghost.
    """
    motion = motion_of(trajectory)
    film = film_of(motion.t_ns, spans(events, "crash"), params)
    rows = keyed_rows(film, motion.t_ns)
    origin = motion.position[rows[0]]
    flat = np.array([1.0, 1.0, 1.0 if params.vertical else 0.0])
    motion = replace(motion, position=(motion.position - origin) * flat)
    keys, t_ns, position = _moving(motion, film, rows), motion.t_ns[rows], motion.position[rows]
    outages = silences(gnss, motion.t_ns, params.max_gap)
    keys |= path_of(position, to_euler(motion.q[rows])[0], motion.std[rows] * params.tube, during(t_ns, outages))
    keys |= ground_of(keys["path_position"], keys["strip"])
    datum = str(meta(trajectory).get("height_datum", ""))
    keys |= fixes_of(gnss, film.shows, t_ns, position, origin, anchor_of(trajectory), datum)
    keys |= _second(ghost, film, origin, flat, trajectory)
    found = happenings(events, outages if gnss is not None else [], film)
    scene = {
        "recon_scene": VERSION,
        "name": about.name,
        "fps": params.fps,
        "frames": max(1, int(np.ceil(keys["frame"][-1]))),
        **_about(trajectory, t_ns[:1], origin),
        "markers": markers(found, film),
        "captions": captions(found, film, params.fps),
        "force": force(found, film, params.fps, streams),
        "warnings": list(about.warnings),
    }
    return scene, keys


def _moving(motion: Motion, film: Film, rows: NDArray[np.intp]) -> dict[str, NDArray[Any]]:
    """What moves the vehicle and the camera behind it, at the keys: rows (n,) of the motion."""
    t_ns = motion.t_ns[rows]
    return {
        "time": t_ns,
        "frame": film.frame_of(t_ns),
        "elapsed": film.elapsed(t_ns),
        "position": motion.position[rows],
        "q": sign_continuous(motion.q[rows]),
        "speed": np.linalg.norm(motion.velocity[rows], axis=1),
        **{name: values[rows] for name, values in wheels(motion).items()},
        "follow": follow(motion)[rows],
    }


def _about(trajectory: pa.Table, start_ns: Times, origin: Array) -> Json:
    """Clock, axes, places and sizes. start_ns : (1,); origin : (3,) m, local"""
    anchor = anchor_of(trajectory)
    return {
        "start": iso_8601(start_ns)[0].as_py(),
        "time_scale": meta(trajectory).get("time_scale", ""),
        "axes": "x east, y north, z up, m about the origin",
        "origin": origin.tolist(),
        "anchor": None if anchor is None else {"lat": anchor.lat, "lon": anchor.lon, "height": anchor.height},
        "wheelbase": WHEELBASE,
        "wheel_radius": WHEEL_RADIUS,
    }


def motion_of(trajectory: pa.Table) -> Motion:
    """The rows that can be shown. Raises NothingToExport where there is none."""
    position, q, velocity = (matrix(trajectory, name, gaps=True) for name in ("pos", "q", "vel"))
    known = np.flatnonzero(np.isfinite(np.hstack((position, q, velocity))).all(axis=1))
    if not len(known):
        raise NothingToExport("no row of trajectory has a position, an attitude and a velocity")
    std = matrix_or_nan(trajectory, "pos_std")[known]
    return Motion(time_ns(trajectory)[known], position[known], q[known], velocity[known], std)


def wheels(motion: Motion) -> dict[str, Array]:
    """Angle to which the wheels have rolled, and angle by which the front ones are steered, (n,) rad, of every row.

    tan(steering) = wheelbase * yaw_rate / v; at a crawl, where that says nothing, it fades with v^2 / (v^2 + SLOW^2).
    """
    t_s = (motion.t_ns - motion.t_ns[0]) / _NS
    forward = rotate(conjugate(motion.q), motion.velocity)[:, 0]
    rolled = cumulative(t_s, forward, "trapezoid") / WHEEL_RADIUS
    if len(t_s) < 2:
        return {"wheel_angle": rolled, "steering": np.zeros(len(t_s))}
    yaw = moving_average(np.unwrap(to_euler(motion.q)[0]), _window(motion, SMOOTHING))
    steering = np.arctan(WHEELBASE * differentiate(t_s, yaw) * forward / (forward**2 + SLOW**2))
    return {"wheel_angle": rolled, "steering": steering.clip(-LARGEST_STEERING, LARGEST_STEERING)}


def follow(motion: Motion) -> Array:
    """(n, 3) m: a camera behind the vehicle that neither shakes nor jumps with it."""
    window = _window(motion, FOLLOWING)
    yaw = moving_average(np.unwrap(to_euler(motion.q)[0]), window)
    center = moving_average(motion.position, window)
    ahead, left, up = BEHIND
    cos, sin = np.cos(yaw), np.sin(yaw)
    offset = np.column_stack((ahead * cos - left * sin, ahead * sin + left * cos, np.full(len(yaw), up)))
    return np.asarray(center + offset)


def _window(motion: Motion, span: float) -> int:
    """Odd number of rows in a span of s."""
    rate = median_rate(motion.t_ns) if len(motion.t_ns) > 1 else 0.0
    return 2 * int(0.5 * span * rate) + 1


def silences(gnss: pa.Table | None, t_ns: Times, max_gap: float) -> list[tuple[int, int]]:
    """From and to, ns, where GNSS says nothing for more than `max_gap` s; all of a drive without GNSS."""
    told = time_ns(gnss) if gnss is not None else np.zeros(0, dtype=np.int64)
    ends = np.concatenate((t_ns[:1], told[(told > t_ns[0]) & (told < t_ns[-1])], t_ns[-1:]))
    long = np.flatnonzero(np.diff(ends) > max_gap * _NS)
    return [(int(ends[row]), int(ends[row + 1])) for row in long]


def during(t_ns: Times, found: list[tuple[int, int]]) -> NDArray[np.bool_]:
    """(n,) do these times lie inside of one of the spans, which do not overlap?"""
    starts, ends = np.array(found, dtype=np.int64).reshape(-1, 2).T
    return np.asarray(np.searchsorted(starts, t_ns, side="left") > np.searchsorted(ends, t_ns, side="right"))


def _second(
    ghost: pa.Table | None, film: Film, origin: Array, flat: Array, trajectory: pa.Table
) -> Mapping[str, NDArray[Any]]:
    """Keys of the ghost. Raises DataError where the film shows no row of it in the frame of the trajectory."""
    if ghost is None:
        return {}
    position = about_anchor(ghost, anchor_of(trajectory), str(meta(trajectory).get("height_datum", "")))
    q, t_ns = matrix(ghost, "q", gaps=True), time_ns(ghost)
    known = np.flatnonzero(np.isfinite(np.hstack((position, q))).all(axis=1) & film.shows(t_ns))
    if not len(known):
        raise DataError(
            "the film shows no row of the ghost whose place beside the trajectory is known",
            "the two need a common time, and a common anchor or latitude and longitude",
        )
    rows = known[keyed_rows(film, t_ns[known])]
    return {
        "ghost_frame": film.frame_of(t_ns[rows]),
        "ghost_position": (position[rows] - origin) * flat,
        "ghost_q": sign_continuous(q[rows]),
    }
