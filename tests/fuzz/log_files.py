"""Small files in the formats of loggers, made from the drive of the test suite as their specifications say."""

from __future__ import annotations

import struct
from functools import reduce

import numpy as np
import pyarrow as pa

from recon.numerics.rotation import heading_from_yaw, to_euler
from recon.tables import matrix, time_ns, vector
from recon.testing.drives import drive

GNSS_ROWS, IMU_ROWS = 60, 400


def gnss(rows: int = GNSS_ROWS) -> pa.Table:
    """A stretch on which the vehicle moves."""
    return drive()["gnss"].slice(75, rows)


def imu(rows: int = IMU_ROWS) -> pa.Table:
    """As long as 20 rows of gnss."""
    return drive()["imu"].slice(1500, rows)


def stamps(table: pa.Table, pattern: str, digits: int = 3) -> list[str]:
    """Times by a pattern of strftime, with decimals of the second."""
    import datetime

    found = []
    for t_ns in time_ns(table).tolist():
        whole, rest = divmod(t_ns, 1_000_000_000)
        moment = datetime.datetime.fromtimestamp(whole, datetime.UTC)
        found.append(f"{moment:{pattern}}.{rest // 10 ** (9 - digits):0{digits}d}")
    return found


# --- NMEA -----------------------------------------------------------------------------------------------------------


def sentence(text: str) -> str:
    """With $ and its checksum."""
    return f"${text}*{reduce(lambda total, byte: total ^ byte, text.encode(), 0):02X}"


def minutes(value: float, digits: int, sides: str) -> str:
    """Degrees as (d)ddmm.mmmmmm and the hemisphere."""
    whole, part = divmod(round(abs(value) * 60, 6), 60)
    return f"{int(whole):0{digits}d}{part:09.6f},{sides[int(value < 0)]}"


def nmea(rows: int = GNSS_ROWS) -> bytes:
    """GGA, GST, VTG and RMC of each time; a sentence of another type."""
    table = gnss(rows)
    clocks, dates = stamps(table, "%H%M%S", 3), stamps(table, "%d%m%y")
    lines = []
    for row in range(rows):
        lat, lon, height, speed, course = (vector(table, n)[row] for n in ("lat", "lon", "height", "speed", "course"))
        place = f"{minutes(lat, 2, 'NS')},{minutes(lon, 3, 'EW')}"
        knots, degrees = f"{speed / 0.514444444:.4f}", f"{np.degrees(course) % 360:.3f}"
        clock = clocks[row]
        lines += [
            sentence(f"GNGGA,{clock},{place},4,12,0.8,{height:.3f},M,45.1,M,1.0,0001"),
            sentence(f"GNGST,{clock},1.2,0.5,0.4,10.0,0.021,0.012,0.034"),
            sentence(f"GNVTG,{degrees},T,,M,{knots},N,{speed * 3.6:.4f},K,A"),
            sentence(f"GNRMC,{clock},A,{place},{knots},{degrees},{dates[row][:6]},,,A"),
            sentence("GPGSV,1,1,01,21,74,276,34"),
        ]
    return ("\r\n".join(lines) + "\r\n").encode()


# --- UBX ------------------------------------------------------------------------------------------------------------


def message(group: int, number: int, payload: bytes) -> bytes:
    """A message of UBX with its checksum (the loop of the interface description, 3.4)."""
    body = bytes([group, number]) + struct.pack("<H", len(payload)) + payload
    a = b = 0
    for byte in body:
        a = (a + byte) & 0xFF
        b = (b + a) & 0xFF
    return b"\xb5\x62" + body + bytes([a, b])


def nav_pvt(table: pa.Table, row: int) -> bytes:
    """NAV-PVT of a row of gnss: 92 bytes."""
    t_ns = int(time_ns(table)[row])
    moment = np.datetime64(t_ns, "ns").astype("datetime64[s]").item()
    lat, lon, height, speed, course = (vector(table, n)[row] for n in ("lat", "lon", "height", "speed", "course"))
    vel_n, vel_e = speed * np.cos(course), speed * np.sin(course)
    payload = struct.pack(
        "<IHBBBBBBIiBBBBiiiiIIiiiiiIIHHIihH",
        0, moment.year, moment.month, moment.day, moment.hour, moment.minute, moment.second, 7, 20,
        t_ns % 1_000_000_000, 3, 1, 0xE0, 12, round(lon * 1e7), round(lat * 1e7), round(height * 1e3),
        round(height * 1e3) - 45_100, 12, 34, round(vel_n * 1e3), round(vel_e * 1e3), 0, round(speed * 1e3),
        round(np.degrees(course) * 1e5), 50, 100_000, 150, 0, 0, 0, 0, 0,
    )  # fmt: skip
    return message(0x01, 0x07, payload)


