"""Large texts for `reading.py`, made as receivers, phones and crash tests write them."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

START_NS = 1_700_000_000_000_000_000
ROWS = 100_000
"""Rows that are made at a time."""

Made = Callable[[int, int], dict[str, Any]]
"""Columns of so many rows from a number on."""


def append_rows(path: Path, size: float, make: Made, separator: str = ",", *, titled: bool = False) -> None:
    """Write rows behind what a file holds until it has so many bytes. titled : the names of the columns first"""
    import pyarrow as pa
    from pyarrow import csv

    with path.open("ab") as file:
        first = 0
        while file.tell() < size:
            table = pa.table(make(first, ROWS))
            options = csv.WriteOptions(
                include_header=titled and not first, delimiter=separator, quoting_style="none", quoting_header="none"
            )
            csv.write_csv(table, file, options)
            first += ROWS


def noise(first: int, around: Sequence[float], scale: float = 0.1) -> np.ndarray:
    """(ROWS, k) numbers of six decimals about k others, as sensors of a moving vehicle report them."""
    return np.round(np.random.default_rng(first).normal(around, scale, size=(ROWS, len(around))), 6)


def moments(first: int, step_ns: int) -> np.ndarray:
    """(ROWS,) texts such as 2023-11-14T22:13:20.000."""
    t_ns = START_NS + (first + np.arange(ROWS)) * step_ns
    return np.datetime_as_string((t_ns // 1_000_000).astype("datetime64[ms]"))


def write_vbox(path: Path, size: float) -> None:
    """A VBOX 3i with an IMU at 100 Hz."""
    names = "sats time lat long velocity heading height X_Accel Y_Accel Z_Accel RollRate PitchRate YawRate"
    lines = ["File created on 14/11/2023 @ 00:00", "", "[header]", "velocity kmh", "", "[column names]", names]
    path.write_text("\n".join([*lines, "", "[data]", ""]))

    def make(first: int, count: int) -> dict[str, Any]:
        clock = np.char.replace(np.char.partition(moments(first, 10_000_000), "T")[:, 2], ":", "")
        place = (first + np.arange(count)) * 1e-6 % 60
        driven = {
            "lat": 2670.0 + place,
            "long": -678.0 - place,
            "v": 50.0 + place,
            "h": 90.0 + place,
            "z": 60.0 + place,
        }
        felt = dict(zip("abcdef", noise(first, (0, 0, 1, 0, 0, 0)).T, strict=True))
        return {"sats": np.full(count, 12), "time": clock, **driven, **felt}

    append_rows(path, size, make, " ")


def write_rtklib(path: Path, size: float) -> None:
    """Positions and velocities at 10 Hz."""
    path.write_text(
        "% program   : RTKPOST\n%  GPST  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)"
        "  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio    vn(m/s)    ve(m/s)    vu(m/s)      sdvn     sdve     sdvu\n"
    )

    def make(first: int, count: int) -> dict[str, Any]:
        date, _, clock = np.char.partition(moments(first, 100_000_000), "T").T
        place = noise(first, (44.5, 11.3, 60.0), 1e-3)
        sigmas, rest = 0.01 + np.abs(noise(first + 1, (0, 0, 0))), noise(first + 2, (0,) * 11)
        numbers = {f"p{n}": values for n, values in enumerate(place.T)}
        numbers |= {"Q": np.ones(count, dtype=int), "ns": np.full(count, 12)}
        numbers |= {f"s{n}": values for n, values in enumerate([*sigmas.T, *rest.T[:8], *np.abs(rest.T[8:]) + 1e-3])}
        return {"date": np.char.replace(date, "-", "/"), "clock": clock, **numbers}

    append_rows(path, size, make, " ")


def write_kitti(path: Path, size: float) -> None:
    """Packets at 100 Hz, a file each, as in the folders "extract"."""
    data = path / "oxts" / "data"
    data.mkdir(parents=True)
    count = int(size / 300)
    moments = np.datetime64("2011-09-26T13:02:25", "ns") + np.arange(count) * np.timedelta64(10_000_000, "ns")
    (path / "oxts" / "timestamps.txt").write_text("\n".join(str(one).replace("T", " ") for one in moments) + "\n")
    felt = np.random.default_rng(0).normal(size=(count, 6))
    for at, values in enumerate(felt.round(12).tolist()):
        numbers = [49.0 + 1e-8 * at, 8.43, 112.8, 0.02, 0.01, 1.5, 0.1, 9.9, 9.9, 0.0, 0.0, *values[:3], *values[:3]]
        numbers += [*values[3:], *values[3:], 0.05, 0.01, 4, 10, 4, 4, 0]
        (data / f"{at:010d}.txt").write_text(" ".join(map(str, numbers)) + "\n")


def write_kf_gins(path: Path, size: float) -> None:
    """Increments of an IMU at 200 Hz."""

    def make(first: int, count: int) -> dict[str, Any]:
        moved = np.round(noise(first, (0, 0, 0, 0, 0, -9.8)) * 0.005, 9)
        columns = {"t": 100_000.0 + np.round((first + np.arange(count)) * 0.005, 3)}
        return columns | {f"c{n}": values for n, values in enumerate(moved.T)}

    append_rows(path, size, make, " ")


def write_nhtsa(path: Path, size: float) -> None:
    """Three accelerations of one place at 20 kHz."""
    sensors = "".join(
        f"1|{n}|AC|NA|FLLR|{axis}G|SEC|G'S|2800|MFG|12/APR/2017|800|21|57.09|-50|299|1000|AM|P|LEFT REAR {axis}\n"
        for n, axis in enumerate("XYZ", 1)
    )
    test = "V5|NCAP|OBJECTIVE|03/OCT/2017|MGA|CON|REF|NCA|VTB|CON|DRY|22|OTH|OTH|57.09|0|0|0|5|REMARK\n"
    path.write_text(f"----- EV5 -----\n----- TEST -----\n{test}----- INSTRUMENTATION -----\n{sensors}----- END -----\n")

    def make(first: int, count: int) -> dict[str, Any]:
        return {"t": np.round((first + np.arange(count)) * 5e-5, 6), "value": noise(first, (0,))[:, 0]}

    for number in (1, 2, 3):
        append_rows(path.with_suffix(f".{number:03d}"), size / 3, make, "\t")


def write_novatel(path: Path, size: float) -> None:
    """BESTPOSA and BESTVELA at 20 Hz."""
    with path.open("wb") as file:
        at = 0
        while file.tell() < size:
            file.write(b"".join(_best(row) for row in range(at, at + ROWS)))
            at += ROWS


def _best(row: int) -> bytes:
    place = f"{44.5 + row % 10**6 * 1e-8:.11f},{11.3 + row % 10**6 * 1e-8:.11f},{60.0 + row % 100 * 1e-3:.4f}"
    pos = f'SOL_COMPUTED,NARROW_INT,{place},40.0000,WGS84,0.0101,0.0202,0.0303,"AAAA",1.0,0.0,35,30,30,28,00,06,39,33'
    vel = f"SOL_COMPUTED,DOPPLER_VELOCITY,0.150,0.000,{row % 50:.4f},{row % 360:.6f},0.0000,0.0"
    week, tow_ms = divmod(row * 50, 604_800_000)
    head = f"COM1,0,65.0,FINESTEERING,{2000 + week},{tow_ms / 1000:.3f},02000020,cdba,16809"
    bodies = (f"BESTPOSA,{head};{pos}".encode(), f"BESTVELA,{head};{vel}".encode())
    return b"".join(b"#%s*%08x\r\n" % (body, zlib.crc32(body, 0xFFFFFFFF) ^ 0xFFFFFFFF) for body in bodies)


def write_sensor_logger(path: Path, size: float) -> None:
    """Accelerometer and gyroscope of an Android phone at 400 Hz, at times of their own."""
    path.mkdir()
    Path(path, "Metadata.csv").write_text("version,device name,platform\n3,a phone,android\n")
    for name, upwards, late_ns in (("TotalAcceleration", 9.8, 0), ("Gyroscope", 0.0, 1_000_000)):

        def make(first: int, count: int, upwards: float = upwards, late_ns: int = late_ns) -> dict[str, Any]:
            since_ns = (first + np.arange(count)) * 2_500_000 + late_ns
            values = noise(first, (upwards, 0, 0))
            columns = {"time": START_NS + since_ns, "seconds_elapsed": since_ns * 1e-9}
            return columns | dict(zip("zyx", values.T, strict=True))

        append_rows(Path(path, f"{name}.csv"), size / 2, make, titled=True)


def write_phyphox(path: Path, size: float) -> None:
    """Accelerometer and gyroscope at 200 Hz, at the same times."""
    path.mkdir()
    for name, unit, upwards in (("Acceleration", "m/s^2", 9.8), ("Gyroscope", "rad/s", 0.0)):

        def make(first: int, count: int, name: str = name, unit: str = unit, up: float = upwards) -> dict[str, Any]:
            values = noise(first, (0, 0, up))
            titles = (f"{name} {axis} ({unit})" for axis in "xyz")
            return {"Time (s)": (first + np.arange(count)) * 0.005, **dict(zip(titles, values.T, strict=True))}

        append_rows(Path(path, f"{name}.csv"), size / 2, make, titled=True)


def write_gnsslogger(path: Path, size: float) -> None:
    """Accelerometer and gyroscope at 100 Hz, in stretches."""
    clocks = "utcTimeMillis,elapsedRealtimeNanos"
    fixes = "# Fix,Provider,LatitudeDegrees,LongitudeDegrees,UnixTimeMillis\n"
    path.write_text(f"{fixes}# Accel,{clocks},AccelXMps2,AccelYMps2,AccelZMps2\n# Gyro,{clocks},GyroX,GyroY,GyroZ\n")
    import pyarrow as pa
    from pyarrow import csv

    form = csv.WriteOptions(include_header=False, quoting_style="none")
    with path.open("ab") as file:
        first = 0
        while file.tell() < size:
            for kind, up in (("Accel", 9.8), ("Gyro", 0.0)):
                since_ns = (first + np.arange(ROWS)) * 10_000_000
                columns = {"kind": np.full(ROWS, kind), "utc": START_NS // 10**6 + since_ns // 10**6, "own": since_ns}
                values = noise(first, (0, 0, up))
                csv.write_csv(pa.table({**columns, **dict(zip("xyz", values.T, strict=True))}), file, form)
            first += ROWS


def write_gpx(path: Path, size: float) -> None:
    """A point a second, with speed and course."""
    head = '<?xml version="1.0"?>\n<gpx version="1.0" xmlns="http://www.topografix.com/GPX/1/0"><trk><trkseg>\n'
    _write_points(
        path, size, head, "</trkseg></trk></gpx>\n",
        lambda at, time: (
            f'<trkpt lat="{44.5 + at % 10**6 * 1e-6:.9f}" lon="11.300000000"><ele>{60 + at % 100:.3f}</ele>'
            f"<time>{time}Z</time><course>{at % 360:.3f}</course><speed>{at % 40:.4f}</speed></trkpt>\n"
        ),
    )  # fmt: skip


def write_kml(path: Path, size: float) -> None:
    """Placemarks with a time each, a second apart."""
    head = '<?xml version="1.0"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document>\n'
    _write_points(
        path, size, head, "</Document></kml>\n",
        lambda at, time: (
            f"<Placemark><TimeStamp><when>{time}Z</when></TimeStamp><Point><altitudeMode>absolute</altitudeMode>"
            f"<coordinates>11.3,{44.5 + at % 10**6 * 1e-6:.9f},{60 + at % 100:.3f}</coordinates></Point></Placemark>\n"
        ),
    )  # fmt: skip


def _write_points(path: Path, size: float, head: str, end: str, point: Callable[[int, str], str]) -> None:
    with path.open("w") as file:
        file.write(head)
        for number, time in _seconds():
            file.write(point(number, time))
            if number % 10_000 == 0 and file.tell() > size:
                break
        file.write(end)


def _seconds() -> Iterator[tuple[int, str]]:
    first = 0
    while True:
        yield from enumerate(moments(first, 1_000_000_000).tolist(), first)
        first += ROWS
