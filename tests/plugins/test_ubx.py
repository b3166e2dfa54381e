"""reader.ubx: messages become gnss, imu and wheel; a message counts wherever it stands, if its checksum is right."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from fuzz import log_files

import recon
import recon_readers.ubx
from recon import Streams
from recon.errors import ReadFailed
from recon.rows import warnings_of
from recon.tables import matrix, meta, time_ns, vector
from recon_readers.ubx import UbxParams


def read(folder: Path, data: bytes, **params: object) -> Streams:
    path = folder / "log.ubx"
    path.write_bytes(data)
    return recon_readers.ubx.read(path, UbxParams(**params))


def pvts(rows: int) -> list[bytes]:
    return [log_files.nav_pvt(log_files.gnss(), row) for row in range(rows)]


def test_a_drive_comes_back_as_it_was_written(tmp_path: Path) -> None:
    streams = read(tmp_path, log_files.ubx(), at_rest="up")
    gnss, truth = streams["gnss"], log_files.gnss()
    np.testing.assert_array_equal(time_ns(gnss), time_ns(truth))
    np.testing.assert_allclose(vector(gnss, "lat"), vector(truth, "lat"), rtol=0, atol=0.51e-7)
    np.testing.assert_allclose(vector(gnss, "lon"), vector(truth, "lon"), rtol=0, atol=0.51e-7)
    np.testing.assert_allclose(vector(gnss, "height"), vector(truth, "height"), rtol=0, atol=0.51e-3)
    np.testing.assert_allclose(vector(gnss, "speed"), vector(truth, "speed"), rtol=0, atol=0.51e-3)
    np.testing.assert_allclose(vector(gnss, "course"), vector(truth, "course"), rtol=0, atol=np.radians(0.51e-5))
    assert matrix(gnss, "pos_std")[0].tolist() == [0.012, 0.012, 0.034]
    assert matrix(gnss, "vel_std")[0].tolist() == [0.05] * 3
    assert meta(gnss)["height_datum"] == "ellipsoid"
    assert meta(gnss)["heading_kind"] == "course_true"


def test_the_imu_is_in_si_and_set_to_utc_by_the_messages_before_it(tmp_path: Path) -> None:
    streams = read(tmp_path, log_files.ubx(), at_rest="up")
    table, truth = streams["imu"], log_files.imu(1200).take(list(range(0, 1200, 4)))
    np.testing.assert_allclose(matrix(table, "accel"), matrix(truth, "accel"), rtol=0, atol=0.51 * 2**-10)
    np.testing.assert_allclose(matrix(table, "gyro"), matrix(truth, "gyro"), rtol=0, atol=np.radians(0.51 * 2**-12))
    assert time_ns(table)[0] == time_ns(streams["gnss"])[0]  # the first comes right behind its NAV-PVT
    wheel = vector(streams["wheel"], "speed")
    np.testing.assert_allclose(wheel, vector(log_files.gnss(), "speed"), rtol=0, atol=0.51e-3)


def test_the_sense_of_the_accelerometer_is_asked_for(tmp_path: Path) -> None:
    streams = read(tmp_path, log_files.ubx())
    assert "imu" not in streams
    assert any("set reader.ubx.at_rest" in text for text in warnings_of(streams["metrics"]))
    up, down = (matrix(read(tmp_path, log_files.ubx(), at_rest=sense)["imu"], "accel") for sense in ("up", "down"))
    np.testing.assert_array_equal(up, -down)
    only_imu = b"".join(log_files.esf_meas(10 * n, {16: n, 17: 0, 18: 10_000}) for n in range(4))
    with pytest.raises(ReadFailed, match="it holds no fix, imu or wheel speed: 4 ESF-MEAS") as caught:
        read(tmp_path, only_imu)
    assert "set reader.ubx.at_rest" in caught.value.hint
    alone = read(tmp_path, only_imu, at_rest="up")["imu"]
    assert meta(alone)["clock"] == "relative"
    assert time_ns(alone).tolist() == [0, 10_000_000, 20_000_000, 30_000_000]


def test_whole_messages_count_behind_damaged_ones(tmp_path: Path) -> None:
    first, second, third, fourth = pvts(4)
    cut = second[:40]
    flipped = third[:50] + bytes([third[50] ^ 0xFF]) + third[51:]
    too_long = b"\xb5\x62\x01\x07\xff\x1f"
    streams = read(tmp_path, first + cut + flipped + too_long + fourth)
    assert time_ns(streams["gnss"]).tolist() == time_ns(log_files.gnss())[[0, 3]].tolist()
    (damaged,) = [row["value"] for row in streams["metrics"].to_pylist() if row["name"] == "damaged_messages"]
    assert damaged == 3


def test_a_message_inside_another_is_no_message(tmp_path: Path) -> None:
    inner = pvts(1)[0]
    assert recon_readers._ubx_frames.count_messages(log_files.message(0x04, 0x02, inner)) == {(0x04, 0x02): 1}


def test_blocks_give_what_the_whole_gives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = read(tmp_path, log_files.ubx(), at_rest="up")
    monkeypatch.setattr("recon_readers._ubx_frames.BLOCK", 20_001)
    parts = read(tmp_path, log_files.ubx(), at_rest="up")
    for name in ("gnss", "imu", "wheel"):
        assert parts[name].equals(whole[name])


def test_invalid_times_and_fixes_are_left_out(tmp_path: Path) -> None:
    good = pvts(3)
    no_time, no_fix = bytearray(good[0][6:-2]), bytearray(good[1][6:-2])
    no_time[11], no_fix[21] = 0, 0
    changed = [log_files.message(1, 7, bytes(part)) for part in (no_time, no_fix)]
    assert read(tmp_path, b"".join([*changed, good[2]]))["gnss"].num_rows == 1


def test_a_week_that_begins_between_a_place_and_what_tells_it_costs_no_row(tmp_path: Path) -> None:
    epochs = [(2389, 604_798_000), (2389, 604_799_000), (2390, 0), (2390, 1_000)]
    parts = []
    for number, (week, tow) in enumerate(epochs):
        place = (113_000_000, 445_000_000 + 100 * number, 60_000, 15_000, 1_000, 2_000)
        parts.append(log_files.message(0x01, 0x02, struct.pack("<I4i2I", tow, *place)))
        parts.append(log_files.message(0x01, 0x20, struct.pack("<IihbBI", tow, 0, week, 18, 7, 20)))
    gnss = read(tmp_path, b"".join(parts))["gnss"]
    begins = np.datetime64("2025-10-26T00:00:00", "ns").astype(np.int64) - 18 * 10**9  # week 2390, less leap seconds
    assert time_ns(gnss).tolist() == (begins + 10**9 * np.arange(-2, 2)).tolist()


def older(tow: int, number: int) -> bytes:
    """NAV-POSLLH."""
    return log_files.message(
        0x01, 0x02, struct.pack("<I4i2I", tow, 113_000_000, 445_000_000 + number, 60_000, 15_000, 1_000, 2_000)
    )


@pytest.mark.parametrize("state", ["NAV-SOL", "NAV-STATUS"])
def test_places_without_a_fix_are_left_out_of_older_messages_too(tmp_path: Path, state: str) -> None:
    """NAV-POSLLH goes on with the last place, and says of itself nothing about a fix."""
    parts = []
    for number, fix in enumerate((0, 0, 3, 2, 3, 0)):
        tow, ok = 1_000 * number, fix > 0
        parts += [older(tow, number), log_files.message(0x01, 0x20, struct.pack("<IihbBI", tow, 0, 2389, 18, 7, 20))]
        if state == "NAV-SOL":
            payload = struct.pack("<IihBB35xBI", tow, 0, 2389, fix, 0b1100 | ok, 9, 0)
        else:
            payload = struct.pack("<IBB2xII", tow, fix, 0b1100 | ok, 0, 0)
        parts.append(log_files.message(0x01, 0x06 if state == "NAV-SOL" else 0x03, payload))
    gnss = read(tmp_path, b"".join(parts))["gnss"]
    np.testing.assert_allclose(vector(gnss, "lat"), [44.5000002, 44.5000003, 44.5000004], rtol=0, atol=1e-9)
    assert vector(gnss, "fix").tolist() == [3, 2, 3]
    streams = read(tmp_path, b"".join(parts[: 3 * 6 : 3] + parts[1 : 3 * 6 : 3]))
    assert streams["gnss"].num_rows == 6
    assert any("tells whether there was a fix" in text for text in warnings_of(streams["metrics"]))


def test_leap_seconds_that_the_receiver_does_not_know_yet_are_set_right(tmp_path: Path) -> None:
    """Of the first messages it shows UTC by the 16 leap seconds of its firmware, and is not sure of them."""
    truth, parts = log_files.gnss(), []
    start = np.datetime64("1980-01-06", "ns")
    shown = truth.set_column(0, "time", pa.array(time_ns(truth) + 2 * 10**9, truth.schema.field("time").type))
    for row in range(6):
        payload = bytearray(log_files.nav_pvt(truth if row >= 3 else shown, row)[6:-2])
        gps_ns = int(time_ns(truth)[row]) + 18 * 10**9 - start.astype(np.int64)
        struct.pack_into("<I", payload, 0, gps_ns // 10**6 % 604_800_000)
        payload[11] = 0b111 if row >= 3 else 0b011
        parts.append(log_files.message(1, 7, bytes(payload)))
    gnss = read(tmp_path, b"".join(parts))["gnss"]
    assert time_ns(gnss).tolist() == time_ns(truth)[:6].tolist()


def test_older_messages_and_fine_places_are_put_together(logs: Path, tmp_path: Path) -> None:
    """NAV-POSLLH, NAV-VELNED and NAV-TIMEGPS of a real log, without its NAV-PVT, tell the same as NAV-PVT."""
    pyubx2 = pytest.importorskip("pyubx2")
    path = logs / "formats" / "ubx" / "pygpsdata-MIXED.log"
    with path.open("rb") as file:
        kept = [raw for raw, one in pyubx2.UBXReader(file) if getattr(one, "identity", "") != "NAV-PVT"]
    older, newer = read(tmp_path, b"".join(kept))["gnss"], recon.read(path)["gnss"]
    assert older.num_rows == 21
    own, others = np.intersect1d(np.round(time_ns(older), -9), np.round(time_ns(newer), -9), return_indices=True)[1:]
    assert len(own) == 21
    # both round to 1e-7 deg and 1 mm
    np.testing.assert_allclose(vector(older, "lat")[own], vector(newer, "lat")[others], rtol=0, atol=1.1e-7)
    np.testing.assert_allclose(vector(older, "height")[own], vector(newer, "height")[others], rtol=0, atol=1.1e-3)


def test_real_logs_agree_with_pyubx2(logs: Path) -> None:
    pyubx2 = pytest.importorskip("pyubx2")
    for file, identity, rows in (("gnss_1730.ubx", "NAV-PVT", 536), ("pygpsdata-SF-calibration.log", "NAV-PVAT", 527)):
        path = logs / "formats" / "ubx" / file
        gnss = recon.read(path)["gnss"]
        with path.open("rb") as opened:
            parsed = [one for _, one in pyubx2.UBXReader(opened, protfilter=2) if one.identity == identity]
        assert gnss.num_rows == rows == len(parsed)
        np.testing.assert_allclose(vector(gnss, "lat"), [one.lat for one in parsed], rtol=0, atol=1e-11)
        np.testing.assert_allclose(vector(gnss, "lon"), [one.lon for one in parsed], rtol=0, atol=1e-11)
        np.testing.assert_allclose(vector(gnss, "height"), [one.height * 1e-3 for one in parsed], rtol=0, atol=1e-9)
        vel = np.array([[one.velE, one.velN, -one.velD] for one in parsed]) * 1e-3
        np.testing.assert_allclose(matrix(gnss, "vel"), vel, rtol=0, atol=1e-12)
        assert vector(gnss, "satellites").tolist() == [one.numSV for one in parsed]


def test_a_real_log_without_a_solution_says_what_it_holds(logs: Path) -> None:
    with pytest.raises(ReadFailed, match="14 RXM-RAWX") as caught:
        recon.read(logs / "formats" / "ubx" / "pygpsdata-RXMRAWX.log")
    assert "NAV-PVT" in caught.value.hint


def test_real_damaged_logs_give_every_whole_message(logs: Path) -> None:
    folder = logs / "formats" / "ubx"
    assert recon.read(folder / "pygpsdata-BADEOF1.log")["gnss"].num_rows == 1
    assert recon.read(folder / "pygpsdata-MIXED3BADCK.log")["gnss"].num_rows == 1
    with pytest.raises(ReadFailed, match="1 NAV-SOL"):
        recon.read(folder / "pygpsdata-BADHDR.log")
