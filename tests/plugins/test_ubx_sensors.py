"""Data of ESF-MEAS and ESF-RAW: their times in UTC, also over a restart of the receiver; how many a message holds."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from fuzz import log_files

import recon_readers.ubx
from recon import Streams
from recon.rows import warnings_of
from recon.tables import meta, time_ns, vector
from recon_readers.ubx import UbxParams

GNSS = log_files.gnss()
START_NS = int(time_ns(GNSS)[0])
AXES = {16: 1024, 17: 0, 18: 10_000}
"""Specific force in 2^-10 m/s^2."""


def read(folder: Path, parts: list[bytes], **params: object) -> Streams:
    path = folder / "log.ubx"
    path.write_bytes(b"".join(parts))
    return recon_readers.ubx.read(path, UbxParams(at_rest="up", **params))


def meas(tag_ms: int, data: dict[int, int], *, source: int = 0, flags: int | None = None) -> bytes:
    words = b"".join(struct.pack("<I", kind << 24 | value & 0xFFFFFF) for kind, value in data.items())
    return log_files.message(
        0x10, 0x02, struct.pack("<IHH", tag_ms, len(data) << 11 if flags is None else flags, source) + words
    )


def raw(ticks: list[int], data: dict[int, int]) -> bytes:
    pairs = (struct.pack("<II", kind << 24 | value & 0xFFFFFF, tick) for tick in ticks for kind, value in data.items())
    return log_files.message(0x10, 0x03, bytes(4) + b"".join(pairs))


def after_start_ms(table: pa.Table) -> list[int]:
    return ((time_ns(table) - START_NS) // 1_000_000).tolist()


def fixes(rows: range) -> list[tuple[int, bytes]]:
    """NAV-PVT, each with the ms since the first."""
    return [(int(time_ns(GNSS)[row] - START_NS) // 1_000_000, log_files.nav_pvt(GNSS, row)) for row in rows]


def test_a_receiver_that_starts_again_is_set_to_utc_again(tmp_path: Path) -> None:
    parts, expected = [], []
    for begin_ms, rows in ((500_000, range(20)), (3_000, range(30, 40))):
        for at_ms, fix in fixes(rows):
            parts += [fix, meas(begin_ms + at_ms, AXES)]
            expected.append(at_ms)
    streams = read(tmp_path, parts)
    assert after_start_ms(streams["imu"]) == expected
    told = [row["value"] for row in streams["metrics"].to_pylist() if row["name"] == "clock_offset"]
    np.testing.assert_allclose(told, [START_NS * 1e-9 - 500.0, START_NS * 1e-9 - 3.0], rtol=0, atol=1e-6)


def test_data_behind_a_restart_that_nothing_sets_to_utc_are_left_out(tmp_path: Path) -> None:
    parts = [part for at_ms, fix in fixes(range(5)) for part in (fix, meas(500_000 + at_ms, AXES))]
    streams = read(tmp_path, [*parts, *(meas(tag_ms, AXES) for tag_ms in (10, 110, 210))])
    assert streams["imu"].num_rows == 5
    assert any("9 data of imu and wheel are left out" in text for text in warnings_of(streams["metrics"]))


def test_a_sensor_beside_the_receiver_has_a_clock_of_its_own(tmp_path: Path) -> None:
    parts = []
    for at_ms, fix in fixes(range(20)):
        parts += [fix, meas(5_000 + at_ms, AXES), meas(9_000_000 + at_ms, {11: 12_500}, source=7)]
    streams = read(tmp_path, parts)
    assert after_start_ms(streams["imu"]) == after_start_ms(streams["wheel"]) == after_start_ms(streams["gnss"])


def test_a_time_without_a_fix_sets_no_clock(tmp_path: Path) -> None:
    """Before the first fix a receiver tells the time of its own clock, here 1.5 s ahead."""
    ahead = GNSS.set_column(0, "time", pa.array(time_ns(GNSS) + 1_500_000_000, GNSS.schema.field("time").type))
    parts = []
    for row, (at_ms, fix) in enumerate(fixes(range(20))):
        early = bytearray(log_files.nav_pvt(ahead, row)[6:-2])
        early[21] = 0
        parts += [fix if row >= 5 else log_files.message(1, 7, bytes(early)), meas(5_000 + at_ms, AXES)]
    streams = read(tmp_path, parts)
    assert after_start_ms(streams["imu"])[5:] == after_start_ms(streams["gnss"])


def test_messages_of_several_lengths_keep_their_order(tmp_path: Path) -> None:
    """Every second one holds a temperature as well."""
    parts = []
    for number, (at_ms, fix) in enumerate(fixes(range(20))):
        parts += [fix, meas(5_000 + at_ms, AXES | ({12: 2_500} if number % 2 else {}))]
    assert read(tmp_path, parts)["imu"].num_rows == 20


@pytest.mark.parametrize("with_time", [False, True])
def test_how_many_data_there_are_may_be_left_to_the_length(tmp_path: Path, *, with_time: bool) -> None:
    """The number among the flags is optional; behind the data may stand a time, of which bit 3 tells."""
    parts = [part for at_ms, fix in fixes(range(4)) for part in (fix, meas(at_ms, AXES, flags=0))]
    if with_time:
        timed = AXES | {0: 0x123456}
        parts = [part for at_ms, fix in fixes(range(4)) for part in (fix, meas(at_ms, timed, flags=8))]
    imu = read(tmp_path, parts)["imu"]
    assert vector(imu, "accel_x").tolist() == [1.0] * 4
    assert imu.column_names == ["time", "accel_x", "accel_y", "accel_z"]


def test_raw_data_are_set_to_utc_and_go_before_their_averages(tmp_path: Path) -> None:
    tick_us, parts = 50.0, []
    for at_ms, fix in fixes(range(10)):
        averages = meas(5_000 + at_ms, {**dict.fromkeys(AXES, 1), 11: 12_500})
        parts += [fix, raw([20 * at_ms + 100_000, 20 * at_ms + 100_200], AXES), averages]
    streams = read(tmp_path, parts, raw_tick=tick_us * 1e-6)
    assert after_start_ms(streams["imu"])[:4:2] == after_start_ms(streams["gnss"])[:2]
    assert np.diff(time_ns(streams["imu"]))[0] == 10_000_000
    assert set(vector(streams["imu"], "accel_x").tolist()) == {1.0}
    assert after_start_ms(streams["wheel"]) == after_start_ms(streams["gnss"])[:10]
    assert meta(streams["imu"])["clock"] == "absolute"
