"""reader.ardupilot: DataFlash and telemetry become streams forward, left, up in UTC; pymavlink agrees."""

from __future__ import annotations

import struct
import warnings
from pathlib import Path

import autopilot_logs as made
import numpy as np
import pytest
from autopilot_logs import ACCEL_FRD, BOOT_US, FIELD_FRD, GYRO_FRD, HEIGHT, LAT, LON, SPEED, UTC_US

import recon_readers.ardupilot
from recon import Streams
from recon.errors import NothingUsable, ReadFailed
from recon.numerics.rotation import to_euler
from recon.parameters import NoParams
from recon.rows import warnings_of
from recon.stages import EVERYTHING, Wanted
from recon.tables import matrix, meta, time_ns, vector
from recon_readers import _mavlink

FLU = (1.0, -1.0, -1.0)
START_NS = (UTC_US + BOOT_US) * 1000


def read(path: Path, data: bytes | None = None, wanted: Wanted = EVERYTHING) -> Streams:
    if data is not None:
        path.write_bytes(data)
    return recon_readers.ardupilot.read(path, NoParams(), wanted)


def told(streams: Streams, name: str) -> list[float | None]:
    return [row["value"] for row in streams["metrics"].to_pylist() if row["name"] == name]


@pytest.fixture(params=["bin", "tlog1", "tlog2"])
def streams(request: pytest.FixtureRequest, tmp_path: Path) -> Streams:
    data = made.dataflash() if request.param == "bin" else made.tlog(version=int(request.param[-1]))
    return read(tmp_path / "log", data)


def test_vectors_come_along_forward_left_up(streams: Streams) -> None:
    # telemetry counts mg, mrad/s and mgauss: half a step each
    np.testing.assert_allclose(matrix(streams["imu"], "accel")[0], np.multiply(ACCEL_FRD, FLU), atol=0.5e-3 * 9.81)
    np.testing.assert_allclose(matrix(streams["imu"], "gyro")[0], np.multiply(GYRO_FRD, FLU), atol=0.5e-3)
    np.testing.assert_allclose(matrix(streams["mag"], "mag")[0], np.multiply(FIELD_FRD, FLU) * 1e-4, atol=0.5e-7)


def test_times_are_utc_of_the_receiver_to_the_microsecond(streams: Streams) -> None:
    steps = np.diff(time_ns(streams["imu"]))
    assert int(time_ns(streams["imu"])[0]) == START_NS
    assert set(steps.tolist()) in ({10_000_000}, {20_000_000})
    assert (meta(streams["imu"])["clock"], meta(streams["imu"])["time_scale"]) == ("absolute", "UTC")


def test_gnss_has_place_motion_and_sigmas(streams: Streams) -> None:
    row = streams["gnss"].to_pylist()[0]
    assert (row["lat"], row["lon"], row["height"]) == (LAT, LON, HEIGHT)
    assert (row["speed"], row["course"]) == (SPEED, pytest.approx(np.pi / 4))
    assert (row["fix"], row["satellites"]) == (3, 14)
    assert [row["pos_std_e"], row["pos_std_u"], row["vel_std_n"]] == [0.5, 1.0, 0.25]
    facts = meta(streams["gnss"])
    assert (facts["height_datum"], facts["heading_kind"]) == ("mean_sea_level", "course_true")


def test_pressure_is_in_pascal_and_temperature_in_kelvin(streams: Streams) -> None:
    assert vector(streams["baro"], "pressure")[0] == pytest.approx(made.PRESSURE, abs=1e-2)  # floats of 1000 hPa
    assert vector(streams["baro"], "temperature")[0] == pytest.approx(293.15)


def test_the_estimate_is_in_east_north_up(streams: Streams) -> None:
    reference = streams["reference"]
    q = matrix(reference, "q", gaps=True)
    yaw, pitch, roll = (np.degrees(angle) for angle in to_euler(q[np.isfinite(q).all(axis=1)][:1]))
    assert (yaw[0], pitch[0], roll[0]) == pytest.approx((45.0, 0.0, 0.0), abs=1e-5)  # north-east
    vel = matrix(reference, "vel", gaps=True)
    # telemetry counts cm/s
    np.testing.assert_allclose(vel[np.isfinite(vel).all(axis=1)][0], [SPEED * np.sqrt(0.5)] * 2 + [0.0], atol=5e-3)
    anchor = meta(reference)["anchor"]
    assert (anchor["lat"], anchor["lon"], anchor["height"]) == (LAT, LON, HEIGHT)


