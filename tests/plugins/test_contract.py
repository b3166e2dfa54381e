"""Every first-party stage keeps the laws of its role."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

import contract_logs as logs
import measurement_logs
import pyarrow as pa
import pytest
import read_back
from fuzz import log_files

from recon.pytest_plugin import MARK
from recon.registry import Registry
from recon.schema import ATTITUDE, IMU
from recon.stages import Exporter, Reader
from recon.tables import matrix, replace
from recon.testing import BoundLaw, Case, contract
from recon.testing.drives import drive
from recon.testing.serving import serve
from recon_exporters.blender import BlenderParams
from recon_exporters.plots import PlotsParams
from recon_filters.terrain import TerrainParams
from recon_readers.csv import CsvParams
from recon_readers.mf4 import Mf4Params
from recon_readers.ubx import UbxParams
from recon_readers.vbox import VboxParams

FIRST_PARTY = [key for key in Registry.installed() if Registry.installed().source(key).distribution == "recon-dynamics"]
IN_ONE_FRAME = "filter.absolute_acceleration"
BY_A_MAP = "filter.terrain"
BY_THE_MAGNETIC_FIELD = ("integrator.madgwick", "integrator.mahony", "integrator.vqf")
BY_IMAGES = "integrator.visual_odometry"
OF_SEVERAL_BOXES = ("aligner.boxes", "fuser.virtual_imu")
OF_THEIR_OWN = (
    Reader.role, Exporter.role, IN_ONE_FRAME, BY_A_MAP, BY_IMAGES, *BY_THE_MAGNETIC_FIELD, *OF_SEVERAL_BOXES
)  # fmt: skip
WITHOUT_CASES = [key for key in FIRST_PARTY if not key.startswith(OF_THEIR_OWN)]


@pytest.fixture(scope="module", autouse=True)
def files() -> Iterator[None]:
    """What the readers read."""
    logs.write_all()
    yield
    shutil.rmtree(logs.FOLDER)


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


@contract(BY_A_MAP, cases=[Case(params=TerrainParams(raster=str(logs.HEIGHTS)))])
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


@contract(BY_IMAGES, cases=[logs.pictures()])
def test_visual_odometry(law: BoundLaw) -> None:
    law()


@contract(
    "reader.physycom",
    cases=[
        Case("inertial", path=logs.INERTIAL),
        Case("fullinertial", path=logs.FULLINERTIAL),
        Case("json", path=logs.RECORDS),
    ],
)
def test_reader_physycom(law: BoundLaw) -> None:
    law()


@contract(
    "reader.parquet",
    cases=[Case("folder", path=logs.PARQUET), Case("file", path=logs.PARQUET / "streams" / "gnss.parquet")],
)
def test_reader_parquet(law: BoundLaw) -> None:
    law()


@contract(
    "reader.mcap",
    cases=[
        Case("folder", path=logs.MCAP),
        Case("file", path=logs.MCAP / "streams.mcap"),
        Case("ros2", path=logs.BAGS["mcap"] / "bag_mcap.mcap"),
    ],
)
def test_reader_mcap(law: BoundLaw) -> None:
    law()


@contract("reader.mf4", cases=[Case("mapped", Mf4Params(channels=measurement_logs.CHANNELS), path=logs.MEASURED)])
def test_reader_mf4(law: BoundLaw) -> None:
    law()


@contract("reader.ulog", cases=[Case(path=logs.FLIGHTS["ulg"])])
def test_reader_ulog(law: BoundLaw) -> None:
    law()


@contract("reader.ardupilot", cases=[Case("bin", path=logs.FLIGHTS["bin"]), Case("tlog", path=logs.FLIGHTS["tlog"])])
def test_reader_ardupilot(law: BoundLaw) -> None:
    law()


@contract("reader.rosbag", cases=[Case(form, path=path) for form, path in logs.BAGS.items()])
def test_reader_rosbag(law: BoundLaw) -> None:
    law()


@contract(
    "reader.csv",
    cases=[Case("held", CsvParams(columns=logs.MAPPING), path=logs.TABLE)],
    expected_failures={"it_knows_its_own_file": "what the columns of a table mean, only its mapping tells"},
)
def test_reader_csv(law: BoundLaw) -> None:
    law()


@contract("reader.comma2k19", cases=[Case("segment", path=logs.SEGMENT), Case("folder", path=logs.SEGMENT.parent)])
def test_reader_comma2k19(law: BoundLaw) -> None:
    law()


@contract("reader.frames", cases=[Case("folder", path=logs.IMAGES), Case("list", path=logs.IMAGES / "list.txt")])
def test_reader_frames(law: BoundLaw) -> None:
    law()


@contract("reader.navego", cases=[Case("folder", path=logs.NAVEGO), Case("file", path=logs.NAVEGO / "gnss.mat")])
def test_reader_navego(law: BoundLaw) -> None:
    law()


@contract("reader.nmea", cases=[Case(path=logs.NMEA)])
def test_reader_nmea(law: BoundLaw) -> None:
    law()


@contract("reader.ubx", cases=[Case("gnss", path=logs.UBX), Case("imu", UbxParams(at_rest="up"), path=logs.UBX)])
def test_reader_ubx(law: BoundLaw) -> None:
    law()


@contract("reader.vbox", cases=[Case("gnss", path=logs.VBO), Case("imu", VboxParams(axes="FLU"), path=logs.VBO)])
def test_reader_vbox(law: BoundLaw) -> None:
    law()


@contract("reader.gpx", cases=[Case(path=logs.GPX)])
def test_reader_gpx(law: BoundLaw) -> None:
    law()


@contract("reader.kml", cases=[Case(path=logs.KML)])
def test_reader_kml(law: BoundLaw) -> None:
    law()


@contract("reader.rtklib", cases=[Case(path=logs.POS)])
def test_reader_rtklib(law: BoundLaw) -> None:
    law()


@contract("reader.sbet", cases=[Case(path=logs.SBET)])
def test_reader_sbet(law: BoundLaw) -> None:
    law()


@contract(
    "reader.kf_gins",
    cases=[Case("folder", path=logs.KF_GINS), *(Case(name, path=logs.KF_GINS / name) for name in log_files.kf_gins())],
)
def test_reader_kf_gins(law: BoundLaw) -> None:
    law()


@contract("reader.edr_csv", cases=[Case(path=logs.EDR)])
def test_edr_csv(law: BoundLaw) -> None:
    law()


@contract("reader.kitti", cases=[Case(path=logs.KITTI)])
def test_reader_kitti(law: BoundLaw) -> None:
    law()


@contract("reader.novatel", cases=[Case("ascii", path=logs.NOVATEL), Case("packets", path=logs.PACKETS)])
def test_reader_novatel(law: BoundLaw) -> None:
    law()


@contract("reader.nhtsa", cases=[Case("folder", path=logs.NHTSA), Case("channel", path=logs.NHTSA / "v1.EV5")])
def test_reader_nhtsa(law: BoundLaw) -> None:
    law()


@contract("reader.gpmf", cases=[Case("video", path=logs.GOPRO), Case("raw", path=logs.GPMF)])
def test_reader_gpmf(law: BoundLaw) -> None:
    law()


@contract(
    "reader.sensor_logger", cases=[Case("folder", path=logs.SENSOR_LOGGER), Case("zip", path=logs.SENSOR_LOGGER_ZIP)]
)
def test_reader_sensor_logger(law: BoundLaw) -> None:
    law()


@contract("reader.phyphox", cases=[Case("folder", path=logs.PHYPHOX), Case("table", path=logs.PHYPHOX_TABLE)])
def test_reader_phyphox(law: BoundLaw) -> None:
    law()


@contract("reader.gnsslogger", cases=[Case("text", path=logs.GNSS_LOGGER)])
def test_reader_gnsslogger(law: BoundLaw) -> None:
    law()


@contract("reader.auto", cases=[Case("text", path=logs.INERTIAL), Case("folder", path=logs.PARQUET)])
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
