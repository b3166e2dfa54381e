"""What apps of phones write of a drive whose truth is known: Sensor Logger, phyphox, GnssLogger."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.tables import matrix, time_ns, vector
from recon.testing.drives import drive

START_NS = 1_700_000_000_000_000_000


class Logged(NamedTuple):
    """What the sensors of a phone felt: times (n,) ns and values in SI; gyroscopes 3 ms after accelerometers."""

    t_ns: np.ndarray
    accel: np.ndarray
    gyro_ns: np.ndarray
    gyro: np.ndarray
    mag_ns: np.ndarray
    mag: np.ndarray
    fix_ns: np.ndarray
    fix: dict[str, np.ndarray]


@cache
def logged(rows: int = 400, apart_ns: int = 3_000_000) -> Logged:
    """Some seconds of the drive of recon.testing."""
    streams = drive()
    imu, mag, gnss = streams["imu"].slice(1500, rows), streams["mag"].slice(150, rows // 10), streams["gnss"]
    gnss = gnss.slice(75, max(rows // 20, 1))
    fix = {name: vector(gnss, name) for name in ("lat", "lon", "height", "speed", "course")}
    t_ns = time_ns(imu)
    return Logged(
        t_ns, matrix(imu, "accel"), t_ns + apart_ns, matrix(imu, "gyro"), time_ns(mag), matrix(mag, "mag"),
        time_ns(gnss), fix,
    )  # fmt: skip


def table(names: Sequence[str], columns: Sequence[Sequence[str]], separator: str = ",") -> str:
    """Delimited text with a header."""
    return "\n".join([separator.join(names), *map(separator.join, zip(*columns, strict=True)), ""])


def texts(values: np.ndarray, form: str = ".9f") -> list[str]:
    """Numbers as text."""
    return [f"{value:{form}}" for value in values.tolist()]


# --- Sensor Logger ----------------------------------------------------------------------------------------------------


def sensor_logger(log: Logged, platform: str = "android", *, total: bool = True) -> dict[str, str]:
    """The files of a recording by name. total : with TotalAcceleration.csv, else with Gravity.csv alone."""
    sign = -1.0 if platform == "ios" else 1.0
    gravity = np.tile([0.3, 0.2, 9.8], (len(log.t_ns), 1))
    fix = log.fix
    place = {
        "bearingAccuracy": np.full(len(log.fix_ns), 5.0), "speedAccuracy": np.full(len(log.fix_ns), 0.4),
        "verticalAccuracy": np.full(len(log.fix_ns), 3.0), "horizontalAccuracy": np.full(len(log.fix_ns), 4.545),
        "speed": fix["speed"], "bearing": np.degrees(fix["course"]), "altitude": fix["height"],
        "longitude": fix["lon"], "latitude": fix["lat"],
    }  # fmt: skip
    files = {
        "Metadata.csv": f"version,device name,platform\n3,a phone,{platform}\n",
        "Accelerometer.csv": _logger(log.t_ns, sign * (log.accel - gravity)),
        "Gravity.csv": _logger(log.t_ns, sign * gravity),
        "Gyroscope.csv": _logger(log.gyro_ns, log.gyro),
        "Magnetometer.csv": _logger(log.mag_ns, 1e6 * log.mag),
        "Barometer.csv": table(
            ("time", "seconds_elapsed", "relativeAltitude", "pressure"),
            (texts(log.mag_ns, "d"), texts((log.mag_ns - START_NS) * 1e-9), *([["0"] * len(log.mag)]),
             texts(np.full(len(log.mag), 1007.25))),
        ),
        "Location.csv": table(
            ("time", "seconds_elapsed", *place),
            (texts(log.fix_ns, "d"), texts((log.fix_ns - START_NS) * 1e-9), *map(texts, place.values())),
        ),
    }  # fmt: skip
    if total:
        files["TotalAcceleration.csv"] = _logger(log.t_ns, sign * log.accel)
    return files


def _logger(t_ns: np.ndarray, values: np.ndarray) -> str:
    columns = [texts(t_ns, "d"), texts((t_ns - START_NS) * 1e-9), *(texts(column) for column in values.T[::-1])]
    return table(("time", "seconds_elapsed", "z", "y", "x"), columns)


def uncalibrated_ios(log: Logged) -> str:
    """AccelerometerUncalibrated.csv of an iPhone: in g, at rest -1 upwards."""
    return _logger(log.t_ns, -log.accel / STANDARD_GRAVITY)


# --- phyphox ----------------------------------------------------------------------------------------------------------


def phyphox(log: Logged, separator: str = ",", decimal: str = ".", *, named: bool = True) -> dict[str, str]:
    """The files of a recording by name, its clock paused for 100 s. named : "Acceleration x", else "X"."""
    start = int(log.t_ns[0]) - 500_000_000
    halfway = (int(log.t_ns[-1]) - start) * 0.5e-9

    def since(t_ns: np.ndarray) -> np.ndarray:
        return (t_ns - start) * 1e-9

    def sheet(name: str, unit: str, t_ns: np.ndarray, values: np.ndarray) -> str:
        axes = [f'"{name} {axis} ({unit})"' if named else f'"{axis.upper()} ({unit})"' for axis in "xyz"]
        columns = [texts(since(t_ns), ".12E"), *(texts(column, ".9E") for column in values.T)]
        return table(
            ['"Time (s)"', *axes], [[c.replace(".", decimal) for c in column] for column in columns], separator
        )

    titles = ("Time (s)", "Latitude (°)", "Longitude (°)", "Height (m)", "Velocity (m/s)", "Direction (°)")
    titles = (*titles, "Horizontal Accuracy (m)", "Vertical Accuracy (m)")
    fix = [*(log.fix[name] for name in ("lat", "lon", "height", "speed")), np.degrees(log.fix["course"])]
    fix += [np.full(len(log.fix_ns), 4.545), np.full(len(log.fix_ns), 3.0)]
    place = [texts(since(log.fix_ns), ".12E"), *(texts(column, ".12E") for column in fix)]
    times = table(
        ('"event"', '"experiment time"', '"system time"', '"system time text"'),
        [
            ['"START"', '"PAUSE"', '"START"', '"PAUSE"'],
            [f"{at:.12E}".replace(".", decimal) for at in (0.0, halfway, halfway, 2.0 * halfway)],
            [f"{at:.15E}".replace(".", decimal) for at in _system_times(start, halfway)],
            ['"x"'] * 4,
        ],
        separator,
    )
    return {
        "Accelerometer.csv": sheet("Acceleration", "m/s^2", log.t_ns, log.accel),
        "Gyroscope.csv": sheet("Gyroscope", "rad/s", log.gyro_ns, log.gyro),
        "Magnetometer.csv": sheet("Magnetic Field", "µT", log.mag_ns, 1e6 * log.mag),
        "Location.csv": table(
            [f'"{title}"' for title in titles],
            [[c.replace(".", decimal) for c in column] for column in place],
            separator,
        ),
        "meta/time.csv": times,
    }


def _system_times(start_ns: int, halfway_s: float) -> list[float]:
    first, again = start_ns * 1e-9, start_ns * 1e-9 + halfway_s + 100.0
    return [first, first + halfway_s, again, again + halfway_s]


# --- GnssLogger -------------------------------------------------------------------------------------------------------

_KINDS = {"Accel": "Mps2", "Gyro": "RadPerSec", "Mag": "MicroT"}


def gnsslogger(log: Logged, *, corrected: bool = True) -> str:
    """The text of a log; the phone was switched on 1000 s before."""
    boot = int(log.t_ns[0]) - 1_000_000_000_000
    lines = ["# ", "# Header Description:", "# ", "# Version: v3.0.6.4 Platform: 14 Manufacturer: a Model: phone", "# "]
    rows: list[tuple[int, str]] = []
    for name, t_ns, values in (
        ("Accel", log.t_ns, log.accel), ("Gyro", log.gyro_ns, log.gyro), ("Mag", log.mag_ns, 1e6 * log.mag)
    ):  # fmt: skip
        kind = name if corrected else f"Uncal{name}"
        axes = ",".join(f"{kind}{axis}{_KINDS[name]}" for axis in "XYZ")
        drift = "" if corrected else "," + ",".join(f"Bias{axis}{_KINDS[name]}" for axis in "XYZ")
        lines += [f"# {kind},utcTimeMillis,elapsedRealtimeNanos,{axes}{drift}", "# "]
        for at, value in zip(t_ns.tolist(), values.tolist(), strict=True):
            shown = value if corrected else [v + 0.5 for v in value]
            biases = "" if corrected else ",0.5,0.5,0.5"
            text = f"{kind},{at // 1_000_000},{at - boot},{','.join(f'{v:.9f}' for v in shown)}{biases}"
            rows.append((at, text))
    lines += [
        "# Fix,Provider,LatitudeDegrees,LongitudeDegrees,AltitudeMeters,SpeedMps,AccuracyMeters,BearingDegrees,"
        "UnixTimeMillis,SpeedAccuracyMps,BearingAccuracyDegrees,elapsedRealtimeNanos,VerticalAccuracyMeters",
        "# ",
    ]
    for index, at in enumerate(log.fix_ns.tolist()):
        lat, lon, height, speed, course = (log.fix[n][index] for n in ("lat", "lon", "height", "speed", "course"))
        place = f"{lat:.10f},{lon:.10f},{height:.6f},{speed:.6f},4.545,{np.degrees(course):.6f}"
        rows.append((at, f"Fix,GPS,{place},{at // 1_000_000},0.4,5.0,{at - boot},3.0"))
        rows.append((at, f"Fix,NLP,{lat + 0.01:.7f},{lon:.7f},,,250.0,,{at // 1_000_000},,,{at - boot},"))
        rows.append((at, "Raw,1,2,,,3"))
    return "\n".join([*lines, *(text for _, text in sorted(rows)), ""])


def zipped(files: Mapping[str, str], folder: str = "") -> bytes:
    """A zip of the files, inside a folder where one is named."""
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(zipfile.ZipInfo(f"{folder}/{name}" if folder else name), text)
    return sink.getvalue()
