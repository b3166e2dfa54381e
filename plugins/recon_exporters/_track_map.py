"""The track from above as an inline SVG: metres on the ground in the middle of the map, north up.

With latitudes and longitudes it is Mercator's map, which a street map behind it shares (EPSG:3857), in the scale that
is true in the middle; without, it is the local frame.

    x = R lambda cos(phi_0)      y = R asinh(tan(phi)) cos(phi_0)

References
    EPSG Guidance Note 7-2 (IOGP publication 373-7-2), 3.2.1.2: Popular Visualisation Pseudo-Mercator.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.schema import unnumbered
from recon.tables import Array, has, matrix, time_ns, vector
from recon_exporters._chart import Span, legend, nice_step, paint, path, ticks
from recon_exporters._decimate import gaps, pieces
from recon_exporters._labels import LETTER, placed
from recon_exporters._panels import Source, sources_of
from recon_exporters._style import EVENTS, OTHER_EVENT, layer, role_of_fixes
from recon_exporters._words import words

WIDTH: Final = 1000.0
HIGHEST: Final = 560.0
LOWEST: Final = 220.0
MARGIN: Final = 36.0
"""Of the drawing, in its own unit: width, most and least height, and what stays free around the tracks."""
FINE: Final = 0.4
"""Points of a track closer together, in the drawing's unit, are left out: half of a line's thickness."""
RADIUS: Final = 6_378_137.0
"""m, of the equator (WGS84)."""
_MOST_NAMES: Final = 40
"""Names of points; of more, crashes come first."""
_FAR: Final = 14.0
"""A name further above or below its point is joined to it by a line."""
_SCALE_HEIGHT: Final = 36.0
"""Below the names, for the scale."""


@dataclass(frozen=True)
class Path:
    """Where something was: t_ns (n,) ns since 1970, xy (n, 2) m to the right and upwards, all finite."""

    name: str
    role: str
    t_ns: NDArray[np.int64]
    xy: Array


@dataclass(frozen=True)
class Sheet:
    """The paper: m of its left and upper edge, drawing units per m, its height; world : (x, y, m) in Mercator's unit
    square of the point (0, 0) and of one m, None where no place on the Earth is known.
    """

    left: float
    upper: float
    scale: float
    height: float
    world: tuple[float, float, float] | None

    def place(self, xy: Array) -> Array:
        """In the drawing: (n, 2), from (n, 2) m."""
        return np.column_stack(((xy[:, 0] - self.left) * self.scale, (self.upper - xy[:, 1]) * self.scale))


def track_map(streams: Mapping[str, pa.Table], spans: Sequence[Span], zero_ns: int, max_gap: float) -> str:
    """The map as <figure>; "" where no stream has a position."""
    paths, world = paths_of(streams)
    if not paths:
        return ""
    sheet = _sheet(paths, world)
    in_order = sorted(paths, key=lambda one: layer(one.role))
    drawn = [_path(one, sheet, zero_ns, max_gap) for one in in_order]
    drawn += _marks(paths[0], spans, sheet)
    behind = f' data-world="{" ".join(map(repr, _corner(sheet)))}"' if sheet.world else ""
    keys = legend((one.name, one.role, False) for one in paths) + _marks_key(spans)
    kind = "north up" if world else "local frame, whose north is a guess: no place on the Earth is known"
    return (
        f'<figure class="map"{behind}><figcaption><b>Track</b> [{kind}]{keys}</figcaption>'
        f'<svg viewBox="0 0 {WIDTH:g} {sheet.height:.0f}" role="img" aria-label="The track from above">'
        f'<g class="tiles"></g>{"".join(_grid(sheet))}{"".join(drawn)}{_scale_bar(sheet)}'
        f'<circle class="now" r="6" visibility="hidden"/></svg></figure>'
    )


def paths_of(streams: Mapping[str, pa.Table]) -> tuple[list[Path], tuple[float, float, float] | None]:
    """Trajectories, references, then GNSS, as far as they have positions of one kind, and where (0, 0) is (Sheet)."""
    fixes = [Source(n, role_of_fixes(n), t, n) for n, t in streams.items() if unnumbered(n) == "gnss" and t.num_rows]
    everything = [*sources_of(streams), *fixes]
    placed = [source for source in everything if has(source.table, "lat") and has(source.table, "lon")]
    if not placed:
        local = [source for source in everything if has(source.table, "pos")]
        found = [_finite(source, matrix(source.table, "pos", gaps=True)[:, :2]) for source in local]
        return [one for one in found if len(one.t_ns)], None
    lat, lon = (np.nanmedian(vector(placed[0].table, name, gaps=True)) for name in ("lat", "lon"))
    middle = math.cos(math.radians(lat))
    across, up = RADIUS * math.radians(lon) * middle, RADIUS * math.asinh(math.tan(math.radians(lat))) * middle
    found = []
    for source in placed:
        phi = np.radians(np.clip(vector(source.table, "lat", gaps=True), -85.0, 85.0))
        east = (vector(source.table, "lon", gaps=True) - lon + 180.0) % 360.0 - 180.0
        xy = np.column_stack((RADIUS * np.radians(east), RADIUS * np.arcsinh(np.tan(phi)))) * middle
        found.append(_finite(source, xy - (0.0, up)))
    around = 2.0 * math.pi * RADIUS * middle
    return [one for one in found if len(one.t_ns)], (0.5 + across / around, 0.5 - up / around, 1.0 / around)


def _finite(source: Source, xy: Array) -> Path:
    known = np.isfinite(xy).all(axis=1)
    return Path(source.name, source.role, time_ns(source.table)[known], xy[known])


def _sheet(paths: Sequence[Path], world: tuple[float, float, float] | None) -> Sheet:
    """Around the trajectories; without one, around everything."""
    lines = [one.xy for one in paths if not one.role.startswith("gnss ")] or [one.xy for one in paths]
    low, high = (reduce([reduce(xy, axis=0) for xy in lines], axis=0) for reduce in (np.min, np.max))
    across, up = np.maximum(high - low, 5.0)
    scale = min((WIDTH - 2 * MARGIN) / across, (HIGHEST - 2 * MARGIN) / up)
    height = max(up * scale + 2 * MARGIN, LOWEST)
    middle = 0.5 * (low + high)
    return Sheet(middle[0] - 0.5 * WIDTH / scale, middle[1] + 0.5 * height / scale, scale, height, world)


def _corner(sheet: Sheet) -> tuple[float, float, float]:
    """Of the upper left corner, its place in Mercator's unit square, and the size of a drawing unit there."""
    assert sheet.world is not None
    x, y, metre = sheet.world
    return float(x + sheet.left * metre), float(y - sheet.upper * metre), float(metre / sheet.scale)


