"""What the stages read that are held to their contract: a file in each format, all in one folder."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Any

import autopilot_logs
import cv2
import measurement_logs
import numpy as np
import phone_logs
import pyarrow as pa
import ros_logs
from array_logs import navego_gnss, navego_imu, navego_ref, save_mat, segment
from fuzz import log_files

from recon.schema import FRAMES
from recon.tables import build, matrix, seconds, time_ns, vector, with_meta
from recon.testing import Case
from recon.testing.drives import drive
from recon.testing.samples import samples
from recon_integrators.visual_odometry import VisualOdometryParams

FOLDER = Path(tempfile.gettempdir()) / f"recon-contract-{os.getpid()}"
FULLINERTIAL, RECORDS = FOLDER / "fullinertial.txt", FOLDER / "gnss.json"
TABLE = FOLDER / "drive.csv"
INERTIAL, PARQUET, MCAP = (FOLDER / name for name in ("inertial.txt", "kept_parquet", "kept_mcap"))
BAGS = {form: FOLDER / ("drive.bag" if form == "bag" else f"bag_{form}") for form in ("bag", "sqlite3", "mcap")}
IMAGES, VIEWS = FOLDER / "images", FOLDER / "views"
FLIGHTS = {name: FOLDER / f"flight.{name}" for name in ("ulg", "bin", "tlog")}
MEASURED = FOLDER / "drive.mf4"
SEGMENT, NAVEGO = FOLDER / "comma2k19" / "40", FOLDER / "navego"
NMEA, UBX, VBO = (FOLDER / name for name in ("drive.nmea", "drive.ubx", "drive.vbo"))
GPX, KML, POS, SBET = (FOLDER / name for name in ("drive.gpx", "drive.kml", "drive.pos", "sbet.out"))
KF_GINS, KITTI, NHTSA = FOLDER / "kf_gins", FOLDER / "kitti", FOLDER / "nhtsa"
NOVATEL, PACKETS, GOPRO, GPMF = (FOLDER / name for name in ("logs.asc", "logs.pcap", "GX01.MP4", "payloads.raw"))
EDR = FOLDER / "edr.csv"
SENSOR_LOGGER, SENSOR_LOGGER_ZIP = FOLDER / "sensor_logger", FOLDER / "sensor_logger.zip"
PHYPHOX_TABLE = FOLDER / "phyphox.csv"
PHYPHOX, GNSS_LOGGER = FOLDER / "phyphox", FOLDER / "gnss_log.txt"
T0_S = 518_716_448.0
"""June 2016 in the clock of physycom, which counts from 2000."""
HEIGHTS = FOLDER / "heights.tif"
MAPPING = {
    "imu": {
        "time": {"column": "t", "format": "unix", "unit": "ms"},
        "accel": {"columns": ["ax", "ay", "az"], "unit": "m/s^2"},
        "gyro": {"columns": ["gx", "gy", "gz"], "unit": "rad/s"},
    }
}


def write_all() -> None:
    """Every file below FOLDER."""
    FOLDER.mkdir(exist_ok=True)  # the images of `pictures` are there
    samples(FOLDER)
    FULLINERTIAL.write_text(fullinertial(), encoding="utf-8")
    TABLE.write_text(table(), encoding="utf-8")
    RECORDS.write_text(json.dumps(records(), indent=1), encoding="utf-8")
    segment(SEGMENT)
    IMAGES.mkdir()
    for number in range(30):
        (IMAGES / f"{1_574_762_400_000 + 40 * number}.jpg").touch()
    names = sorted(path.name for path in IMAGES.iterdir())
    (IMAGES / "list.txt").write_text("".join(f"{Path(name).stem} {name}\n" for name in names), encoding="utf-8")
    makers = (autopilot_logs.ulog, autopilot_logs.dataflash, autopilot_logs.tlog)
    for path, make in zip(FLIGHTS.values(), makers, strict=True):
        path.write_bytes(make())
    measurement_logs.mf4(MEASURED)
    for form, path in BAGS.items():
        ros_logs.write(path, form)
    for name, fields in {"gnss": navego_gnss(), "imu": navego_imu(), "ref": navego_ref()}.items():
        save_mat(NAVEGO / f"{name}.mat", **{name: fields})
    for path, content in of_loggers().items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    log = phone_logs.logged()
    for folder, files in ((SENSOR_LOGGER, phone_logs.sensor_logger(log)), (PHYPHOX, phone_logs.phyphox(log))):
        for name, text in files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")
    SENSOR_LOGGER_ZIP.write_bytes(phone_logs.zipped(phone_logs.sensor_logger(log, "ios")))
    PHYPHOX_TABLE.write_text(phone_logs.phyphox(log)["Gyroscope.csv"], encoding="utf-8")
    heights_of_a_slope(HEIGHTS)
    GNSS_LOGGER.write_text(phone_logs.gnsslogger(log), encoding="utf-8")


def heights_of_a_slope(path: Path) -> None:
    """A map about the suite's drives, 200 m each way, that rises by 1 m for each of its cells."""
    import rasterio
    from rasterio.transform import from_origin

    heights = np.add.outer(np.arange(300.0), np.arange(300.0))
    place = from_origin(11.3426 - 0.015, 44.4949 + 0.015, 1e-4, 1e-4)
    with rasterio.open(
        path, "w", driver="GTiff", height=300, width=300, count=1, dtype="float64", crs="EPSG:4326", transform=place
    ) as file:
        file.write(heights, 1)


