"""exporter.kml: KML 2.2 with gx tracks, read back with an XML parser that knows nothing of us.

A place is written to 1e-9 deg and other numbers to 1e-3, so they read back within half of that.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from exporter_tables import drive, fixes, happened

from recon.errors import NothingToExport
from recon.manifest import RunInfo
from recon.tables import vector, with_meta
from recon_exporters import kml as module
from recon_exporters.kml import MapParams

HALF_PLACE = 0.51e-9
HALF_NUMBER = 0.51e-3
NAMESPACES = {"k": "http://www.opengis.net/kml/2.2", "gx": "http://www.google.com/kml/ext/2.2"}
TENTHS = np.arange(0, 101) / 10


def export(folder: Path, *, trajectory=None, gnss=None, events=None, name="run", **params) -> ElementTree.Element:
    (path,) = module.kml(
        trajectory=trajectory, gnss=gnss, events=events, folder=folder, about=RunInfo(name), params=MapParams(**params)
    )
    assert path == folder / "track.kml"
    return ElementTree.parse(path).getroot()


def tags(element: ElementTree.Element) -> list[str]:
    """Names of the children; those of Google's extension with the prefix gx."""
    return [
        child.tag.replace(f"{{{NAMESPACES['k']}}}", "").replace(f"{{{NAMESPACES['gx']}}}", "gx:") for child in element
    ]


def texts(element: ElementTree.Element, path: str) -> list[str]:
    return [found.text or "" for found in element.findall(path, NAMESPACES)]


def places(element: ElementTree.Element) -> np.ndarray:
    return np.array([text.split(" ") for text in texts(element, ".//gx:coord")], dtype=np.float64)


def test_the_record_keeps_the_rules_of_its_role():
    (record,) = module.declare_exporters()
    assert record.faults() == []


def test_elements_stand_in_the_order_of_the_schema(tmp_path):
    root = export(tmp_path, trajectory=drive([0, 1, 9, 10]), gnss=fixes([0, 1]), events=happened((0, 1)))
    (document,) = root
    assert tags(document) == [
        "name", "description", "Style", "Style", "Schema", "Schema", "Placemark", "Placemark", "Placemark"
    ]  # fmt: skip
    trajectory, gnss, event = document.findall("k:Placemark", NAMESPACES)
    assert tags(trajectory) == tags(gnss) == ["name", "description", "styleUrl", "gx:MultiTrack"]
    assert tags(trajectory[-1]) == ["altitudeMode", "gx:interpolate", "gx:Track", "gx:Track"]
    assert tags(trajectory[-1][-1]) == ["altitudeMode", "when", "when", "gx:coord", "gx:coord", "ExtendedData"]
    assert tags(event) == ["name", "TimeSpan", "ExtendedData", "Point"]
    assert tags(event[-1]) == ["altitudeMode", "coordinates"]


def test_references_inside_the_file_lead_somewhere(tmp_path):
    root = export(tmp_path, trajectory=drive([0, 1, 9, 10]), gnss=fixes([0, 1]))
    named = {f"#{element.get('id')}" for element in root.iter() if element.get("id")}
    styles = set(texts(root, ".//k:styleUrl"))
    schemas = {data.get("schemaUrl") for data in root.findall(".//k:SchemaData", NAMESPACES)}
    assert styles | schemas == named
    fields = [field.get("name") for field in root.findall(".//k:Schema[1]/gx:SimpleArrayField", NAMESPACES)]
    first = root.find(".//gx:Track", NAMESPACES)
    assert [data.get("name") for data in first.findall(".//gx:SimpleArrayData", NAMESPACES)] == fields


def test_colours_are_those_of_the_viewer_opacity_first_and_red_last(tmp_path):
    """The trajectory sky blue #56B4E9, fixes orange #E69F00, as on the dark ground of Rerun."""
    root = export(tmp_path, trajectory=drive([0, 1]), gnss=fixes([0, 1]))
    assert texts(root, ".//k:LineStyle/k:color") == ["ffe9b456", "ff009fe6"]


def test_times_and_places_read_back(tmp_path):
    table = drive(TENTHS, datum="mean_sea_level")
    root = export(tmp_path, trajectory=table)
    off = np.abs(places(root) - np.column_stack([vector(table, name) for name in ("lon", "lat", "height")]))
    assert off[:, :2].max() < HALF_PLACE
    assert off[:, 2].max() < HALF_NUMBER
    assert texts(root, ".//k:when")[99:] == ["2024-05-01T08:00:09.900Z", "2024-05-01T08:00:10.000Z"]


@pytest.mark.parametrize(
    ("datum", "mode", "altitude"),
    [("mean_sea_level", "absolute", 101.0), ("ellipsoid", "clampToGround", 0.0), (None, "clampToGround", 0.0)],
)
def test_only_heights_above_mean_sea_level_are_altitudes(tmp_path, datum, mode, altitude):
    root = export(tmp_path, trajectory=drive(TENTHS, datum=datum), events=happened((10, 10)))
    assert set(texts(root, ".//k:altitudeMode")) == {mode}
    assert places(root)[-1, 2] == altitude
    point = texts(root, ".//k:Point/k:coordinates")[0].split(",")
    assert [float(number) for number in point] == [11.3002, 44.5001, *[101.0] * (mode == "absolute")]
    assert texts(root, ".//gx:SimpleArrayData[@name='height']/gx:value")[-1] == "101.000"


