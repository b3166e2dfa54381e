"""What charts of reports and figures say beside their curves."""

from __future__ import annotations

import re

import numpy as np
import pytest
from exporter_tables import SECOND, START_NS, drive, fixes

from recon.schema import RESIDUALS
from recon.tables import build
from recon_exporters._chart import BOTTOM, Window, figure
from recon_exporters._panels import Curve, Panel, panels_of
from recon_exporters._style import on_dark, style_of

T_NS = START_NS + np.arange(60) * SECOND


@pytest.mark.parametrize(
    ("largest", "title"),
    [
        (7.9, "Residuals of GNSS position east"),
        (8.1, "Residuals of GNSS position east; those beyond 8 σ are drawn at 8 σ"),
    ],
)
def test_a_chart_of_residuals_says_where_far_ones_are_drawn(largest: float, title: str) -> None:
    residuals = build(
        RESIDUALS, time=T_NS, sensor=["gnss"] * 60, component=["pos_e"] * 60, value=np.linspace(0.0, largest, 60),
        sigma=np.ones(60), weight=np.ones(60), accepted=np.ones(60, dtype=bool),
    )  # fmt: skip
    assert [panel.title for panel in panels_of({"residuals": residuals})] == [title]


def test_a_value_at_the_lower_edge_stands_above_the_times() -> None:
    """A tick lies at the edge itself where the margin below the curve, 6 % of its span, ends in a round number."""
    curve = Curve("speed", "trajectory 1", T_NS, np.linspace(0.6, 10.6, 60))
    panel = Panel("speed", "Speed", "m/s", "motion", [curve], second=("km/h", 3.6))
    text = figure(panel, Window(int(T_NS[0]), int(T_NS[-1]), START_NS), (), 2.0)
    heights = [float(y) for y in re.findall(r'<text(?: class="left")? x="\S+" y="(\S+)">', text)]
    assert len(heights) >= 8
    assert max(heights) == BOTTOM


def test_of_gnss_alone_speed_as_derived_and_height_are_drawn_and_beside_a_trajectory_neither() -> None:
    t_s = np.arange(4.0)
    velocity = np.tile((3.0, 4.0, 1.0), (4, 1))
    alone = fixes(t_s, lat=np.full(4, 44.5), lon=np.full(4, 11.3), height=100.0 + t_s, vel=velocity)
    drawn = {panel.key: panel for panel in panels_of({"gnss": alone})}
    assert {key: [curve.role for curve in panel.curves] for key, panel in drawn.items()} == {
        "speed": ["gnss 1"], "height": ["gnss 1"],
    }  # fmt: skip
    assert drawn["speed"].curves[0].values.tolist() == [5.0] * 4
    assert drawn["height"].curves[0].values.tolist() == [100.0, 101.0, 102.0, 103.0]
    beside = {panel.key: panel for panel in panels_of({"gnss": alone, "trajectory": drive(t_s)})}
    assert [curve.name for key in ("speed", "height") for curve in beside[key].curves] == ["trajectory"] * 2


def test_what_shares_the_plot_of_speeds_has_colours_of_its_own_on_white_and_on_black() -> None:
    roles = ["trajectory 1", "reference", "wheel", "gnss 1", "gnss 2", "gnss 3"]
    assert len({style_of(role).color for role in roles}) == len(roles)
    assert len({on_dark(role) for role in roles}) == len(roles)
