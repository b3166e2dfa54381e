"""reader.rosbag and topics in general: bags of ROS 1 and ROS 2 become the same streams, whole or damaged."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import ros_logs
from benchmarks.reading_logs import write_bag
from metric_rows import rows_named

import recon
import recon_readers.rosbag
from recon import Pipeline, Streams
from recon.errors import NothingUsable, ReadFailed
from recon.rows import warnings_of
from recon.stages import EVERYTHING, Wanted
from recon.tables import matrix, meta, time_ns, vector
from recon_readers._rosbag1 import Bag
from recon_readers._topics import Intake, TopicParams

FORMS = ("bag", "sqlite3", "mcap")


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("bags")
    return {form: ros_logs.write(folder / ("drive.bag" if form == "bag" else form), form) for form in FORMS}


def read(path: Path, wanted: Wanted = EVERYTHING, **params: object) -> Streams:
    return recon_readers.rosbag.read(path, TopicParams(**params), wanted)


@pytest.mark.parametrize("form", FORMS)
def test_every_container_gives_what_was_measured(bags: dict[str, Path], form: str) -> None:
    streams = read(bags[form])
    assert {name: table.num_rows for name, table in streams.items() if name != "metrics"} == {
        "imu": 200, "gnss": 10, "mag": 40, "baro": 20,
    }  # fmt: skip
    np.testing.assert_array_equal(matrix(streams["imu"], "accel"), np.tile(ros_logs.ACCEL, (200, 1)))
    np.testing.assert_array_equal(matrix(streams["imu"], "gyro"), np.tile(ros_logs.GYRO, (200, 1)))
    np.testing.assert_array_equal(matrix(streams["mag"], "mag"), np.tile(ros_logs.FIELD, (40, 1)))
    fix = streams["gnss"].slice(0, 1).to_pylist()[0]
    assert (fix["lat"], fix["lon"], fix["height"]) == (ros_logs.LAT, ros_logs.LON, ros_logs.HEIGHT)
    assert [fix[f"pos_std_{axis}"] for axis in "enu"] == [1.0, 2.0, 3.0]
    assert fix["fix"] == 3
    assert vector(streams["baro"], "pressure")[0] == ros_logs.PRESSURE


@pytest.mark.parametrize("form", FORMS)
def test_times_are_those_of_measurement_to_the_nanosecond(bags: dict[str, Path], form: str) -> None:
    measured = ros_logs.START_NS + np.arange(200) * 10_000_000
    np.testing.assert_array_equal(time_ns(read(bags[form])["imu"]), measured)
    np.testing.assert_array_equal(time_ns(read(bags[form], time="log")["imu"]), measured + ros_logs.LATE_NS)


def test_facts_come_from_the_format(bags: dict[str, Path]) -> None:
    streams = read(bags["bag"])
    assert meta(streams["gnss"])["height_datum"] == "ellipsoid"
    assert meta(streams["imu"])["axes"] == "FLU"
    assert (meta(streams["imu"])["clock"], meta(streams["imu"])["time_scale"]) == ("absolute", "UTC")
    above_sea = read(bags["bag"], height_datum="mean_sea_level")
    assert meta(above_sea["gnss"])["height_datum"] == "mean_sea_level"


def test_an_odometry_is_read_where_a_parameter_says_what_it_is(bags: dict[str, Path]) -> None:
    (row,) = rows_named(read(bags["bag"]), "topic_to_choose")
    assert row["value"] == 40.0
    assert "--set reader.rosbag.wheel=/odom or --set reader.rosbag.reference=/odom" in str(row["note"])
    wheel = read(bags["sqlite3"], wheel=("/odom",))["wheel"]
    assert vector(wheel, "speed").tolist() == [ros_logs.SPEED] * 40
    reference = read(bags["sqlite3"], reference=("/odom",))["reference"]
    assert matrix(reference, "vel")[0].tolist() == [ros_logs.SPEED, 0.0, 0.0]
    # positions were written from times rounded to the nanosecond, at 10 m/s
    np.testing.assert_allclose(matrix(reference, "pos")[:, 0], np.arange(40) * 0.5, atol=1e-7)


def test_axes_of_a_driver_that_writes_others_are_told_by_a_parameter(bags: dict[str, Path]) -> None:
    x, y, z = ros_logs.ACCEL
    turned = read(bags["bag"], axes="FRD")["imu"]
    assert matrix(turned, "accel")[0].tolist() == [x, -y, -z]
    assert meta(turned)["axes"] == "FRD"
    assert matrix(read(bags["bag"], axes="FRD", at_rest="down")["imu"], "accel")[0].tolist() == [-x, y, z]


def test_the_topics_that_are_left_are_counted(bags: dict[str, Path]) -> None:
    (row,) = rows_named(read(bags["bag"]), "topics_left")
    assert (row["value"], row["note"]) == (1.0, "/camera (sensor_msgs/CompressedImage)")


def test_a_topic_that_is_not_there_or_does_not_fit_is_refused(bags: dict[str, Path]) -> None:
    with pytest.raises(ReadFailed, match="it has no topic '/imu'") as caught:
        read(bags["bag"], imu=("/imu",))
    assert caught.value.hint == "did you mean '/imu/data'?"
    with pytest.raises(ReadFailed, match=r"/baro \(sensor_msgs/FluidPressure\) holds nothing for imu"):
        read(bags["bag"], imu=("/baro",))


def test_only_what_later_steps_read_is_loaded(bags: dict[str, Path]) -> None:
    wanted = Wanted({"gnss": frozenset({"time", "lat", "lon"})})
    for form in FORMS:
        whole, some = read(bags[form]), read(bags[form], wanted)
        assert set(some) == {"gnss", "metrics"}
        assert some["gnss"].column_names == ["time", "lat", "lon"]
        assert some["gnss"].equals(whole["gnss"].select(["time", "lat", "lon"]))


def test_the_plan_tells_the_reader_what_is_wanted(bags: dict[str, Path]) -> None:
    text = "name: t\nsteps:\n  - use: reader.auto\n  - use: filter.moving_average\n"
    run = recon.run(Pipeline.from_text(text, "t.yaml"), bags["bag"])
    assert set(run.recording) == {"imu", "metrics"}


def test_several_imus_are_numbered_by_name_and_a_parameter_chooses(tmp_path: Path) -> None:
    path = two_imus(tmp_path)
    streams = read(path)
    assert {"imu", "imu_2"} <= set(streams)
    (text,) = warnings_of(streams["metrics"])
    assert text.startswith("imu is /front, imu_2 is /rear: steps read imu unless told otherwise")
    chosen = read(path, imu=("/rear",))
    assert "imu_2" not in chosen
    assert meta(chosen["imu"])["topic"] == "/rear"


def two_imus(folder: Path) -> Path:
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    imu = [each for each in ros_logs.messages(types, 0.5) if each[0] == "/imu/data"]
    with Writer(folder / "two", version=9) as bag:
        for topic in ("/rear", "/front"):
            connection = bag.add_connection(topic, imu[0][1], typestore=types)
            for _, name, t_ns, message in imu:
                bag.write(connection, t_ns, types.serialize_cdr(message, name))
    return folder / "two"


@pytest.mark.skipif(sys.platform == "win32", reason="files have no holes there unless told so")
def test_ten_gigabytes_with_a_camera_are_read_in_little_memory(tmp_path: Path) -> None:
    """The images are holes in the file; the process may hold 2 GB, and holds a tenth of that."""
    path = tmp_path / "camera.bag"
    write_bag(path, 1e10, image=2_500_000_000)
    lines = [
        "import psutil, sys; from pathlib import Path; from recon_readers.rosbag import read",
        "from recon_readers._topics import TopicParams",
        "print(read(Path(sys.argv[1]), TopicParams())['imu'].num_rows)",
        # Not the maxrss of getrusage, which on Linux begins with that of the process that started this one.
        "status = Path('/proc/self/status')",
        "told = dict(line.split(':') for line in status.read_text().splitlines()) if status.exists() else {}",
        "print(int(told['VmHWM'].split()[0]) * 1024 if told else psutil.Process().memory_info().rss)",
    ]
    command = [sys.executable, "-c", "\n".join(lines), str(path)]
    rows, peak = map(int, subprocess.run(command, capture_output=True, text=True, check=True).stdout.split())
    assert path.stat().st_size > 1e10
    assert rows == 8_000
    assert peak < 400e6


# --- damage ---------------------------------------------------------------------------------------------------------


def test_a_bag_cut_short_gives_every_whole_message(bags: dict[str, Path], tmp_path: Path) -> None:
    data = bags["bag"].read_bytes()
    cut = tmp_path / "cut.bag"
    whole = read(bags["bag"])["imu"]
    before = -1
    for share in (0.2, 0.5, 0.9):
        cut.write_bytes(data[: int(share * len(data))])
        streams = read(cut)
        assert streams["imu"].equals(whole.slice(0, streams["imu"].num_rows))
        assert before < streams["imu"].num_rows < whole.num_rows
        before = streams["imu"].num_rows
        (text,) = warnings_of(streams["metrics"])
        assert "cut.bag is cut short or damaged" in text


def test_behind_a_damaged_chunk_the_next_one_is_found(bags: dict[str, Path], tmp_path: Path) -> None:
    data = bytearray(bags["bag"].read_bytes())
    at = data.index(b"op=\x05", len(data) // 3)
    data[at - 24 : at] = b"\xff" * 24
    path = tmp_path / "drive.bag"
    path.write_bytes(data)
    streams, whole = read(path), read(bags["bag"])
    t_ns = time_ns(streams["imu"])
    assert 100 < len(t_ns) < 200
    assert t_ns[-1] == time_ns(whole["imu"])[-1]
    assert [row["value"] for row in rows_named(streams, "damaged_places")] == [1.0]


def test_a_sqlite_bag_with_a_damaged_page_gives_what_is_before_it(bags: dict[str, Path], tmp_path: Path) -> None:
    (source,) = bags["sqlite3"].glob("*.db3")
    data = bytearray(source.read_bytes())
    middle = len(data) // 2 // 4096 * 4096
    data[middle : middle + 8192] = b"\xff" * 8192
    damaged = tmp_path / "damaged.db3"
    damaged.write_bytes(data)
    streams = read(damaged)
    assert 0 < streams["imu"].num_rows < 200
    assert any("damaged.db3 is damaged" in text for text in warnings_of(streams["metrics"]))


# --- real bags ------------------------------------------------------------------------------------------------------


def test_the_husky_of_the_robot_localization_bag(logs: Path) -> None:
    streams = read(logs / "formats/rosbag1/test1.bag", wheel=("/husky_velocity_controller/odom",))
    assert (streams["imu"].num_rows, streams["gnss"].num_rows, streams["wheel"].num_rows) == (11_865, 989, 3_952)
    felt = matrix(streams["imu"], "accel").mean(axis=0)
    # the box is mounted with y up; a ramp and noise leave less than 3 % on the other axes
    assert felt[1] == pytest.approx(9.8, rel=0.03)
    assert abs(felt[[0, 2]]).max() < 0.3
    (text,) = warnings_of(streams["metrics"])
    assert text.startswith("imu: gravity is felt along +y, so z does not point up")
    # 0.64 to 2.9 m^2 stand in the bag
    assert vector(streams["gnss"], "pos_std_e").min() >= 0.8
    assert 1.0 < vector(streams["wheel"], "speed").max() < 1.05


def test_ros_2_copies_of_the_husky_agree_with_each_other(logs: Path) -> None:
    folder = logs / "formats/converted_here"
    one, other = (read(folder / name) for name in ("husky_90s_db3", "husky_90s_mcap"))
    for name in ("imu", "gnss"):
        assert one[name].equals(other[name])
    original = read(logs / "formats/rosbag1/test1.bag")["imu"]
    assert one["imu"].select(["accel_x"]).equals(original.select(["accel_x"]).slice(0, 2702))


def test_messages_inside_custom_ones_are_read_by_their_embedded_definitions(logs: Path) -> None:
    streams = read(logs / "neu_boston_car/circle/circle_imu.bag", axes="FRD")
    # a VN-100 in a car: 40 Hz, forward, right, down; its scale is 1.8 % high
    assert streams["imu"].num_rows == streams["mag"].num_rows == 6_001
    assert np.median(matrix(streams["imu"], "accel")[:, 2]) == pytest.approx(9.98, rel=0.01)
    assert any("gauss" in text for text in warnings_of(streams["metrics"]))


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("rosbag1/example.bag", "no topic holds a type of message that is read: /rosout"),
        ("rosbag1/example-lz4.bag", "no topic holds a type of message that is read: /rosout"),
        ("rosbag1/example-bz2.bag", "no topic holds a type of message that is read: /rosout"),
        ("rosbag1/no-messages.bag", "it holds no topic"),
        ("rosbag2_db3/openRTK", "no topic holds a type of message that is read: /gps_utm"),
        ("rosbag2_db3/topics_and_services.db3", "no topic holds a type of message that is read: /add_two_ints"),
        ("mcap/talker.mcap", "no topic holds a type of message that is read: /parameter_events"),
    ],
)
def test_a_bag_without_a_usable_topic_is_refused_and_the_other_readers_are_heard(
    logs: Path, name: str, what: str
) -> None:
    with pytest.raises(NothingUsable, match=what.replace("(", r"\(")) as caught:
        recon.read(logs / "formats" / name)
    assert "reader.physycom" in caught.value.hint
    assert caught.value.exit_code == 4


def test_compressed_chunks_hold_the_same_messages(logs: Path) -> None:
    counts = []
    for name in ("example.bag", "example-lz4.bag", "example-bz2.bag"):
        path = logs / "formats/rosbag1" / name
        intake = Intake(path, "reader.rosbag", TopicParams(), EVERYTHING)
        bag = Bag(path, intake)
        bag.take_in()
        counts.append((bag.taken, bag.damaged, {topic: found.count for topic, found in intake.topics.items()}))
    assert counts[0][:2] == (8_647, 0)
    assert counts[0] == counts[1] == counts[2]


def test_the_metadata_of_a_bag_names_its_folder(logs: Path) -> None:
    folder = logs / "formats/converted_here/husky_90s_db3"
    assert recon.read(folder / "metadata.yaml")["imu"] == recon.read(folder)["imu"]
