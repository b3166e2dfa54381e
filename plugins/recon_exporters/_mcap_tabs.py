"""The plots of a layout for Foxglove, in tabs: the crash, motion, attitude, sigmas, sensors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from colorsys import hls_to_rgb, rgb_to_hls
from dataclasses import dataclass, field
from typing import Any, Final

import pyarrow as pa

from recon.tables import Array, has
from recon_exporters._mcap_plots import HIGH, LOW, SIGMAS, is_of
from recon_exporters._panels import Curve, Panel, Source
from recon_exporters._style import on_dark
from recon_exporters._viewers import axes_of, sensor_groups, shown_in_degrees, shown_unit
from recon_exporters._words import words

Json = dict[str, Any]

_DEGREES: Final = ".@rad2deg"
_TABS: Final = {"motion": "Motion", "attitude": "Attitude"}
_SIGMA_TITLES: Final = {
    "pos_std": "Sigma of position [m]",
    "vel_std": "Sigma of velocity [m/s]",
    "att_std": "Sigma of attitude [°]",
}
_LINE_LIGHT, _EDGE_LIGHT = 0.6, 0.85
"""Lightness of colours, of 1: Studio draws each value as a dot that is darker by 0.3, which else would be black."""
_AXIS_ROLES: Final = ("x", "y", "z")
_FURTHER_ROLES: Final = tuple(f"trajectory {number}" for number in (1, 2, 3, 4))
_BEFORE_S, _AFTER_S = 0.1, 0.4
"""Around time zero of a crash: its pulse, which lasts some 100 ms."""


@dataclass(frozen=True)
class Shown:
    """What the file holds.

    topics : of its channels that have messages; places : (n, 3) m in the frame `local` by stream; kinds : of events
    start_ns : its first time; impact_ns : time zero of the severest crash, None without one
    """

    topics: frozenset[str]
    streams: Mapping[str, pa.Table]
    sources: Sequence[Source]
    panels: Sequence[Panel]
    places: Mapping[str, Array]
    kinds: Sequence[str]
    start_ns: int
    impact_ns: int | None


@dataclass
class Layout:
    """Configurations of panels by their names."""

    panels: dict[str, Json] = field(default_factory=dict)

    def add(self, kind: str, name: str, **config: Any) -> str:
        """A panel; its name in the tree."""
        key = f"{kind}!{name}"
        self.panels[key] = config
        return key


def tabs_of(made: Layout, shown: Shown) -> dict[str, list[str]]:
    """Names of plots by tab."""
    tabs: dict[str, list[str]] = {}
    if shown.impact_ns is not None:
        tabs["Crash"] = list(_crash_plots(made, shown))
    named: set[str] = set()
    for panel in shown.panels:
        lines = [line for curve in panel.curves for line in _lines(panel, curve, shown)]
        if panel.group in _TABS and lines:
            names = {curve.name for curve in panel.curves}
            title = f"{panel.title} [{panel.unit}]"
            plot = _plot(made, panel.key, title, lines, legend=len(names) > 1 and not names <= named)
            tabs.setdefault(_TABS[panel.group], []).append(plot)
            named |= names
    tabs["Sigmas"] = list(_sigma_plots(made, shown))
    tabs["Sensors"] = list(_sensor_plots(made, shown))
    return tabs


def _plot(
    made: Layout,
    name: str,
    title: str,
    lines: Sequence[Json],
    *,
    legend: bool = True,
    window_s: tuple[float, float] | None = None,
) -> str:
    config: Json = {
        "foxglovePanelTitle": title,
        "paths": list(lines),
        "xAxisVal": "timestamp",
        "isSynced": window_s is None,
        "showLegend": True,
        "legendDisplay": "floating" if legend else "none",
        "showPlotValuesInLegend": False,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "sidebarDimension": 240,
    }
    if window_s is not None:
        config |= {"minXValue": round(window_s[0], 3), "maxXValue": round(window_s[1], 3)}
    return made.add("Plot", name, **config)


def _line(path: str, label: str, role: str, light: float = _LINE_LIGHT) -> Json:
    color = _lighter(on_dark(role), light)
    return {"value": path, "label": label, "color": color, "enabled": True, "timestampMethod": "receiveTime"}


def _lighter(color: str, light: float) -> str:
    """The colour #RRGGBB with at least that lightness."""
    hue, lightness, saturation = rgb_to_hls(*(part / 255.0 for part in bytes.fromhex(color[1:])))
    parts = hls_to_rgb(hue, max(lightness, light), saturation)
    return "#" + "".join(f"{round(255.0 * part):02X}" for part in parts)


