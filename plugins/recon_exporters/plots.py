"""Figures for papers, as PNG or SVG, drawn by Matplotlib: what the report shows.

    track         from above; east and north in m about the middle of the map, no wider than the track asks for
    motion        speed, accelerations and turn rate over time
    attitude      heading, pitch, roll and height over time
    uncertainty   sigma of the position over time
    residuals     value / sigma of each sensor and component over time
    sensors       specific force and turn rates, where nothing says how the vehicle moved

One file for each of which there is something to draw, as wide as a page or a column of it. Bands are two sigma to
either side. Lines of many rows are thinned as in the report (see _decimate). The same figure gives the same bytes. In
an SVG the curves carry ids, <panel>:<name>.

References
    Hunter (2007), "Matplotlib: a 2D graphics environment", Computing in Science and Engineering 9 (3).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from textwrap import wrap
from typing import Any, Final, Literal

import numpy as np
import pyarrow as pa

from recon.errors import NothingToExport
from recon.extras import needs
from recon.hookspecs import hookimpl
from recon.manifest import RunInfo
from recon.parameters import Params, quantity, setting
from recon.recording import Recording
from recon.stages import Exporter
from recon_exporters._chart import Span, spans_of, turn_step
from recon_exporters._decimate import band, extremes, gaps, pieces, scattered
from recon_exporters._panels import Curve, Panel, panels_of
from recon_exporters._style import EVENTS, OTHER_EVENT, layer, style_of
from recon_exporters._track_map import Path as Track
from recon_exporters._track_map import paths_of
from recon_exporters._words import words

_INCH: Final = 0.0254
_PANEL_HEIGHT: Final = 0.036
"""Of a panel over time, m."""
_TALLEST: Final = 1.1
"""Height of the track's figure, in widths of a page or column."""
_NARROWEST: Final = 0.06
"""Width of the track's figure, m, at least."""
_MARGIN: Final = 0.015
"""Beside the axes, m."""
_LETTER, _TICK, _KEY = 0.0016, 0.014, 0.028
"""Width of a letter of a label, of the number of a tick with what parts it from the next, of a name in the key, m."""
_RC: Final[Any] = {
    "font.size": 8.0,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "grid.color": "#e4e6e8",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.markerscale": 2.0,
    "path.simplify": False,
    "svg.hashsalt": "recon",
    "svg.fonttype": "none",
}


class PlotsParams(Params):
    """Parameters of exporter.plots."""

    format: Literal["png", "svg"] = setting("png", doc="Pixels, or lines that can be scaled.")
    width: float = quantity(170.0, "mm", ge=60, le=1000, doc="Of the figures: 170 mm a page, 85 mm a column.")
    dots_per_inch: int = setting(200, ge=50, le=1200, doc="Pixels of a PNG in 25.4 mm.")
    max_gap: float = quantity(2.0, "s", gt=0, doc="No line joins rows that are further apart.")


def plots(*, streams: Mapping[str, pa.Table], folder: Path, about: RunInfo, params: PlotsParams) -> list[Path]:
    """Write `folder/<figure>.<format>`; the paths.

    Raises NothingToExport where there is nothing to draw, PluginError where Matplotlib is not installed.
    """
    with needs("exporter.plots", "matplotlib", extra="report"):
        from matplotlib import rc_context
    panels = panels_of(streams)
    groups = {panel.group: [p for p in panels if p.group == panel.group] for panel in panels}
    tracks, placed = paths_of(streams)
    if not groups and not tracks:
        raise NothingToExport("no stream has a position, speed or attitude: there is nothing to draw")
    start = (Recording(streams).span_ns() or (0, 0))[0]
    paths = []
    with rc_context(_RC):
        if tracks:
            paths.append(_save(_track(tracks, placed is not None, params), folder / "track", params))
        for group, members in groups.items():
            figure = _over_time(members, spans_of(streams.get("events")), start, params)
            paths.append(_save(figure, folder / group, params))
    return paths


def _save(figure: Any, path: Path, params: PlotsParams) -> Path:
    target = path.with_suffix(f".{params.format}")
    undated = {"png": {"Software": None}, "svg": {"Date": None}}[params.format]
    figure.savefig(target, dpi=params.dots_per_inch, metadata=undated)
    return target


def _figure(width: float, height: float) -> Any:
    from matplotlib.figure import Figure

    return Figure(figsize=(width / _INCH, height / _INCH), layout="constrained")


def _track(tracks: Sequence[Track], placed: bool, params: PlotsParams) -> Any:
    """From above; narrower than the other figures where the track is, which they would leave blank."""
    across, up = np.maximum(np.ptp(np.concatenate([one.xy for one in tracks]), axis=0), 1.0)
    width = float(np.clip(params.width * _TALLEST * across / up, _NARROWEST, params.width))
    figure = _figure(width, params.width * float(np.clip(up / across, 0.4, _TALLEST)))
    axes = figure.add_subplot()
    for one in tracks:
        begins = gaps(one.t_ns, params.max_gap)
        x, y = (np.insert(values, np.flatnonzero(begins), np.nan) for values in one.xy.T)
        axes.plot(x, y, label=one.name, gid=f"track:{one.name}", **_paint(one.role))
    axes.set_aspect("equal", adjustable="datalim")
    around = "of the middle of the track" if placed else "in the local frame"
    label = wrap(f"east {around} [m]", int((width - _MARGIN) / _LETTER))
    axes.set(xlabel="\n".join(label), ylabel="north [m]")
    axes.locator_params(axis="x", nbins=min(9, int(width / _TICK)))
    figure.legend(loc="outside upper center", ncols=max(1, int(width / _KEY)))
    return figure


