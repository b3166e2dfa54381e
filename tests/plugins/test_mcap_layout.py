"""The layout for Foxglove beside an MCAP file: all that it shows is in the file, and stands where the drive is."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from exporter_tables import SECOND, START_NS, drive, fixes, happened
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from recon.manifest import RunInfo
from recon.numerics.rotation import from_euler
from recon.parameters import NoParams
from recon.schema import IMU, MAG, REFERENCE
from recon.tables import build, matrix, replace, time_ns, with_meta
from recon_exporters import mcap as module

Json = dict[str, Any]
Messages = dict[str, list[tuple[int, Any]]]

_PATH = re.compile(r"(?P<topic>/[a-z0-9_/]+)(?:\{kind==(?P<kind>\"[^\"]*\")\})?\.(?P<field>\w+)(?P<size>\.@rad2deg)?")
T_S = np.arange(0.0, 20.0, 0.1)


def export(folder: Path, streams: dict[str, pa.Table], **manifest: Any) -> tuple[Messages, Json]:
    """Messages by topic with their times, and the layout."""
    paths = module.mcap(streams=streams, folder=folder, about=RunInfo("run", manifest), params=NoParams())
    assert [path.name for path in paths] == ["recording.mcap", "foxglove_layout.json"]
    found: Messages = {}
    factory = DecoderFactory()
    with paths[0].open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            is_json = channel.message_encoding == "json"
            decode = json.loads if is_json else factory.decoder_for("protobuf", schema)
            found.setdefault(channel.topic, []).append((message.log_time, decode(message.data)))
    return found, json.loads(paths[1].read_text(encoding="utf-8"))


def imu(t_s: Any) -> pa.Table:
    t_ns = START_NS + np.rint(np.asarray(t_s) * SECOND).astype(np.int64)
    return build(IMU, time=t_ns, accel=np.ones((len(t_ns), 3)), gyro=np.ones((len(t_ns), 3)))


def sure(t_s: Any, **groups: Any) -> pa.Table:
    """A drive with sigmas and sensors' axes."""
    count = len(t_s)
    given = {name: np.full((count, 3), 0.25) for name in ("pos_std", "vel_std", "att_std", "accel", "gyro")}
    return drive(t_s, **{**given, **groups})


def everything() -> dict[str, pa.Table]:
    parked = happened((0, 3), (8, 9))
    hit = happened((12, 12.1), kind="impact", value=5.0, unit="m/s")
    return {
        "imu": imu(T_S),
        "mag": build(MAG, time=time_ns(imu(T_S)), mag=np.full((len(T_S), 3), 4e-5)),
        "gnss": fixes([0, 1, 2], speed=np.ones(3)),
        "trajectory": sure(T_S),
        "reference": drive(T_S),
        "events": pa.concat_tables([parked, hit]),
    }


def panels(layout: Json, kind: str) -> dict[str, Json]:
    """Configurations of the panels of a type, by their names."""
    return {
        key.partition("!")[2]: config for key, config in layout["configById"].items() if key.partition("!")[0] == kind
    }


def leaves(node: Any) -> Iterator[str]:
    if isinstance(node, str):
        yield node
    else:
        assert node["direction"] in ("row", "column")
        assert 0 < node["splitPercentage"] < 100
        for side in ("first", "second"):
            yield from leaves(node[side])


def paths_of(layout: Json) -> list[str]:
    plots = [*panels(layout, "Plot").values(), *panels(layout, "StateTransitions").values()]
    return [path["value"] for plot in plots for path in plot["paths"]]


CASES = {
    "everything": everything(),
    "no place": {"trajectory": sure(T_S, lat=None, lon=None, height=None), "imu": imu(T_S)},
    "no attitude": {"trajectory": drive(T_S, q=None)},
    "a reference alone": {"reference": drive(T_S), "gnss": fixes([0, 1])},
    "two trajectories": {"trajectory": sure(T_S), "trajectory_2": with_meta(drive(T_S), run="another run")},
    "sensors": {"imu": imu(T_S)},
    "fixes": {"gnss": fixes([0, 1, 2])},
    "wordy kinds": {"imu": imu(T_S), "events": happened((1, 2), kind='a "b"')},
    "nothing": {"imu": imu([]), "trajectory": drive([])},
}


