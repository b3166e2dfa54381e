"""Large binary logs for `reading.py`, made as receivers, autopilots and measurement programs write them."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

START_US = 1_700_000_000_000_000
ROWS = 100_000
"""Rows that are made at a time."""


def felt(first: int, kind: str = "<f4") -> np.ndarray:
    """(ROWS, 6) rates in rad/s and specific forces in m/s^2 along forward, right, down."""
    values = np.random.default_rng(first).normal(size=(ROWS, 6)) * 0.1 - (0, 0, 0, 0, 0, 9.8)
    return values.astype(kind)


def write_ubx(path: Path, size: float) -> None:
    """NAV-PVT at 10 Hz."""
    head = np.frombuffer(b"\xb5\x62\x01\x07" + struct.pack("<H", 92), dtype=np.uint8)
    with path.open("wb") as file:
        first = 0
        while file.tell() < size:
            payloads = _nav_pvt(first)
            body = np.hstack([np.broadcast_to(head, (ROWS, 6)), payloads])
            a = np.cumsum(body[:, 2:].astype(np.int64), axis=1)
            ends = np.column_stack([a[:, -1] % 256, a.sum(axis=1) % 256]).astype(np.uint8)
            file.write(np.hstack([body, ends]).tobytes())
            first += ROWS


def _nav_pvt(first: int) -> np.ndarray:
    """(ROWS, 92) bytes."""
    names = [("tow", "<u4"), ("year", "<u2"), *((name, "u1") for name in ("month", "day", "hour", "minute", "second"))]
    names += [("valid", "u1"), ("accuracy", "<u4"), ("nano", "<i4"), ("fix", "u1"), ("flags", "u1"), ("more", "u1")]
    names += [("satellites", "u1"), *((name, "<i4") for name in ("lon", "lat", "height", "msl")), ("h", "<u4")]
    names += [("v", "<u4"), *((name, "<i4") for name in ("vn", "ve", "vd", "speed", "course")), ("s", "<u4")]
    rows = np.zeros(ROWS, dtype=np.dtype([*names, ("c", "<u4"), ("rest", "u1", 16)]))
    tick = first + np.arange(ROWS)
    moment = (START_US + tick * 100_000).astype("datetime64[us]")
    day, month, year = (moment.astype(f"datetime64[{unit}]") for unit in "DMY")
    seconds = (moment - day).astype(np.int64) // 10**6
    rows["year"], rows["month"] = year.astype(int) + 1970, (month - year).astype(int) + 1
    rows["day"], rows["hour"] = (day - month.astype("datetime64[D]")).astype(int) + 1, seconds // 3600
    rows["minute"], rows["second"], rows["nano"] = seconds // 60 % 60, seconds % 60, tick % 10 * 100_000_000
    rows["tow"], rows["valid"], rows["fix"], rows["flags"], rows["satellites"] = tick * 100, 7, 3, 1, 12
    rows["lat"], rows["lon"], rows["height"] = 445_000_000 + tick % 10**6, 113_000_000, 60_000
    rows["h"], rows["v"], rows["vn"], rows["speed"], rows["s"], rows["c"] = 12, 34, 1000, 1000, 50, 100_000
    return rows.view(np.uint8).reshape(ROWS, -1)


def write_ulog(path: Path, size: float) -> None:
    """sensor_combined at 250 Hz."""

    def record(kind: str, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), ord(kind)) + body

    kind = np.dtype([("length", "<u2"), ("kind", "S1"), ("id", "<u2"), ("time", "<u8"), ("felt", "<f4", 6)])
    with path.open("wb") as file:
        file.write(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 20_000_000) + record("B", bytes(40)))
        file.write(record("F", b"sensor_combined:uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;"))
        file.write(record("A", struct.pack("<BH", 0, 0) + b"sensor_combined"))
        first = 0
        while file.tell() < size:
            rows = np.zeros(ROWS, dtype=kind)
            rows["length"], rows["kind"], rows["felt"] = 34, b"D", felt(first)
            rows["time"] = 20_000_000 + (first + np.arange(ROWS)) * 4000
            file.write(rows.tobytes())
            first += ROWS


def write_dataflash(path: Path, size: float) -> None:
    """IMU at 400 Hz."""
    columns = b"TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"
    kind = np.dtype([("head", "u1", 3), ("time", "<u8"), ("number", "u1"), ("felt", "<f4", 6)])
    with path.open("wb") as file:
        for facts in (
            (128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns"),
            (1, kind.itemsize, b"IMU", b"QBffffff", columns),
        ):
            file.write(b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", *facts))
        first = 0
        while file.tell() < size:
            rows = np.zeros(ROWS, dtype=kind)
            rows["head"], rows["felt"] = (0xA3, 0x95, 1), felt(first)
            rows["time"] = 20_000_000 + (first + np.arange(ROWS)) * 2500
            file.write(rows.tobytes())
            first += ROWS


def write_tlog(path: Path, size: float) -> None:
    """HIGHRES_IMU at 50 Hz, as pymavlink packs it."""
    from pymavlink.dialects.v20 import ardupilotmega as v2

    packer = v2.MAVLink(None, srcSystem=1, srcComponent=1)
    with path.open("wb") as file:
        at = 0
        while file.tell() < size:
            t_us = 20_000_000 + at * 20_000
            message = packer.highres_imu_encode(
                t_us, 0.1, 0.2, -9.8, 0.1, 0.2, 0.3, 0.2, 0.0, 0.4, 1000.0, 0, 0, 20, 63
            )
            file.write(struct.pack(">Q", START_US + t_us) + message.pack(packer))
            at += 1


def write_mf4(path: Path, size: float) -> None:
    """An IMU at 100 Hz, as asammdf writes it."""
    from asammdf import MDF, Signal

    rows = int(size / 56)
    t_s = np.arange(rows) * 0.01
    names = ("AccX", "AccY", "AccZ", "RateX", "RateY", "RateZ")
    values = np.random.default_rng(0).normal(size=(6, rows)) * 0.1 + np.array([0, 0, 9.8, 0, 0, 0])[:, None]
    with MDF(version="4.10") as file:
        file.append([Signal(column, t_s, name=name, unit="") for name, column in zip(names, values, strict=True)])
        file.save(path, overwrite=True)


def write_sbet(path: Path, size: float) -> None:
    """Records at 200 Hz."""
    with path.open("wb") as file:
        first = 0
        while file.tell() < size:
            tick = first + np.arange(ROWS)
            rows = np.zeros((ROWS, 17))
            rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3] = 100_000 + tick * 0.005, 0.77 + tick * 1e-10, 0.2, 60.0
            rows[:, 5] = 0.13
            file.write(rows.astype("<f8").tobytes())
            first += ROWS


def write_gpmf(path: Path, size: float) -> None:
    """A video of which only accelerometer, gyroscope and their times are there: 200 Hz."""
    count = max(int(size / 2700), 2)
    payloads = [_payload(second) for second in range(count)]
    raw = b"".join(payloads)
    start = _box(b"ftyp", b"mp41" + bytes(4))
    table = _box(b"stbl", *_samples(payloads, len(start) + 8))
    header = _box(b"mdhd", struct.pack(">IIIIII", 0, 0, 0, 1000, 1000 * count, 0))
    track = _box(b"trak", _box(b"mdia", header, _box(b"minf", table)))
    path.write_bytes(start + _box(b"mdat", raw) + _box(b"moov", track))


def _samples(payloads: list[bytes], offset: int) -> list[bytes]:
    sizes = [len(payload) for payload in payloads]
    places = offset + np.concatenate([[0], np.cumsum(sizes[:-1])])
    return [
        _box(b"stsd", struct.pack(">II", 0, 1), _box(b"gpmd", bytes(8))),
        _box(b"stts", struct.pack(">IIII", 0, 1, len(sizes), 1000)),
        _box(b"stsc", struct.pack(">IIIII", 0, 1, 1, 1, 1)),
        _box(b"stsz", struct.pack(">III", 0, 0, len(sizes)), np.array(sizes, dtype=">u4").tobytes()),
        _box(b"stco", struct.pack(">II", 0, len(sizes)), places.astype(">u4").tobytes()),
    ]


def _box(name: bytes, *contents: bytes) -> bytes:
    raw = b"".join(contents)
    return struct.pack(">I", 8 + len(raw)) + name + raw


def _payload(second: int) -> bytes:
    """A second of GPMF."""

    def entry(key: bytes, kind: bytes, size: int, count: int, raw: bytes) -> bytes:
        return key + kind + struct.pack(">BH", size, count) + raw + b"\0" * (-len(raw) % 4)

    streams = b""
    for key, scale, rest in ((b"ACCL", 418, (0, 0, 4100)), (b"GYRO", 3755, (0, 0, 0))):
        values = np.random.default_rng(second).integers(-50, 50, size=(200, 3)) + rest
        stream = entry(b"STMP", b"J", 8, 1, struct.pack(">Q", 1_000_000 * second))
        stream += entry(b"SCAL", b"s", 2, 1, struct.pack(">h", scale)) + entry(b"ORIN", b"c", 1, 3, b"YxZ")
        stream += entry(key, b"s", 6, 200, values.astype(">i2").tobytes())
        streams += entry(b"STRM", b"\0", 1, len(stream), stream)
    device = entry(b"DVID", b"L", 4, 1, struct.pack(">I", 1)) + streams
    return entry(b"DEVC", b"\0", 1, len(device), device)
