"""A panel as an inline SVG that prints sharply, needs no script, and of which a script can show a part.

The curves lie in an inner drawing of COLUMNS x ROWS integer points, stretched over the plot: time runs linearly from
its left to its right edge, the value from its lower to its upper one. The figure says in data-t and data-y (s after the
start of the run, unit of the panel) which times and values the edges are, so that programs read the numbers back.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.tables import Array, time_ns
from recon_exporters._decimate import band, extremes, gaps, pieces, scattered
from recon_exporters._panels import Curve, Panel
from recon_exporters._style import EVENTS, OTHER_EVENT, layer, style_of
from recon_exporters._words import words

COLUMNS: Final = 30_000
ROWS: Final = 10_000
WIDTH: Final = 1000
HEIGHT: Final = 158
LEFT, TOP, RIGHT, BOTTOM = 62, 6, 948, 134
"""Edges of the plot in the drawing of WIDTH x HEIGHT."""
_UNSHADED: Final = ("trip", "impact")
"""Events that last as long as the drive, or are crashes already."""
_STEPS: Final = (1.0, 2.0, 2.5, 5.0, 10.0)
_TURNS: Final = (15.0, 30.0, 45.0, 90.0, 180.0, 360.0, 720.0, 1800.0, 3600.0)
_TIMES: Final = (1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 60.0, 120.0, 300.0, 600.0, 900.0, 1800.0, 3600.0, 7200.0, 14400.0)


@dataclass(frozen=True)
class Span:
    """An event to shade: ns since 1970, and its kind."""

    start_ns: int
    end_ns: int
    kind: str


@dataclass(frozen=True)
class Window:
    """What is shown: from start to end, ns since 1970; zero_ns, the start of the run, from which seconds count."""

    start_ns: int
    end_ns: int
    zero_ns: int

    @property
    def seconds(self) -> tuple[float, float]:
        """First and last second after the start of the run."""
        return (self.start_ns - self.zero_ns) * 1e-9, (self.end_ns - self.zero_ns) * 1e-9

    def columns(self, t_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Horizontal places of times: (n,)."""
        share = (t_ns - self.start_ns) / max(self.end_ns - self.start_ns, 1)
        return np.asarray(np.rint(np.clip(share, -1.0, 2.0) * COLUMNS), dtype=np.int64)


def spans_of(events: pa.Table | None) -> list[Span]:
    """The events to shade."""
    if events is None:
        return []
    kinds = [kind or "event" for kind in events["kind"].to_pylist()]
    times = (time_ns(events, name).tolist() for name in ("time", "end_time"))
    return [Span(*row) for row in zip(*times, kinds, strict=True) if row[2] not in _UNSHADED]


def figure(panel: Panel, window: Window, spans: Sequence[Span], max_gap: float) -> str:
    """The panel as <figure>; "" where none of its curves has a row in the window."""
    curves = [part for curve in panel.curves if (part := _inside(curve, window)) is not None]
    if not curves:
        return ""
    low, high = _limits(curves, panel)
    (first, last), (kind, factor) = window.seconds, panel.second or ("", 1.0)
    axes = [*_value_axis(panel, low, high), *_time_axis(first, last)]
    if panel.second:
        axes += _second_axis(low * factor, high * factor)
    drawn = [_span(span, window) for span in spans if span.end_ns >= window.start_ns and span.start_ns <= window.end_ns]
    drawn += [_level(level, low, high) for level in panel.levels if low < level < high]
    for curve in sorted(curves, key=lambda curve: layer(curve.role)):
        drawn += _drawn(curve, window, (low, high), max_gap)
    facts = f'data-key="{escape(panel.key)}" data-t="{first!r} {last!r}" data-y="{low!r} {high!r}"'
    turns = ' data-circular="1"' if panel.circular else ""
    units = f"{panel.unit}; right: {kind}" if kind else panel.unit
    return (
        f'<figure class="panel" {facts}{turns}><figcaption><b>{escape(panel.title)}</b> [{escape(units)}]'
        f"{legend((curve.name, curve.role, curve.sigma is not None) for curve in curves)}<output></output></figcaption>"
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(panel.title)} over time">'
        f"{''.join(axes)}"
        f'<svg class="data" x="{LEFT}" y="{TOP}" width="{RIGHT - LEFT}" height="{BOTTOM - TOP}" '
        f'viewBox="0 0 {COLUMNS} {ROWS}" preserveAspectRatio="none">{"".join(drawn)}</svg>'
        f'<rect class="frame" x="{LEFT}" y="{TOP}" width="{RIGHT - LEFT}" height="{BOTTOM - TOP}"/></svg></figure>'
    )


