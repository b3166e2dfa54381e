"""reader.novatel: logs in ASCII, in binary and in captures of packets, if their checksum is right."""

from __future__ import annotations

import struct
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
from recon_readers._novatel_logs import find_logs

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
    rows = np.arange(0, 20 * log_files.GNSS_ROWS, 2)
    truth = log_files.imu(20 * log_files.GNSS_ROWS).take(rows.tolist())
    np.testing.assert_allclose(matrix(imu, "accel"), matrix(truth, "accel"), rtol=0, atol=1e-9)
    np.testing.assert_allclose(matrix(imu, "gyro"), matrix(truth, "gyro"), rtol=0, atol=1e-12)
    schema = schema_of(recon.read(tmp_path / "receiver.gps")["imu"])
    assert (schema["accel_x"].frame, schema["accel_x"].quantity) == ("vehicle", "acceleration")


EXAMPLES = (
    b"%IMURATECORRIMUSA,2209,489768.026;2209,489768.026275000,-0.000000298,-0.000000690,-0.000001034,-0.000043357,"
    b"0.000009959,-0.000012101*36ef5bdd\r\n",
    b"%CORRIMUDATASA,2209,488331.000;2209,488331.000000000,-0.0000016434879909,0.0000053888857361,-0.0000077180775912,"
    b"-0.0001338946509402,-0.0013131748634920,-0.0002721905080061*bd5ba919\r\n",
    b"%CORRIMUSA,2269,129755.030;1,-0.0000731120567875,-0.0000083534662499,0.0000521803559345,-0.0007077320118335,"
    b"0.0008881368174285,0.0001594393292871,7.090,0*b388322e\r\n",
)
"""The first two of the manual, the last one of a receiver."""


def test_logs_of_receivers_with_short_headers_are_read_with_their_checksums() -> None:
    found = find_logs(b"".join(EXAMPLES))
    assert (dict(found.counts), found.damaged) == ({"IMURATECORRIMUS": 1, "CORRIMUDATAS": 1, "CORRIMUS": 1}, 0)
    full_rate, counted = found.columns("IMURATECORRIMUS"), found.columns("CORRIMUS")
    assert (full_rate["seconds"][0], full_rate["yaw_rate"][0], full_rate["vertical"][0]) == (
        489768.026275, -0.000001034, -0.000012101
    )  # fmt: skip
    assert (counted["samples"][0], counted["pitch_rate"][0], counted["vertical"][0]) == (
        1.0, -0.0000731120567875, 0.0001594393292871
    )  # fmt: skip


ACCEL, GYRO = np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.2, 0.3])
"""Forward, left, up."""


def increments(span_s: float) -> list[float]:
    """Pitch, roll, yaw; right, forward, up, of that motion."""
    right_forward_up = np.array([-GYRO[1], GYRO[0], GYRO[2], -ACCEL[1], ACCEL[0], ACCEL[2]])
    return (span_s * right_forward_up).tolist()


def corrected(name: str, form: str, tow_s: float, span_s: float) -> bytes:
    """A log of that motion."""
    body = [log_files.WEEK, tow_s] if name != "CORRIMUS" else [round(span_s / 0.005)]
    numbers = [*body, *increments(span_s)]
    if form == "ascii":
        return log_files.novatel_text(name, tow_s, ",".join(map(repr, numbers)) + ",0,0" * (name == "CORRIMUS"))
    number = {"CORRIMUS": 2264, "IMURATECORRIMUS": 1362, "CORRIMUDATAS": 813}[name]
    payload = struct.pack("<I6dfI" if name == "CORRIMUS" else "<Id6d", *numbers, *[0, 0] * (name == "CORRIMUS"))
    return getattr(log_files, f"novatel_{form}")(number, tow_s, payload)


