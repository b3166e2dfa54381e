"""reader.ulog: logs of PX4 become streams forward, left, up in UTC."""

from __future__ import annotations

import struct
from pathlib import Path

import autopilot_logs as made
import numpy as np
import pytest
from autopilot_logs import ACCEL_FRD, BOOT_US, FIELD_FRD, GYRO_FRD, HEIGHT, LAT, LON, SPEED, UTC_US

import recon_readers.ulog
from recon import Streams
from recon.errors import NothingUsable, ReadFailed
from recon.numerics.rotation import to_euler
from recon.parameters import NoParams
from recon.rows import warnings_of
from recon.stages import EVERYTHING, Wanted
from recon.tables import matrix, meta, time_ns, vector

FLU = (1.0, -1.0, -1.0)


def read(path: Path, data: bytes | None = None, wanted: Wanted = EVERYTHING) -> Streams:
    if data is not None:
        path.write_bytes(data)
    return recon_readers.ulog.read(path, NoParams(), wanted)


@pytest.fixture
def streams(tmp_path: Path) -> Streams:
    return read(tmp_path / "log.ulg", made.ulog())


def test_vectors_come_along_forward_left_up(streams: Streams) -> None:
    assert matrix(streams["imu"], "accel")[0].tolist() == np.multiply(ACCEL_FRD, FLU).tolist()
    assert matrix(streams["imu"], "gyro")[0].tolist() == np.multiply(GYRO_FRD, FLU).tolist()
    np.testing.assert_allclose(matrix(streams["mag"], "mag")[0], np.multiply(FIELD_FRD, FLU) * 1e-4, rtol=1e-15)


def test_times_are_utc_of_the_receiver_to_the_microsecond(streams: Streams) -> None:
    np.testing.assert_array_equal(time_ns(streams["imu"]), (UTC_US + BOOT_US) * 1000 + np.arange(100) * 10_000_000)
    assert (meta(streams["imu"])["clock"], meta(streams["imu"])["time_scale"]) == ("absolute", "UTC")


def test_gnss_has_place_motion_and_sigmas(streams: Streams) -> None:
    row = streams["gnss"].to_pylist()[0]
    assert (row["lat"], row["lon"], row["height"]) == (LAT, LON, HEIGHT)
    assert (row["speed"], row["course"]) == (SPEED, pytest.approx(np.pi / 4))
    assert (row["vel_e"], row["vel_u"]) == (pytest.approx(SPEED * np.sqrt(0.5)), 0.0)
    assert (row["fix"], row["satellites"]) == (3, 14)
    assert [row["pos_std_e"], row["pos_std_u"], row["vel_std_n"]] == [0.5, 1.0, 0.25]
    assert meta(streams["gnss"])["height_datum"] == "mean_sea_level"


def test_the_estimate_is_in_east_north_up_about_its_origin(streams: Streams) -> None:
    reference = streams["reference"]
    pos, q = matrix(reference, "pos", gaps=True), matrix(reference, "q", gaps=True)
    assert pos[0].tolist() == [2.0, 1.0, 3.0]
    yaw, pitch, roll = (np.degrees(angle) for angle in to_euler(q[:1]))
    assert (yaw[0], pitch[0], roll[0]) == pytest.approx((45.0, 0.0, 0.0), abs=1e-5)
    assert meta(reference)["anchor"] == {"lat": LAT, "lon": LON, "height": HEIGHT}
    assert np.isnan(pos[1]).all()  # attitudes come at twice the rate


def test_positions_about_an_origin_that_moved_are_told(tmp_path: Path) -> None:
    """The estimator is set anew on the way: before, x and y count from another place."""
    moved = made.ulog().replace(struct.pack("<dd", LAT, LON), struct.pack("<dd", LAT + 0.001, LON), 3)
    streams = read(tmp_path / "log.ulg", moved)
    assert np.isfinite(matrix(streams["reference"], "pos", gaps=True)).all(axis=1).sum() == 7
    assert meta(streams["reference"])["anchor"]["lat"] == LAT
    (row,) = [row for row in streams["metrics"].to_pylist() if row["name"] == "rows_left_out"]
    assert (row["value"], row["note"].partition(":")[0]) == (3.0, "vehicle_local_position")


def test_only_topics_that_are_wanted_are_read(tmp_path: Path) -> None:
    some = read(tmp_path / "log.ulg", made.ulog(), Wanted({"imu": frozenset({"accel_x", "accel_y", "accel_z"})}))
    assert set(some) == {"imu", "metrics"}
    assert some["imu"].column_names == ["time", "accel_x", "accel_y", "accel_z"]


@pytest.mark.parametrize("share", [0.4, 0.7, 0.95])
def test_a_cut_log_gives_every_whole_row(tmp_path: Path, share: float) -> None:
    data = made.ulog()
    whole = read(tmp_path / "log.ulg", data)["imu"]
    streams = read(tmp_path / "log.ulg", data[: int(share * len(data))])
    assert 0 < streams["imu"].num_rows < whole.num_rows
    assert streams["imu"].select(["accel_x"]).equals(whole.select(["accel_x"]).slice(0, streams["imu"].num_rows))


def test_a_damaged_log_says_so_and_prints_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    streams = read(tmp_path / "log.ulg", made.damaged(made.ulog(4.0), (0.5,), 40, b"\0"))
    assert streams["imu"].num_rows > 200
    assert any("log.ulg is damaged" in text for text in warnings_of(streams["metrics"]))
    assert capsys.readouterr().out == ""


def test_logs_that_hold_nothing_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ReadFailed, match="damaged in its definitions"):
        read(tmp_path / "log.ulg", recon_readers.ulog.MAGIC)
    with pytest.raises(NothingUsable, match="none of the topics that are read"):
        read(tmp_path / "log.ulg", made.ulog(0.0))


# --- real logs ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "rows"),
    [
        ("sample_log_small.ulg", {"imu": 1298, "gnss": 32, "mag": 319, "baro": 120}),
        ("sample.ulg", {"imu": 17_070, "mag": 6_759}),
        ("sample_appended_multiple.ulg", {"imu": 2_373, "mag": 444}),
        ("test_ulog.ulg", {"imu": 1297, "gnss": 13, "mag": 13, "baro": 34, "reference": 197}),
    ],
)
def test_the_samples_of_px4(logs: Path, name: str, rows: dict[str, int]) -> None:
    streams = read(logs / "formats/ulog" / name)
    assert {key: table.num_rows for key, table in streams.items() if key != "metrics"} == rows
    # multirotors that stand or hover, one of them tilted
    felt = np.median(matrix(streams["imu"], "accel"), axis=0)
    assert np.linalg.norm(felt) == pytest.approx(9.8, rel=0.03)
    assert felt[2] > 9.0


def test_the_receiver_and_the_estimate_of_a_real_log_agree(logs: Path) -> None:
    streams = read(logs / "formats/ulog/test_ulog.ulg")
    assert time_ns(streams["gnss"])[0] // 10**9 == 1_765_331_252  # 2025-12-10
    lat = vector(streams["reference"], "lat", gaps=True)
    # metres of a hovering multirotor
    assert np.nanmedian(lat) == pytest.approx(vector(streams["gnss"], "lat")[0], abs=1e-4)