@pytest.mark.parametrize("streams", CASES.values(), ids=CASES)
def test_all_that_is_shown_is_in_the_file(tmp_path: Path, streams: dict[str, pa.Table]) -> None:
    found, layout = export(tmp_path, streams)
    for path in paths_of(layout):
        told = _PATH.fullmatch(path.replace(r"\"", "'"))
        assert told is not None, path
        messages = [message for _, message in found[told["topic"]]]
        if told["kind"]:
            kind = json.loads(path[path.index("==") + 2 : path.rindex("}")])
            messages = [message for message in messages if message["kind"] == kind]
        assert any(told["field"] in message for message in messages), path
    for space in panels(layout, "3D").values():
        frames = {"local"} | {one.child_frame_id for topic in found if topic.endswith("tf") for _, one in found[topic]}
        assert {space["followTf"], *(name.removeprefix("frame:") for name in space["transforms"])} <= frames
        assert space["topics"].keys() <= found.keys()
    for maps in panels(layout, "map").values():
        placed = {topic for topic in found if topic.endswith(("/fix", "/place", "/way"))}
        assert maps["topicColors"].keys() | set(maps["disabledTopics"]) == placed
        assert set(maps["disabledTopics"]) == {f"/{name}/fix" for name in streams if f"/{name}/place" in found}
    assert all(log["topicToRender"] in found for log in panels(layout, "RosOut").values())


@pytest.mark.parametrize("streams", CASES.values(), ids=CASES)
def test_every_panel_stands_at_one_place(tmp_path: Path, streams: dict[str, pa.Table]) -> None:
    _, layout = export(tmp_path, streams)
    placed = list(leaves(layout["layout"])) if "layout" in layout else []
    for tabs in panels(layout, "Tab").values():
        placed += [name for tab in tabs["tabs"] for name in leaves(tab["layout"])]
    assert sorted(placed) == sorted(layout["configById"])


def test_a_crash_comes_first_and_is_seen_from_close_by(tmp_path: Path) -> None:
    _, layout = export(tmp_path, everything())
    assert [tab["title"] for tab in panels(layout, "Tab")["plots"]["tabs"]] == [
        "Crash",
        "Motion",
        "Attitude",
        "Sigmas",
        "Sensors",
    ]
    crash = panels(layout, "Plot")["crash_accel"]
    assert (crash["minXValue"], crash["maxXValue"], crash["isSynced"]) == (11.9, 12.4, False)
    assert [path["value"] for path in crash["paths"]] == [f"/trajectory/motion.accel_{axis}" for axis in "xyz"]


def test_without_plots_events_are_below_the_map(tmp_path: Path) -> None:
    _, layout = export(tmp_path, {"gnss": fixes([0, 1]).drop_columns("height")}, warnings=["the clock was not set"])
    whole = layout["layout"]
    assert (whole["direction"], whole["first"], whole["second"]) == ("column", "map!way", "RosOut!log")


def test_a_crash_test_shows_the_axes_that_it_measured(tmp_path: Path) -> None:
    """Forward and upwards, in the colours that they have elsewhere."""
    streams = everything()
    whole = streams.pop("imu")
    del streams["trajectory"], streams["reference"]
    _, layout = export(tmp_path, {**streams, "imu": replace(whole, accel_y=np.full(whole.num_rows, np.nan))})
    _, other = export(tmp_path, {**streams, "imu": whole})
    for name in ("crash_accel", "imu_accel"):
        paths = panels(layout, "Plot")[name]["paths"]
        assert [path["value"] for path in paths] == ["/imu.accel_x", "/imu.accel_z"]
        assert paths == [panels(other, "Plot")[name]["paths"][axis] for axis in (0, 2)]


def test_a_speed_that_no_topic_holds_is_in_no_plot(tmp_path: Path) -> None:
    """That of fixes without one is derived for charts; JSON has the velocity."""
    alone = fixes([0, 1], vel=np.tile((3.0, 4.0, 0.0), (2, 1)))
    _, layout = export(tmp_path, {"gnss": alone})
    assert [*panels(layout, "Plot")] == ["height"]


def test_the_map_shows_the_whole_drive(tmp_path: Path) -> None:
    """The drive is at 44.5 deg north, the fixes 111 km north of it: 2^8 of the world's 256 px hold 40 000 km."""
    _, layout = export(tmp_path, {"trajectory": drive([0, 100]), "gnss": fixes([0])})
    shown = panels(layout, "map")["way"]
    assert shown["center"]["lat"] == pytest.approx((44.5 + 45.5) / 2)
    pixels = 256 * 2 ** shown["zoomLevel"] * 111.0 / 40_000
    assert 100 < pixels <= 200


def test_without_an_attitude_the_way_is_seen_from_above(tmp_path: Path) -> None:
    _, layout = export(tmp_path, CASES["no attitude"])
    space = panels(layout, "3D")["space"]
    assert (space["followTf"], space["followMode"], space["cameraState"]["phi"]) == ("local", "follow-none", 0)
    middle = matrix(CASES["no attitude"]["trajectory"], "pos")[[0, -1]].mean(axis=0)
    assert space["cameraState"]["targetOffset"] == pytest.approx(middle, abs=1e-3)


