"""exporter.geojson: what RFC 7946 asks, gaps that stay gaps, and the thinning of rows that all maps share.

A place is written to 1e-9 deg and other numbers to 1e-3, so they read back within half of that.
"""

from __future__ import annotations

import json
import math
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exporter_tables import START_NS, drive, fixes, happened

from recon.errors import NothingToExport
from recon.manifest import RunInfo
from recon.tables import time_ns, vector, with_meta
from recon_exporters import geojson as module
from recon_exporters.geojson import MapParams

HALF_PLACE = 0.51e-9
HALF_NUMBER = 0.51e-3
TENTHS = np.arange(0, 301) / 10


def export(folder: Path, *, trajectory=None, gnss=None, events=None, with_gnss=True, **params) -> dict[str, Any]:
    (path,) = module.geojson(
        trajectory=trajectory,
        gnss=gnss,
        events=events,
        folder=folder,
        about=RunInfo("run"),
        params=MapParams(gnss=with_gnss, **params),
    )
    assert path == folder / "track.geojson"
    return json.loads(path.read_text(encoding="utf-8"))


def of_type(collection: dict[str, Any], kind: str) -> list[dict[str, Any]]:
    return [feature for feature in collection["features"] if feature["geometry"]["type"] == kind]


def lines_of(collection: dict[str, Any]) -> list[list[list[float]]]:
    (feature,) = of_type(collection, "MultiLineString")
    return feature["geometry"]["coordinates"]


def facts_of(collection: dict[str, Any], kind: str = "MultiLineString") -> dict[str, Any]:
    return of_type(collection, kind)[0]["properties"]["coordinateProperties"]


def faults(collection: dict[str, Any]) -> list[str]:
    """What RFC 7946 forbids: sections 3.1 to 3.3, 4 and 5."""
    found = []
    if collection["type"] != "FeatureCollection" or "crs" in collection:
        found.append("collection")
    sizes = set()
    for feature in collection["features"]:
        kind, coordinates = feature["geometry"]["type"], feature["geometry"]["coordinates"]
        if feature["type"] != "Feature" or not isinstance(feature["properties"], dict):
            found.append("feature")
        lines = {"Point": [[coordinates]], "MultiPoint": [coordinates], "MultiLineString": coordinates}[kind]
        if kind == "MultiLineString" and min(map(len, lines)) < 2:
            found.append("a line of one position")
        for lon, lat, *rest in (position for line in lines for position in line):
            sizes.add(2 + len(rest))
            if not (-180 <= lon <= 180 and -90 <= lat <= 90 and len(rest) <= 1):
                found.append(f"position {lon}, {lat}")
        if any(abs(b[0] - a[0]) > 180 for line in lines for a, b in pairwise(line)):
            found.append("a line around the Earth")
    if [len(collection["bbox"])] != [2 * size for size in sizes]:
        found.append(f"bbox of {len(collection['bbox'])} numbers for positions of {sizes}")
    return found


def test_the_record_keeps_the_rules_of_its_role():
    (record,) = module.declare_exporters()
    assert record.faults() == []


def test_positions_are_longitude_latitude_height_to_the_precision_of_the_format(tmp_path):
    table = drive(TENTHS)
    (line,) = lines_of(export(tmp_path, trajectory=table))
    off = np.abs(np.array(line) - np.column_stack([vector(table, name) for name in ("lon", "lat", "height")]))
    assert off[:, :2].max() < HALF_PLACE
    assert off[:, 2].max() < HALF_NUMBER


def test_what_is_written_is_geojson(tmp_path):
    lone = [*TENTHS, 40.0, 50.0, 50.1]
    everything = export(tmp_path, trajectory=drive(lone), gnss=fixes([0, 1, 2, 9]), events=happened((3, 4), (5, 9)))
    assert faults(everything) == []
    assert faults(export(tmp_path, trajectory=drive(lone))) == []
    assert len(everything["features"]) == 6


def test_the_checker_of_the_structure_sees_faults(tmp_path):
    good = export(tmp_path, trajectory=drive(TENTHS))
    for spoil in (
        lambda c: c["bbox"].pop(),
        lambda c: c["features"][0]["geometry"]["coordinates"].append([[1.0, 2.0, 3.0]]),
        lambda c: c["features"][0]["geometry"]["coordinates"][0].append([-179.0, 2.0, 3.0]),
        lambda c: c["features"][0]["geometry"]["coordinates"][0].append([10.0, 98.0, 3.0]),
    ):
        bad = json.loads(json.dumps(good))
        spoil(bad)
        assert faults(bad) != []


