"""exporter.hdf5: every column reads back to the same bits, with its unit."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pytest
from exporter_tables import START_NS, drive, happened

from recon.errors import PluginError
from recon.manifest import RunInfo
from recon.parameters import NoParams
from recon.schema import FRAMES, GNSS, IMU, KNOTS, RESIDUALS
from recon.tables import build, matrix, time_ns, with_meta
from recon_exporters import hdf5 as module

TIMES = START_NS + np.arange(3)


def export(folder: Path, streams: dict[str, pa.Table], **manifest: Any) -> h5py.File:
    (path,) = module.hdf5(streams=streams, folder=folder, about=RunInfo("run", manifest), params=NoParams())
    assert path == folder / "recording.h5"
    return h5py.File(path)


def test_the_record_keeps_the_rules_of_its_role():
    (record,) = module.declare_exporters()
    assert record.faults() == []
    assert record.every_stream


def test_doubles_and_times_read_back_to_the_last_bit(tmp_path):
    rng = np.random.default_rng(6)
    accel = rng.normal(size=(50_000, 3)) * 10.0 ** rng.integers(-300, 300, size=(50_000, 3))
    accel[7, 1] = np.nan
    table = build(IMU, time=START_NS + np.arange(50_000), accel=accel, gyro=-accel)
    with export(tmp_path, {"imu": table}) as file:
        read = np.column_stack([file["imu"][f"accel_{axis}"][:] for axis in "xyz"])
        assert np.array_equal(read, matrix(table, "accel", gaps=True), equal_nan=True)
        assert np.array_equal(file["imu/time"][:], time_ns(table))
        assert file["imu/time"].dtype == np.int64


def test_columns_say_their_unit_frame_and_quantity(tmp_path):
    with export(tmp_path, {"imu": build(IMU, time=TIMES, accel=np.ones((3, 3)), gyro=np.ones((3, 3)))}) as file:
        assert dict(file["imu/accel_x"].attrs) == {
            "unit": "m/s^2",
            "frame": "sensor",
            "quantity": "specific_force",
        }
        assert file["imu/time"].attrs["unit"] == "ns since 1970-01-01T00:00:00Z"


def test_streams_keep_their_facts(tmp_path):
    table = with_meta(drive([0, 1]), anchor={"lat": 44.5, "lon": 11.3, "height": 54.0})
    with export(tmp_path, {"trajectory": table}) as file:
        facts = file["trajectory"].attrs
        assert facts["height_datum"] == "ellipsoid"
        assert json.loads(facts["anchor"]) == {"lat": 44.5, "lon": 11.3, "height": 54.0}


def test_whole_numbers_stay_whole_unless_some_are_missing(tmp_path):
    place = {"lat": np.full(3, 44.5), "lon": np.full(3, 11.3)}
    table = build(
        GNSS, time=TIMES, fix=pa.array([3, 0, 1], pa.int32()), satellites=pa.array([9, None, 7], pa.int32()), **place
    )
    with export(tmp_path, {"gnss": table}) as file:
        assert file["gnss/fix"].dtype == np.int32
        assert file["gnss/fix"][:].tolist() == [3, 0, 1]
        assert np.array_equal(file["gnss/satellites"][:], [9.0, np.nan, 7.0], equal_nan=True)


def test_texts_switches_and_lists_read_back(tmp_path):
    residuals = build(
        RESIDUALS, time=TIMES, sensor=["gnss", "ü", None], value=np.ones(3), accepted=pa.array([True, False, True])
    )
    knots = build(KNOTS, time=TIMES, chain=pa.array([[1.5, -0.0], None, []]))
    frames = build(FRAMES, time=TIMES, index=np.arange(3), file=pa.array(list("abc")))
    with export(tmp_path, {"residuals": residuals, "knots": knots, "frames": frames}) as file:
        assert file["residuals/sensor"].asstr()[:].tolist() == ["gnss", "ü", ""]
        assert file["residuals/accepted"][:].tolist() == [True, False, True]
        assert [values.tolist() for values in file["knots/chain"][:]] == [[1.5, -0.0], [], []]
        assert file["frames/file"].asstr()[:].tolist() == ["a", "b", "c"]


def test_the_file_carries_its_manifest_without_the_environment(tmp_path):
    with export(tmp_path, {"events": happened((0, 1))}, recon="0.1", environment={"host": "here"}) as file:
        assert json.loads(file.attrs["manifest"]) == {"recon": "0.1"}
        assert file.attrs["name"] == "run"


def test_a_large_manifest_is_kept(tmp_path):
    """Attributes of more than 64 KiB need the newer format of HDF5."""
    with export(tmp_path, {"events": happened((0, 1))}, text="x" * 200_000) as file:
        assert len(json.loads(file.attrs["manifest"])["text"]) == 200_000


def test_streams_without_rows_are_written(tmp_path):
    with export(tmp_path, {"trajectory": drive([]), "events": happened()}) as file:
        assert file["trajectory/lat"].shape == (0,)
        assert file["events/kind"].shape == (0,)


def test_without_h5py_one_sentence_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(PluginError, match=r'needs h5py(.|\n)*pip install "recon-dynamics\[hdf5\]"'):
        export(tmp_path, {})
    assert list(tmp_path.iterdir()) == []
