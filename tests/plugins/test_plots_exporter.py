"""exporter.plots: figures of what there is, whose curves read back as the rows of the streams."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from browser import pixels
from exporter_tables import drive, fixes, happened

from recon.errors import NothingToExport, PluginError
from recon.manifest import RunInfo
from recon.numerics.rotation import from_euler
from recon_exporters._panels import panels_of
from recon_exporters._track_map import paths_of
from recon_exporters.plots import PlotsParams, _over_time, _track, declare_exporters, plots

SVG = "{http://www.w3.org/2000/svg}"
T_S = np.arange(0, 30.01, 0.1)
SPEED = 10.0 + np.sin(T_S)
VEL = np.column_stack((SPEED, 0.0 * SPEED, 0.0 * SPEED))


def streams(**others: Any) -> dict[str, Any]:
    return {"trajectory": drive(T_S, vel=VEL, vel_std=np.full((len(T_S), 3), 0.1)), **others}


def export(folder: Path, made: dict[str, Any], **params: Any) -> dict[str, Path]:
    paths = plots(streams=made, folder=folder, about=RunInfo("run"), params=PlotsParams(**params))
    return {path.stem: path for path in paths}


def test_the_record_keeps_the_rules_of_its_role():
    (record,) = declare_exporters()
    assert record.faults() == []


def test_there_is_a_figure_for_all_that_can_be_drawn(tmp_path):
    made = export(tmp_path, streams(gnss=fixes(np.arange(30)), events=happened((3, 4))))
    assert list(made) == ["track", "motion", "attitude"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in made.values())


def test_a_curve_of_an_svg_reads_back_as_the_rows_of_the_stream(tmp_path):
    """The least squared map of drawn to true values leaves what 6 digits of an SVG's coordinates leave."""
    root = ElementTree.parse(export(tmp_path, streams(), format="svg")["motion"]).getroot()
    (group,) = [node for node in root.iter(f"{SVG}g") if node.get("id") == "speed:trajectory"]
    line = next(group.iter(f"{SVG}path")).get("d") or ""
    drawn = np.array(re.findall(r"[ML] (-?[\d.]+) (-?[\d.]+)", line), dtype=float)
    assert len(drawn) == len(T_S)
    for column, wanted in ((0, T_S), (1, SPEED)):
        fit = np.polyfit(drawn[:, column], wanted, 1)
        step = abs(fit[0]) * 1e-5  # units of the drawing, to 1e-6 rounded in points
        assert np.abs(np.polyval(fit, drawn[:, column]) - wanted).max() < step


def test_headings_of_more_than_a_turn_are_marked_at_parts_of_a_turn(tmp_path):
    """Two turns: in steps of 200 deg the marks would read 0, 200, 40, 240."""
    turning = drive(T_S, q=from_euler(np.linspace(0.0, 4.0 * np.pi, len(T_S)), 0.0, 0.0))
    drawn = export(tmp_path, {"trajectory": turning}, format="svg")["attitude"].read_text()
    marks = re.findall(r">(\d+)<", drawn[: drawn.index("Heading")])
    assert set(marks) == {"0", "180"}


def test_the_picture_shows_the_curve(tmp_path):
    from matplotlib.image import imread

    picture = np.rint(imread(export(tmp_path, streams())["motion"])[..., :3] * 255)
    assert picture.shape[1] == pytest.approx(170 / 25.4 * 200, abs=1)
    assert pixels(picture, "#0072b2") > 1000


@pytest.mark.parametrize("width", [60.0, 85.0, 170.0])
def test_titles_and_keys_stand_clear_of_each_other_however_narrow(width):
    from matplotlib.text import Text

    panels = panels_of(streams(gnss=fixes(np.arange(30))))
    figure = _over_time(panels, [], 0, PlotsParams(width=width * 1e-3))
    figure.draw_without_rendering()
    for axes, panel in zip(figure.axes, panels, strict=False):
        (title,) = [text for text in axes.findobj(Text) if text.get_text().replace("\n", " ") == panel.title]
        box, key = title.get_window_extent(), axes.get_legend().get_window_extent()
        assert not box.overlaps(key)
        assert figure.bbox.x0 <= min(box.x0, key.x0)
        assert max(box.x1, key.x1) <= figure.bbox.x1 + 1.0


def test_a_dot_of_the_key_is_large_enough_to_tell_its_colour(tmp_path):
    """A fix is drawn with a radius of 0.96 pt and the key with twice that: a shape of at least 3.5 pt."""
    root = ElementTree.parse(export(tmp_path, streams(gnss=fixes(np.arange(30))), format="svg")["track"]).getroot()
    (key,) = [node for node in root.iter(f"{SVG}g") if (node.get("id") or "").startswith("legend")]
    marks = [path.get("d") or "" for defs in key.iter(f"{SVG}defs") for path in defs.iter(f"{SVG}path")]
    sizes = [np.ptp(np.array(re.findall(r"-?\d+\.?\d*", mark), dtype=float)) for mark in marks]
    assert max(sizes) > 3.5


def test_equal_runs_give_equal_bytes(tmp_path):
    for kind in ("png", "svg"):
        (tmp_path / kind).mkdir()
        first, second = export(tmp_path, streams(), format=kind), export(tmp_path / kind, streams(), format=kind)
        assert all(first[name].read_bytes() == second[name].read_bytes() for name in first)


def test_nothing_to_draw_is_said(tmp_path):
    with pytest.raises(NothingToExport, match="nothing to draw"):
        export(tmp_path, {})


def test_without_matplotlib_one_sentence_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(PluginError) as caught:
        export(tmp_path, streams())
    assert str(caught.value) == 'exporter.plots needs matplotlib\n  pip install "recon-dynamics[report]"'


def test_the_module_loads_without_matplotlib():
    code = "import recon_exporters.plots, sys; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(
    ("across_m", "along_m", "width_mm"),
    [(0.0, 900.0, 60.0), (100.0, 220.0, 85.0), (900.0, 900.0, 170.0), (900.0, 0.0, 170.0)],
)
def test_the_figure_of_a_track_is_as_narrow_as_the_track_and_its_words_stand_inside(across_m, along_m, width_mm):
    """A straight way to the north would leave a page blank: 1.1 widths of a page high, and 60 mm wide at least."""
    share = np.linspace(0.0, 1.0, len(T_S))
    place = np.column_stack((across_m * share, along_m * share, 0.0 * share))
    tracks, _ = paths_of({"trajectory": drive(T_S, pos=place, lat=None, lon=None)})
    figure = _track(tracks, True, PlotsParams())
    assert figure.get_figwidth() * 25.4 == pytest.approx(width_mm)
    figure.draw_without_rendering()
    (axes,) = figure.axes
    words = [axes.xaxis.label, axes.yaxis.label, *figure.legends]
    boxes = [part.get_window_extent() for part in words]
    assert min(box.x0 for box in boxes) >= 0.0
    assert max(box.x1 for box in boxes) <= figure.bbox.width
