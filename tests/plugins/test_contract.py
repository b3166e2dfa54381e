"""Every first-party stage keeps the laws of its role."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import autopilot_logs
import cv2
import measurement_logs
import numpy as np
import phone_logs
import pyarrow as pa
import pytest
import read_back
import ros_logs
from array_logs import navego_gnss, navego_imu, navego_ref, save_mat, segment
from fuzz import log_files

from recon.pytest_plugin import MARK
from recon.registry import Registry
from recon.schema import ATTITUDE, FRAMES, IMU
from recon.stages import Exporter, Reader
from recon.tables import build, matrix, replace, seconds, time_ns, vector, with_meta
from recon.testing import BoundLaw, Case, contract
from recon.testing.drives import drive
from recon.testing.samples import samples
from recon.testing.serving import serve
from recon_exporters.blender import BlenderParams
from recon_exporters.plots import PlotsParams
from recon_filters.terrain import TerrainParams
from recon_integrators.visual_odometry import VisualOdometryParams
from recon_readers.csv import CsvParams
from recon_readers.mf4 import Mf4Params
from recon_readers.ubx import UbxParams
from recon_readers.vbox import VboxParams

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
FIRST_PARTY = [key for key in Registry.installed() if Registry.installed().source(key).distribution == "recon-dynamics"]
IN_ONE_FRAME = "filter.absolute_acceleration"
BY_A_MAP = "filter.terrain"
HEIGHTS = FOLDER / "heights.tif"
BY_THE_MAGNETIC_FIELD = ("integrator.madgwick", "integrator.mahony", "integrator.vqf")
BY_IMAGES = "integrator.visual_odometry"
OF_SEVERAL_BOXES = ("aligner.boxes", "fuser.virtual_imu")
OF_THEIR_OWN = (
    Reader.role, Exporter.role, IN_ONE_FRAME, BY_A_MAP, BY_IMAGES, *BY_THE_MAGNETIC_FIELD, *OF_SEVERAL_BOXES
)  # fmt: skip
WITHOUT_CASES = [key for key in FIRST_PARTY if not key.startswith(OF_THEIR_OWN)]

MAPPING = {
    "imu": {
        "time": {"column": "t", "format": "unix", "unit": "ms"},
        "accel": {"columns": ["ax", "ay", "az"], "unit": "m/s^2"},
        "gyro": {"columns": ["gx", "gy", "gz"], "unit": "rad/s"},
    }
}


@pytest.fixture(scope="module", autouse=True)
def files() -> Iterator[None]:
    """What the readers read."""
    FOLDER.mkdir(exist_ok=True)  # the images are there
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
    for path, content in logs().items():
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
    yield
    shutil.rmtree(FOLDER)


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


def logs() -> dict[Path, bytes]:
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


def few_columns() -> dict[str, pa.Table]:
    """Of what a slow exporter draws: the laws run it for each column."""
    trajectory = drive()["trajectory"].slice(0, 200)
    return {
        "trajectory": trajectory.select([n for n in trajectory.column_names if n[:4] in ("time", "pos_", "vel_")][:7]),
        "gnss": drive()["gnss"].select(["time", "speed"]),
        "events": drive()["events"],
    }


@contract(*WITHOUT_CASES)
def test_stages(law: BoundLaw) -> None:
    law()


def two_boxes() -> dict[str, pa.Table]:
    """A second box on the same drive, turned."""
    imu = drive()["imu"].slice(0, 4500)
    turned = {group: matrix(imu, group)[:, [1, 2, 0]] for group in ("accel", "gyro")}
    return {"imu": imu, "imu_2": replace(imu, **turned)}


@contract(*OF_SEVERAL_BOXES, cases=[Case("two", streams=two_boxes())])
def test_several_boxes(law: BoundLaw) -> None:
    law()


def in_vehicle_axes() -> dict[str, pa.Table]:
    """imu along the axes of the body whose attitude is given."""
    return serve(drive(), {"imu": IMU.need("accel", frame="vehicle"), "attitude": ATTITUDE.need("q")})


@contract(BY_A_MAP, cases=[Case(params=TerrainParams(raster=str(HEIGHTS)))])
def test_terrain(law: BoundLaw) -> None:
    law()


@contract(IN_ONE_FRAME, cases=[Case(streams=in_vehicle_axes())])
def test_of_one_frame(law: BoundLaw) -> None:
    law()


@contract(
    *BY_THE_MAGNETIC_FIELD,
    expected_failures={"shifting_all_times_shifts_the_result": "the Earth's field changes with the date"},
)
def test_attitude_filters(law: BoundLaw) -> None:
    law()


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


@contract(BY_IMAGES, cases=[pictures()])
def test_visual_odometry(law: BoundLaw) -> None:
    law()


@contract(
    "reader.physycom",
    cases=[
        Case("inertial", path=INERTIAL),
        Case("fullinertial", path=FULLINERTIAL),
        Case("json", path=RECORDS),
    ],
)
def test_reader_physycom(law: BoundLaw) -> None:
    law()


@contract(
    "reader.parquet", cases=[Case("folder", path=PARQUET), Case("file", path=PARQUET / "streams" / "gnss.parquet")]
)
def test_reader_parquet(law: BoundLaw) -> None:
    law()


@contract(
    "reader.mcap",
    cases=[
        Case("folder", path=MCAP),
        Case("file", path=MCAP / "streams.mcap"),
        Case("ros2", path=BAGS["mcap"] / "bag_mcap.mcap"),
    ],
)
def test_reader_mcap(law: BoundLaw) -> None:
    law()


@contract("reader.mf4", cases=[Case("mapped", Mf4Params(channels=measurement_logs.CHANNELS), path=MEASURED)])
def test_reader_mf4(law: BoundLaw) -> None:
    law()


@contract("reader.ulog", cases=[Case(path=FLIGHTS["ulg"])])
def test_reader_ulog(law: BoundLaw) -> None:
    law()


@contract("reader.ardupilot", cases=[Case("bin", path=FLIGHTS["bin"]), Case("tlog", path=FLIGHTS["tlog"])])
def test_reader_ardupilot(law: BoundLaw) -> None:
    law()


@contract("reader.rosbag", cases=[Case(form, path=path) for form, path in BAGS.items()])
def test_reader_rosbag(law: BoundLaw) -> None:
    law()


@contract(
    "reader.csv",
    cases=[Case("held", CsvParams(columns=MAPPING), path=TABLE)],
    expected_failures={"it_knows_its_own_file": "what the columns of a table mean, only its mapping tells"},
)
def test_reader_csv(law: BoundLaw) -> None:
    law()


@contract("reader.comma2k19", cases=[Case("segment", path=SEGMENT), Case("folder", path=SEGMENT.parent)])
def test_reader_comma2k19(law: BoundLaw) -> None:
    law()


@contract("reader.frames", cases=[Case("folder", path=IMAGES), Case("list", path=IMAGES / "list.txt")])
def test_reader_frames(law: BoundLaw) -> None:
    law()


@contract("reader.navego", cases=[Case("folder", path=NAVEGO), Case("file", path=NAVEGO / "gnss.mat")])
def test_reader_navego(law: BoundLaw) -> None:
    law()


@contract("reader.nmea", cases=[Case(path=NMEA)])
def test_reader_nmea(law: BoundLaw) -> None:
    law()


@contract("reader.ubx", cases=[Case("gnss", path=UBX), Case("imu", UbxParams(at_rest="up"), path=UBX)])
def test_reader_ubx(law: BoundLaw) -> None:
    law()


@contract("reader.vbox", cases=[Case("gnss", path=VBO), Case("imu", VboxParams(axes="FLU"), path=VBO)])
def test_reader_vbox(law: BoundLaw) -> None:
    law()


@contract("reader.gpx", cases=[Case(path=GPX)])
def test_reader_gpx(law: BoundLaw) -> None:
    law()


@contract("reader.kml", cases=[Case(path=KML)])
def test_reader_kml(law: BoundLaw) -> None:
    law()


@contract("reader.rtklib", cases=[Case(path=POS)])
def test_reader_rtklib(law: BoundLaw) -> None:
    law()


@contract("reader.sbet", cases=[Case(path=SBET)])
def test_reader_sbet(law: BoundLaw) -> None:
    law()


@contract(
    "reader.kf_gins",
    cases=[Case("folder", path=KF_GINS), *(Case(name, path=KF_GINS / name) for name in log_files.kf_gins())],
)
def test_reader_kf_gins(law: BoundLaw) -> None:
    law()


@contract("reader.edr_csv", cases=[Case(path=EDR)])
def test_edr_csv(law: BoundLaw) -> None:
    law()


@contract("reader.kitti", cases=[Case(path=KITTI)])
def test_reader_kitti(law: BoundLaw) -> None:
    law()


@contract("reader.novatel", cases=[Case("ascii", path=NOVATEL), Case("packets", path=PACKETS)])
def test_reader_novatel(law: BoundLaw) -> None:
    law()


@contract("reader.nhtsa", cases=[Case("folder", path=NHTSA), Case("channel", path=NHTSA / "v1.EV5")])
def test_reader_nhtsa(law: BoundLaw) -> None:
    law()


@contract("reader.gpmf", cases=[Case("video", path=GOPRO), Case("raw", path=GPMF)])
def test_reader_gpmf(law: BoundLaw) -> None:
    law()


@contract("reader.sensor_logger", cases=[Case("folder", path=SENSOR_LOGGER), Case("zip", path=SENSOR_LOGGER_ZIP)])
def test_reader_sensor_logger(law: BoundLaw) -> None:
    law()


@contract("reader.phyphox", cases=[Case("folder", path=PHYPHOX), Case("table", path=PHYPHOX_TABLE)])
def test_reader_phyphox(law: BoundLaw) -> None:
    law()


@contract("reader.gnsslogger", cases=[Case("text", path=GNSS_LOGGER)])
def test_reader_gnsslogger(law: BoundLaw) -> None:
    law()


@contract("reader.auto", cases=[Case("text", path=INERTIAL), Case("folder", path=PARQUET)])
def test_reader_auto(law: BoundLaw) -> None:
    law()


@contract("exporter.blender", cases=[Case(params=BlenderParams(blender="none"), read_back=read_back.blender)])
def test_exporter_blender(law: BoundLaw) -> None:
    law()


@contract("exporter.csv", cases=[Case(read_back=read_back.csv)])
def test_exporter_csv(law: BoundLaw) -> None:
    law()


@contract("exporter.tum", cases=[Case(read_back=read_back.tum)])
def test_exporter_tum(law: BoundLaw) -> None:
    law()


@contract("exporter.kitti", cases=[Case(read_back=read_back.kitti)])
def test_exporter_kitti(law: BoundLaw) -> None:
    law()


@contract("exporter.gpx", cases=[Case(read_back=read_back.gpx)])
def test_exporter_gpx(law: BoundLaw) -> None:
    law()


@contract("exporter.kml", cases=[Case(read_back=read_back.kml)])
def test_exporter_kml(law: BoundLaw) -> None:
    law()


@contract("exporter.geojson", cases=[Case(read_back=read_back.geojson)])
def test_exporter_geojson(law: BoundLaw) -> None:
    law()


@contract("exporter.mcap", cases=[Case(read_back=read_back.mcap)])
def test_exporter_mcap(law: BoundLaw) -> None:
    law()


@contract("exporter.sbet", cases=[Case(read_back=read_back.sbet)])
def test_exporter_sbet(law: BoundLaw) -> None:
    law()


@contract("exporter.hdf5", cases=[Case(read_back=read_back.hdf5)])
def test_exporter_hdf5(law: BoundLaw) -> None:
    law()


RERUN_IDS = "Rerun's SDK numbers a file by clock and chance, and lets no one tell it not to; a test compares the rest"


@contract(
    "exporter.rerun",
    cases=[Case(read_back=read_back.rerun)],
    expected_failures=dict.fromkeys(
        ("same_input_twice_gives_same_output", "same_for_any_chunking", "same_after_parquet", "same_after_mcap"),
        RERUN_IDS,
    ),
)
def test_exporter_rerun(law: BoundLaw) -> None:
    law()


@contract("exporter.map", cases=[Case(read_back=read_back.street_map)])
def test_exporter_map(law: BoundLaw) -> None:
    law()


@contract("exporter.report", cases=[Case(read_back=read_back.report)])
def test_exporter_report(law: BoundLaw) -> None:
    law()


@contract(
    "exporter.plots",
    cases=[Case("small", PlotsParams(dots_per_inch=50), streams=few_columns())],
    expected_failures={"files_read_back_to_the_same_numbers": "a picture; its curves have a test of their own"},
)
def test_exporter_plots(law: BoundLaw) -> None:
    law()


def test_no_stage_is_left_out() -> None:
    contracts = [getattr(test, MARK, None) for test in globals().values()]
    held = [name for contract in contracts if contract is not None for name in contract.names]
    assert sorted(held) == sorted(FIRST_PARTY)