def legend(entries: Iterable[tuple[str, str, bool]]) -> str:
    """Names beside a sample of how they are drawn; entries : name, role, with a band of two sigma?"""
    return "".join(
        f'<span class="key"><svg viewBox="0 0 26 10">{_band_sample(role) if band else ""}'
        f'<path d="{_sample(role)}" {paint(role)}/></svg>{escape(name)}{" ± 2σ" if band else ""}</span>'
        for name, role, band in entries
    )


def events_key(spans: Sequence[Span]) -> str:
    """What the shades mean; "" without an event."""
    kinds = {span.kind: EVENTS.get(span.kind, OTHER_EVENT) for span in spans}
    keys = (
        f'<span class="key"><i style="color:{color};background:{color}44"></i>{escape(words(kind))}</span>'
        for kind, color in kinds.items()
    )
    return f'<p class="events">Shaded: {"".join(keys)}</p>' if kinds else ""


def paint(role: str) -> str:
    """Attributes of a path."""
    style = style_of(role)
    dashes = f' stroke-dasharray="{" ".join(f"{part:g}" for part in style.dashes)}"' if style.dashes else ""
    cap = {"line": "butt", "dots": "round", "squares": "square"}[style.mark]
    return f'stroke="{style.color}" stroke-width="{style.width:g}" stroke-linecap="{cap}"{dashes}'


def path(x: Sequence[float], y: Sequence[float], parts: Iterable[slice], role: str) -> str:
    """Path data: a line for each part, or a mark at each point; squares without a length would be missing on paper."""
    if style_of(role).mark == "line":
        return "".join("M" + " ".join(f"{a} {b}" for a, b in zip(x[part], y[part], strict=True)) for part in parts)
    length = 1 if style_of(role).mark == "squares" else 0
    return "".join(f"M{a} {b}h{length}" for part in parts for a, b in zip(x[part], y[part], strict=True))


def nice_step(span: float, count: int, steps: Sequence[float] = ()) -> float:
    """The smallest round step that cuts a span into at most `count` parts."""
    for step in steps:
        if span / step <= count:
            return step
    size = 10.0 ** math.floor(math.log10(span / count))
    return next(size * step for step in _STEPS if span / (size * step) <= count * (1.0 + 1e-9))


