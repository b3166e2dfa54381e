"""reader.gpmf: measurements of GoPro cameras, from an MP4 or raw, along forward, left, up."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from fuzz import log_files

import recon
import recon_readers.gpmf
from recon import Streams
from recon.errors import ReadFailed
from recon.rows import warnings_of
from recon.tables import matrix, meta, seconds, time_ns, vector
from recon_readers.gpmf import GpmfParams

START_NS = int(np.datetime64("2025-10-08T10:00:00", "ns").astype(np.int64))


def read(folder: Path, data: bytes, **params: object) -> Streams:
    path = folder / "GX01.MP4"
    path.write_bytes(data)
    return recon_readers.gpmf.read(path, GpmfParams(**params))


def test_a_drive_comes_back_as_it_was_written(tmp_path: Path) -> None:
    streams = read(tmp_path, log_files.mp4(log_files.gpmf_payloads(3)))
    imu, truth = streams["imu"], log_files.imu(300)
    np.testing.assert_allclose(matrix(imu, "accel"), matrix(truth, "accel"), rtol=0, atol=0.51 / 418)
    np.testing.assert_allclose(matrix(imu, "gyro"), matrix(truth, "gyro"), rtol=0, atol=0.51 / 3755)
    assert time_ns(imu).tolist() == (START_NS + 10_000_000 * np.arange(300)).tolist()
    gnss = streams["gnss"]
    truth = log_files.gnss(60).take(list(range(0, 60, 4)))
    np.testing.assert_allclose(vector(gnss, "lat"), vector(truth, "lat"), rtol=0, atol=0.51e-7)
    np.testing.assert_allclose(vector(gnss, "speed"), vector(truth, "speed"), rtol=0, atol=0.51e-3)
    assert time_ns(gnss).tolist() == (START_NS + 200_000_000 * np.arange(15)).tolist()


def test_without_stamps_the_track_tells_the_times(tmp_path: Path) -> None:
    stamped, bare = (
        read(tmp_path, log_files.mp4(log_files.gpmf_payloads(3, stamps_us=stamps))) for stamps in (True, False)
    )
    assert bare["imu"].equals(stamped["imu"])


def test_a_raw_file_without_times_asks_for_them(tmp_path: Path) -> None:
    raw = b"".join(log_files.gpmf_payloads(3, stamps_us=False))
    with pytest.raises(ReadFailed, match=r"does not tell how long its payloads last \(3 in all\)") as caught:
        read(tmp_path, raw)
    assert "set reader.gpmf.payload" in caught.value.hint
    assert read(tmp_path, raw, payload=1.0)["imu"].num_rows == 300
    assert read(tmp_path, b"".join(log_files.gpmf_payloads(3)))["imu"].num_rows == 300  # STMP tells


def test_without_a_fix_there_is_no_gnss_and_no_date(tmp_path: Path) -> None:
    no_fix = log_files.klv("GPSF", "L", 4, 1, bytes(4))
    payloads = [p.replace(log_files.klv("GPSF", "L", 4, 1, b"\0\0\0\3"), no_fix) for p in log_files.gpmf_payloads(2)]
    streams = read(tmp_path, log_files.mp4(payloads))
    assert "gnss" not in streams
    assert meta(streams["imu"])["clock"] == "relative"
    assert "GPS had no fix" in warnings_of(streams["metrics"])[0]


def test_an_mp4_that_was_not_closed_is_searched(tmp_path: Path) -> None:
    film = log_files.mp4(log_files.gpmf_payloads(3))
    closed, cut = read(tmp_path, film), read(tmp_path, film[: film.index(b"moov") - 4])
    assert cut["imu"].equals(closed["imu"])
    assert "its payloads were searched for" in warnings_of(cut["metrics"])[0]


def test_a_payload_that_is_lost_leaves_a_gap(tmp_path: Path) -> None:
    payloads = log_files.gpmf_payloads(5)
    imu = read(tmp_path, b"".join([*payloads[:2], b"lost", *payloads[3:]]))["imu"]
    assert np.flatnonzero(np.diff(time_ns(imu)) != 10_000_000).tolist() == [199]
    assert np.diff(time_ns(imu))[199] == 1_010_000_000


def test_an_mp4_of_another_camera_says_so(tmp_path: Path) -> None:
    film = log_files.mp4([b"pictures", b"pictures"])
    with pytest.raises(ReadFailed, match="no track of GoPro's measurements"):
        read(tmp_path, film.replace(b"gpmd", b"avc1"))
    with pytest.raises(ReadFailed, match="has no index"):
        read(tmp_path, film[: film.index(b"moov") - 4])


def test_a_cut_payload_is_read_as_far_as_it_is_whole(tmp_path: Path) -> None:
    raw = b"".join(log_files.gpmf_payloads(3))
    assert 200 <= read(tmp_path, raw[:-700])["imu"].num_rows <= 300


@pytest.mark.parametrize(
    ("file", "accl", "gyro", "gps"),
    [
        ("hero5.raw", 199, 399, 18),
        ("Fusion.raw", 197, 3300, 19),
        ("hero6.raw", 204, 204, 0),
        ("karma.raw", 196, 392, 0),
    ],
)
def test_real_payloads_hold_what_gopros_own_parser_counts(
    logs: Path, file: str, accl: int, gyro: int, gps: int
) -> None:
    recording = recon.read(logs / "formats" / "gpmf" / file, **{"reader.gpmf.payload": "1.001 s"})
    accel, turned = (matrix(recording["imu"], group, gaps=True) for group in ("accel", "gyro"))
    assert (int(np.isfinite(accel[:, 0]).sum()), int(np.isfinite(turned[:, 0]).sum())) == (accl, gyro)
    assert (recording["gnss"].num_rows if "gnss" in recording else 0) == gps  # hero6 had no fix, karma no GPS
    assert np.linalg.norm(np.nanmean(accel, axis=0)) == pytest.approx(9.8, abs=0.8)


def test_real_videos(logs: Path) -> None:
    folder = logs / "formats" / "gpmf"
    video = recon.read(folder / "max-heromode.mp4")
    accel = matrix(video["imu"], "accel").mean(axis=0)
    assert accel[2] == pytest.approx(9.8, abs=0.3)  # ORIN XzY: it stands upright
    assert np.linalg.norm(accel[:2]) < 2.0
    assert seconds(video["imu"])[-1] == pytest.approx(10.54, abs=0.02)  # 10 payloads of 1.001 s and one of 0.533 s
    assert str(np.datetime64(int(time_ns(video["gnss"])[0]), "ns"))[:16] == "2019-11-18T23:45"
    alone, film = (
        recon.read(folder / name, **{"reader.gpmf.payload": "1.001 s"}) for name in ("karma.raw", "karma.mp4")
    )
    first = matrix(film["imu"], "accel", gaps=True)[: alone["imu"].num_rows]
    np.testing.assert_array_equal(first, matrix(alone["imu"], "accel", gaps=True))  # the raw file is its first payload


def gps9(seconds: int, fixed_from: int, wrong_clock_s: int) -> list[bytes]:
    """Payloads of a second with GPS9 alone at 5 Hz; before the fix the camera's own clock is that much ahead."""
    scale = struct.pack(">9i", 10**7, 10**7, 1000, 1000, 100, 1, 1000, 100, 1)
    about = [klv_text("TYPE", "lllllllSS"), log_files.klv("SCAL", "l", 4, 9, scale)]
    day, of_day = 9412, 10 * 3600  # 2025-10-08, days after 2000-01-01, 10 h
    found = []
    for second in range(seconds):
        fix, ahead = (3, 0) if second >= fixed_from else (0, wrong_clock_s)
        of_day_ms = 1000 * (of_day + second + ahead)
        rows = [
            (
                (481_000_000 + 100 * (5 * second + k), 115_000_000, 500_000, 9000, 900, day),
                (of_day_ms + 200 * k, 150, fix),
            )
            for k in range(5)
        ]
        raw = b"".join(struct.pack(">7i2H", *place, *clock) for place, clock in rows)
        stamp = log_files.klv("STMP", "J", 8, 1, struct.pack(">Q", 1_000_000 * second))
        held = log_files.nest("STRM", stamp, *about, log_files.klv("GPS9", "?", 32, 5, raw))
        found.append(log_files.nest("DEVC", log_files.klv("DVID", "L", 4, 1, struct.pack(">I", 1)), held))
    return found


def klv_text(key: str, text: str) -> bytes:
    return log_files.klv(key, "c", 1, len(text), text.encode())


def test_a_clock_without_a_fix_does_not_push_out_the_fixes_behind_it(tmp_path: Path) -> None:
    gnss = read(tmp_path, log_files.mp4(gps9(10, fixed_from=7, wrong_clock_s=3600)))["gnss"]
    assert time_ns(gnss).tolist() == (START_NS + 7 * 10**9 + 200_000_000 * np.arange(15)).tolist()
    assert vector(gnss, "lat")[0] == pytest.approx(48.10035, abs=1e-9)