def esf_meas(tag_ms: int, data: dict[int, int]) -> bytes:
    """ESF-MEAS with data by type."""
    words = b"".join(struct.pack("<I", kind << 24 | value & 0xFFFFFF) for kind, value in data.items())
    return message(0x10, 0x02, struct.pack("<IHH", tag_ms, len(data) << 11, 0) + words)


def ubx(rows: int = GNSS_ROWS) -> bytes:
    """NAV-PVT, between them ESF-MEAS with accelerations, rates and speed, and sentences of NMEA."""
    table, inertial = gnss(rows), imu(20 * rows)
    accel, gyro, speed = matrix(inertial, "accel"), matrix(inertial, "gyro"), vector(table, "speed")
    each = inertial.num_rows // rows
    start_ns = int(time_ns(table)[0])
    step_ms = round(float(np.diff(time_ns(table))[0]) * 1e-6)
    parts = []
    for row in range(rows):
        parts.append(nav_pvt(table, row))
        parts.append((sentence("GNTXT,01,01,02,hello") + "\r\n").encode())
        tag_ms = 5_000 + (int(time_ns(table)[row]) - start_ns) // 1_000_000
        for part in range(0, each, 4):
            at = row * each + part
            force = {16 + axis: round(accel[at, axis] * 2**10) for axis in range(3)}
            rate = {kind: round(np.degrees(gyro[at, axis]) * 2**12) for axis, kind in enumerate((14, 13, 5))}
            now_ms = tag_ms + step_ms * part // each
            parts.append(esf_meas(now_ms, {**force, **rate}))
        parts.append(esf_meas(tag_ms, {11: round(speed[row] * 1e3)}))
    return b"".join(parts)


# --- VBOX -----------------------------------------------------------------------------------------------------------


def vbo(rows: int = GNSS_ROWS) -> bytes:
    """With an IMU in the axes forward, left, up; longitude positive to the west."""
    table, inertial = gnss(rows), imu(rows)
    day, clock = stamps(table, "%d/%m/%Y")[0][:10], stamps(table, "%H%M%S", 3)
    accel, gyro = matrix(inertial, "accel") / 9.80665, np.degrees(matrix(inertial, "gyro"))
    lines = [
        f"File created on {day} @ {clock[0][:2]}:{clock[0][2:4]}", "", "[header]", "satellites", "time", "latitude",
        "longitude", "velocity kmh", "heading", "height", "", "[comments]", "Log Rate (Hz) : 10.00", "",
        "[column names]",
        "sats time lat long velocity heading height Brake X_Accel Y_Accel Z_Accel RollRate PitchRate YawRate Brake",
        "", "[data]",
    ]  # fmt: skip
    for row in range(rows):
        lat, lon, height, speed, course = (vector(table, n)[row] for n in ("lat", "lon", "height", "speed", "course"))
        place = f"{lat * 60:+014.8f} {-lon * 60:+014.8f} {speed * 3.6:08.4f} {np.degrees(course):07.3f} {height:+09.3f}"
        moving = " ".join(f"{value:+.6E}" for value in (*accel[row], *gyro[row]))
        lines.append(f"140 {clock[row]} {place} +0.0000E+00 {moving} +0.0000E+00 ")
    return ("\r\n".join(lines) + "\r\n").encode("latin-1")


# --- tracks and solutions -------------------------------------------------------------------------------------------


def gpx(rows: int = GNSS_ROWS) -> bytes:
    """GPX 1.0 has elements for speed and course; a waypoint stands before the track."""
    table = gnss(rows)
    times = stamps(table, "%Y-%m-%dT%H:%M:%S", 3)
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', '<gpx version="1.0" xmlns="http://www.topografix.com/GPX/1/0">']
    lines += ['<wpt lat="1" lon="2"><time>2001-01-01T00:00:00Z</time></wpt>', "<trk><trkseg>"]
    for row in range(rows):
        lat, lon, height, speed, course = (vector(table, n)[row] for n in ("lat", "lon", "height", "speed", "course"))
        moving = f"<course>{np.degrees(course):.3f}</course><speed>{speed:.4f}</speed>"
        lines.append(
            f'<trkpt lat="{lat:.9f}" lon="{lon:.9f}"><ele>{height:.3f}</ele><time>{times[row]}Z</time>{moving}'
            "<fix>3d</fix><sat>12</sat></trkpt>"
        )
    return "\n".join([*lines, "</trkseg></trk>", "</gpx>", ""]).encode()


