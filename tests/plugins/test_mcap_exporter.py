"""exporter.mcap: what viewers read is what the streams hold, and the file is what the specification asks for.

Messages are decoded by Google's protobuf with the schemas in the file, and those are held against Foxglove's own.
"""

from __future__ import annotations

import json
import subprocess
import zlib
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import foxglove.messages
import numpy as np
import pyarrow as pa
import pytest
from exporter_tables import SECOND, START_NS, drive, fixes, happened
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from jsonschema import Draft202012Validator
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from recon.cli.view import _viewer
from recon.errors import DataError
from recon.manifest import RunInfo
from recon.numerics.geodesy import Anchor, geodetic_to_enu
from recon.numerics.rotation import from_euler
from recon.parameters import NoParams
from recon.rows import Metric, metrics
from recon.schema import IMU, KNOTS, unnumbered
from recon.tables import build, matrix, replace, time_ns, vector, with_meta
from recon_exporters import mcap as module
from recon_exporters._mcap_file import CHUNK_MESSAGES

SOURCES = ("trajectory", "reference")
Messages = dict[str, list[tuple[int, Any]]]


def export(folder: Path, streams: dict[str, pa.Table], **manifest: Any) -> Path:
    path, _ = module.mcap(streams=streams, folder=folder, about=RunInfo("run", manifest), params=NoParams())
    assert path == folder / "recording.mcap"
    return path


def decoded(path: Path) -> Messages:
    """Log time and message, by topic; checksums are verified."""
    found: Messages = {}
    with path.open("rb") as file:
        reader, factory = make_reader(file, validate_crcs=True), DecoderFactory()
        for schema, channel, message in reader.iter_messages():
            if channel.message_encoding == "json":
                content = json.loads(message.data)
            else:
                content = factory.decoder_for("protobuf", schema)(message.data)
            found.setdefault(channel.topic, []).append((message.log_time, content))
    return found


def test_the_record_keeps_the_rules_of_its_role():
    (record,) = module.declare_exporters()
    assert record.faults() == []
    assert record.every_stream


def random_drive(rows: int) -> pa.Table:
    rng = np.random.default_rng(3)
    return drive(
        np.arange(rows) / 100,
        lat=rng.uniform(-90, 90, rows),
        lon=rng.uniform(-180, 180, rows),
        height=rng.normal(size=rows) * 1e3,
        pos=rng.normal(size=(rows, 3)) * 10.0 ** rng.integers(-9, 7, size=(rows, 3)),
        q=from_euler(*rng.uniform(-1.5, 1.5, size=(3, rows))),
        pos_std=rng.uniform(0.1, 3.0, size=(rows, 3)),
    )


def vec(message: Any) -> list[float]:
    return [message.x, message.y, message.z]


def stamp(message: Any) -> int:
    return message.seconds * SECOND + message.nanos


def test_places_read_back_to_the_last_bit(tmp_path):
    table = random_drive(300)
    found = decoded(export(tmp_path, {"trajectory": table}))["/trajectory/fix"]
    read = np.array([(fix.latitude, fix.longitude, fix.altitude) for _, fix in found])
    assert np.array_equal(read, np.column_stack([vector(table, name) for name in ("lat", "lon", "height")]))
    assert [time for time, _ in found] == time_ns(table).tolist()
    assert [stamp(fix.timestamp) for _, fix in found] == time_ns(table).tolist()


def test_covariances_are_the_squares_of_the_sigmas_where_they_are_known(tmp_path):
    std = np.array([(1.0, 2.0, 3.0), (np.nan, 2.0, 3.0)])
    found = decoded(export(tmp_path, {"gnss": fixes([0, 1], pos_std=std)}))["/gnss/fix"]
    first, second = (fix for _, fix in found)
    assert list(first.position_covariance) == [1, 0, 0, 0, 4, 0, 0, 0, 9]
    assert (first.position_covariance_type, second.position_covariance_type) == (2, 0)
    assert list(second.position_covariance) == [0] * 9


