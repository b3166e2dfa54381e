"""exporter.map: the places and speeds of the streams, on a page that asks nobody for anything where it is a file."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from browser import opened, pixels, seen
from exporter_tables import drive, fixes, happened

from recon.errors import NothingToExport
from recon.manifest import RunInfo
from recon.tables import vector
from recon_exporters.map import StreetMapParams, declare_exporters, street_map

TENTHS = np.arange(0, 301) / 10


def export(
    folder: Path, *, trajectory=None, gnss=None, events=None, name="run", **params
) -> tuple[Path, dict[str, Any]]:
    (path,) = street_map(
        trajectory=trajectory, gnss=gnss, events=events, folder=folder, about=RunInfo(name),
        params=StreetMapParams(**params),
    )  # fmt: skip
    (data,) = re.findall(r'id="data">(.*?)</script>', path.read_text(encoding="utf-8"), re.DOTALL)
    return path, json.loads(data)


def test_the_record_keeps_the_rules_of_its_role():
    (record,) = declare_exporters()
    assert record.faults() == []


def test_places_and_speeds_are_those_of_the_stream(tmp_path):
    table = drive(TENTHS)
    _, data = export(tmp_path, trajectory=table)
    (piece,) = data["tracks"][0]["pieces"]
    places = np.array(piece["place"])
    assert np.abs(places[:, 0] - vector(table, "lat")).max() <= 0.51e-9  # half of the last digit that is written
    assert np.abs(places[:, 1] - vector(table, "lon")).max() <= 0.51e-9
    assert piece["speed"] == [5.0] * 301
    assert piece["time"][1] == "2024-05-01T08:00:00.100Z"


def test_a_drive_over_the_antimeridian_goes_on(tmp_path):
    lon = (179.9999 + 1e-6 * np.arange(301) + 180.0) % 360.0 - 180.0
    late = fixes(TENTHS[200:], lon=lon[200:])
    _, data = export(tmp_path, trajectory=drive(TENTHS, lon=lon), gnss=late, events=happened((3, 4), (25, 26)))
    (piece,) = data["tracks"][0]["pieces"]
    assert np.diff([place[1] for place in piece["place"]]) == pytest.approx(np.full(300, 1e-6), abs=2e-9)
    everything = [*data["marks"], *({"place": place} for place in data["tracks"][1]["pieces"][0]["place"])]
    assert all(179.9 < one["place"][1] < 180.1 for one in everything)


def test_a_log_without_a_place_is_told_so(tmp_path):
    with pytest.raises(NothingToExport, match="which a map needs"):
        export(tmp_path, trajectory=drive(TENTHS, lat=None, lon=None))


def test_it_opens_from_a_file_on_a_blank_ground_without_an_error(tmp_path):
    gnss = fixes(np.arange(30), lat=44.5001 + 1e-5 * np.arange(30))
    path, _ = export(tmp_path, trajectory=drive(TENTHS), gnss=gnss, events=happened((3, 4)), name="<b>drive</b>")
    document, console = opened(path, tmp_path / "profile")
    assert console == []
    assert 'data-ready="1"' in document
    assert "&lt;b&gt;drive&lt;/b&gt;" in document
    assert "no street map: grid of" in document
    assert "tile.openstreetmap.org/" not in re.sub(r"<script.*?</script>", "", document, flags=re.DOTALL)
    picture = seen(path, tmp_path / "profile", 900, 600)
    assert pixels(picture, "#0072b2", 25) > 500
    assert pixels(picture, "#e69f00") > 200


def test_the_page_itself_loads_no_address(tmp_path):
    path, _ = export(tmp_path, trajectory=drive(TENTHS))
    text = path.read_text(encoding="utf-8")
    assert re.findall(r'<(?:script|link|img)[^>]*(?:src|href)="(?!data:)[^"]*"', text) == []
    assert "sourceMappingURL" not in text


def test_other_tiles_are_taken_as_they_are_named(tmp_path):
    _, data = export(tmp_path, trajectory=drive(TENTHS), tiles="https://t.example/{z}/{x}/{y}", attribution="<me>")
    assert (data["tiles"], data["attribution"]) == ("https://t.example/{z}/{x}/{y}", "&lt;me&gt;")


def test_a_crash_is_seen_though_other_events_begin_where_it_does(tmp_path):
    events = pa.concat_tables([happened((3, 4), kind=kind) for kind in ("saturation", "crash", "impact")])
    path, data = export(tmp_path, trajectory=drive(TENTHS), events=events)
    assert len({tuple(mark["place"]) for mark in data["marks"]}) == 1
    # A ring of 7 points across and 3 wide has some 130 of them; the legend's own has fewer.
    assert pixels(seen(path, tmp_path / "profile", 900, 600), "#d55e00", 25) > 130


def test_on_a_phone_the_legend_leaves_the_buttons_of_the_zoom_free(tmp_path):
    """Windows of Chromium are wider than a phone; a frame in one is not."""
    path, _ = export(tmp_path, trajectory=drive(TENTHS))
    phone = tmp_path / "phone.html"
    phone.write_text(f'<body style="margin:0"><iframe src="{path.name}" width="375" height="700" frameborder="0">')
    picture = seen(phone, tmp_path / "profile", 900, 800)
    assert pixels(picture[20:60, 100:375], "#ffffff", 0) > 0.5 * 40 * 275  # the legend
    between = picture[20:60, 50:85]  # the ground, and lines of its grid across
    assert pixels(between, "#fafbfb", 0) > 0.5 * 40 * 35