def of_loggers() -> dict[Path, bytes]:
    """Files in the formats of loggers."""
    return {
        NMEA: log_files.nmea(),
        UBX: log_files.ubx(),
        VBO: log_files.vbo(),
        GPX: log_files.gpx(),
        KML: log_files.kml(),
        POS: log_files.rtklib(),
        SBET: log_files.sbet(),
        EDR: b"Times (sec),Speed (km/h)\n-1,50\n0,48\n\nTime (msec),Delta-V longitudinal (km/h)\n0,0\n10,-2\n",
        **{KF_GINS / name: content for name, content in log_files.kf_gins().items()},
        **{KITTI / name: content for name, content in log_files.kitti().items()},
        **{NHTSA / name: content for name, content in log_files.nhtsa().items()},
        NOVATEL: log_files.novatel_ascii(50),
        PACKETS: log_files.novatel_packets(),
        GOPRO: log_files.mp4(log_files.gpmf_payloads(3)),
        GPMF: b"".join(log_files.gpmf_payloads(3)),
    }


def fullinertial(rows: int = 400) -> str:
    """GNSS held for 20 rows of the imu, as boxes write it."""
    imu, gnss = drive()["imu"].slice(1500, rows), drive()["gnss"].slice(75, rows // 20)
    held = np.arange(rows) // 20
    place = [vector(gnss, name)[held] for name in ("lat", "lon", "height")]
    course, speed = np.degrees(vector(gnss, "course"))[held], vector(gnss, "speed")[held] * 3.6
    accel, gyro, t_s = matrix(imu, "accel") / 9.80665, np.degrees(matrix(imu, "gyro")), seconds(imu)
    size = np.linalg.norm(accel, axis=1)
    values = np.column_stack([T0_S + t_s, *place, course, speed, accel, gyro, size, t_s])
    return "".join("\t".join(f"{value:.7f}" for value in row) + "\n" for row in values.tolist())


def table(rows: int = 400) -> str:
    """The imu as a table of commas, its time in ms since 1970."""
    imu = drive()["imu"].slice(1500, rows)
    columns = [time_ns(imu) // 1_000_000, *matrix(imu, "accel").T, *matrix(imu, "gyro").T]
    lines = [",".join(map(repr, row)) for row in zip(*(column.tolist() for column in columns), strict=True)]
    return "\n".join(["t,ax,ay,az,gx,gy,gz", *lines]) + "\n"


def records() -> dict[str, Any]:
    """One record per line of JSON and more."""
    gnss = drive()["gnss"].slice(75, 60)
    rows = zip(seconds(gnss), vector(gnss, "lat"), vector(gnss, "lon"), vector(gnss, "speed") * 3.6, strict=True)
    return {
        f"gnss_record_{number}": {"timestamp": T0_S + t_s, "lat": lat, "lon": lon, "speed": speed}
        for number, (t_s, lat, lon, speed) in enumerate(rows)
    }


def pictures() -> Case:
    """Four images of a wall that a camera comes nearer to, and how they are read."""
    VIEWS.mkdir(parents=True, exist_ok=True)
    wall = cv2.GaussianBlur(np.random.default_rng(1).uniform(0.0, 255.0, (240, 320)), (0, 0), 2.0)
    wall = cv2.normalize(wall, None, 0.0, 255.0, cv2.NORM_MINMAX)
    for number in range(4):
        nearer = cv2.getRotationMatrix2D((160.0, 120.0), 0.0, 1.0 + 0.02 * number)
        cv2.imwrite(str(VIEWS / f"{number}.png"), cv2.warpAffine(wall, nearer, (320, 240)).astype(np.uint8))
    frames = build(
        FRAMES,
        time=1_700_000_000_000_000_000 + 100_000_000 * np.arange(4),
        index=np.arange(4),
        file=pa.array([f"{number}.png" for number in range(4)]),
    )
    params = VisualOdometryParams(folder=str(VIEWS), focal=(260.0, 260.0), centre=(160.0, 120.0), mounting=(0.0,) * 3)
    return Case("wall", params, {"frames": with_meta(frames, time_scale="UTC", clock="absolute")})