@pytest.mark.parametrize("datum", ["mean_sea_level", None])
def test_heights_above_another_datum_are_properties_and_no_coordinates(tmp_path, datum):
    collection = export(tmp_path, trajectory=drive(TENTHS, datum=datum), events=happened((3, 4)))
    assert {len(position) for position in lines_of(collection)[0]} == {2}
    assert faults(collection) == []
    assert facts_of(collection)["height"][0][10] == 100.1
    assert ("mean sea level" if datum else "not known") in collection["description"]


def test_one_unknown_height_makes_all_positions_flat(tmp_path):
    height = np.full(len(TENTHS), 7.0)
    height[3] = np.nan
    collection = export(tmp_path, trajectory=drive(TENTHS, height=height))
    assert {len(position) for position in lines_of(collection)[0]} == {2}
    assert facts_of(collection)["height"][0][2:5] == [7.0, None, 7.0]


def test_speed_heading_and_sigmas_stand_beside_the_positions(tmp_path):
    std = np.tile((0.1, 0.2, 0.3), (301, 1))
    std[0] = np.nan
    table = drive(TENTHS, pos_std=std, att_std_yaw=np.full(301, math.radians(2.0)))
    facts = facts_of(export(tmp_path, trajectory=table))
    assert {name: values[0][1] for name, values in facts.items() if name != "times"} == {
        "height": 100.01, "speed": 5.0, "heading": 60.0, "pos_std_e": 0.1, "pos_std_n": 0.2, "pos_std_u": 0.3,
        "heading_std": 2.0,
    }  # fmt: skip
    assert facts["pos_std_e"][0][0] is None
    assert {len(values[0]) for values in facts.values()} == {301}


def test_a_number_that_no_vehicle_shows_is_null(tmp_path):
    vel = np.zeros((3, 3))
    vel[1], vel[2] = np.inf, 1e200
    assert facts_of(export(tmp_path, trajectory=drive([0, 1, 2], vel=vel)))["speed"] == [[0.0, None, None]]


def test_times_are_iso_with_as_many_digits_as_they_need(tmp_path):
    def times(t_s: list[float]) -> list[str]:
        return facts_of(export(tmp_path, trajectory=drive(t_s)))["times"][0]

    assert times([0, 0.12]) == ["2024-05-01T08:00:00.000Z", "2024-05-01T08:00:00.120Z"]
    assert times([0, 0.120004])[1] == "2024-05-01T08:00:00.120004Z"
    assert times([0.25, 0.400000001]) == ["2024-05-01T08:00:00.250000000Z", "2024-05-01T08:00:00.400000001Z"]


def test_rows_more_than_the_largest_gap_apart_are_not_joined(tmp_path):
    t_s = [0, 1, 2, 4, 5, 7.001, 8]
    first, second = lines_of(export(tmp_path, trajectory=drive(t_s)))
    assert (len(first), len(second)) == (5, 2)
    assert [len(line) for line in lines_of(export(tmp_path, trajectory=drive(t_s), max_gap=1.5))] == [3, 2, 2]
    assert len(lines_of(export(tmp_path, trajectory=drive(t_s), max_gap=1e300))) == 1


@pytest.mark.parametrize("column", ["lat", "lon"])
@pytest.mark.parametrize("missing", [np.nan, np.inf, 1000.0])
def test_a_row_without_a_position_ends_a_line(tmp_path, column, missing):
    values = np.linspace(10.0, 11.0, 10)
    values[4] = missing
    collection = export(tmp_path, trajectory=drive(np.arange(10) / 10, **{column: values}))
    assert [len(line) for line in lines_of(collection)] == [4, 5]
    assert [len(line) for line in facts_of(collection)["times"]] == [4, 5]


def test_a_row_alone_between_gaps_is_a_point(tmp_path):
    collection = export(tmp_path, gnss=fixes([0, 1, 10, 20, 21]))
    assert [len(line) for line in lines_of(collection)] == [2, 2]
    (alone,) = of_type(collection, "MultiPoint")
    assert alone["geometry"]["coordinates"] == [[11.3002, 45.5001]]
    assert facts_of(collection, "MultiPoint")["times"] == ["2024-05-01T08:00:10.000Z"]


