"""Small logs of autopilots, written byte by byte: a vehicle that drives north-east, level, at 10 m/s."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Final

import numpy as np

BOOT_US: Final = 20_000_000
UTC_US: Final = 1_700_000_000_000_000
"""When the autopilot was booted."""
ACCEL_FRD, GYRO_FRD, FIELD_FRD = (0.5, 0.25, -9.75), (0.125, -0.25, 0.5), (0.25, 0.125, 0.5)
"""m/s^2, rad/s, gauss; powers of two, which every width of number holds."""
LAT, LON, HEIGHT, SPEED, COURSE_DEG, PRESSURE = 44.5, 11.25, 54.5, 10.0, 45.0, 101_312.0
WEEK, WEEK_MS = 2288, (UTC_US // 1000 + 18_000 - 315_964_800_000) % 604_800_000
"""GPS week of 2023-11-12, and the time of boot in it: UTC + 18 s."""


# --- ULog: PX4 user guide, ULog file format ---------------------------------------------------------------------------

_ULOG_TYPES: Final = {"uint64_t": "Q", "float": "f", "double": "d", "int32_t": "i", "uint8_t": "B", "bool": "?"}


def ulog(seconds: float = 1.0, *, appended: bytes = b"") -> bytes:
    """sensor_combined 100 Hz, vehicle_gps_position 5 Hz, magnetometer, air data, attitude, local position."""
    topics = {
        "sensor_combined": (100, "float[3] gyro_rad;float[3] accelerometer_m_s2", [*GYRO_FRD, *ACCEL_FRD]),
        "vehicle_gps_position": (
            5,
            "uint64_t time_utc_usec;int32_t lat;int32_t lon;int32_t alt;float eph;float epv;float s_variance_m_s;"
            "float vel_m_s;float vel_n_m_s;float vel_e_m_s;float vel_d_m_s;float cog_rad;bool vel_ned_valid;"
            "uint8_t fix_type;uint8_t satellites_used",
            [
                *(0, round(LAT * 1e7), round(LON * 1e7), round(HEIGHT * 1e3), 0.5, 1.0, 0.25, SPEED),
                *(SPEED * np.sqrt(0.5), SPEED * np.sqrt(0.5), 0.0, np.radians(COURSE_DEG), True, 3, 14),
            ],
        ),
        "vehicle_magnetometer": (20, "float[3] magnetometer_ga", list(FIELD_FRD)),
        "vehicle_air_data": (20, "float baro_pressure_pa;float baro_temp_celcius", [PRESSURE, 20.0]),
        "vehicle_attitude": (20, "float[4] q", list(_heading(COURSE_DEG))),
        "vehicle_local_position": (
            10,
            "double ref_lat;double ref_lon;float ref_alt;float x;float y;float z;float vx;float vy;float vz;"
            "bool xy_valid;bool z_valid",
            [LAT, LON, HEIGHT, 1.0, 2.0, -3.0, SPEED * np.sqrt(0.5), SPEED * np.sqrt(0.5), 0.0, True, True],
        ),
    }
    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", BOOT_US), _record("B", bytes(40))]
    out += [_record("F", f"{name}:uint64_t timestamp;{fields};".encode()) for name, (_, fields, _) in topics.items()]
    for number, name in enumerate(topics):
        out.append(_record("A", struct.pack("<BH", 0, number) + name.encode()))
    rows = []
    for number, (rate, fields, values) in enumerate(topics.values()):
        layout = "<HQ" + "".join(_layout(field.split()[0]) for field in fields.split(";"))
        for at in range(round(seconds * rate)):
            t_us = BOOT_US + at * 10**6 // rate
            own = [UTC_US + t_us, *values[1:]] if rate == 5 else values
            rows.append((t_us, number, _record("D", struct.pack(layout, number, t_us, *own))))
    sync = _record("S", bytes.fromhex("2f731320250cbb12"))
    rows += [(BOOT_US + at * 200_000, -1, sync) for at in range(int(5 * seconds))]
    return b"".join([*out, *(row for *_, row in sorted(rows)), appended])


def _layout(kind: str) -> str:
    name, _, count = kind.partition("[")
    return f"{count[:-1]}{_ULOG_TYPES[name]}"


def _record(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def _heading(degrees: float) -> tuple[float, float, float, float]:
    """Forward, right, down in north, east, down."""
    return (np.cos(np.radians(degrees) / 2), 0.0, 0.0, np.sin(np.radians(degrees) / 2))


# --- DataFlash: ArduPilot, AP_Logger/LogStructure.h -------------------------------------------------------------------

_FLASH: Final = {
    "IMU": (1, 100, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", [0, *GYRO_FRD, *ACCEL_FRD]),
    "GPS": (
        *(2, 5, "QBBIHBcLLeffff", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw"),
        [0, 3, 0, WEEK, 14, 80, round(LAT * 1e7), round(LON * 1e7), round(HEIGHT * 100), SPEED, COURSE_DEG, 0.0, 0.0],
    ),
    "GPA": (3, 5, "QBCCCC", "TimeUS,I,VDop,HAcc,VAcc,SAcc", [0, 90, 50, 100, 25]),
    "MAG": (4, 10, "QBhhh", "TimeUS,I,MagX,MagY,MagZ", [0, *(round(1000 * value) for value in FIELD_FRD)]),
    "BARO": (5, 10, "QBffc", "TimeUS,I,Alt,Press,Temp", [0, 0.0, PRESSURE, 2000]),
    "ORGN": (6, 1, "QBLLe", "TimeUS,Type,Lat,Lng,Alt", [0, round(LAT * 1e7), round(LON * 1e7), round(HEIGHT * 100)]),
    "XKF1": (
        *(7, 20, "QBccCffffff", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD"),
        [0, 0, 0, round(COURSE_DEG * 100), SPEED * np.sqrt(0.5), SPEED * np.sqrt(0.5), 0.0, 1.0, 2.0, -3.0],
    ),
    "CAM": (8, 5, "QBLL", "TimeUS,I,Lat,Lng", [0, 1, 1]),
}
"""By name: number, Hz, types, columns, values behind the time."""
_FLASH_TYPES: Final = {
    "Q": "Q",
    "B": "B",
    "f": "f",
    "c": "h",
    "C": "H",
    "h": "h",
    "H": "H",
    "I": "I",
    "L": "i",
    "e": "i",
}


def dataflash(seconds: float = 1.0) -> bytes:
    """IMU 100 Hz, GPS with its accuracies 5 Hz, compass, barometer, the estimate with its origin, camera triggers."""
    out = [_flash(128, struct.pack("<BB4s16s64s", 128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns"))]
    rows = []
    for name, (number, rate, types, columns, values) in _FLASH.items():
        layout = "<" + "".join(_FLASH_TYPES[code] for code in types)
        facts = (number, 3 + struct.calcsize(layout), name.encode(), types.encode(), columns.encode())
        out.append(_flash(128, struct.pack("<BB4s16s64s", *facts)))
        for at in range(max(round(seconds * rate), 1)):
            t_us = BOOT_US + at * 10**6 // rate
            own = [*values[:2], WEEK_MS + t_us // 1000, *values[3:]] if name == "GPS" else values
            rows.append((t_us, number, _flash(number, struct.pack(layout, t_us, *own))))
    return b"".join([*out, *(row for *_, row in sorted(rows))])


def _flash(number: int, body: bytes) -> bytes:
    return b"\xa3\x95" + bytes([number]) + body


# --- telemetry: mavlink.io --------------------------------------------------------------------------------------------


def tlog(
    seconds: float = 1.0,
    *,
    version: int = 2,
    autopilot: int = 3,
    utc_us: int = UTC_US,
    told: bool = True,
    component: int = 1,
) -> bytes:
    """RAW_IMU 50 Hz, GPS_RAW_INT 5 Hz, pressure, position and attitude at 10 Hz, as pymavlink packs them.

    utc_us : of the boot; told : by SYSTEM_TIME
    """
    from pymavlink.dialects.v20 import ardupilotmega as v2

    packer = v2.MAVLink(None, srcSystem=1, srcComponent=component)
    milli = [round(value * 1000 / 9.80665) for value in ACCEL_FRD]
    rates = [round(value * 1000) for value in (*GYRO_FRD, *FIELD_FRD)]
    place = [round(LAT * 1e7), round(LON * 1e7), round(HEIGHT * 1e3)]
    speeds = [round(SPEED * 100 * np.sqrt(0.5))] * 2
    makers = {
        1: lambda t: [
            packer.heartbeat_encode(2, autopilot, 0, 0, 4),
            packer.system_time_encode(utc_us + t if told else 0, t // 1000),
        ],
        50: lambda t: [packer.raw_imu_encode(t, *milli, *rates)],
        5: lambda t: [packer.gps_raw_int_encode(t, 3, *place, 80, 90, 1000, 4500, 14, 0, 500, 1000, 250, 0)],
        10: lambda t: [
            packer.scaled_pressure_encode(t // 1000, PRESSURE / 100, 0.0, 2000),
            packer.global_position_int_encode(t // 1000, *place, 0, *speeds, 0, 4500),
            packer.attitude_encode(t // 1000, 0.0, 0.0, np.radians(COURSE_DEG), 0.0, 0.0, 0.0),
        ],
    }
    rows = []
    for rate, make in makers.items():
        for at in range(max(round(seconds * rate), 1)):
            t_us = BOOT_US + at * 10**6 // rate
            for message in make(t_us):
                frame = message.pack(packer, force_mavlink1=version == 1)
                rows.append((t_us, rate, struct.pack(">Q", utc_us + t_us + 3000) + frame))
    return b"".join(row for *_, row in sorted(rows, key=lambda each: each[:2]))


def highres_imu(stamp_us: int, *, sensors: int = 1, told: bool = True, seconds: float = 1.0) -> bytes:
    """HIGHRES_IMU at 50 Hz, stamped with `stamp_us` and the time since boot, SYSTEM_TIME at 1 Hz if it is told."""
    from pymavlink.dialects.v20 import ardupilotmega as v2

    packer = v2.MAVLink(None, srcSystem=1, srcComponent=1)
    rows = []
    for at in range(round(50 * seconds)):
        t_us = BOOT_US + at * 20_000
        felt = (*ACCEL_FRD, *GYRO_FRD, *FIELD_FRD)
        messages = [
            packer.highres_imu_encode(stamp_us + t_us, *felt, 1000.0, 0.0, 0.0, 20.0, 63, sensor)
            for sensor in range(sensors)
        ]
        if told and at % 50 == 0:
            messages.append(packer.system_time_encode(UTC_US + t_us, t_us // 1000))
        rows += [struct.pack(">Q", UTC_US + t_us + 3000) + message.pack(packer) for message in messages]
    return b"".join(rows)


def damaged(data: bytes, places: Iterable[float], length: int = 7, fill: bytes = b"\xff") -> bytes:
    """The bytes with some of them, at these shares of their length, overwritten."""
    changed = bytearray(data)
    for share in places:
        at = int(share * len(data))
        changed[at : at + length] = fill * length
    return bytes(changed)
