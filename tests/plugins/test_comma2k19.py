"""reader.comma2k19: folders of arrays become streams in UTC, along forward, left, up and east, north, up."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from array_logs import ACCEL_FRD, BOOT_S, GYRO_FRD, HEIGHT, LAT, LON, SPEED, save, save_sensor, segment, times
from metric_rows import rows_named

import recon
import recon_readers.comma2k19
from recon import Streams
from recon.errors import DataError, ReadFailed
from recon.numerics.geodesy import Anchor, geodetic_to_enu
from recon.numerics.rotation import conjugate, multiply, to_rotvec
from recon.parameters import NoParams
from recon.rows import warnings_of
from recon.tables import has, matrix, meta, seconds, time_ns, vector

FIRST_FRAME = datetime(2018, 8, 2, 16, 14, 48, tzinfo=UTC)
"""Week 2012 of GPS began on 2018-07-29; 404 106 s later it is Thursday, 16:15:06, and UTC is 18 s behind."""
FIRST_FRAME_NS = round(FIRST_FRAME.timestamp()) * 1_000_000_000
AS_FLU = (1.0, -1.0, -1.0)


def read(path: Path) -> Streams:
    return recon_readers.comma2k19.read(path, NoParams())


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return segment(tmp_path / "40")


def test_vectors_come_along_forward_left_up(folder: Path) -> None:
    streams = read(folder)
    assert matrix(streams["imu"], "accel")[0].tolist() == [1.0, -0.5, 9.8]
    assert matrix(streams["imu"], "gyro")[0].tolist() == [0.1, -0.2, 0.3]
    assert matrix(streams["mag"], "mag")[0] == pytest.approx([20e-6, -5e-6, -40e-6])


def test_time_is_utc_by_the_gps_times_of_the_frames(folder: Path) -> None:
    streams = read(folder)
    # the times of week are kept to 1e-10 s of 4e5 s, the sum since 1970 to 2e-7 s of 1.5e9 s, then rounded to 1e-6 s
    for name in ("imu", "reference", "frames"):
        assert abs(int(time_ns(streams[name])[0]) - FIRST_FRAME_NS) <= 1_000
        assert (meta(streams[name])["clock"], meta(streams[name])["time_scale"]) == ("absolute", "UTC")
    assert [row["value"] for row in rows_named(streams, "gnss_age")] == [pytest.approx(0.2, abs=1e-6)] * 2


def test_without_poses_the_receiver_tells_utc(folder: Path) -> None:
    shutil.rmtree(folder / "global_pose")
    streams = read(folder)
    # its rows arrive 0.2 s after the time that they give
    assert abs(int(time_ns(streams["imu"])[0]) - (FIRST_FRAME_NS - 200_000_000)) <= 1_000
    assert "reference" not in streams


def test_where_nothing_tells_utc_times_count_from_boot_and_a_warning_says_so(folder: Path) -> None:
    shutil.rmtree(folder / "global_pose")
    shutil.rmtree(folder / "processed_log" / "GNSS")
    streams = read(folder)
    assert int(time_ns(streams["imu"])[0]) == round(BOOT_S * 1e9)
    assert meta(streams["imu"])["clock"] == "relative"
    assert warnings_of(streams["metrics"]) == [
        "nothing in the segment tells UTC: times count from the boot of the phone"
    ]


def test_the_reference_is_the_camera_in_east_north_up(folder: Path) -> None:
    reference = read(folder)["reference"]
    anchor = meta(reference)["anchor"]
    # Bowring's latitude is exact to rounding, 1e-9 m of 6e6 m; heights and positions lose three digits more
    assert [anchor["lat"], anchor["lon"], anchor["height"]] == pytest.approx([LAT, LON, HEIGHT], abs=1e-6)
    np.testing.assert_allclose(matrix(reference, "vel"), np.tile([SPEED, 0.0, 0.0], (80, 1)), atol=1e-9)
    np.testing.assert_allclose(matrix(reference, "pos")[:, 0], SPEED * seconds(reference), atol=1e-6)
    # it looks east, level: forward, left, up are east, north, up
    np.testing.assert_allclose(np.abs(matrix(reference, "q")), np.tile([1.0, 0.0, 0.0, 0.0], (80, 1)), atol=1e-9)
    assert meta(reference)["body"] == "camera"


def test_gnss_of_both_receivers_has_place_speed_and_course(folder: Path) -> None:
    streams = read(folder)
    assert (streams["gnss"].num_rows, streams["gnss_2"].num_rows) == (40, 8)
    first = streams["gnss"].to_pylist()[0]
    assert (first["lat"], first["lon"], first["height"]) == pytest.approx((LAT, LON, HEIGHT))
    assert (first["speed"], first["course"]) == (SPEED, pytest.approx(np.pi / 2))


def test_wheels_keep_their_order_and_the_steering_its_own_times(folder: Path) -> None:
    wheel = read(folder)["wheel"]
    names = ("speed", "speed_front_left", "speed_front_right", "speed_rear_left", "speed_rear_right")
    assert [vector(wheel, name, gaps=True)[0] for name in names] == [SPEED, 9.0, 11.0, 9.5, 10.5]
    angle = vector(wheel, "steering_angle", gaps=True)
    assert np.isnan(angle[0])
    assert angle[1] == pytest.approx(np.pi / 2)


def test_an_accelerometer_and_a_gyroscope_of_other_times_leave_gaps(folder: Path) -> None:
    t_s = BOOT_S + times(100.0) + 0.004
    save_sensor(folder / "processed_log/IMU/gyro", t_s, np.tile(GYRO_FRD, (len(t_s), 1)))
    imu = read(folder)["imu"]
    assert imu.num_rows == 800
    assert np.isnan(matrix(imu, "gyro", gaps=True)[::2]).all()
    np.testing.assert_array_equal(
        matrix(imu, "accel", gaps=True)[::2], np.tile(np.multiply(ACCEL_FRD, AS_FLU), (400, 1))
    )


@pytest.mark.parametrize(("kind", "stream"), [("IMU", "imu"), ("GNSS", "gnss"), ("CAN", "wheel")])
def test_one_kind_of_sensor_is_enough(folder: Path, kind: str, stream: str) -> None:
    for other in {"IMU", "GNSS", "CAN"} - {kind}:
        shutil.rmtree(folder / "processed_log" / other)
    shutil.rmtree(folder / "global_pose")
    assert read(folder)[stream].num_rows > 0


def test_rows_out_of_order_are_left_out_and_told(folder: Path) -> None:
    t_s = BOOT_S + times(100.0)
    t_s[[7, 9, 20]] = t_s[3], np.nan, t_s[19]
    save(folder / "processed_log/IMU/accelerometer/t", t_s)
    streams = read(folder)
    assert [(row["value"], row["note"].split(":")[0]) for row in rows_named(streams, "rows_left_out")] == [
        (3.0, "of 400 rows of IMU/accelerometer")
    ]
    assert np.isnan(matrix(streams["imu"], "accel", gaps=True)).all(axis=1).sum() == 3


def test_frames_name_the_video_where_it_is_there(folder: Path) -> None:
    assert set(read(folder)["frames"]["file"].to_pylist()) == {None}
    (folder / "video.hevc").write_bytes(b"")
    frames = read(folder)["frames"]
    assert set(frames["file"].to_pylist()) == {"video.hevc"}
    assert frames["index"].to_pylist() == list(range(80))


def test_auto_knows_a_segment_and_a_folder_that_holds_one(folder: Path) -> None:
    for path in (folder, folder.parent):
        streams = recon.read(path)
        assert [row["method"] for row in rows_named(dict(streams), "reader")] == ["reader.comma2k19"]
        assert {"imu", "gnss", "gnss_2", "mag", "wheel", "reference", "frames"} <= set(streams)


# --- what is refused ------------------------------------------------------------------------------------------------


class Bomb:
    """What a pickle could do."""

    def __reduce__(self) -> tuple[Callable[..., object], tuple[object, ...]]:
        return (exec, ("raise SystemExit('unpickled')",))


def pickled(path: Path) -> None:
    with path.open("wb") as file:
        np.save(file, np.array([Bomb()], dtype=object), allow_pickle=True)


BROKEN = {
    "objects": (pickled, "it is no whole NumPy array of numbers"),
    "no array": (lambda path: path.write_bytes(b"PK\x03\x04 none"), "it is no whole NumPy array of numbers"),
    "cut": (lambda path: path.write_bytes(path.read_bytes()[:500]), "it is no whole NumPy array of numbers"),
    "empty": (lambda path: path.write_bytes(b""), "it is no whole NumPy array of numbers"),
    "text": (
        lambda path: save(path, np.array(["a"])),
        "it is an array of <U1, shape (1,); numbers of shape (n, 3) are needed",
    ),
    "two columns": (
        lambda path: save(path, np.zeros((400, 2))),
        "it is an array of float64, shape (400, 2); numbers of shape (n, 3) are needed",
    ),
    "fewer rows": (lambda path: save(path, np.zeros((9, 3))), "it has 9 rows where its times are 400"),
    "absent": (lambda path: path.unlink(), "the file is not there"),
    "impossible": (
        lambda path: save(path, np.full((400, 3), 1e30)),
        "accel is 1e+30 in row 0, which no vehicle shows",
    ),
}


@pytest.mark.parametrize(("damage", "what"), BROKEN.values(), ids=BROKEN)
def test_a_broken_array_is_named_and_refused_in_one_sentence(
    folder: Path, damage: Callable[[Path], object], what: str
) -> None:
    path = folder / "processed_log/IMU/accelerometer/value"
    damage(path)
    with pytest.raises(ReadFailed) as caught:
        read(folder)
    assert (caught.value.path, caught.value.what) == (path, what)
    assert caught.value.hint


def test_poses_that_are_not_complete_are_refused(folder: Path) -> None:
    (folder / "global_pose" / "frame_velocities").unlink()
    with pytest.raises(ReadFailed, match="frame_velocities: the file is not there"):
        read(folder)


def test_a_folder_of_two_segments_is_refused_with_their_names(folder: Path) -> None:
    segment(folder.parent / "41")
    with pytest.raises(DataError, match="it holds 2 segments: 40, 41") as caught:
        recon.read(folder.parent)
    assert caught.value.hint == "name the folder of one of them"


def test_a_segment_without_rows_is_refused(tmp_path: Path) -> None:
    (tmp_path / "40" / "processed_log" / "IMU").mkdir(parents=True)
    with pytest.raises(ReadFailed, match="no row of IMU, GNSS or CAN is below processed_log"):
        read(tmp_path / "40")


def test_another_folder_is_no_segment(tmp_path: Path) -> None:
    assert recon_readers.comma2k19.sniff(tmp_path, b"").confidence == 0.0
    with pytest.raises(ReadFailed, match="this is no segment of comma2k19"):
        read(tmp_path)


# --- the example of the data set ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def example(logs: Path) -> Streams:
    return read(logs / "comma2k19_example")


def at(table, group: str, t_ns: np.ndarray) -> np.ndarray:
    """Columns of a group between the rows of a table: (n, k)."""
    own = (time_ns(table) - t_ns[0]) * 1e-9
    return np.column_stack([np.interp((t_ns - t_ns[0]) * 1e-9, own, column) for column in matrix(table, group).T])


def test_the_accelerometer_of_the_example_feels_gravity_upwards(example: Streams) -> None:
    # a minute of a car on a road: what is not gravity averages out to some percent, the mounting tilts 4 deg
    assert matrix(example["imu"], "accel").mean(axis=0)[2] == pytest.approx(9.8, rel=0.03)


def test_the_gyroscope_of_the_example_turns_as_the_camera_does(example: Streams) -> None:
    reference, imu = example["reference"], example["imu"]
    q, t_ns = matrix(reference, "q"), time_ns(reference)
    rate = to_rotvec(multiply(conjugate(q[:-1]), q[1:])) / np.diff(t_ns * 1e-9)[:, None]
    measured = at(imu, "gyro", (t_ns[1:] + t_ns[:-1]) // 2)
    for axis in range(3):
        slope = np.polyfit(rate[:, axis], measured[:, axis], 1)[0]
        assert slope == pytest.approx(1.0, abs=0.15)  # vibration between frames is noise in both; the sign is the point


def test_gnss_and_wheels_of_the_example_agree_with_the_reference(example: Streams) -> None:
    reference, gnss, wheel = example["reference"], example["gnss"], example["wheel"]
    place = [vector(gnss, name) for name in ("lat", "lon", "height")]
    apart = geodetic_to_enu(*place, Anchor(**meta(reference)["anchor"])) - at(reference, "pos", time_ns(gnss))
    # a receiver without corrections errs by some m; the data set gives no figure of its own
    assert np.abs(apart).max() < 5.0
    speed = np.linalg.norm(matrix(reference, "vel"), axis=1)
    known = ~np.isnan(vector(wheel, "speed", gaps=True))
    t_s = (time_ns(wheel)[known] - time_ns(reference)[0]) * 1e-9
    ratio = vector(wheel, "speed", gaps=True)[known].mean() / np.interp(t_s, seconds(reference), speed).mean()
    assert ratio == pytest.approx(1.0, abs=0.03)  # tyres differ from their nominal radius by some percent
    assert has(wheel, "steering_angle")