def test_ten_rows_in_a_second_are_every_tenth_of_a_hundred_even_if_the_clock_shakes(tmp_path):
    """Times shake by 3 ms about a step of 10 ms; the row of each tenth of a second is the one kept."""
    steps = np.arange(1001)
    shaken = steps / 100 + np.random.default_rng(1).uniform(-0.003, 0.003, len(steps)) * (steps > 0)
    collection = export(tmp_path, trajectory=drive(shaken, height=steps))
    assert facts_of(collection)["height"][0] == [float(row) for row in steps[::10]]
    assert "101 of 1001 rows, at most 10 in a second" in collection["description"]


def test_no_rate_keeps_every_row_and_the_description_says_so(tmp_path):
    collection = export(tmp_path, trajectory=drive(np.arange(500) / 100), rate=None)
    assert len(lines_of(collection)[0]) == 500
    assert "500 of 500 rows, all that there are" in collection["description"]


def test_a_rate_above_that_of_the_data_keeps_every_row(tmp_path):
    assert len(lines_of(export(tmp_path, trajectory=drive(TENTHS), rate=1e6))[0]) == 301


def test_thinning_keeps_the_ends_of_lines_and_makes_no_gaps(tmp_path):
    t_s = np.concatenate((np.arange(0, 20, 0.01), np.arange(23.37, 40, 0.01)))
    collection = export(tmp_path, trajectory=drive(t_s), rate=0.1)
    ends = [[times[0][17:-1], times[-1][17:-1]] for times in facts_of(collection)["times"]]
    assert ends == [["00.000", "19.990"], ["23.370", "39.990"]]
    assert [len(line) for line in lines_of(collection)] == [3, 3]


def test_a_line_is_cut_at_the_antimeridian(tmp_path):
    """From 179.0 to -179.5 the meridian comes after two thirds of the way, at 18 of 10 to 22 deg north and at 2/3 s."""
    table = drive(
        [0, 1, 2], lon=np.array([179.0, -179.5, -179.0]), lat=np.array([10.0, 22.0, 23.0]), height=np.zeros(3)
    )
    collection = export(tmp_path, trajectory=table)
    east, west = lines_of(collection)
    assert east == [[179.0, 10.0, 0.0], [180.0, 18.0, 0.0]]
    assert west == [[-180.0, 18.0, 0.0], [-179.5, 22.0, 0.0], [-179.0, 23.0, 0.0]]
    assert facts_of(collection)["speed"] == [[5.0, None], [None, 5.0, 5.0]]
    assert facts_of(collection)["times"][0][1] == "2024-05-01T08:00:00.666666666Z"
    assert collection["bbox"] == [179.0, 10.0, 0.0, -179.0, 23.0, 0.0]
    assert faults(collection) == []


def test_lines_are_cut_at_every_crossing_and_gaps_stay_where_they_were(tmp_path):
    lon = np.array([-179.9, 179.9, 180.0, 181.0, 170.0, 179.0, -179.0, 179.0])
    collection = export(tmp_path, gnss=fixes([0, 1, 2, 3, 9, 10, 11, 12], lon=lon, height=np.full(8, np.nan)))
    assert [[position[0] for position in line] for line in lines_of(collection)] == [
        [-179.9, -180.0],
        [180.0, 179.9, 180.0],
        [-180.0, -180.0, -179.0],
        [170.0, 179.0, 180.0],
        [-180.0, -179.0, -180.0],
        [180.0, 179.0],
    ]
    assert collection["bbox"][::2] == [170.0, -179.0]


def test_the_bounding_box_holds_tracks_and_events(tmp_path):
    collection = export(tmp_path, trajectory=drive([0, 1, 2]), gnss=fixes([0, 10]))
    assert collection["bbox"] == [11.3, 44.5, 11.3002, 45.5001]
    deep = export(tmp_path, trajectory=drive([0, 1, 2]))
    assert deep["bbox"] == [11.3, 44.5, 100.0, 11.30004, 44.50002, 100.2]


