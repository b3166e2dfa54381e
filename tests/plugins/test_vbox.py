"""reader.vbox: longitude positive to the west, km/h or knots, midnight, and an IMU whose axes are asked for."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from fuzz import log_files

import recon
import recon_readers.vbox
from recon import Streams
from recon.errors import ReadFailed
from recon.rows import warnings_of
from recon.tables import matrix, meta, time_ns, vector
from recon_readers.vbox import VboxParams


def read(folder: Path, text: bytes, **params: object) -> Streams:
    path = folder / "drive.vbo"
    path.write_bytes(text)
    return recon_readers.vbox.read(path, VboxParams(**params))


def test_a_drive_comes_back_as_it_was_written(tmp_path: Path) -> None:
    gnss, truth = read(tmp_path, log_files.vbo())["gnss"], log_files.gnss()
    np.testing.assert_array_equal(time_ns(gnss), time_ns(truth))
    for name in ("lat", "lon"):
        np.testing.assert_allclose(vector(gnss, name), vector(truth, name), rtol=0, atol=0.51e-8 / 60)
    np.testing.assert_allclose(vector(gnss, "height"), vector(truth, "height"), rtol=0, atol=0.51e-3)
    np.testing.assert_allclose(vector(gnss, "speed"), vector(truth, "speed"), rtol=0, atol=0.51e-4 / 3.6)
    np.testing.assert_allclose(vector(gnss, "course"), vector(truth, "course"), rtol=0, atol=np.radians(0.51e-3))
    assert set(vector(gnss, "satellites")) == {12.0}  # 140 = 128 for differential corrections + 12
    assert meta(gnss)["height_datum"] == "mean_sea_level"


def test_the_axes_of_the_imu_are_asked_for(tmp_path: Path) -> None:
    streams = read(tmp_path, log_files.vbo())
    assert "imu" not in streams
    assert any("set reader.vbox.axes" in text for text in warnings_of(streams["metrics"]))
    imu, truth = read(tmp_path, log_files.vbo(), axes="FLU")["imu"], log_files.imu(log_files.GNSS_ROWS)
    np.testing.assert_allclose(matrix(imu, "accel"), matrix(truth, "accel"), rtol=1e-6, atol=1e-9)  # 7 digits
    np.testing.assert_allclose(matrix(imu, "gyro"), matrix(truth, "gyro"), rtol=1e-6, atol=1e-9)


def test_axes_that_contradict_gravity_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ReadFailed, match=r"feels -9\.\d\d m/s\^2 upwards") as caught:
        read(tmp_path, log_files.vbo(), axes="FRD")
    assert caught.value.hint == "correct axes or at_rest"


def test_knots_are_read_from_the_header_and_a_missing_unit_is_asked_for(tmp_path: Path) -> None:
    in_knots = read(tmp_path, log_files.vbo().replace(b"velocity kmh", b"velocity knots"))["gnss"]
    in_km_h = read(tmp_path, log_files.vbo())["gnss"]
    np.testing.assert_allclose(vector(in_knots, "speed"), vector(in_km_h, "speed") * 1.852, rtol=1e-12)
    silent = log_files.vbo().replace(b"velocity kmh", b"velocity")
    with pytest.raises(ReadFailed, match="does not tell the unit of velocity"):
        read(tmp_path, silent)
    assert read(tmp_path, silent, speed_unit="km/h")["gnss"].equals(in_km_h)


def test_time_goes_on_over_midnight(tmp_path: Path) -> None:
    lines = log_files.vbo(4).split(b"\r\n")
    clocks = (b"235959.800", b"235959.900", b"000000.000", b"000000.100")
    for clock, row in zip(clocks, range(len(lines) - 5, len(lines) - 1), strict=True):
        parts = lines[row].split(b" ")
        lines[row] = b" ".join([parts[0], clock, *parts[2:]])
    assert np.diff(time_ns(read(tmp_path, b"\r\n".join(lines))["gnss"])).tolist() == [100_000_000] * 3


def at_clocks(lines: list[bytes], *clocks: bytes) -> bytes:
    """The file of as many rows at other times of day."""
    for clock, row in zip(clocks, range(len(lines) - 1 - len(clocks), len(lines) - 1), strict=True):
        parts = lines[row].split(b" ")
        lines[row] = b" ".join([parts[0], clock, *parts[2:]])
    return b"\r\n".join(lines)


@pytest.mark.parametrize(
    ("created", "first", "day"),
    [
        (b"15/04/2004 @ 08:21", b"072148.26", "2004-04-15T07:21:48.26"),
        (b"15/04/2004 @ 23:59", b"000001.00", "2004-04-16T00:00:01"),
        (b"15/04/2004 @ 00:30", b"233000.00", "2004-04-14T23:30:00"),
    ],
)
def test_the_clock_by_which_a_file_was_created_may_be_another_zones(
    tmp_path: Path, created: bytes, first: bytes, day: str
) -> None:
    lines = log_files.vbo(1).split(b"\r\n")
    lines[0] = b"File created on " + created
    gnss = read(tmp_path, at_clocks(lines, first))["gnss"]
    assert time_ns(gnss)[0] == np.datetime64(day, "ns").astype(np.int64)


def test_a_column_of_dates_goes_before_the_date_of_the_file(tmp_path: Path) -> None:
    """As a VBOX Micro writes it; the first rows have none yet."""
    lines = log_files.vbo(4).replace(b" Brake\r\n", b" Date\r\n").split(b"\r\n")
    dates = (b"000000", b"000000", b"080708", b"080708")
    for date, row in zip(dates, range(len(lines) - 5, len(lines) - 1), strict=True):
        lines[row] = b" ".join([*lines[row].split()[:-1], date])
    gnss = read(tmp_path, at_clocks(lines, b"235959.80", b"235959.90", b"000000.00", b"000000.10"))["gnss"]
    midnight = np.datetime64("2008-07-08", "ns").astype(np.int64)
    assert time_ns(gnss).tolist() == (midnight + 100_000_000 * np.arange(-2, 2)).tolist()


def test_without_satellites_a_speed_of_zero_is_no_stop(tmp_path: Path) -> None:
    lines = log_files.vbo(6).split(b"\r\n")
    for row in (len(lines) - 4, len(lines) - 3):
        parts = lines[row].split(b" ")
        lines[row] = b" ".join([b"064", *parts[1:4], b"000.000", *parts[5:]])  # 64: the brake was pressed
    streams = read(tmp_path, b"\r\n".join(lines), axes="FLU")
    assert (streams["gnss"].num_rows, streams["imu"].num_rows) == (4, 6)


def test_an_infinite_number_of_satellites_warns_nobody(tmp_path: Path) -> None:
    lines = log_files.vbo(6).split(b"\r\n")
    lines[-3] = lines[-3].replace(b"140 ", b"1e999 ", 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        satellites = vector(read(tmp_path, b"\r\n".join(lines))["gnss"], "satellites", gaps=True)
    np.testing.assert_array_equal(satellites, [12.0, 12.0, 12.0, 12.0, np.nan, 12.0])


def test_damaged_rows_are_left_out_and_counted(tmp_path: Path) -> None:
    lines = log_files.vbo().split(b"\r\n")
    first = lines.index(b"[data]") + 1
    lines[first + 5] = lines[first + 5].replace(b"+", b"?", 1)
    lines[first + 9] = lines[first + 9][:60]
    streams = read(tmp_path, b"\r\n".join(lines))
    assert streams["gnss"].num_rows == log_files.GNSS_ROWS - 2
    (skipped,) = [row for row in streams["metrics"].to_pylist() if row["name"] == "lines_skipped"]
    assert (skipped["value"], skipped["note"]) == (2.0, f"damaged, the first in line {first + 6}")


def test_a_last_row_that_was_cut_off_is_left_out(tmp_path: Path) -> None:
    text = log_files.vbo().rstrip()
    for cut in (1, 4, 20, 100):
        assert read(tmp_path, text[:-cut])["gnss"].num_rows == log_files.GNSS_ROWS - 1


def test_a_file_without_data_names_what_it_lacks(tmp_path: Path) -> None:
    with pytest.raises(ReadFailed, match=r"it has no section \[data\]"):
        read(tmp_path, log_files.vbo().partition(b"[data]")[0])


def test_the_real_log_of_a_vbox_3i(logs: Path) -> None:
    path = logs / "formats" / "vbox" / "Example_File.VBO"
    recording = recon.read(path, **{"reader.vbox.axes": "FLU"})
    gnss, imu = recording["gnss"], recording["imu"]
    assert gnss.num_rows == imu.num_rows == 1833
    assert set(np.diff(time_ns(gnss)).tolist()) == {10_000_000}
    assert vector(gnss, "lat")[0] == pytest.approx(3141.68909263 / 60, abs=1e-12)
    assert vector(gnss, "lon")[0] == pytest.approx(-99.51333601 / 60, abs=1e-12)  # positive to the west in the file
    assert vector(gnss, "speed").max() < 0.5  # it stands
    assert np.median(matrix(imu, "accel")[:, 2]) == pytest.approx(9.8, abs=0.1)
    assert np.abs(matrix(imu, "gyro")).mean() < np.radians(1.0)
    assert any("took 15 s off GPS time where UTC was 17 s behind" in text for text in warnings_of(recording["metrics"]))
