"""exporter.gpx: the rules of the GPX 1.1 schema, checked element by element, and numbers that read back.

A place is written to 1e-9 deg and other numbers to 1e-3, so they read back within half of that.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from exporter_tables import drive, fixes, happened

from recon.errors import NothingToExport
from recon.manifest import RunInfo
from recon.tables import vector
from recon_exporters import gpx as module
from recon_exporters.gpx import MapParams

HALF_PLACE = 0.51e-9
HALF_NUMBER = 0.51e-3
GPX = "http://www.topografix.com/GPX/1/1"
NAMESPACES = {
    "g": GPX,
    "t": "http://www.garmin.com/xmlschemas/TrackPointExtension/v2",
    "r": "urn:recon:track:1",
}
TENTHS = np.arange(0, 101) / 10

POINT = (
    "ele", "time", "magvar", "geoidheight", "name", "cmt", "desc", "src", "link", "sym", "type", "fix", "sat", "hdop",
    "vdop", "pdop", "ageofdgpsdata", "dgpsid", "extensions",
)  # fmt: skip
SEQUENCES = {
    "gpx": ("metadata", "wpt", "rte", "trk", "extensions"),
    "metadata": ("name", "desc", "author", "copyright", "link", "time", "keywords", "bounds", "extensions"),
    "trk": ("name", "cmt", "desc", "src", "link", "number", "type", "extensions", "trkseg"),
    "trkseg": ("trkpt", "extensions"),
    "wpt": POINT,
    "trkpt": POINT,
}
"""The complex types of the schema that we use: children in their order; those in MANY may be repeated."""
MANY = ("wpt", "rte", "trk", "trkseg", "trkpt", "link")
DECIMAL = re.compile(r"[+-]?\d+(\.\d+)?")
DATE_TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?Z")


def export(folder: Path, *, trajectory=None, gnss=None, events=None, name="run", **params) -> ElementTree.Element:
    (path,) = module.gpx(
        trajectory=trajectory, gnss=gnss, events=events, folder=folder, about=RunInfo(name), params=MapParams(**params)
    )
    assert path == folder / "track.gpx"
    return ElementTree.parse(path).getroot()


def faults(element: ElementTree.Element) -> list[str]:
    """What the GPX 1.1 schema forbids in an element and below."""
    namespace, _, tag = element.tag.removeprefix("{").partition("}")
    if namespace != GPX:
        return [f"{tag} is of another namespace"]
    found = []
    if tag == "gpx" and (element.get("version") != "1.1" or not element.get("creator")):
        found.append("gpx without version or creator")
    if tag in ("wpt", "trkpt"):
        lat, lon = element.get("lat", ""), element.get("lon", "")
        if not (
            DECIMAL.fullmatch(lat) and DECIMAL.fullmatch(lon) and abs(float(lat)) <= 90 and -180 <= float(lon) < 180
        ):
            found.append(f"{tag} at {lat}, {lon}")
    if tag == "ele" and not DECIMAL.fullmatch(element.text or ""):
        found.append(f"ele {element.text}")
    if tag == "time" and not DATE_TIME.fullmatch(element.text or ""):
        found.append(f"time {element.text}")
    if tag == "extensions":
        return found + [f"{child.tag} in extensions" for child in element if child.tag.startswith(f"{{{GPX}}}")]
    names = [child.tag.partition("}")[2] for child in element]
    sequence = SEQUENCES.get(tag, ())
    found += [f"{name} in {tag}" for name in names if name not in sequence]
    found += [f"{name} twice in {tag}" for name in {*names} - {*MANY} if names.count(name) > 1]
    if not found and names != sorted(names, key=sequence.index):
        found.append(f"order of {names} in {tag}")
    return found + [fault for child in element for fault in faults(child)]


def texts(element: ElementTree.Element, path: str) -> list[str]:
    return [found.text or "" for found in element.findall(path, NAMESPACES)]


def test_the_record_keeps_the_rules_of_its_role():
    (record,) = module.declare_exporters()
    assert record.faults() == []


def test_what_is_written_keeps_the_rules_of_the_schema(tmp_path):
    height = np.where(TENTHS == 3.0, np.nan, 50.0)
    course = np.radians([0.0, 10.0, 359.99999])
    root = export(
        tmp_path,
        trajectory=drive(TENTHS, height=height, pos_std=np.ones((101, 3))),
        gnss=fixes([0, 1, 9], speed=np.array([np.nan, 1e-7, 3.0]), course=course),
        events=happened((0, 1), (3.05, 4), kind="crash", value=1e-9, unit="m/s^2", note="a & b"),
    )
    assert faults(root) == []
    assert faults(export(tmp_path, gnss=fixes([0], lon=np.array([180.0]), lat=np.array([-90.0])))) == []


@pytest.mark.parametrize(
    ("good", "bad"),
    [
        (
            "<ele>100.000</ele><time>2024-05-01T08:00:00.000Z</time>",
            "<time>2024-05-01T08:00:00.000Z</time><ele>1</ele>",
        ),
        ("<ele>100.000</ele>", "<ele>1e2</ele>"),
        ("<ele>100.000</ele>", "<ele>1</ele><ele>1</ele>"),
        ("<ele>100.000</ele>", "<speed>1</speed>"),
        ('lon="11.300000000"', 'lon="180.0"'),
        ("08:00:00.000Z", "08:00:00.000"),
        ('version="1.1"', 'version="1.0"'),
        ("<recon:heading>60.000</recon:heading>", "<heading>60.000</heading>"),
    ],
)
def test_the_checker_of_the_schema_sees_faults(tmp_path, good, bad):
    export(tmp_path, trajectory=drive([0, 1]))
    text = (tmp_path / "track.gpx").read_text(encoding="utf-8")
    assert good in text
    assert faults(ElementTree.fromstring(text.replace(good, bad))) != []


def test_places_heights_and_times_read_back(tmp_path):
    table = drive(TENTHS)
    points = export(tmp_path, trajectory=table).findall(".//g:trkpt", NAMESPACES)
    for name, read in (
        ("lat", [float(point.get("lat")) for point in points]),
        ("lon", [float(point.get("lon")) for point in points]),
        ("height", [float(point[0].text) for point in points]),
    ):
        assert np.abs(np.array(read) - vector(table, name)).max() < (HALF_NUMBER if name == "height" else HALF_PLACE)
    assert points[99][1].text == "2024-05-01T08:00:09.900Z"


def test_a_gap_is_a_segment_of_its_own(tmp_path):
    lat = np.full(8, 44.0)
    lat[6] = np.nan
    root = export(tmp_path, trajectory=drive([0, 1, 9, 10, 11, 11.1, 11.2, 11.3], lat=lat))
    assert [len(segment) for segment in root.findall(".//g:trkseg", NAMESPACES)] == [2, 4, 1]


def test_a_height_that_is_not_known_is_left_out(tmp_path):
    points = export(tmp_path, trajectory=drive([0, 1], height=np.array([np.nan, 7.0]))).findall(
        ".//g:trkpt", NAMESPACES
    )
    assert [len(texts(point, "g:ele")) for point in points] == [0, 1]


def test_speed_and_course_are_those_of_garmin_in_its_order(tmp_path):
    tables = fixes([0, 1, 2], speed=np.array([1.0, np.nan, 3.5]), course=np.radians([90.0, 359.9999, np.nan]))
    root = export(tmp_path, gnss=tables)
    extensions = root.findall(".//g:extensions/t:TrackPointExtension", NAMESPACES)
    told = [[(child.tag.partition("}")[2], child.text) for child in extension] for extension in extensions]
    assert told == [
        [("speed", "1.000"), ("course", "90.000")],
        [("course", "0.000")],
        [("speed", "3.500")],
    ]


def test_heading_and_sigmas_stand_in_a_namespace_of_our_own(tmp_path):
    root = export(tmp_path, trajectory=drive(TENTHS, pos_std=np.tile((0.1, 0.2, 0.3), (101, 1))))
    assert set(texts(root, ".//r:heading")) == {"60.000"}
    assert set(texts(root, ".//r:pos_std_n")) == {"0.200"}
    assert len(texts(root, ".//r:pos_std_u")) == 101


def test_a_track_of_places_alone_has_no_extensions(tmp_path):
    root = export(tmp_path, gnss=fixes([0, 1]))
    assert root.findall(".//g:extensions", NAMESPACES) == []


def test_a_size_is_rounded_for_people_said_once_and_kept_whole_in_the_extensions(tmp_path):
    found = happened((1.25, 3.5), kind="standstill", value=2.2499999999999, unit="s")
    (point,) = export(tmp_path, trajectory=drive([0, 1, 2, 3, 4]), events=found).findall("g:wpt", NAMESPACES)
    assert texts(point, "g:desc") == ["2.25 s"]
    assert texts(point, ".//r:value") == ["2.2499999999999"]


def test_an_event_is_a_waypoint_where_it_began(tmp_path):
    found = happened((1.25, 3.5), kind="crash", value=42.5, unit="m/s^2", note="front left")
    (point,) = export(tmp_path, trajectory=drive([0, 1, 2, 3, 4]), events=found).findall("g:wpt", NAMESPACES)
    assert abs(float(point.get("lat")) - 44.5000125) < HALF_PLACE
    assert abs(float(point.get("lon")) - 11.300025) < HALF_PLACE
    assert texts(point, "g:ele") == ["100.125"]
    assert texts(point, "g:time") == ["2024-05-01T08:00:01.250Z"]
    assert texts(point, "g:name") == texts(point, "g:type") == ["crash"]
    assert texts(point, "g:desc") == ["2.25 s; 42.5 m/s^2; front left"]
    assert texts(point, ".//r:end_time") == ["2024-05-01T08:00:03.500Z"]


def test_text_that_means_something_in_xml_survives(tmp_path):
    hostile = "a < b & \"c\" > 'd' ]]> naïve"
    root = export(tmp_path, trajectory=drive(TENTHS), events=happened((1, 2), kind=hostile, note=hostile), name=hostile)
    assert texts(root, "g:metadata/g:name") == texts(root, "g:wpt/g:name") == texts(root, ".//r:note") == [hostile]


def test_raw_gnss_is_a_second_track_unless_it_is_not_wanted(tmp_path):
    tables = {"trajectory": drive(TENTHS), "gnss": fixes([0, 1])}
    assert texts(export(tmp_path, **tables), "g:trk/g:name") == ["trajectory", "gnss"]
    (path,) = module.gpx(
        **tables, events=None, folder=tmp_path, about=RunInfo("run"), params=MapParams(gnss=False, rate=1.0)
    )
    alone = ElementTree.parse(path).getroot()
    assert texts(alone, "g:trk/g:name") == ["trajectory"]
    assert "11 of 101 rows, at most 1 in a second" in texts(alone, "g:metadata/g:desc")[0]


def test_a_log_without_latitude_and_longitude_is_refused(tmp_path):
    with pytest.raises(NothingToExport, match="no row of trajectory or gnss has a latitude and longitude"):
        export(tmp_path, trajectory=drive(TENTHS, lat=None, lon=None))
    assert list(tmp_path.iterdir()) == []