def kml(rows: int = GNSS_ROWS) -> bytes:
    """A gx:Track, and a line without times."""
    table = gnss(rows)
    places = zip(*(vector(table, name).tolist() for name in ("lon", "lat", "height")), strict=True)
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2">',
        "<Document><Placemark><LineString><coordinates>1,2,3 4,5,6</coordinates></LineString></Placemark>",
        "<Placemark><gx:Track><altitudeMode>absolute</altitudeMode>",
        *(f"<when>{time}Z</when>" for time in stamps(table, "%Y-%m-%dT%H:%M:%S", 3)),
        *(f"<gx:coord>{lon:.9f} {lat:.9f} {height:.3f}</gx:coord>" for lon, lat, height in places),
        "</gx:Track></Placemark></Document></kml>",
    ]
    return "\n".join([*lines, ""]).encode()


def rtklib(rows: int = GNSS_ROWS) -> bytes:
    """As RTKPOST writes it, times in UTC."""
    table = gnss(rows)
    title = (
        "%  UTC                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)"
        "  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio    vn(m/s)    ve(m/s)    vu(m/s)      sdvn     sdve     sdvu"
    )
    lines = ["% program   : RTKPOST ver.2.4.3 b34", "% pos mode  : Kinematic", title]
    for row, time in enumerate(stamps(table, "%Y/%m/%d %H:%M:%S", 3)):
        lat, lon, height, speed, course = (vector(table, n)[row] for n in ("lat", "lon", "height", "speed", "course"))
        vel_n, vel_e = speed * np.cos(course), speed * np.sin(course)
        lines.append(
            f"{time} {lat:14.9f} {lon:14.9f} {height:10.4f} {1 + row % 2:3d} {12:3d}   0.0101   0.0202   0.0303"
            f"   0.0000   0.0000   0.0000   0.10    3.5 {vel_n:10.5f} {vel_e:10.5f}    0.00000"
            "   0.01000  0.02000  0.03000"
        )
    return "\n".join([*lines, ""]).encode()


WEEK, WEEK_NS = 1930, 604_800_000_000_000


def _of_week(table: pa.Table) -> np.ndarray:
    """Times as seconds of a GPS week of their own, (n,): all samples begin at 100 000 s."""
    return 100_000.0 + (time_ns(table) - time_ns(gnss())[0]) * 1e-9


def trajectory(rows: int = GNSS_ROWS) -> pa.Table:
    """The truth at the times of gnss."""
    return drive()["trajectory"].take(list(range(1500, 1500 + 20 * rows, 20)))


def sbet(rows: int = GNSS_ROWS) -> bytes:
    """In a wander frame that is turned by 0.3 rad, x to its north; accelerations and rates are zero."""
    table = trajectory(rows)
    lat, lon, height = (vector(table, name) for name in ("lat", "lon", "height"))
    (east, north, up), wander = matrix(table, "vel").T, np.full(rows, 0.3)
    yaw, pitch, roll = to_euler(matrix(table, "q"))
    x, y = north * np.cos(wander) - east * np.sin(wander), north * np.sin(wander) + east * np.cos(wander)
    columns = [_of_week(table), np.radians(lat), np.radians(lon), height, x, y, up, roll, -pitch]
    columns += [heading_from_yaw(yaw) + wander, wander, *np.zeros((6, rows))]
    return np.column_stack(columns).astype("<f8").tobytes()