def test_events_are_points_where_they_began(tmp_path):
    """At 0.25 s of a second a quarter of the way, though no row is there."""
    found = happened((1.25, 3.5), kind="crash", value=42.5, unit="m/s^2", note='he said "ouch"')
    (point,) = of_type(export(tmp_path, trajectory=drive([0, 1, 2, 3, 4]), events=found), "Point")
    assert np.abs(np.array(point["geometry"]["coordinates"]) - (11.300025, 44.5000125, 100.125)).max() < HALF_PLACE
    assert point["properties"] == {
        "kind": "crash", "time": "2024-05-01T08:00:01.250Z", "end_time": "2024-05-01T08:00:03.500Z", "duration": 2.25,
        "value": 42.5, "unit": "m/s^2", "note": 'he said "ouch"',
    }  # fmt: skip


def test_events_are_placed_by_all_rows_and_not_by_those_drawn(tmp_path):
    """A height that jumps at 5.5 s would be smeared over ten seconds by the rows that a rate of 0.1 Hz draws."""
    t_s = np.arange(0, 20.01, 0.01)
    table = drive(t_s, height=np.where(t_s < 5.495, 0.0, 10.0))
    points = of_type(export(tmp_path, trajectory=table, events=happened((5.4, 6), (5.6, 6)), rate=0.1), "Point")
    assert [point["geometry"]["coordinates"][2] for point in points] == [0.0, 10.0]


def test_events_where_no_position_is_known_are_left_out_and_counted(tmp_path):
    found = happened((-1, 0), (0.5, 5), (3, 4), (99, 99))
    collection = export(tmp_path, trajectory=drive([0, 1, 7, 8]), events=found)
    assert [point["properties"]["time"][17:19] for point in of_type(collection, "Point")] == ["00"]
    assert "3 of 4 began where no position is known" in collection["description"]


def test_an_event_with_which_a_gap_begins_stands_at_the_last_row_before(tmp_path):
    found = happened((1.0, 7), (1.5, 7), (2.5, 7), (8.5, 9))
    points = of_type(export(tmp_path, trajectory=drive([0, 1, 7, 8]), events=found), "Point")
    assert [point["properties"]["time"][17:22] for point in points] == ["01.00", "01.50"]
    assert [point["geometry"]["coordinates"] for point in points] == [[11.30002, 44.50001, 100.1]] * 2


def test_raw_gnss_is_a_track_of_its_own_unless_it_is_not_wanted(tmp_path):
    course = np.radians([0.0, 359.9999, 90.0])
    tables = {"trajectory": drive(TENTHS), "gnss": fixes([0, 1, 2], course=course, speed=np.array([1.0, 2.0, np.nan]))}
    tables["gnss"] = with_meta(tables["gnss"], heading_kind="magnetic")
    both = export(tmp_path, **tables)
    assert [f["properties"]["name"] for f in both["features"]] == ["trajectory", "gnss"]
    facts = both["features"][1]["properties"]["coordinateProperties"]
    assert facts["course"] == [[0.0, 0.0, 90.0]]
    assert facts["speed"] == [[1.0, 2.0, None]]
    assert "courses count from magnetic north" in both["description"]
    assert [f["properties"]["name"] for f in export(tmp_path, **tables, with_gnss=False)["features"]] == ["trajectory"]


def test_times_on_another_scale_or_of_a_clock_never_set_are_told(tmp_path):
    table = with_meta(drive(TENTHS), time_scale="GPS", clock="relative")
    said = export(tmp_path, trajectory=table)["description"]
    assert "times are GPS time, not UTC" in said
    assert "dates mean nothing" in said


def test_a_log_without_latitude_and_longitude_is_refused_in_one_sentence(tmp_path):
    local = drive(TENTHS, lat=None, lon=None, height=None)
    with pytest.raises(NothingToExport, match="no row of trajectory or gnss has a latitude and longitude") as caught:
        export(tmp_path, trajectory=local, gnss=fixes([0, 1], lat=np.full(2, np.nan)))
    assert "tum" in caught.value.hint
    with pytest.raises(NothingToExport, match="no row of trajectory has"):
        export(tmp_path, trajectory=local, gnss=fixes([0, 1]), with_gnss=False)
    with pytest.raises(NothingToExport):
        export(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_times_read_back_to_those_of_the_rows(tmp_path):
    table = drive(TENTHS)
    times = facts_of(export(tmp_path, trajectory=table))["times"][0]
    read = [round(datetime.fromisoformat(text).timestamp() * 1000) for text in times]
    assert read == (time_ns(table) // 1_000_000).tolist()
    assert read[0] == START_NS // 1_000_000