def _path(one: Path, sheet: Sheet, zero_ns: int, max_gap: float) -> str:
    place = sheet.place(one.xy)
    begins = gaps(one.t_ns, max_gap)
    cell = np.floor(place / FINE)
    moved = np.concatenate(([True], (np.diff(cell, axis=0) != 0).any(axis=1)))
    kept = moved | begins | np.append(begins[1:], True)
    inside = ((place > -WIDTH) & (place < 2.0 * WIDTH)).all(axis=1)
    rows = np.flatnonzero(kept & inside)
    x, y = place[rows].round(2).T.tolist()
    times = ""
    if one.role == "trajectory 1":
        times = f' data-t="{" ".join(map(str, np.rint((one.t_ns[rows] - zero_ns) * 1e-6).astype(np.int64).tolist()))}"'
    data = path(x, y, pieces(rows, begins), one.role)
    return f'<path class="curve" data-name="{escape(one.name)}"{times} d="{data}" {paint(one.role)}/>'


def _marks_key(spans: Sequence[Span]) -> str:
    kinds = dict.fromkeys(span.kind for span in spans)
    return "".join(
        f'<span class="key"><svg class="cross" viewBox="0 0 10 10"><path class="mark" d="M1 1L9 9M1 9L9 1" '
        f'stroke="{EVENTS.get(kind, OTHER_EVENT)}"/></svg>{escape(words(kind))}</span>'
        for kind in kinds
    )


def _marks(one: Path, spans: Sequence[Span], sheet: Sheet) -> Iterator[str]:
    """Start, end, and the events along a path; names as far as there is room, those of crashes first."""
    place = sheet.place(one.xy)
    rows = np.minimum(np.searchsorted(one.t_ns, [span.start_ns for span in spans]), len(place) - 1)
    points = [(float(x), float(y)) for x, y in place[rows]]
    ends = {"start": (float(place[0, 0]), float(place[0, 1])), "end": (float(place[-1, 0]), float(place[-1, 1]))}
    for span, (x, y) in zip(spans, points, strict=True):
        size = 4.5 if span.kind == "standstill" else 7.0
        cross = f"M{x - size:.1f} {y - size:.1f}l{2 * size} {2 * size}m0 {-2 * size}l{-2 * size} {2 * size}"
        told = f"<title>{escape(words(span.kind))}</title>"
        yield f'<path class="mark" d="{cross}" stroke="{EVENTS.get(span.kind, OTHER_EVENT)}">{told}</path>'
    for x, y in ends.values():
        yield f'<circle class="end" cx="{x:.1f}" cy="{y:.1f}" r="4"/>'
    named = [(words(span.kind), at) for span, at in zip(spans, points, strict=True) if span.kind != "standstill"]
    names = [*ends.items(), *sorted(named, key=lambda name: name[0] != "crash")][:_MOST_NAMES]
    for label in placed(names, [*points, *ends.values()], WIDTH, sheet.height - _SCALE_HEIGHT):
        (x, y), middle = label.point, label.y - 4.0
        if abs(middle - y) > _FAR:
            edge = label.x if label.x > x else label.x + LETTER * len(label.text)
            yield f'<path class="leader" d="M{x:.1f} {y:.1f}L{edge:.1f} {middle:.1f}"/>'
        yield f'<text class="name" x="{label.x:.1f}" y="{label.y:.1f}">{escape(label.text)}</text>'


def _grid(sheet: Sheet) -> Iterator[str]:
    step = _grid_step(sheet)
    for value in ticks(sheet.left, sheet.left + WIDTH / sheet.scale, step):
        yield f'<path class="grid" d="M{(value - sheet.left) * sheet.scale:.1f} 0V{sheet.height:.0f}"/>'
    for value in ticks(sheet.upper - sheet.height / sheet.scale, sheet.upper, step):
        yield f'<path class="grid" d="M0 {(sheet.upper - value) * sheet.scale:.1f}H{WIDTH:g}"/>'


def _grid_step(sheet: Sheet) -> float:
    return nice_step(WIDTH / sheet.scale, 8)


def _scale_bar(sheet: Sheet) -> str:
    """A round length, and where north is, as far as it is known."""
    step = _grid_step(sheet)
    length, y = step * sheet.scale, sheet.height - 14
    text = f"{step / 1000:g} km" if step >= 1000 else f"{step:g} m"
    north = '<path class="scale" d="M980 44V16l-6 12m6 -12l6 12"/><text class="name" x="975" y="60">N</text>'
    return (
        f'<path class="scale" d="M16 {y - 5:.1f}v5h{length:.1f}v-5"/><text class="name" x="22" y="{y - 6:.1f}">{text}'
        f"</text>{north if sheet.world else ''}"
    )