def ticks(low: float, high: float, step: float) -> list[float]:
    """Multiples of the step from low to high."""
    return [number * step for number in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def clock(t_s: float, step: float) -> str:
    """Seconds after the start, as people read them."""
    if abs(t_s) < 600.0 and step < 60.0:
        return f"{round(t_s, 6):g} s".replace("-", "−")
    sign, whole = "−" if t_s < 0 else "", abs(round(t_s))
    minutes = f"{whole // 60 % 60:02d}:{whole % 60:02d}"
    return f"{sign}{whole // 3600}:{minutes}" if whole >= 3600 else f"{sign}{whole // 60}:{whole % 60:02d}"


def _inside(curve: Curve, window: Window) -> Curve | None:
    """The rows in the window, and one on either side; None without one in it."""
    first, last = np.searchsorted(curve.t_ns, (window.start_ns, window.end_ns + 1))
    if first == last:
        return None
    rows = slice(max(first - 1, 0), last + 1)
    sigma = None if curve.sigma is None else curve.sigma[rows]
    return Curve(curve.name, curve.role, curve.t_ns[rows], curve.values[rows], sigma)


def _limits(curves: Sequence[Curve], panel: Panel) -> tuple[float, float]:
    """Values at the lower and the upper edge: all that is drawn, and what it needs not to look restless."""
    low, high = [math.inf, *panel.levels], [-math.inf, *panel.levels]
    for curve in curves:
        around = np.zeros(1) if curve.sigma is None else 2.0 * np.nan_to_num(curve.sigma)
        low.append(float((curve.values - around).min()))
        high.append(float((curve.values + around).max()))
    bottom, top = min(low), max(high)
    margin = 0.06 * (top - bottom) or 0.5 * max(abs(top), 1e-3)
    return bottom - margin, top + margin


def _height(values: Array, limits: tuple[float, float]) -> list[int]:
    low, high = limits
    heights: list[int] = np.rint((high - values) / (high - low) * ROWS).astype(np.int64).tolist()
    return heights


def _drawn(curve: Curve, window: Window, limits: tuple[float, float], max_gap: float) -> Iterator[str]:
    if curve.sigma is not None:
        yield _band(curve, window, limits, max_gap)
    begins = gaps(curve.t_ns, max_gap)
    choose = extremes if style_of(curve.role).mark == "line" else scattered
    rows = choose(curve.t_ns, curve.values, begins)
    x = window.columns(curve.t_ns[rows]).tolist()
    data = path(x, _height(curve.values[rows], limits), pieces(rows, begins), curve.role)
    yield f'<path class="curve" data-name="{escape(curve.name)}" d="{data}" {paint(curve.role)}/>'


def _band(curve: Curve, window: Window, limits: tuple[float, float], max_gap: float) -> str:
    assert curve.sigma is not None
    t_ns, low, high, parts = band(curve.t_ns, curve.values, curve.sigma, max_gap)
    x, bottom, top = window.columns(t_ns).tolist(), _height(low, limits), _height(high, limits)
    outline = []
    for part in parts:
        edge = [*zip(x[part], top[part], strict=True), *reversed(list(zip(x[part], bottom[part], strict=True)))]
        outline.append("M" + " ".join(f"{a} {b}" for a, b in edge) + "Z")
    return f'<path class="band" d="{"".join(outline)}" fill="{style_of(curve.role).color}"/>'


def _span(span: Span, window: Window) -> str:
    left, right = window.columns(np.array([span.start_ns, span.end_ns])).tolist()
    color = EVENTS.get(span.kind, OTHER_EVENT)
    return (
        f'<rect class="event" x="{left}" y="0" width="{right - left}" height="{ROWS}" fill="{color}" stroke="{color}">'
        f"<title>{escape(words(span.kind))}</title></rect>"
    )


def _level(level: float, low: float, high: float) -> str:
    height = round((high - level) / (high - low) * ROWS)
    return f'<path class="level" d="M0 {height}H{COLUMNS}"/>'


def _value_axis(panel: Panel, low: float, high: float) -> Iterator[str]:
    step = turn_step(high - low) if panel.circular else nice_step(high - low, 5)
    for value in ticks(low, high, step):
        y = BOTTOM - (value - low) / (high - low) * (BOTTOM - TOP)
        shown = value % 360.0 if panel.circular else value
        yield f'<path class="grid" d="M{LEFT} {y:.1f}H{RIGHT}"/>'
        yield f'<text class="left" x="{LEFT - 6}" y="{min(y + 4.0, BOTTOM):.1f}">{_number(shown, step)}</text>'


def turn_step(span: float) -> float:
    """Degrees between the marks of an axis of headings: parts of a turn where it spans more than a little."""
    return nice_step(span, 5, _TURNS if span > 60.0 else ())


def _second_axis(low: float, high: float) -> Iterator[str]:
    step = nice_step(high - low, 5)
    for value in ticks(low, high, step):
        y = BOTTOM - (value - low) / (high - low) * (BOTTOM - TOP)
        yield f'<path class="tick" d="M{RIGHT} {y:.1f}h5"/>'
        yield f'<text x="{RIGHT + 8}" y="{min(y + 4.0, BOTTOM):.1f}">{_number(value, step)}</text>'


def _time_axis(first: float, last: float) -> Iterator[str]:
    step = nice_step(last - first, 9, _TIMES if last - first > 9.0 else ())
    yield '<g class="times">'
    for value in ticks(first, last, step):
        x = LEFT + (value - first) / (last - first) * (RIGHT - LEFT)
        yield f'<path class="grid" d="M{x:.1f} {TOP}V{BOTTOM}"/>'
        yield f'<text class="time" x="{x:.1f}" y="{BOTTOM + 16}">{clock(value, step)}</text>'
    yield "</g>"


def _number(value: float, step: float) -> str:
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    digits += round(step * 10**digits, 6) != round(step * 10**digits)
    return f"{value:.{digits}f}".replace("-", "−") if round(value, digits) else f"{0:.{digits}f}"


def _sample(role: str) -> str:
    return "M0 5H26" if style_of(role).mark == "line" else "M5 5h.1M13 5h.1M21 5h.1"


def _band_sample(role: str) -> str:
    return f'<path class="band" d="M0 0H26V10H0Z" fill="{style_of(role).color}"/>'