def kf_gins(rows: int = GNSS_ROWS) -> dict[str, bytes]:
    """Increments of an IMU, positions, and a reference, by file."""
    table, inertial = gnss(rows), imu(20 * rows)
    t_s, step_s = _of_week(inertial), float(np.diff(time_ns(inertial))[0]) * 1e-9
    down = np.array([1.0, -1.0, -1.0]) * step_s
    moved = np.column_stack([t_s + 0.5 * step_s, matrix(inertial, "gyro") * down, matrix(inertial, "accel") * down])
    lat, lon, height, speed, course = (vector(table, n) for n in ("lat", "lon", "height", "speed", "course"))
    place = np.column_stack([_of_week(table), lat, lon, height])
    sigmas = np.tile([0.01, 0.02, 0.03], (rows, 1))
    week, still, vel = np.full(rows, float(WEEK)), np.zeros(rows), speed * np.array([np.cos(course), np.sin(course)])
    truth = np.column_stack([week, place, *vel, still, still, still, np.degrees(course)])
    return {
        "imu.txt": _blank_parted(moved, "%15.6f" + " %16.12f" * 6),
        "gnss.pos": _blank_parted(np.column_stack([place, sigmas]), "%12.4f %14.9f %14.9f %10.4f" + " %7.4f" * 3),
        "truth.nav": _blank_parted(truth, "%4.0f %12.4f %14.9f %14.9f %10.4f" + " %10.5f" * 6),
    }


def _blank_parted(values: np.ndarray, pattern: str) -> bytes:
    return "".join(pattern % tuple(row) + "\n" for row in values.tolist()).encode()


def kitti(rows: int = 30) -> dict[str, bytes]:
    """The folder oxts: times, and a packet of 30 numbers for each."""
    table, inertial = gnss(rows), imu(rows)
    accel, gyro = matrix(inertial, "accel"), matrix(inertial, "gyro")
    files = {"oxts/timestamps.txt": "".join(f"{time}\n" for time in stamps(table, "%Y-%m-%d %H:%M:%S", 9)).encode()}
    for row in range(rows):
        lat, lon, height, speed, course = (vector(table, n)[row] for n in ("lat", "lon", "height", "speed", "course"))
        vel = [speed * np.cos(course), speed * np.sin(course), speed, 0.0, 0.0]
        numbers = [
            lat,
            lon,
            height,
            0.0,
            0.0,
            np.pi / 2 - course,
            *vel,
            *accel[row],
            *accel[row],
            *gyro[row],
            *gyro[row],
        ]
        text = " ".join(f"{value:.13g}" for value in [*numbers, 0.05, 0.02]) + " 4 12 5 5 6"
        files[f"oxts/data/{row:010d}.txt"] = text.encode()
    return files


# --- NovAtel --------------------------------------------------------------------------------------------------------