def test_one_unknown_height_puts_the_track_on_the_ground(tmp_path):
    height = np.full(101, 50.0)
    height[2] = np.nan
    root = export(tmp_path, trajectory=drive(TENTHS, datum="mean_sea_level", height=height))
    assert set(texts(root, ".//k:altitudeMode")) == {"clampToGround"}
    assert texts(root, ".//gx:SimpleArrayData[@name='height']/gx:value")[1:4] == ["50.000", "", "50.000"]


def test_a_gap_is_a_track_of_its_own_and_nothing_is_interpolated(tmp_path):
    root = export(tmp_path, trajectory=drive([0, 1, 9, 10, 11]))
    assert [len(track.findall("k:when", NAMESPACES)) for track in root.iter(f"{{{NAMESPACES['gx']}}}Track")] == [2, 3]
    assert texts(root, ".//gx:interpolate") == ["0"]


def test_every_row_has_a_time_a_place_and_all_its_facts(tmp_path):
    root = export(tmp_path, trajectory=drive(TENTHS, pos_std=np.full((101, 3), 0.25)), gnss=fixes([0, 1, 9]))
    for track in root.iter(f"{{{NAMESPACES['gx']}}}Track"):
        count = len(track.findall("k:when", NAMESPACES))
        assert len(track.findall("gx:coord", NAMESPACES)) == count
        for data in track.findall(".//gx:SimpleArrayData", NAMESPACES):
            assert len(data) == count
    facts = {name: texts(root, f".//gx:SimpleArrayData[@name='{name}']/gx:value")[1] for name in ("speed", "heading")}
    assert facts == {"speed": "5.000", "heading": "60.000"}
    assert texts(root, ".//gx:SimpleArrayData[@name='pos_std_u']/gx:value")[1] == "0.250"


def test_numbers_have_no_exponent_and_keep_their_sign(tmp_path):
    lon, lat = np.array([-0.000000123, -0.5, 1e-9]), np.array([-1e-10, -89.5, 1e-5])
    table = drive([0, 1, 2], lon=lon, lat=lat, height=np.array([-0.25, -0.0001, 1e6]), datum="mean_sea_level")
    assert texts(export(tmp_path, trajectory=table), ".//gx:coord") == [
        "-0.000000123 0.000000000 -0.250",
        "-0.500000000 -89.500000000 0.000",
        "0.000000001 0.000010000 1000000.000",
    ]


def test_an_event_lasts_on_the_time_slider_and_says_what_it_knows(tmp_path):
    found = happened((1, 3.5), kind="crash", value=42.5, unit="m/s^2")
    root = export(tmp_path, trajectory=drive(TENTHS), events=found)
    event = root.findall(".//k:Placemark", NAMESPACES)[-1]
    assert texts(event, "k:name") == ["crash"]
    assert texts(event, "k:TimeSpan/*") == ["2024-05-01T08:00:01.000Z", "2024-05-01T08:00:03.500Z"]
    told = {data.get("name"): data[0].text for data in event.findall(".//k:Data", NAMESPACES)}
    assert {name: told[name] for name in ("duration", "value", "unit")} == {
        "duration": "2.5", "value": "42.5", "unit": "m/s^2",
    }  # fmt: skip


def test_text_that_means_something_in_xml_survives(tmp_path):
    hostile = "a < b & \"c\" > 'd' ]]> naïve \U0001f697"
    root = export(tmp_path, trajectory=drive(TENTHS), events=happened((1, 2), kind=hostile, note=hostile), name=hostile)
    assert texts(root, "k:Document/k:name") == [hostile]
    event = root.findall(".//k:Placemark", NAMESPACES)[-1]
    assert texts(event, "k:name") == [hostile]
    assert hostile in [data[0].text for data in event.findall(".//k:Data", NAMESPACES)]


def test_characters_that_xml_cannot_hold_are_left_out(tmp_path):
    root = export(tmp_path, trajectory=drive(TENTHS), events=happened((1, 2), note="a\x00b\x1b\ufffe\tc"))
    assert "ab\tc" in texts(root, ".//k:Data/k:value")


def test_the_description_tells_of_thinning_and_datum(tmp_path):
    said = texts(export(tmp_path, trajectory=drive(TENTHS), rate=1.0), "k:Document/k:description")[0]
    assert "11 of 101 rows, at most 1 in a second" in said
    assert "heights are above the WGS84 ellipsoid" in said


def test_a_log_without_latitude_and_longitude_is_refused(tmp_path):
    local = with_meta(drive(TENTHS, lat=None, lon=None), height_datum=None)
    with pytest.raises(NothingToExport, match="no row of trajectory or gnss has a latitude and longitude"):
        export(tmp_path, trajectory=local)
    assert list(tmp_path.iterdir()) == []