def _lines(panel: Panel, curve: Curve, shown: Shown) -> Iterator[Json]:
    """A curve, and the edges of its band; none where no topic holds it, as a speed that is derived for a plot."""
    stream = next((source.stream for source in shown.sources if is_of(curve, source)), None)
    if stream is None and not has(shown.streams.get(curve.name), panel.key):
        return
    path = f"/{curve.name}.{panel.key}" if stream is None else f"/{stream}/motion.{panel.key}"
    if stream is not None and curve.sigma is not None:
        for edge, sign in ((LOW, "−"), (HIGH, "+")):
            yield _line(f"{path}_{edge}", f"{sign} 2σ", curve.role, _EDGE_LIGHT)
    yield _line(path, curve.name, curve.role)


def _sigma_plots(made: Layout, shown: Shown) -> Iterator[str]:
    """Of the first trajectory."""
    for source in shown.sources[:1]:
        for group, axes in SIGMAS.items():
            if has(source.table, group):
                lines = [
                    _line(f"/{source.stream}/motion.{group}_{axis}", words(f"std_{axis}").removeprefix("sigma "), role)
                    for axis, role in zip(axes, _AXIS_ROLES, strict=True)
                ]
                yield _plot(made, group, _SIGMA_TITLES[group], lines)


def _sensor_plots(made: Layout, shown: Shown) -> Iterator[str]:
    """Without magnetometers, whose field is lost among the three decimals of Studio's axes."""
    named: set[str] = set()
    for stream, group, columns in sensor_groups(shown.streams):
        unit = columns[0].unit
        if unit == "T":
            continue
        size = _DEGREES if shown_in_degrees(unit) else ""
        names = [column.name.removeprefix(f"{group}_") for column in columns]
        axes = axes_of(columns)
        roles = _FURTHER_ROLES if axes is None else [_AXIS_ROLES[axis] for axis in axes]
        lines = [
            _line(f"/{stream}.{column.name}{size}", name, role)
            for column, name, role in zip(columns, names, roles, strict=False)
        ]
        title = f"{words(group)} of {stream} [{shown_unit(unit)}]"
        legend = len(names) > 1 and not set(names) <= named
        yield _plot(made, f"{stream}_{group}", title, lines, legend=legend)
        named |= set(names)


def _crash_plots(made: Layout, shown: Shown) -> Iterator[str]:
    """The pulse of the severest crash from close by."""
    zero = ((shown.impact_ns or 0) - shown.start_ns) * 1e-9
    window = (zero - _BEFORE_S, zero + _AFTER_S)
    moved = [source.stream for source in shown.sources if has(source.table, "accel")]
    stream, topic = (moved[0], f"/{moved[0]}/motion") if moved else ("imu", "/imu")
    axes = [axis for axis in "xyz" if has(shown.streams.get(stream), f"accel_{axis}")]
    if axes:
        lines = [_line(f"{topic}.accel_{axis}", axis, axis) for axis in axes]
        title = f"Acceleration at the crash, {stream} [m/s²]"
        yield _plot(made, "crash_accel", title, lines, window_s=window)
    for panel in shown.panels:
        if panel.key == "speed":
            lines = [line for curve in panel.curves for line in _lines(panel, curve, shown)]
            if lines:
                yield _plot(made, "crash_speed", f"Speed at the crash [{panel.unit}]", lines, window_s=window)
