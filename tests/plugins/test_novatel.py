"""reader.novatel: logs in ASCII, in binary and in captures of packets, if their checksum is right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fuzz import log_files

import recon
import recon_readers.novatel
from recon import Streams
from recon.errors import ReadFailed
from recon.numerics.gnss_time import GPS_EPOCH_NS, NS, WEEK_NS
from recon.numerics.rotation import to_euler
from recon.parameters import NoParams
from recon.rows import warnings_of
from recon.tables import matrix, meta, schema_of, time_ns, vector

FIRST_NS = GPS_EPOCH_NS + log_files.WEEK * WEEK_NS + (100_000 - 18) * NS


def read(folder: Path, data: bytes) -> Streams:
    path = folder / "receiver.gps"
    path.write_bytes(data)
    return recon_readers.novatel.read(path, NoParams())


@pytest.mark.parametrize("made", [log_files.novatel_ascii, log_files.novatel_packets], ids=["ascii", "binary"])
def test_a_drive_comes_back_as_it_was_written(tmp_path: Path, made: object) -> None:
    gnss, truth = read(tmp_path, made())["gnss"], log_files.gnss()  # type: ignore[operator]
    assert time_ns(gnss)[0] == FIRST_NS  # 18 leap seconds; BESTVELA is 0.15 s old, and so at the time of BESTPOSA
    np.testing.assert_array_equal(np.diff(time_ns(gnss)), np.diff(time_ns(truth)))
    for name, half_digit in (("lat", 0.51e-11), ("height", 0.51e-4), ("speed", 0.51e-4)):
        np.testing.assert_allclose(vector(gnss, name), vector(truth, name), rtol=0, atol=half_digit)
    np.testing.assert_allclose(vector(gnss, "course"), vector(truth, "course"), rtol=0, atol=np.radians(0.51e-6))
    np.testing.assert_allclose(matrix(gnss, "pos_std")[0], [0.0202, 0.0101, 0.0303], rtol=1e-6)  # east, north, up
    assert meta(gnss)["height_datum"] == "ellipsoid"


def test_the_solution_of_ins_is_the_reference(tmp_path: Path) -> None:
    reference, truth = read(tmp_path, log_files.novatel_ascii())["reference"], log_files.gnss()
    yaw, pitch, roll = to_euler(matrix(reference, "q"))
    np.testing.assert_allclose(np.sin(yaw), np.cos(vector(truth, "course")), rtol=0, atol=1e-9)
    np.testing.assert_allclose(np.degrees(roll), 1.5, atol=1e-9)  # right side down
    np.testing.assert_allclose(np.degrees(pitch), 2.5, atol=1e-9)  # -2.5 with the nose up is 2.5 with the nose down
    course = np.arctan2(*matrix(reference, "vel")[:, :2].T)
    np.testing.assert_allclose(np.mod(course, 2 * np.pi), vector(truth, "course"), atol=1e-4)


def test_corrected_increments_become_accelerations_of_the_vehicle(tmp_path: Path) -> None:
    imu = read(tmp_path, log_files.novatel_packets())["imu"]
    rows = np.arange(2, 20 * log_files.GNSS_ROWS, 2)  # of the first the step is not known
    truth = log_files.imu(20 * log_files.GNSS_ROWS).take(rows.tolist())
    np.testing.assert_allclose(matrix(imu, "accel"), matrix(truth, "accel"), rtol=0, atol=1e-9)
    np.testing.assert_allclose(matrix(imu, "gyro"), matrix(truth, "gyro"), rtol=0, atol=1e-12)
    schema = schema_of(recon.read(tmp_path / "receiver.gps")["imu"])
    assert (schema["accel_x"].frame, schema["accel_x"].quantity) == ("vehicle", "acceleration")


def test_damaged_logs_are_left_out_and_counted(tmp_path: Path) -> None:
    lines = log_files.novatel_ascii(4).splitlines(keepends=True)
    lines[0] = lines[0].replace(b"NARROW_INT", b"NARROW_IND")
    streams = read(tmp_path, b"".join(lines)[:-20])
    assert int(np.isfinite(vector(streams["gnss"], "lat", gaps=True)).sum()) == 3
    assert streams["reference"].num_rows == 3
    assert any("1 logs with a wrong checksum" in text for text in warnings_of(streams["metrics"]))


def test_times_that_are_not_known_and_solutions_that_are_none_do_not_count(tmp_path: Path) -> None:
    good = log_files.novatel_ascii(1).splitlines(keepends=True)[0]
    fields = good.partition(b";")[2].rpartition(b"*")[0].decode()
    none = log_files.novatel_text("BESTPOS", 99_999.0, fields.replace("SOL_COMPUTED", "INSUFFICIENT_OBS"))
    assert read(tmp_path, none + good)["gnss"].num_rows == 1
    with pytest.raises(ReadFailed, match="none of its logs holds a solution: 1 BESTPOS"):
        read(tmp_path, none)


def test_real_captures_of_packets(logs: Path) -> None:
    folder = logs / "formats" / "novatel"
    gnss = recon.read(folder / "bestpos-bestvel-psrdop2-sync.pcap")["gnss"]
    assert int(np.isfinite(vector(gnss, "lat", gaps=True)).sum()) == 33
    assert int(np.isfinite(vector(gnss, "speed", gaps=True)).sum()) == 33
    ins = recon.read(folder / "corrimudata.pcap")
    assert (ins["gnss"].num_rows, ins["reference"].num_rows, ins["imu"].num_rows) == (28, 28, 28)
    apart = [abs(vector(ins["gnss"], n).mean() - vector(ins["reference"], n).mean()) for n in ("lat", "lon", "height")]
    assert max(apart[0] * 1.1e5, apart[1] * 0.8e5, apart[2]) < 3.0  # BESTPOS is the solution of INS there, too