@pytest.mark.parametrize("form", ["ascii", "binary", "short"])
@pytest.mark.parametrize("name", ["CORRIMUS", "IMURATECORRIMUS", "CORRIMUDATAS"])
def test_a_steady_motion_is_the_same_in_every_log_of_it_and_behind_a_lost_one(
    tmp_path: Path, name: str, form: str
) -> None:
    """Headers tell whole milliseconds, the logs of increments themselves all digits: those of CORRIMUS count samples,
    whose period is the median of steps that err by less than 1 ms of 20.
    """
    times = 100_000.000275 + 0.02 * np.arange(50)
    made = [corrected(name, form, float(t), 0.02) for t in times]
    imu = read(tmp_path, b"".join(made[:20] + made[21:]))["imu"]
    assert imu.num_rows == 49
    rtol = 1e-6  # 1e-9 s of 20 ms, in text as well: times go through doubles of the week
    np.testing.assert_allclose(matrix(imu, "accel"), np.tile(ACCEL, (49, 1)), rtol=rtol)
    np.testing.assert_allclose(matrix(imu, "gyro"), np.tile(GYRO, (49, 1)), rtol=rtol)
    late = 0.0 if name == "CORRIMUS" else 0.000275
    middle = GPS_EPOCH_NS + log_files.WEEK * WEEK_NS + (100_000 - 18) * NS + round((late - 0.01) * 1e9)
    assert abs(int(time_ns(imu)[0]) - middle) < 100


def test_corrimus_tells_how_many_samples_it_holds(tmp_path: Path) -> None:
    """A receiver that gathers one sample more now and then."""
    spans = np.where(np.arange(50) % 7 == 3, 0.015, 0.010)
    times = 100_000.0 + np.cumsum(spans)
    made = [corrected("CORRIMUS", "short", float(t), float(s)) for t, s in zip(np.round(times, 3), spans, strict=True)]
    imu = read(tmp_path, b"".join(made))["imu"]
    np.testing.assert_allclose(matrix(imu, "accel"), np.tile(ACCEL, (50, 1)), rtol=1e-6)


def test_of_several_logs_of_increments_one_is_read_and_the_others_are_named(tmp_path: Path) -> None:
    times = 100_000.0 + 0.02 * np.arange(10)
    made = [corrected(n, "short", float(t), 0.02) for t in times for n in ("CORRIMUDATAS", "IMURATECORRIMUS")]
    made += [log_files.novatel_short(325, float(t), bytes(40)) for t in times]
    streams = read(tmp_path, b"".join(made))
    assert streams["imu"].num_rows == 10
    (note,) = [row["note"] for row in streams["metrics"].to_pylist() if row["name"] == "axes"]
    assert note.startswith("imu: IMURATECORRIMUS,")
    assert note.endswith("CORRIMUDATAS, RAWIMUS not read")


def test_raw_counts_alone_are_told_with_what_to_log(tmp_path: Path) -> None:
    data = log_files.novatel_ascii(4) + log_files.novatel_short(325, 100_000.0, bytes(40))
    streams = read(tmp_path, data)
    assert "imu" not in streams
    assert any("RAWIMUS counts in units of its IMU" in text for text in warnings_of(streams["metrics"]))


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


def test_satellites_are_those_of_the_solution_not_those_tracked(tmp_path: Path) -> None:
    gnss = read(tmp_path, log_files.novatel_ascii(1))["gnss"]
    assert vector(gnss, "satellites").tolist() == [30]  # of 35
    assert vector(read(tmp_path, log_files.novatel_packets(1))["gnss"], "satellites").tolist() == [10]  # of 12


@pytest.mark.parametrize("made", [log_files.novatel_ascii, log_files.novatel_packets], ids=["ascii", "binary"])
@pytest.mark.parametrize("week", [0, 65_535])
def test_a_week_that_is_none_dates_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, made: object, week: int
) -> None:
    good = made(4)  # type: ignore[operator]
    expected = read(tmp_path, good)["gnss"]
    monkeypatch.setattr(log_files, "WEEK", week)
    assert read(tmp_path, made(1) + good)["gnss"].equals(expected)  # type: ignore[operator]


def test_real_captures_of_packets(logs: Path) -> None:
    folder = logs / "formats" / "novatel"
    gnss = recon.read(folder / "bestpos-bestvel-psrdop2-sync.pcap")["gnss"]
    assert int(np.isfinite(vector(gnss, "lat", gaps=True)).sum()) == 33
    assert int(np.isfinite(vector(gnss, "speed", gaps=True)).sum()) == 33
    ins = recon.read(folder / "corrimudata.pcap")
    assert (ins["gnss"].num_rows, ins["reference"].num_rows, ins["imu"].num_rows) == (28, 28, 29)
    apart = [abs(vector(ins["gnss"], n).mean() - vector(ins["reference"], n).mean()) for n in ("lat", "lon", "height")]
    assert max(apart[0] * 1.1e5, apart[1] * 0.8e5, apart[2]) < 3.0  # BESTPOS is the solution of INS there, too
