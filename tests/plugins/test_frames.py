"""reader.frames: names, lists and videos that tell when images were taken."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import recon
from recon import meta, time_ns
from recon.errors import ReadFailed
from recon.rows import warnings_of
from recon_readers._frame_times import Told, line_of, told_by
from recon_readers.frames import FramesParams, declare_readers, read, sniff

NS = 1_574_762_400_123_456_789
"""2019-11-26 10:00:00.123456789 UTC."""


def images(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")
    return folder


def taken(path: Path, **params: str) -> tuple[list[int], list[int], list[str | None]]:
    table = read(path, FramesParams(**params))["frames"]  # type: ignore[arg-type]
    return time_ns(table).tolist(), table["index"].to_pylist(), table["file"].to_pylist()


@pytest.mark.parametrize(
    ("text", "t_ns"),
    [
        ("1574762400123456789", NS),
        ("frame_1574762400123456", NS // 1000 * 1000),
        ("1574762400123", NS // 10**6 * 10**6),
        ("1574762400.123456789", NS),
        ("IMG_20191126_100000123", NS // 10**6 * 10**6),
        ("2019-11-26T10-00-00.123456789Z", NS),
        ("PXL_20191126_100000", NS // 10**9 * 10**9),
        ("2019-11-26 11:00:00.123456789+01:00", NS),
        ("000012_1574762400123", NS // 10**6 * 10**6),
    ],
)
def test_names_tell_times_to_the_last_digit(text: str, t_ns: int) -> None:
    told = told_by(text, "auto", 0)
    assert told is not None
    assert (told.t_ns, told.absolute) == (t_ns, True)


@pytest.mark.parametrize("text", ["000012", "image", "20191326_100000", "12.5", ""])
def test_a_counter_is_no_time(text: str) -> None:
    assert told_by(text, "auto", 0) is None


def test_a_zone_shifts_dates_that_name_none_and_no_others() -> None:
    hour = 3600 * 10**9
    assert told_by("IMG_20191126_110000", "auto", hour) == Told(NS // 10**9 * 10**9, True, False)
    assert told_by("20191126_100000Z", "auto", hour) == Told(NS // 10**9 * 10**9, True, True)


@pytest.mark.parametrize(
    ("text", "told", "file"),
    [
        ("1311868164.363181 rgb/131.png", Told(1311868164_363181000, True, True), "rgb/131.png"),
        ("1403636579763555584,14036.png", Told(1403636579763555584, True, True), "14036.png"),
        ("2011-09-26 13:02:25.964389445", Told(1317042145_964389445, True, False), ""),
        ("0.033333", Told(33_333_000, False, True), ""),
        ('"a.jpg";0.5', Told(500_000_000, False, True), "a.jpg"),
    ],
)
def test_lists_of_common_data_sets_are_read(text: str, told: Told, file: str) -> None:
    """TUM RGB-D, EuRoC, KITTI, seconds of a video, a table."""
    line = line_of(text, "auto", 0)
    assert line is not None
    assert (replace(line.told, unit=""), line.file) == (told, file)


def test_images_are_in_the_order_of_their_times(tmp_path: Path) -> None:
    folder = images(tmp_path / "images", "1574762401500.jpg", "1574762400500.jpg", "notes.md")
    assert sniff(folder, b"").confidence == 0.5
    times, index, files = taken(folder)
    assert (index, files) == ([0, 1], ["1574762400500.jpg", "1574762401500.jpg"])
    assert times == [1574762400_500000000, 1574762401_500000000]


def test_a_list_in_the_folder_serves_images_that_are_counted(tmp_path: Path) -> None:
    folder = images(tmp_path / "image_02", "data/0000000000.png", "data/0000000001.png")
    (folder / "times.txt").write_text("# taken\n2011-09-26 13:02:25.5\n2011-09-26 13:02:25.6\n", encoding="utf-8")
    with pytest.raises(ReadFailed, match="tells no time"):
        read(folder, FramesParams())
    (folder / "times.txt").write_text("time file\n1.5 data/0000000001.png\n0.5 data/0000000000.png\n", encoding="utf-8")
    times, index, files = taken(folder, start="2011-09-26T13:00:00Z")
    assert np.diff(times).tolist() == [1_000_000_000]
    # The index is the place in the list.
    assert (index, files) == ([1, 0], ["data/0000000000.png", "data/0000000001.png"])


def test_a_list_alone_is_known_by_the_images_that_it_names(tmp_path: Path) -> None:
    path = tmp_path / "rgb.txt"
    path.write_text("# color images\n# timestamp filename\n1311868164.3 rgb/a.png\n1311868164.4 rgb/b.png\n", "utf-8")
    assert sniff(path, path.read_bytes()).confidence > 0.5
    times, index, files = taken(path)
    assert (times, index) == ([1311868164_300000000, 1311868164_400000000], [0, 1])
    assert files == ["rgb/a.png", "rgb/b.png"]
    assert recon.read(path)["frames"].num_rows == 2


def test_times_without_a_zero_are_relative_and_say_so(tmp_path: Path) -> None:
    path = tmp_path / "frames.txt"
    path.write_text("0.0\n0.1\n0.2\n", "utf-8")
    streams = read(path, FramesParams())
    assert meta(streams["frames"])["clock"] == "relative"
    assert "give reader.frames.start" in warnings_of(streams["metrics"])[0]
    again = read(path, FramesParams(unit="ms", start="2019-11-26T10:00:00+01:00"))["frames"]
    assert (meta(again)["clock"], time_ns(again)[1]) == ("absolute", 1574758800_000100000)


def test_a_date_without_a_zone_is_warned_of(tmp_path: Path) -> None:
    folder = images(tmp_path / "images", "IMG_20191126_110000.jpg")
    assert "they name none" in warnings_of(read(folder, FramesParams(zone="+01:00"))["metrics"])[0]
    assert taken(folder, zone="+01:00")[0] == [NS // 10**9 * 10**9]


def test_lines_without_a_time_are_counted_and_most_of_them_refused(tmp_path: Path) -> None:
    path = tmp_path / "list.txt"
    path.write_text("1574762400.1 a.png\nlost b.png\n1574762400.3 c.png\n1574762400.4 d.png\n15747624", "utf-8")
    streams = read(path, FramesParams())
    assert streams["frames"]["index"].to_pylist() == [0, 1, 2]
    assert any(row["name"] == "lines_left_out" and row["value"] == 2.0 for row in streams["metrics"].to_pylist())
    path.write_text("head\none\ntwo 3\n", "utf-8")
    with pytest.raises(ReadFailed, match=r"list\.txt:2: it lists no times"):
        read(path, FramesParams())


def test_what_holds_no_image_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ReadFailed, match="it holds no image"):
        read(tmp_path, FramesParams())
    images(tmp_path, "000001.jpg")
    with pytest.raises(ReadFailed, match=r"000001\.jpg tells no time"):
        read(tmp_path, FramesParams())


def video(path: Path, shown: list[int], **facts: str) -> Path:
    """A video of grey frames at these ms."""
    av = pytest.importorskip("av", reason="needs recon-dynamics[video]")
    with av.open(str(path), "w", options={"movflags": "use_metadata_tags"}) as container:
        container.metadata.update(facts)
        stream = container.add_stream("mpeg4", rate=1000)
        stream.width = stream.height = 32
        stream.codec_context.time_base = Fraction(1, 1000)
        for ms in shown:
            frame = av.VideoFrame.from_ndarray(np.full((32, 32), 128, np.uint8), "gray").reformat(format="yuv420p")
            frame.pts, frame.time_base = ms, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def test_a_video_tells_the_time_of_each_frame(tmp_path: Path) -> None:
    path = video(tmp_path / "drive.mp4", [0, 33, 67, 100, 180], creation_time="2019-11-26T10:00:00.000000Z")
    assert sniff(path, path.read_bytes()).confidence > 0.0
    streams = read(path, FramesParams())
    wanted = np.array([0, 33, 67, 100, 180]) * 1_000_000
    # The container counts in its own unit, 1/1000 s or finer.
    np.testing.assert_allclose(time_ns(streams["frames"]) - 1574762400 * 10**9, wanted, rtol=0.0, atol=1e5)
    assert streams["frames"]["index"].to_pylist() == [0, 1, 2, 3, 4]
    assert "some phones write when it ended" in warnings_of(streams["metrics"])[0]
    moved = read(path, FramesParams(start="2019-11-26T10:00:05Z"))
    assert time_ns(moved["frames"])[0] == 1574762405 * 10**9
    assert warnings_of(moved["metrics"]) == []


def test_a_video_that_does_not_say_when_it_began_is_relative(tmp_path: Path) -> None:
    streams = read(video(tmp_path / "drive.mp4", [0, 33]), FramesParams())
    assert meta(streams["frames"])["clock"] == "relative"


def test_facts_of_a_video_that_are_no_text_or_no_time_say_nothing(tmp_path: Path) -> None:
    path = video(tmp_path / "drive.mp4", [0, 33], creation_time="2019-11-26T10:00:00.000000Z", comment="by hand")
    for damage in ((b"by hand", b"b\xcf hand"), (b"2019-11-26", b"9019-11-26"), (b"9019-11-26", b"2019-71-26")):
        assert damage[0] in path.read_bytes()
        path.write_bytes(path.read_bytes().replace(*damage))
        assert read(path, FramesParams())["frames"].num_rows == 2
    assert meta(read(path, FramesParams())["frames"])["clock"] == "relative"


def test_a_line_of_a_time_beyond_any_clock_is_left_out(tmp_path: Path) -> None:
    (tmp_path / "rgb.txt").write_text("0.0 a.png\n0.1 b.png\n99999999999999.0 c.png\n0.3 d.png\n")
    assert read(tmp_path / "rgb.txt", FramesParams())["frames"].num_rows == 3


def test_a_damaged_video_is_refused(tmp_path: Path) -> None:
    path = video(tmp_path / "drive.mp4", list(range(0, 1000, 40)))
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(ReadFailed, match="no video"):
        read(path, FramesParams())


def test_the_declaration_has_no_fault() -> None:
    assert [stage.faults() for stage in declare_readers()] == [[]]


@pytest.mark.parametrize(("name", "value"), [("zone", "+01:75"), ("start", "9019-11-26"), ("start", "noon")])
def test_a_zone_or_a_start_that_is_none_is_refused(name: str, value: str) -> None:
    with pytest.raises(ValueError, match=name):
        FramesParams(**{name: value})  # type: ignore[arg-type]


def test_a_start_is_taken_to_the_nanosecond() -> None:
    assert FramesParams(start="2019-11-26T11:00:00.123456789", zone="+01:00").start_ns == NS