def _crc(data: bytes) -> int:
    """CRC-32 bit by bit, as the manual of the receivers has it."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xEDB88320 if crc & 1 else 0)
    return crc


def novatel_text(name: str, tow_s: float, fields: str) -> bytes:
    """A log in ASCII."""
    body = f"{name}A,COM1,0,65.0,FINESTEERING,{WEEK},{tow_s:.3f},02000020,cdba,16809;{fields}"
    return f"#{body}*{_crc(body.encode()):08x}\r\n".encode()


def novatel_binary(number: int, tow_s: float, payload: bytes) -> bytes:
    """A log with the long binary header."""
    head = b"\xaa\x44\x12" + struct.pack(
        "<BHBBHHBBHIIHH", 28, number, 0, 32, len(payload), 0, 0, 180, WEEK, round(tow_s * 1000), 0, 0, 0
    )
    return head + payload + struct.pack("<I", _crc(head + payload))


def novatel_short(number: int, tow_s: float, payload: bytes) -> bytes:
    """A log with the short binary header."""
    head = b"\xaa\x44\x13" + struct.pack("<BHHI", len(payload), number, WEEK, int(tow_s * 1000))
    return head + payload + struct.pack("<I", _crc(head + payload))


def _novatel_rows(rows: int) -> list[tuple[float, list[float]]]:
    """Time of week and lat, lon, height, speed, course deg."""
    table = gnss(rows)
    names = ("lat", "lon", "height", "speed", "course")
    columns = np.column_stack([vector(table, name) for name in names])
    columns[:, 4] = np.degrees(columns[:, 4])
    return list(zip(np.round(_of_week(table), 3).tolist(), columns.tolist(), strict=True))


def novatel_ascii(rows: int = GNSS_ROWS) -> bytes:
    """BESTPOSA, BESTVELA with a latency, INSPVAXA; heights above the geoid, which lies 40 m above the ellipsoid."""
    parts = []
    for tow_s, (lat, lon, height, speed, course) in _novatel_rows(rows):
        place = f"{lat:.11f},{lon:.11f},{height - 40:.4f}"
        pos = f"SOL_COMPUTED,NARROW_INT,{place},40.0000,WGS84,0.0101,0.0202,0.0303,"
        parts.append(novatel_text("BESTPOS", tow_s, f'{pos}"AAAA",1.000,0.000,35,30,30,28,00,06,39,33'))
        vel = f"SOL_COMPUTED,DOPPLER_VELOCITY,0.150,0.000,{speed:.4f},{course:.6f},0.0000,0.0"
        parts.append(novatel_text("BESTVEL", tow_s + 0.15, vel))
        moving = f"{speed * np.cos(np.radians(course)):.4f},{speed * np.sin(np.radians(course)):.4f},0.0000"
        ins = f"INS_SOLUTION_GOOD,INS_RTKFIXED,{place},40.0000,{moving},1.5,-2.5,{course:.9f}"
        parts.append(novatel_text("INSPVAX", tow_s, f"{ins}{',0.01' * 9},00000000,0"))
    return b"".join(parts)


def novatel_packets(rows: int = GNSS_ROWS) -> bytes:
    """BESTPOS, BESTVEL and CORRIMUDATA in binary, with other bytes between."""
    parts = [b"\xd4\xc3\xb2\xa1 a capture"]
    inertial = imu(20 * rows)
    t_s, accel, gyro = np.round(_of_week(inertial), 3), matrix(inertial, "accel"), matrix(inertial, "gyro")
    for row, (tow_s, (lat, lon, height, speed, course)) in enumerate(_novatel_rows(rows)):
        pos = struct.pack("<IIdddfIfff4sffBBBBBBBB", 0, 50, lat, lon, height - 40, 40.0, 61, 0.0101, 0.0202, 0.0303,
                          b"AAAA", 1.0, 0.0, 12, 10, 10, 9, 0, 0, 0, 0)  # fmt: skip
        parts += [novatel_binary(42, tow_s, pos), b"\0\x01 packet "]
        parts.append(novatel_binary(99, tow_s, struct.pack("<IIffdddf", 0, 8, 0.0, 0.0, speed, course, 0.0, 0.0)))
        for at in range(20 * row, 20 * row + 20, 2):
            turned = [gyro[at, 1] * -1, gyro[at, 0], gyro[at, 2], -accel[at, 1], accel[at, 0], accel[at, 2]]
            step = 0.02 * np.array(turned)
            parts.append(novatel_binary(812, t_s[at] + 0.01, struct.pack("<Id6d", WEEK, t_s[at] + 0.01, *step)))
    return b"".join(parts)


# --- NHTSA ----------------------------------------------------------------------------------------------------------


def nhtsa(rows: int = 400) -> dict[str, bytes]:
    """Two places of the vehicle, one of a dummy: a half sine of -30 g in 100 ms, along x; z downwards."""
    t_s = -0.05 + 1e-3 * np.arange(rows)
    pulse = np.where((t_s >= 0) & (t_s <= 0.1), -30 * np.sin(np.pi * t_s / 0.1), 0.0)
    sensors = [
        "1|1|AC|01|HDCG|XL|SEC|G'S|2800|MFG|11/AUG/2017|1200|4|57.09|-50|299|1000|AM|P|DRIVER HEAD X",
        "1|2|AC|NA|FLLR|XG|SEC|G'S|2800|MFG|12/APR/2017|800|21|57.09|-50|299|1000|AM|P|LEFT REAR X",
        "1|3|AC|NA|FLLR|ZG|SEC|G'S|2800|MFG|12/APR/2017|800|21|0.0|-50|299|1000|AM|P|LEFT REAR Z",
        "1|4|AC|NA|ENGN|XG|SEC|G'S|2800|MFG|12/APR/2017|800|21|57.09|-50|299|1000|AM|P|TOP OF ENGINE X",
        "1|5|AV|NA|FLLR|ZG|SEC|DPS|2800|MFG|12/APR/2017|800|21|0.0|-50|299|1000|AM|P|LEFT REAR YAW RATE",
    ]
    test = "V5|NCAP|OBJECTIVE|03/OCT/2017|MGA|CON|REF|NCA|VTB|CON|DRY|22|OTH|OTH|57.09|0|0|0|5|REMARK"
    lines = ["# Source: made for a test", "----- EV5 -----", "----- TEST -----", test]
    lines += ["----- INSTRUMENTATION -----", *sensors, "----- END -----", ""]
    curves = {2: pulse, 3: 0.1 * pulse, 4: 1.2 * pulse, 5: 2.0 * pulse}
    files = {
        f"v1.{number:03d}": "".join(f"{t:.6f}\t{value:.6f}\n" for t, value in zip(t_s, curve, strict=True)).encode()
        for number, curve in curves.items()
    }
    return {"v1.EV5": "\n".join(lines).encode("latin-1"), **files}


# --- GPMF -----------------------------------------------------------------------------------------------------------


def klv(key: str, kind: str, size: int, count: int, raw: bytes) -> bytes:
    """An entry of GPMF."""
    return key.encode() + kind.encode("latin-1") + struct.pack(">BH", size, count) + raw + b"\0" * (-len(raw) % 4)


def nest(key: str, *entries: bytes) -> bytes:
    """Entries inside one."""
    raw = b"".join(entries)
    return klv(key, "\0", 1, len(raw), raw)


def gpmf_payloads(seconds: int = 3, *, stamps_us: bool = True) -> list[bytes]:
    """A second of 100 Hz of imu each, in the order Y, -X, Z of the camera, and its GPS at 5 Hz."""
    inertial, table = imu(100 * seconds), gnss(20 * seconds)
    accel, gyro = matrix(inertial, "accel"), matrix(inertial, "gyro")
    found = []
    for second in range(seconds):
        rows = slice(100 * second, 100 * second + 100)
        stamp = [klv("STMP", "J", 8, 1, struct.pack(">Q", 1_000_000 * second))] if stamps_us else []
        streams = []
        for key, values, scale in (("ACCL", accel[rows], 418), ("GYRO", np.asarray(gyro[rows]), 3755)):
            order = np.column_stack([values[:, 0], values[:, 1], values[:, 2]])  # Y forward, -X left, Z up
            raw = np.clip(np.round(order * scale), -32768, 32767).astype(">i2").tobytes()
            about = [klv("SCAL", "s", 2, 1, struct.pack(">h", scale)), klv("ORIN", "c", 1, 3, b"YxZ")]
            streams.append(nest("STRM", *stamp, *about, klv(key, "s", 6, 100, raw)))
        part = table.slice(20 * second, 20).take(list(range(0, 20, 4)))
        place = np.column_stack([vector(part, "lat") * 1e7, vector(part, "lon") * 1e7, vector(part, "height") * 1e3])
        speed = vector(part, "speed")[:, None] * (1e3, 1e2)
        raw = np.round(np.column_stack([place, speed])).astype(">i4").tobytes()
        utc = f"251008100{second // 60}{second % 60:02d}.000".encode()
        about = [klv("GPSF", "L", 4, 1, struct.pack(">I", 3)), klv("GPSU", "U", 16, 1, utc)]
        about.append(klv("SCAL", "l", 4, 5, struct.pack(">5i", 10**7, 10**7, 1000, 1000, 100)))
        streams.append(nest("STRM", *stamp, *about, klv("GPS5", "l", 20, 5, raw)))
        found.append(nest("DEVC", klv("DVID", "L", 4, 1, struct.pack(">I", 1)), *streams))
    return found


def box(name: bytes, *contents: bytes) -> bytes:
    """A box of an MP4."""
    raw = b"".join(contents)
    return struct.pack(">I", 8 + len(raw)) + name + raw


def mp4(payloads: list[bytes]) -> bytes:
    """A film without pictures: a track of format gpmd, of samples of one second."""
    start = box(b"ftyp", b"mp41\0\0\0\0")
    sizes = [len(payload) for payload in payloads]
    first = len(start) + 8
    offsets = [first + sum(sizes[:index]) for index in range(len(sizes))]
    table = box(
        b"stbl",
        box(b"stsd", struct.pack(">II", 0, 1), box(b"gpmd", b"\0" * 8)),
        box(b"stts", struct.pack(">IIII", 0, 1, len(sizes), 1000)),
        box(b"stsz", struct.pack(f">III{len(sizes)}I", 0, 0, len(sizes), *sizes)),
        box(b"stsc", struct.pack(">IIIII", 0, 1, 1, 1, 1)),
        box(b"stco", struct.pack(f">II{len(sizes)}I", 0, len(sizes), *offsets)),
    )
    header = box(b"mdhd", struct.pack(">IIIII", 0, 0, 0, 1000, 1000 * len(sizes)), b"\0" * 4)
    return start + box(b"mdat", *payloads) + box(b"moov", box(b"trak", box(b"mdia", header, box(b"minf", table))))