def test_poses_and_transforms_read_back_to_the_last_bit(tmp_path):
    table = random_drive(300)
    found = decoded(export(tmp_path, {"trajectory": table, "reference": table}))
    places, turns = matrix(table, "pos"), matrix(table, "q")
    for topic in ("/trajectory/pose", "/reference/pose", "/trajectory/odometry", "/tf"):
        poses = [message.pose if topic != "/tf" else message for _, message in found[topic]]
        where, turn = ("translation", "rotation") if topic == "/tf" else ("position", "orientation")
        assert np.array_equal([vec(getattr(pose, where)) for pose in poses], places)
        assert np.array_equal([(q.w, *vec(q)) for q in (getattr(pose, turn) for pose in poses)], turns)
        assert [stamp(message.timestamp) for _, message in found[topic]] == time_ns(table).tolist()
    _, first = found["/tf"][0]
    assert (first.parent_frame_id, first.child_frame_id) == ("local", "vehicle")


def test_velocities_of_odometry_are_in_the_frame_of_the_vehicle(tmp_path):
    """Yaw 90 deg: what goes north goes forward, what goes east goes to the right; a dozen roundings of numbers <= 4."""
    north = from_euler(np.full(2, np.pi / 2), 0.0, 0.0)
    rates = np.array([(0.1, 0.2, 0.3), (0.4, 0.5, 0.6)])
    table = drive([0, 1], q=north, gyro=rates)
    found = decoded(export(tmp_path, {"trajectory": table}))["/trajectory/odometry"]
    for (_, message), rate in zip(found, rates, strict=True):
        assert np.abs(np.array(vec(message.linear_velocity)) - (4.0, -3.0, 0.0)).max() < 1e-14
        assert vec(message.angular_velocity) == rate.tolist()