def test_only_what_is_wanted_is_read(tmp_path: Path) -> None:
    wanted = Wanted({"gnss": frozenset({"lat", "lon"})})
    for data in (made.dataflash(), made.tlog()):
        some = read(tmp_path / "log", data, wanted)
        assert set(some) == {"gnss", "metrics"}
        assert some["gnss"].column_names == ["time", "lat", "lon"]


@pytest.mark.parametrize(("kind", "field"), [("GPS", "GCrs"), ("XKF1", "PN"), ("IMU", "AccX")])
@pytest.mark.parametrize("bits", ["0100807f", "0000807f"], ids=["signalling", "infinite"])
def test_floats_that_are_no_numbers_warn_nobody(tmp_path: Path, kind: str, field: str, bits: str) -> None:
    data = bytearray(made.dataflash(10.0))
    number, _, types, columns, _ = made._FLASH[kind]
    sizes = [struct.calcsize("<" + made._FLASH_TYPES[code]) for code in types]
    at = data.rindex(bytes([0xA3, 0x95, number])) + 3 + sum(sizes[: columns.split(",").index(field)])
    data[at : at + 4] = bytes.fromhex(bits)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read(tmp_path / "log", bytes(data))["imu"].num_rows == 1000


def test_angles_of_telemetry_that_are_no_numbers_warn_nobody(tmp_path: Path) -> None:
    from pymavlink.dialects.v20 import ardupilotmega as v2

    packer = v2.MAVLink(None, srcSystem=1, srcComponent=1)
    (infinite,) = struct.unpack("<f", bytes.fromhex("0000807f"))
    frame = packer.attitude_encode(BOOT_US // 1000 + 999, infinite, 0.0, 0.0, 0.0, 0.0, 0.0).pack(packer)
    record = struct.pack(">Q", UTC_US + BOOT_US + 10**6) + frame
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        q = matrix(read(tmp_path / "log", made.tlog() + record)["reference"], "q", gaps=True)
    assert np.isfinite(q).all(axis=1).sum() == 10


@pytest.mark.parametrize("data", [made.dataflash(4.0), made.tlog(4.0)], ids=["bin", "tlog"])
def test_behind_damaged_places_every_whole_message_is_used(tmp_path: Path, data: bytes) -> None:
    whole = read(tmp_path / "log", data)["imu"]
    streams = read(tmp_path / "log", made.damaged(data, (0.3, 0.5, 0.7), 80))
    lost = whole.num_rows - streams["imu"].num_rows
    assert lost <= 9  # 80 bytes reach into three messages at most
    assert time_ns(streams["imu"])[-1] == time_ns(whole)[-1]
    assert told(streams, "damaged_places")[0] >= 1.0


def test_a_number_that_is_none_and_signals_it_warns_nobody(tmp_path: Path) -> None:
    """0x7f800001 is a float that makes a processor tell of an invalid operation where it is converted."""
    data = made.dataflash()
    rate = struct.pack("<f", GYRO_FRD[0])
    at = data.index(rate)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        imu = read(tmp_path / "log", data[:at] + bytes.fromhex("0100807f") + data[at + 4 :])["imu"]
    assert int(np.isnan(vector(imu, "gyro_x", gaps=True)).sum()) == 1


@pytest.mark.parametrize("data", [made.dataflash(4.0), made.tlog(4.0)], ids=["bin", "tlog"])
def test_windows_make_no_difference(tmp_path: Path, data: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = read(tmp_path / "log", data)
    monkeypatch.setattr(recon_readers._dataflash, "_WINDOW", 1000)
    monkeypatch.setattr(recon_readers._mavlink, "_WINDOW", 1000)
    again = read(tmp_path / "log")
    assert set(again) == set(whole)
    for name, table in whole.items():
        assert again[name].equals(table), name


def test_a_log_without_a_fix_counts_from_boot_and_says_so(tmp_path: Path) -> None:
    data = made.dataflash()
    (row,) = {made._FLASH["GPS"][0]}
    lost = data.replace(bytes([0xA3, 0x95, row]), bytes([0xA3, 0x95, 200]))
    streams = read(tmp_path / "log", lost)
    assert int(time_ns(streams["imu"])[0]) == BOOT_US * 1000
    assert meta(streams["imu"])["clock"] == "relative"
    assert any("nothing in the log tells UTC" in text for text in warnings_of(streams["metrics"]))


def test_raw_counts_of_another_autopilot_are_left_out(tmp_path: Path) -> None:
    streams = read(tmp_path / "log", made.tlog(autopilot=12))
    assert "imu" not in streams
    assert any("RAW_IMU is left out" in text for text in warnings_of(streams["metrics"]))


@pytest.mark.parametrize("told_utc", [True, False], ids=["system_time", "by_stamps_alone"])
@pytest.mark.parametrize("stamp_us", [0, UTC_US], ids=["since_boot", "since_1970"])
def test_stamps_of_highres_imu_count_from_boot_or_from_1970(tmp_path: Path, stamp_us: int, told_utc: bool) -> None:
    streams = read(tmp_path / "log", made.highres_imu(stamp_us, told=told_utc))
    # nothing but the ground station's clock, which shows 3 ms more, tells UTC of stamps since boot
    late_ns = 3_000_000 if not told_utc and not stamp_us else 0
    assert time_ns(streams["imu"])[:2].tolist() == [START_NS + late_ns, START_NS + late_ns + 20_000_000]
    assert streams["imu"].num_rows == 50
    assert meta(streams["imu"])["clock"] == "absolute"
    np.testing.assert_array_equal(matrix(streams["imu"], "accel")[0], np.multiply(ACCEL_FRD, FLU))
    np.testing.assert_array_equal(matrix(streams["mag"], "mag")[0], np.multiply(FIELD_FRD, FLU) * 1e-4)


def test_each_sensor_of_highres_imu_is_a_stream(tmp_path: Path) -> None:
    streams = read(tmp_path / "log", made.highres_imu(UTC_US, sensors=2))
    assert {"imu", "imu_2", "mag", "mag_2"} <= set(streams)
    assert [streams[name].num_rows for name in ("imu", "imu_2")] == [50, 50]
    assert meta(streams["imu_2"])["source"] == "HIGHRES_IMU 2"


def test_logs_that_were_joined_are_told(tmp_path: Path) -> None:
    streams = read(tmp_path / "log", made.dataflash(12.0) + made.dataflash(12.0))
    assert any("IMU[0]: its clock begins anew" in text for text in warnings_of(streams["metrics"]))
    assert not any("begins anew" in text for text in warnings_of(read(tmp_path / "log", made.dataflash())["metrics"]))


def test_a_kind_that_is_declared_anew_is_told_also_where_only_its_units_change(tmp_path: Path) -> None:
    """Pitch is first in hundredths of deg, then in deg: as many bytes."""
    other = made.dataflash(0.5).replace(b"QBccCffffff", b"QBchCffffff")
    streams = read(tmp_path / "log", made.dataflash() + other)
    assert any("10 messages are left out, for the log declares" in text for text in warnings_of(streams["metrics"]))


@pytest.mark.parametrize("told_utc", [(True, True), (True, False), (False, True), (False, False)])
def test_an_autopilot_that_starts_again_has_a_new_boot_clock(tmp_path: Path, told_utc: tuple[bool, bool]) -> None:
    """The ground station goes on; its clock, which shows 3 ms more, counts where nothing else tells UTC."""
    first, second = (
        made.tlog(15.0, utc_us=UTC_US + late_us, told=own)
        for late_us, own in zip((0, 60_000_000), told_utc, strict=True)
    )
    streams = read(tmp_path / "log", first + second)
    late_ns = 0 if any(told_utc) else 3_000_000
    own = START_NS + late_ns + 20_000_000 * np.arange(750)
    assert time_ns(streams["imu"]).tolist() == [*own.tolist(), *(own + 60 * 10**9).tolist()]
    assert streams["gnss"].num_rows == 150
    assert any("started 2 times" in text for text in warnings_of(streams["metrics"]))
    doubled = read(tmp_path / "log", first + first[len(first) // 4 :])
    assert not any("started" in text for text in warnings_of(doubled["metrics"]))


def test_what_a_gimbal_sends_is_not_the_vehicle(tmp_path: Path) -> None:
    alone, gimbal = made.tlog(), made.tlog(0.5, utc_us=UTC_US + 10_000, component=154)
    streams = read(tmp_path / "log", alone + gimbal)
    assert streams["imu"].equals(read(tmp_path / "log", alone)["imu"])
    assert told(streams, "messages_left_out") == [43.0]  # heartbeats apart


def test_rows_of_times_that_no_clock_shows_are_counted(tmp_path: Path) -> None:
    streams = read(tmp_path / "log", made.highres_imu(0) + made.highres_imu(2**60, seconds=0.1, told=False))
    assert streams["imu"].num_rows == 50
    assert told(streams, "rows_left_out") == [5.0, 5.0]  # of imu and of mag


def test_logs_that_hold_nothing_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ReadFailed, match="it holds no FMT message"):
        read(tmp_path / "log", b"\xa3\x95\x80" + b"\0" * 300)
    with pytest.raises(NothingUsable, match="it holds nothing that is read"):
        read(tmp_path / "log", made.dataflash()[: 9 * 89])


def test_the_table_of_messages_is_that_of_pymavlink() -> None:
    from pymavlink.dialects.v20 import ardupilotmega

    for message in _mavlink.MESSAGES:
        theirs = ardupilotmega.mavlink_map[message.number]
        assert (theirs.msgname, theirs.crc_extra) == (message.name, message.seed)
        assert (theirs.unpacker.size, list(theirs.ordered_fieldnames)) == (
            message.fields.itemsize,
            list(message.fields.names or ()),
        )


# --- real logs ------------------------------------------------------------------------------------------------------


def test_a_dataflash_log_is_as_pymavlink_reads_it(logs: Path) -> None:
    from pymavlink.DFReader import DFReader_binary

    path = logs / "formats/ardupilot_bin/log171.bin"
    streams = read(path)
    theirs: dict[str, list[object]] = {"IMU": [], "GPS": []}
    reader = DFReader_binary(str(path))
    while (message := reader.recv_match(type=list(theirs))) is not None:
        theirs[message.get_type()].append(message)
    reader.close()
    accel = np.array([[one.AccX, -one.AccY, -one.AccZ] for one in theirs["IMU"]])
    np.testing.assert_array_equal(matrix(streams["imu"], "accel"), accel)
    fixes = [one for one in theirs["GPS"] if one.Status >= 2]
    known = ~np.isnan(vector(streams["gnss"], "lat", gaps=True))
    np.testing.assert_allclose(vector(streams["gnss"], "lat", gaps=True)[known], [one.Lat for one in fixes], rtol=1e-15)
    # the receiver shows 1893 m before its first fix: that is no height
    assert np.nanmax(vector(streams["gnss"], "height", gaps=True)) < 1000.0
    assert np.abs(matrix(streams["imu"], "accel")).max() > 100.0  # the crash


def test_a_log_cut_at_64_kb_is_read_to_its_last_message(logs: Path) -> None:
    streams = read(logs / "formats/ardupilot_bin/test.BIN")
    assert (streams["imu"].num_rows, streams["gnss"].num_rows) == (45, 5)
    assert meta(streams["reference"])["anchor"]["lat"] == pytest.approx(-35.3626381)
    assert told(streams, "damaged_places") == [1.0]


def test_a_telemetry_log_gives_every_message(logs: Path) -> None:
    streams = read(logs / "formats/mavlink_tlog/vtol.tlog")
    assert (streams["imu"].num_rows, streams["gnss"].num_rows) == (795, 799)
    # a simulated aircraft that hovers and flies: gravity on the whole upwards
    assert np.median(matrix(streams["imu"], "accel")[:, 2]) == pytest.approx(9.8, rel=0.03)
    pos = matrix(streams["reference"], "pos", gaps=True)
    assert np.isfinite(pos).all(axis=1).sum() > 700