def _over_time(panels: Sequence[Panel], spans: Sequence[Span], start_ns: int, params: PlotsParams) -> Any:
    from matplotlib.ticker import MultipleLocator

    figure = _figure(params.width, _PANEL_HEIGHT * len(panels) + 0.012 + (0.006 if spans else 0.0))
    rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, panel in zip(rows, panels, strict=True):
        _shade(axes, spans, start_ns)
        for curve in panel.curves:
            _draw(axes, panel, curve, start_ns, params.max_gap)
        for level in panel.levels:
            axes.axhline(level, color="#777777", linewidth=0.6, linestyle=(0, (4, 3)))
        axes.set_ylabel(f"[{panel.unit}]")
        axes.margins(x=0.0)
        if panel.circular:
            low, high = axes.get_ylim()
            axes.yaxis.set_major_locator(MultipleLocator(turn_step(high - low)))
            axes.yaxis.set_major_formatter(lambda value, _: f"{value % 360.0:g}")
        if panel.second:
            _second_axis(axes, *panel.second)
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=5, fontsize=7.0, borderaxespad=0.1)
    rows[-1].set_xlabel("time after the start [s]")
    figure.align_ylabels(rows)
    _shades_key(figure, spans)
    _name(figure, rows, panels)
    return figure


def _name(figure: Any, rows: Sequence[Any], panels: Sequence[Panel]) -> None:
    """Titles stand beside the keys of the curves, or above, in lines that fit, where there is no room for both."""
    titles = [axes.set_title(panel.title, loc="left", fontsize=8.0) for axes, panel in zip(rows, panels, strict=True)]
    figure.draw_without_rendering()
    points = 72.0 / figure.dpi
    for axes, panel, title in zip(rows, panels, titles, strict=True):
        room, wide, key = axes.bbox.width, title.get_window_extent().width, axes.get_legend().get_window_extent()
        if wide + key.width > room:
            lines = wrap(panel.title, int(len(panel.title) * room / wide))
            axes.set_title("\n".join(lines), loc="left", fontsize=8.0, pad=points * key.height + 1.0)
            figure.set_figheight(figure.get_figheight() + len(lines) * title.get_window_extent().height / figure.dpi)


def _draw(axes: Any, panel: Panel, curve: Curve, start_ns: int, max_gap: float) -> None:
    """A line is interrupted before each row that begins a piece."""
    style, begins = style_of(curve.role), gaps(curve.t_ns, max_gap)
    choose = extremes if style.mark == "line" else scattered
    rows = choose(curve.t_ns, curve.values, begins)
    name = f"{panel.key}:{curve.name}"
    cuts = [part.start for part in pieces(rows, begins)[1:]]
    x, y = (np.insert(v, cuts, np.nan) for v in ((curve.t_ns[rows] - start_ns) * 1e-9, curve.values[rows]))
    label = curve.name if curve.sigma is None else f"{curve.name} ± 2σ"
    axes.plot(x, y, label=label, gid=name, **_paint(curve.role))
    if curve.sigma is not None:
        t_ns, low, high, parts = band(curve.t_ns, curve.values, curve.sigma, max_gap)
        cuts = [part.start for part in parts[1:]]
        edges = (np.insert(v, cuts, np.nan) for v in ((t_ns - start_ns) * 1e-9, low, high))
        axes.fill_between(*edges, color=style.color, alpha=0.25, linewidth=0.0, gid=f"{name}:band")


def _paint(role: str) -> dict[str, Any]:
    style = style_of(role)
    facts: dict[str, Any] = {"color": style.color, "zorder": 2.0 + 0.1 * layer(role)}
    if style.mark == "line":
        return {**facts, "linewidth": 0.7 * style.width, "linestyle": (0, style.dashes) if style.dashes else "-"}
    marker = {"dots": "o", "squares": "s"}[style.mark]
    return {**facts, "linestyle": "none", "marker": marker, "markersize": 0.6 * style.width, "markeredgewidth": 0.0}


def _shade(axes: Any, spans: Sequence[Span], start_ns: int) -> None:
    for span in spans:
        first, last = ((t_ns - start_ns) * 1e-9 for t_ns in (span.start_ns, span.end_ns))
        color = EVENTS.get(span.kind, OTHER_EVENT)
        axes.axvspan(first, last, facecolor=color, edgecolor=color, alpha=0.2, linewidth=0.5, zorder=0.5)


def _shades_key(figure: Any, spans: Sequence[Span]) -> None:
    """What the shades mean, below the panels."""
    from matplotlib.patches import Patch

    kinds = dict.fromkeys(span.kind for span in spans)
    keys = [Patch(color=EVENTS.get(kind, OTHER_EVENT), alpha=0.35, label=words(kind)) for kind in kinds]
    if keys:
        figure.legend(handles=keys, loc="outside lower center", ncols=5, fontsize=7.0)


def _second_axis(axes: Any, unit: str, factor: float) -> None:
    second = axes.secondary_yaxis("right", functions=(lambda value: value * factor, lambda value: value / factor))
    second.set_ylabel(f"[{unit}]")


@hookimpl
def declare_exporters() -> Iterable[Exporter]:
    """The exporter of figures."""
    yield Exporter(
        name="plots",
        summary="Figures for papers, as PNG or SVG: track, motion, attitude, uncertainty, residuals.",
        params=PlotsParams,
        run=plots,
        every_stream=True,
        made_with=("matplotlib",),
    )
