"""How the times of a drive become frames of a film, which runs slowly around a crash.

frame(t) = 1 + fps * integral of dt / slowness(t)        slowness: `slow_motion` around a crash, 1 elsewhere
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.errors import NothingToExport
from recon.parameters import Params, quantity, setting
from recon.tables import Array

Times = NDArray[np.int64]

_NS: Final = 1e9


class SceneParams(Params):
    """What is filmed, and how fast."""

    fps: int = setting(25, ge=1, le=1000, doc="Frames in a second of the film.")
    start: float = quantity(0.0, "s", ge=0, doc="Where the film begins, after the start of the trajectory.")
    end: float | None = quantity(
        None, "s", gt=0, doc="Where it ends, after the start of the trajectory; none: its end."
    )
    slow_motion: float = setting(10.0, ge=1, le=1000, doc="How many times slower the film runs around a crash.")
    slow_span: float = quantity(1.0, "s", ge=0, le=3600, doc="How long before and after a crash it runs slowly.")
    vertical: bool = setting(True, doc="Does the vehicle rise and sink? Otherwise everything lies in one plane.")
    max_gap: float = quantity(2.0, "s", gt=0, doc="GNSS that is silent for longer is an outage: the path is dashed.")
    tube: float = setting(0.0, ge=0, le=100, doc="Standard deviations that a tube around the path shows; 0 for none.")
    ghost: str = setting(
        "", doc="A second vehicle, translucent: a stream like 'reference', or the folder of another run."
    )


@dataclass(frozen=True)
class Film:
    """How time becomes frames: piecewise linear through (seconds, frames); start_ns is second 0."""

    start_ns: int
    seconds: Array
    frames: Array

    def elapsed(self, t_ns: Times) -> Array:
        """(n,) s after the start of the trajectory."""
        return np.asarray((t_ns - self.start_ns) / _NS)

    def frame_of(self, t_ns: Times) -> Array:
        """(n,) frames, counted from 1, the fraction kept; times outside of the film are taken to its ends."""
        return np.asarray(np.interp(self.elapsed(t_ns), self.seconds, self.frames))

    def shows(self, t_ns: Times) -> NDArray[np.bool_]:
        """(n,) does the film show these times?"""
        elapsed = self.elapsed(t_ns)
        return np.asarray((elapsed >= self.seconds[0]) & (elapsed <= self.seconds[-1]))


def film_of(t_ns: Times, crashes: list[tuple[int, int]], params: SceneParams) -> Film:
    """How the times of a trajectory become frames.

    t_ns : (n,) rising; crashes : first and last ns of each
    Raises NothingToExport where the window holds no row.
    """
    start = int(t_ns[0])
    first = params.start
    last = float(t_ns[-1] - start) / _NS
    last = last if params.end is None else min(last, params.end)
    rows = (t_ns - start >= first * _NS) & (t_ns - start <= last * _NS)
    if not rows.any():
        raise NothingToExport(
            f"no row of trajectory lies from {first:g} s to {last:g} s after its start",
            f"it lasts {float(t_ns[-1] - start) / _NS:.3f} s",
        )
    slow = np.array([((a - start) / _NS - params.slow_span, (b - start) / _NS + params.slow_span) for a, b in crashes])
    slow = slow.reshape(-1, 2)
    cuts = np.unique(np.clip(np.concatenate(([first, last], slow.ravel())), first, last))
    middle = 0.5 * (cuts[1:] + cuts[:-1])
    slowly = ((middle[:, None] > slow[:, 0]) & (middle[:, None] < slow[:, 1])).any(axis=1)
    lasts = np.diff(cuts) * np.where(slowly, params.slow_motion, 1.0) * params.fps
    return Film(start, cuts, 1.0 + np.concatenate(([0.0], np.cumsum(lasts))))


def keyed_rows(film: Film, t_ns: Times) -> NDArray[np.intp]:
    """Rows that become keys: of those that the film shows the first of each frame, and the last of all."""
    shown = np.flatnonzero(film.shows(t_ns))
    frame = np.floor(film.frame_of(t_ns[shown]) + 1e-6)  # a row on a frame belongs to it, whatever was rounded
    kept = np.concatenate(([True], np.diff(frame) > 0))
    kept[-1] = True
    return np.asarray(shown[kept])
