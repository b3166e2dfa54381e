"""How the Rerun viewer opens the file: map and space to the left, plots to the right, events below them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from recon_exporters._panels import Panel
from recon_exporters._rerun_space import Drawn
from recon_exporters._viewers import map_zoom


@dataclass(frozen=True)
class Shown:
    """What a file holds.

    span_ns : first and last time, ns since 1970
    panels : of the folder plots; sensors : titles by path; kinds : of events; cameras : streams with pictures
    """

    span_ns: tuple[int, int]
    space: Drawn
    panels: Sequence[Panel]
    sensors: Mapping[str, str]
    kinds: Sequence[str]
    cameras: Sequence[str]


_TABS: Final = {"motion": "Motion", "attitude": "Motion", "uncertainty": "Sigmas", "residuals": "Residuals"}
"""Tab of each group of panels."""


def layout(shown: Shown) -> rrb.Blueprint:
    """The layout of all that there is."""
    begin, end = (rrb.TimeRangeBoundary.absolute(nanos=t_ns) for t_ns in shown.span_ns)
    whole = rrb.TimeAxis(view_range=rrb.TimeRange(begin, end))
    left = list(_space(shown))
    right = [rrb.Tabs(*_tabs(shown, whole))]
    if shown.kinds:
        lanes = rrb.StateTimelineView(origin="events", name="Events", time_view=whole)
        columns = rrb.TextLogColumns(text_log_columns=["body"])
        told = rrb.TextLogView(origin="events_as_text", name="Events as text", columns=columns)
        right.append(rrb.Tabs(lanes, told))
    sides = [rrb.Vertical(*left)] if left else []
    sides.append(rrb.Vertical(*right, row_shares=[5, 1][: len(right)]))
    root = rrb.Horizontal(*sides, column_shares=[2, 3][-len(sides) :])
    return rrb.Blueprint(
        root, rrb.TimePanel(state="collapsed", timeline="time", play_state="paused"), collapse_panels=True
    )


def _space(shown: Shown) -> Iterable[rrb.View]:
    space = shown.space
    if space.on_map:
        yield rrb.MapView(origin="map", name="Map", zoom=map_zoom(space.reach))
    elif space.reach > 0.0:
        yield _overview(space)
    if space.bodies:
        yield _beside(space)
    for name in shown.cameras:
        yield rrb.Spatial2DView(origin=f"camera/{name}", name=f"Camera {name}")


def _overview(space: Drawn) -> rrb.View:
    eye = space.center + np.array([0.0, -0.4, 1.0]) * 2.8 * max(space.reach, 5.0)
    controls = rrb.EyeControls3D(position=eye, look_target=space.center, eye_up=(0.0, 0.0, 1.0))
    return rrb.Spatial3DView(origin="world", name="Way, from above", eye_controls=controls)


def _beside(space: Drawn) -> rrb.View:
    controls = rrb.EyeControls3D(
        position=(-11.0, -7.0, 6.0),
        look_target=(0.0, 0.0, 0.0),
        tracking_entity=rr.new_entity_path(["world", space.bodies[0], "body"]),
    )
    return rrb.Spatial3DView(origin="world", name="Vehicle", eye_controls=controls)


def _tabs(shown: Shown, whole: rrb.TimeAxis) -> Iterable[rrb.Container | rrb.View]:
    for name in dict.fromkeys(_TABS.values()):
        panels = [panel for panel in shown.panels if _TABS[panel.group] == name]
        if panels:
            yield _grid(name, list(_panel_views(panels, whole)))
    if shown.sensors:
        yield _grid("Sensors", [_plot(path, title, whole, legend=True) for path, title in shown.sensors.items()])
    yield rrb.TextDocumentView(origin="about", name="About")


def _grid(name: str, views: list[rrb.View]) -> rrb.Container:
    return rrb.Grid(*views, grid_columns=1 if len(views) < 4 else 2, name=name)


def _panel_views(panels: Sequence[Panel], whole: rrb.TimeAxis) -> Iterable[rrb.View]:
    """A legend stands where a curve is first named: it hides data, and colours mean the same throughout."""
    named: set[str] = set()
    for panel in panels:
        names = {curve.name for curve in panel.curves}
        path = rr.new_entity_path(["plots", panel.key])
        yield _plot(path, f"{panel.title} [{panel.unit}]", whole, legend=len(names) > 1 and not names <= named)
        named |= names


def _plot(path: str, title: str, whole: rrb.TimeAxis, *, legend: bool) -> rrb.View:
    return rrb.TimeSeriesView(
        origin=path, name=title, axis_x=whole, plot_legend=rrb.PlotLegend("lefttop", visible=legend)
    )