def test_motion_is_told_in_the_units_of_people_with_bands_of_two_sigma(tmp_path: Path) -> None:
    """5 m/s with 0.25 m/s along each axis; yaw 30 deg is heading 60 deg; 0.25 everywhere else."""
    found, _ = export(tmp_path, {"trajectory": sure([0, 1])})
    times, (first, _) = zip(*found["/trajectory/motion"], strict=True)
    assert times == (START_NS, START_NS + SECOND)
    middle = {"speed": 5.0, "heading": 60.0, "pitch": 0.0, "roll": 0.0, "height": 100.0}
    half = {"speed": 0.5, "height": 0.5, **dict.fromkeys(("heading", "pitch", "roll"), np.degrees(0.5))}
    wanted = {"time": first["time"]}
    for name, value in middle.items():
        wanted |= {name: value, f"{name}_low": value - half[name], f"{name}_high": value + half[name]}
    quarter = np.degrees(0.25)
    wanted |= {f"att_std_{axis}": quarter for axis in ("roll", "pitch", "yaw")} | {"gyro_z": quarter}
    wanted |= {f"{group}_std_{axis}": 0.25 for group in ("pos", "vel") for axis in "enu"}
    wanted |= {f"accel_{axis}": 0.25 for axis in "xyz"}
    assert first.keys() == wanted.keys()
    assert all(abs(first[name] - wanted[name]) <= 0.6e-6 for name in wanted if name != "time")


def test_plots_of_long_drives_lose_no_peak_nor_a_row_of_the_crash(tmp_path: Path) -> None:
    """Of what hardly changes a row in each 1000th of the run stays; of every column its extremes."""
    count = 20_000
    accel = np.zeros((count, 3))
    accel[[1234, 15_000], [0, 1]] = 70.0, -80.0
    t_s = np.arange(count) / 100
    hit = happened((100, 100.1), kind="impact", value=5.0, unit="m/s")
    found, _ = export(tmp_path, {"trajectory": sure(t_s, accel=accel), "events": hit})
    rows = [round((t_ns - START_NS) / SECOND * 100) for t_ns, _ in found["/trajectory/motion"]]
    told = dict(zip(rows, (message for _, message in found["/trajectory/motion"]), strict=True))
    assert (told[1234]["accel_x"], told[15_000]["accel_y"]) == (70.0, -80.0)
    assert set(range(9_900, 10_101)) <= told.keys()
    assert 1000 <= len(rows) < 5000


def test_the_map_holds_ten_places_in_a_second(tmp_path: Path) -> None:
    found, _ = export(tmp_path, {"trajectory": drive(np.arange(1000) / 100)})
    every, few = ([fix.SerializeToString() for _, fix in found[f"/trajectory/{what}"]] for what in ("fix", "place"))
    assert few == [*every[::10], every[-1]]


def test_motion_that_is_not_known_is_left_out(tmp_path: Path) -> None:
    q = from_euler(np.zeros(3), 0.0, 0.0)
    q[1] = np.nan
    reference = build(REFERENCE, time=START_NS + np.arange(3), pos=np.zeros((3, 3)), q=q)
    found, _ = export(tmp_path, {"reference": reference})
    rows = [set(message) - {"time"} for _, message in found["/reference/motion"]]
    assert rows == [{"heading", "pitch", "roll", "height"}, {"height"}, {"heading", "pitch", "roll", "height"}]


def test_lanes_tell_what_lasts_and_what_does_not(tmp_path: Path) -> None:
    events = pa.concat_tables([happened((1, 3), (2, 4), (6, 6)), happened((2, 5), kind="park")])
    found, _ = export(tmp_path, {"imu": imu(np.arange(0.0, 10.01, 0.1)), "events": events})
    told = [((t_ns - START_NS) / SECOND, state["kind"], state["active"]) for t_ns, state in found["/events/states"]]
    assert told == [
        (0.0, "standstill", False),
        (0.0, "park", False),
        (1.0, "standstill", True),
        (2.0, "park", True),
        (4.0, "standstill", False),
        (5.0, "park", False),
        (6.0, "standstill", True),
        (6.02, "standstill", False),
    ]


def test_no_colour_becomes_black_when_a_viewer_darkens_it(tmp_path: Path) -> None:
    """Lightness, the middle of largest and smallest part: at least 0.6, less half a step of 255."""
    _, layout = export(tmp_path, everything())
    colors = {path["color"] for plot in panels(layout, "Plot").values() for path in plot["paths"]}
    parts = [bytes.fromhex(color[1:]) for color in colors]
    assert len(colors) > 5
    assert min((max(part) + min(part)) / 2 for part in parts) >= 0.6 * 255 - 1