def test_rows_without_a_place_or_a_pose_are_left_out(tmp_path):
    position = np.ones((4, 3))
    position[1, 2] = np.nan
    lat = np.array([44.0, 44.1, np.nan, 44.3])
    found = decoded(export(tmp_path, {"trajectory": drive([0, 1, 2, 3], pos=position, lat=lat)}))
    at = {topic: [(time - START_NS) // SECOND for time, _ in messages] for topic, messages in found.items()}
    assert at["/tf"] == at["/trajectory/pose"] == at["/trajectory/odometry"] == [0, 2, 3]
    assert at["/trajectory/fix"] == [0, 1, 3]
    assert at["/trajectory"] == [0, 1, 2, 3]


def test_a_height_that_is_not_known_is_no_height_of_zero(tmp_path):
    found = decoded(export(tmp_path, {"gnss": fixes([0, 1], height=np.array([np.nan, 5.0]))}))["/gnss/fix"]
    assert [str(fix.altitude) for _, fix in found] == ["nan", "5.0"]


def test_speed_alone_makes_no_fix(tmp_path):
    table = fixes([0, 1], lat=np.full(2, np.nan), speed=np.ones(2))
    found = decoded(export(tmp_path, {"gnss": table}))
    assert set(found) == {"/gnss"}


def test_a_way_on_the_map_bridges_no_gap(tmp_path):
    table = drive([*range(20), *range(100, 120), 300])
    ((time, way),) = decoded(export(tmp_path, {"trajectory": table}))["/trajectory/way"]
    told = json.loads(way.geojson)
    assert (time, told["type"], told["properties"]) == (START_NS, "Feature", {"name": "trajectory"})
    assert told["geometry"]["type"] == "MultiLineString"
    place = np.column_stack((vector(table, "lon"), vector(table, "lat"))).round(9)
    assert told["geometry"]["coordinates"] == [place[:20].tolist(), place[20:40].tolist()]


def test_every_receiver_has_fixes_of_its_own(tmp_path):
    found = decoded(export(tmp_path, {"gnss": fixes([0, 1]), "gnss_2": fixes([0, 1, 2])}))
    assert {topic: len(found[topic]) for topic in ("/gnss/fix", "/gnss_2/fix")} == {"/gnss/fix": 2, "/gnss_2/fix": 3}
    assert {unnumbered(fix.frame_id) for _, fix in found["/gnss_2/fix"]} == {"gnss"}


def test_a_fix_names_the_frame_whose_origin_it_is(tmp_path):
    """The reference is not where /tf says that the vehicle is."""
    found = decoded(export(tmp_path, {"trajectory": random_drive(2), "reference": random_drive(2), "gnss": fixes([0])}))
    named = {topic: messages[0][1].frame_id for topic, messages in found.items() if topic.endswith("/fix")}
    assert named == {"/trajectory/fix": "vehicle", "/reference/fix": "reference", "/gnss/fix": "gnss"}


def imu(rows: int) -> pa.Table:
    """Doubles of random bits, of every exponent; where they are no number, they are missing."""
    accel = np.random.default_rng(1).integers(-(2**63), 2**63, size=(rows, 3), dtype=np.int64).view(np.float64)
    accel[~np.isfinite(accel) | (accel == 0.0)] = np.nan
    accel[0] = (5e-324, np.nan, -1.7976931348623157e308)
    return build(IMU, time=START_NS + np.arange(rows) * 1_000_003, accel=accel, gyro=np.ones((rows, 3)))


def test_json_reads_back_to_the_same_double_and_leaves_out_what_is_missing(tmp_path):
    table = imu(5000)
    found = decoded(export(tmp_path, {"imu": table}))["/imu"]
    for name in ("accel_x", "accel_y", "accel_z"):
        read = np.array([row.get(name, np.nan) for _, row in found], dtype=np.float64)
        wanted = vector(table, name, gaps=True)
        assert np.array_equal(np.isnan(read), np.isnan(wanted))
        assert np.array_equal(read[~np.isnan(read)].view(np.int64), wanted[~np.isnan(wanted)].view(np.int64))
    assert "accel_y" not in found[0][1]
    times = [row["time"]["sec"] * SECOND + row["time"]["nsec"] for _, row in found]
    assert times == time_ns(table).tolist() == [time for time, _ in found]


def test_texts_are_escaped_as_json_wants_it(tmp_path):
    note = 'said "stop"\n\\ ü'
    found = decoded(export(tmp_path, {"events": happened((0, 1), note=note, value=1.5, unit="m/s")}))
    _, row = found["/events"][0]
    assert (row["note"], row["value"], row["kind"]) == (note, 1.5, "standstill")


def test_rows_without_a_time_come_at_the_start(tmp_path):
    learnt = metrics([Metric("yaw", 1.25, "deg"), Metric("pitch")])
    found = decoded(export(tmp_path, {"imu": imu(3), "metrics": learnt}))["/metrics"]
    assert [(time, row["name"], row.get("value")) for time, row in found] == [
        (START_NS, "yaw", 1.25),
        (START_NS, "pitch", None),
    ]


def test_lists_are_left_out(tmp_path):
    table = build(KNOTS, time=START_NS + np.arange(2), chain=pa.array([[1.5], []]))
    found = decoded(export(tmp_path, {"knots": table}))["/knots"]
    assert list(found[0][1]) == ["time"]


def test_json_schemas_describe_the_messages_with_their_units(tmp_path):
    path = export(tmp_path, {"imu": imu(50), "events": happened((0, 1), note="x"), "gnss": fixes([0, 1])})
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            if channel.message_encoding == "json":
                described = json.loads(schema.data)
                Draft202012Validator.check_schema(described)
                Draft202012Validator({**described, "additionalProperties": False}).validate(json.loads(message.data))
            if channel.topic == "/imu":
                assert described["properties"]["accel_x"]["description"] == "specific_force, in m/s^2, frame sensor"


def test_events_and_warnings_are_told_when_they_happen(tmp_path):
    events = pa.concat_tables([happened((5, 6), kind="crash", value=12.5, unit="m/s"), happened((1, 3), note="park")])
    found = decoded(export(tmp_path, {"imu": imu(10), "events": events}, warnings=["the clock was not set"]))
    assert [(time - START_NS, log.level, log.message) for time, log in found["/log"]] == [
        (0, 3, "the clock was not set"),
        (SECOND, 2, "standstill for 2 s: park"),
        (5 * SECOND, 2, "crash 12.5 m/s for 1 s"),
    ]
    spans = [(stamp(event.start_time), stamp(event.end_time)) for _, event in found["/events/spans"]]
    assert spans == [(START_NS + SECOND, START_NS + 3 * SECOND), (START_NS + 5 * SECOND, START_NS + 6 * SECOND)]
    facts = [{pair.key: pair.value for pair in event.metadata} for _, event in found["/events/spans"]]
    assert facts == [{"kind": "standstill", "note": "park"}, {"kind": "crash", "value": "12.5", "unit": "m/s"}]
    assert [time for time, _ in found["/events"]] == sorted(time for time, _ in found["/events"])


def anchored(lat: float, table: pa.Table) -> pa.Table:
    """The table with the positions of its places about an anchor at that latitude."""
    anchor = Anchor(lat, 11.3, 100.0)
    place = (vector(table, name) for name in ("lat", "lon", "height"))
    return with_meta(replace(table, pos=geodetic_to_enu(*place, anchor)), anchor=asdict(anchor))


def test_what_has_another_anchor_is_brought_to_that_of_the_trajectory(tmp_path):
    """The same way, told about anchors 1 km apart."""
    here, there = (anchored(lat, drive(np.arange(200.0))) for lat in (44.5, 44.509))
    found = decoded(export(tmp_path, {"trajectory": here, "reference": there}))
    one, other = (np.array([vec(pose.pose.position) for _, pose in found[f"/{n}/pose"]]) for n in SOURCES)
    assert np.array_equal(one, matrix(here, "pos"))
    assert np.abs(one - other).max() < 1e-6 < 900.0 < np.abs(one - matrix(there, "pos")).max()
    assert np.array_equal([vec(frame.translation) for _, frame in found["/reference/tf"]], other)
    assert {frame.child_frame_id for _, frame in found["/reference/tf"]} == {"reference"}


def test_the_place_of_a_reference_that_nothing_relates_to_the_trajectory_is_not_invented(tmp_path):
    table = anchored(44.5, drive([0, 1, 2]))
    found = decoded(export(tmp_path, {"trajectory": drive([0, 1]), "reference": table}))
    assert found.keys() & {"/reference/pose", "/reference/tf"} == set()
    assert len(found["/reference/fix"]) == 3


def test_how_long_an_event_lasts_is_said_once(tmp_path):
    events = happened((1, 3.5), value=2.5, unit="s")
    found = decoded(export(tmp_path, {"imu": imu(10), "events": events}))
    assert [log.message for _, log in found["/log"]] == ["standstill for 2.5 s"]


def test_the_scene_holds_the_car_and_its_way(tmp_path):
    table = drive(np.arange(20_000) / 100)
    ((time, scene),) = decoded(export(tmp_path, {"trajectory": table}))["/scene"]
    car, path = scene.entities
    assert time == START_NS
    assert (car.frame_id, car.frame_locked, len(car.cubes)) == ("vehicle", True, 1)
    points = np.array([vec(point) for point in path.lines[0].points])
    assert path.frame_id == "local"
    assert points.tolist() == matrix(table, "pos")[[*range(0, 20_000, 10), 19_999]].tolist()


def test_the_scene_holds_the_reference_and_the_fixes_too(tmp_path):
    streams = {"trajectory": anchored(44.5, drive([5, 6])), "reference": anchored(44.5, drive([0, 1]))}
    there = with_meta(fixes([2, 3], lat=np.array([44.5, np.nan])), height_datum="ellipsoid")
    ((time, scene),) = decoded(export(tmp_path, {**streams, "gnss": there}))["/scene"]
    assert time == START_NS
    assert [(each.id, each.frame_id) for each in scene.entities] == [
        ("trajectory car", "vehicle"),
        ("trajectory way", "local"),
        ("reference car", "reference"),
        ("reference way", "local"),
        ("gnss", "local"),
    ]
    (fix,) = scene.entities[-1].spheres
    wanted = geodetic_to_enu(44.5, 11.3 + 4e-5, 60.2, Anchor(44.5, 11.3, 100.0))
    assert np.abs(np.array(vec(fix.pose.position)) - wanted).max() < 1e-6
    assert (fix.color.r, fix.color.a) == (0xE6 / 255, 1.0)


def everything() -> dict[str, pa.Table]:
    return {
        "trajectory": random_drive(CHUNK_MESSAGES),
        "imu": imu(1000),
        "gnss": fixes(np.arange(30.0)),
        "events": happened((0, 1)),
    }


def test_schemas_are_those_of_foxglove_as_far_as_they_go(tmp_path):
    """A field of the same number, name, type and label, in a file of the same name: no viewer sees a difference."""
    with export(tmp_path, everything()).open("rb") as file:
        schemas = make_reader(file).get_summary().schemas.values()
    seen = set()
    for schema in schemas:
        if schema.encoding == "protobuf":
            title = schema.name.removeprefix("foxglove.")
            seen.add(title)
            own = FileDescriptorSet.FromString(schema.data)
            official = getattr(foxglove.messages, _IN_PYTHON.get(title, title)).get_schema()
            theirs = {each.name: each for each in FileDescriptorSet.FromString(official.data).file}
            assert {each.name for each in own.file} <= theirs.keys()
            for each in own.file:
                assert facts_of(each) <= facts_of(theirs[each.name]), each.name
    assert seen == {
        "LocationFix",
        "GeoJSON",
        "PoseInFrame",
        "FrameTransform",
        "Odometry",
        "SceneUpdate",
        "Event",
        "Log",
    }


_IN_PYTHON = {"GeoJSON": "GeoJson"}


def facts_of(file: FileDescriptorProto) -> set[tuple[Any, ...]]:
    found: set[tuple[Any, ...]] = {(file.package, file.syntax)}
    for message in file.message_type:
        found |= {(message.name, f.number, f.name, f.type, f.label, f.type_name) for f in message.field}
        found |= {(message.name, e.name, v.name, v.number) for e in message.enum_type for v in e.value}
    return found


def test_chunks_follow_each_other_and_say_what_they_hold(tmp_path):
    """So a viewer that jumps to a time reads one chunk; the summary is what is there when the file is read through."""
    path = export(tmp_path, everything())
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        in_order = [message.log_time for _, _, message in reader.iter_messages()]
    chunks = summary.chunk_indexes
    assert len(chunks) > 3
    assert all(first.message_end_time < then.message_start_time for first, then in pairwise(chunks))
    assert in_order == sorted(in_order)
    assert summary.statistics.message_count == len(in_order)
    assert (in_order[0], in_order[-1]) == (summary.statistics.message_start_time, summary.statistics.message_end_time)


def test_the_checksum_of_the_summary_is_right(tmp_path):
    """MCAP, "Footer": CRC-32 from the start of the summary to the fields of the footer before the checksum itself."""
    content = export(tmp_path, everything()).read_bytes()
    start = int.from_bytes(content[-28:-20], "little")
    assert zlib.crc32(content[start:-12]) == int.from_bytes(content[-12:-8], "little")


def test_the_file_carries_its_manifest_and_units(tmp_path):
    path = export(tmp_path, {"imu": imu(3)}, recon="0.1", environment={"host": "here"})
    with path.open("rb") as file:
        reader = make_reader(file)
        (attachment,) = reader.iter_attachments()
        (units,) = reader.iter_metadata()
    assert (attachment.name, json.loads(attachment.data)) == ("manifest.json", {"recon": "0.1"})
    assert units.metadata["imu.gyro_z"] == "rad/s"


def test_no_rows_make_a_whole_file(tmp_path):
    path = export(tmp_path, {"imu": imu(3).slice(0, 0), "trajectory": drive([])})
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_summary().statistics.message_count == 0
        assert list(reader.iter_messages()) == []


def test_times_before_1970_are_refused(tmp_path):
    with pytest.raises(DataError, match="before 1970, which MCAP cannot hold"):
        export(tmp_path, {"trajectory": drive([-2e9, 0])})
    assert list(tmp_path.iterdir()) == []


def test_times_of_no_date_that_begin_before_their_zero_are_moved_on_by_whole_seconds_and_it_says_so(tmp_path):
    """A crash test counts from the contact: its log begins 2.5 s before, its crash at 0."""
    zero = START_NS / 1e9
    table = with_meta(drive([-2.5 - zero, 0.0 - zero, 1.0 - zero]), clock="relative")
    crash = happened((0.0 - zero, 0.1 - zero), kind="crash")
    path = export(tmp_path, {"trajectory": table, "events": crash})
    found = decoded(path)
    assert [log_time for log_time, _ in found["/trajectory"]] == [500_000_000, 3_000_000_000, 4_000_000_000]
    assert [log_time for log_time, _ in found["/events"]] == [3_000_000_000]
    with path.open("rb") as file:
        told = {each.name: each.metadata for each in make_reader(file).iter_metadata()}
    assert told["recon.clock"] == {"later_s": "3"}


def test_rerun_finds_nothing_wrong(tmp_path):
    """Another reader, in another language: `rerun mcap check` decodes every message."""
    path = export(tmp_path, everything())
    checked = subprocess.run([_viewer(), "mcap", "check", "--full", path], capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stdout + checked.stderr
