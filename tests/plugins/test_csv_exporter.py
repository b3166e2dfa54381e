"""exporter.csv: numbers read back to the last bit, times to the nanosecond, angles as people use them."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pydantic import ValidationError

from recon.errors import DataError
from recon.numerics.rotation import from_euler
from recon.rows import Event, events
from recon.schema import ATTITUDE, IMU, KNOTS, TRAJECTORY
from recon.tables import build
from recon_exporters import csv as module
from recon_exporters.csv import CsvParams

START_NS = 1_501_762_930_123_456_789


def export(folder: Path, tables: dict[str, pa.Table], **params: object) -> list[Path]:
    return module.csv(streams=tables, folder=folder, about=None, params=CsvParams(**params))


def rows_of(path: Path, delimiter: str = ",") -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(path.read_text(encoding="utf-8"), newline=""), delimiter=delimiter))


def attitude(yaw: list[float], pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    return from_euler(np.radians(yaw), np.radians(pitch), np.radians(roll))


def imu(rows: int) -> pa.Table:
    rng = np.random.default_rng(1)
    accel = rng.integers(0, 2**63, size=(rows, 3), dtype=np.int64).view(np.float64)
    accel[~np.isfinite(accel)] = 0.1
    return build(IMU, time=START_NS + np.arange(rows) * 10_000_000, accel=accel, gyro=-accel)


def test_the_record_keeps_the_rules_of_its_role() -> None:
    (record,) = module.declare_exporters()
    assert record.faults() == []
    assert record.every_stream


def test_numbers_of_any_size_read_back_to_the_same_double(tmp_path: Path) -> None:
    """Random bits make doubles of every exponent; 200 000 rows are more than three blocks, so their order is seen."""
    table = imu(200_000)
    (path,) = export(tmp_path, {"imu": table})
    rows = rows_of(path)
    for name, unit in (("accel_x", "m/s^2"), ("gyro_z", "rad/s")):
        read = np.array([float(row[f"{name} [{unit}]"]) for row in rows])
        assert np.array_equal(read.view(np.int64), table[name].to_numpy().view(np.int64))


def test_header_names_columns_and_units(tmp_path: Path) -> None:
    (path,) = export(tmp_path, {"imu": imu(1)})
    assert path == tmp_path / "imu.csv"
    header = path.read_bytes().split(b"\n")[0].decode()
    assert header == (
        "time,t_s,accel_x [m/s^2],accel_y [m/s^2],accel_z [m/s^2],gyro_x [rad/s],gyro_y [rad/s],gyro_z [rad/s]"
    )


def test_times_are_iso_8601_with_all_nanoseconds(tmp_path: Path) -> None:
    (path,) = export(tmp_path, {"imu": imu(2)})
    assert [row["time"] for row in rows_of(path)] == [
        "2017-08-03T12:22:10.123456789Z",
        "2017-08-03T12:22:10.133456789Z",
    ]


def test_seconds_count_from_the_first_time_of_the_recording_whatever_is_chosen(tmp_path: Path) -> None:
    late = build(ATTITUDE, time=START_NS + np.array([300_000_000, 1_000_000_001]), q=attitude([0.0, 0.0]))
    (path,) = export(tmp_path, {"imu": imu(2), "attitude": late}, streams=("attitude",))
    assert [row["t_s"] for row in rows_of(path)] == ["0.3", "1.000000001"]


def test_a_missing_value_is_an_empty_field(tmp_path: Path) -> None:
    gyro = np.array([[np.nan, 1.0, 2.0]])
    (path,) = export(tmp_path, {"imu": build(IMU, time=np.array([0]), accel=np.zeros((1, 3)), gyro=gyro)})
    assert path.read_text().splitlines()[1] == '"1970-01-01T00:00:00.000000000Z",0,0,0,0,,1,2'


def test_trajectories_have_euler_angles_and_heading(tmp_path: Path) -> None:
    """Doubles hold half-angle sines to 1.1e-16: 1e-12 deg is a hundred roundings."""
    q = attitude([0.0, 90.0, -90.0, 180.0, 30.0], pitch=10.0, roll=-20.0)
    q[4] = np.nan
    table = build(TRAJECTORY, time=np.arange(5), q=q)
    (path,) = export(tmp_path, {"trajectory": table})
    *rows, empty = rows_of(path)
    expected = {"yaw": [0, 90, -90, 180], "heading": [90, 0, 180, 270], "pitch": [10] * 4, "roll": [-20] * 4}
    for name, angles in expected.items():
        off = np.array([float(row[f"{name} [deg]"]) for row in rows]) - angles
        assert np.abs((off + 180.0) % 360.0 - 180.0).max() < 1e-12
    assert [empty[f"{name} [deg]"] for name in expected] == ["", "", "", ""]


def test_attitude_has_no_heading_since_its_north_is_not_known(tmp_path: Path) -> None:
    (path,) = export(tmp_path, {"attitude": build(ATTITUDE, time=np.arange(1), q=attitude([10.0]))})
    assert list(rows_of(path)[0])[-3:] == ["roll [deg]", "pitch [deg]", "yaw [deg]"]


@pytest.mark.parametrize(("name", "mark"), [("comma", ","), ("semicolon", ";"), ("tab", "\t")])
def test_text_with_delimiters_quotes_and_breaks_survives(tmp_path: Path, name: str, mark: str) -> None:
    note = f'he said "1{mark}5"\nand left: naïve'
    (path,) = export(tmp_path, {"events": events([Event(1, 2, "crash", note=note)])}, delimiter=name)
    (row,) = rows_of(path, mark)
    assert row["note"] == note
    assert (row["time"][-11:], row["end_time"][-11:]) == (".000000001Z", ".000000002Z")


def test_every_stream_is_written_unless_some_are_chosen(tmp_path: Path) -> None:
    streams = {"imu": imu(1), "imu_2": imu(1), "events": events([])}
    assert [path.name for path in export(tmp_path, streams)] == ["imu.csv", "imu_2.csv", "events.csv"]
    assert [path.name for path in export(tmp_path, streams, streams=["imu_2"])] == ["imu_2.csv"]


def test_columns_of_lists_are_left_out(tmp_path: Path) -> None:
    table = build(KNOTS, time=np.array([START_NS]), chain=pa.array([[1.0, 2.0]]), accel_noise=np.array([0.25]))
    (row,) = rows_of(export(tmp_path, {"knots": table})[0])
    assert row["accel_noise [m/s^1.5]"] == "0.25"
    assert not {"root", "chain", "shared"} & set(row)


def test_a_stream_without_rows_is_a_header(tmp_path: Path) -> None:
    (path,) = export(tmp_path, {"events": events([])})
    assert path.read_text() == "time,t_s,end_time,kind,value,unit,note\n"


def test_an_unknown_stream_gets_the_nearest_name(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no stream 'trajectry'") as caught:
        export(tmp_path, {"trajectory": imu(1)}, streams=("trajectry",))
    assert caught.value.hint == "did you mean 'trajectory'?"


def test_an_unknown_delimiter_is_refused() -> None:
    with pytest.raises(ValidationError, match="comma"):
        CsvParams(delimiter="pipe")
