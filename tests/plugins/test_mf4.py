"""reader.mf4: channels become streams by a mapping, each at the times of its group."""

from __future__ import annotations

import shutil
from datetime import timedelta, timezone
from pathlib import Path
from typing import Any, Final

import measurement_logs as made
import numpy as np
import pytest
from asammdf import MDF, Signal
from pydantic import ValidationError

import recon
import recon_readers.mf4
from recon import Streams
from recon.errors import NothingUsable, ReadFailed
from recon.rows import warnings_of
from recon.stages import EVERYTHING, Wanted
from recon.tables import matrix, meta, time_ns, vector
from recon_readers import _mf4_file
from recon_readers.mf4 import Mf4Params

READ: Final = ("imu", "wheel", "gnss")
WHEEL: Final = {"wheel": {"speed": {"column": "Speed", "unit": "km/h"}}}
HOUR_NS: Final = 3_600 * 10**9
HEADER_3: Final = 64
"""Byte of the header of an MDF 3 file."""


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made.mf4(tmp_path_factory.mktemp("mf4") / "drive.mf4")


def read(path: Path, channels: dict[str, Any], wanted: Wanted = EVERYTHING, **params: object) -> Streams:
    return recon_readers.mf4.read(path, Mf4Params(channels=channels, **params), wanted)


def test_each_group_keeps_its_own_raster(drive: Path) -> None:
    streams = read(drive, made.CHANNELS)
    assert {name: table.num_rows for name, table in streams.items() if name != "metrics"} == {
        "imu": 100,
        "wheel": 50,
        "gnss": 5,
    }
    np.testing.assert_array_equal(time_ns(streams["imu"]), made.START_NS + np.arange(100) * 10_000_000)
    assert (meta(streams["imu"])["time_scale"], meta(streams["imu"])["clock"]) == ("UTC", "absolute")


def test_values_come_in_the_units_of_the_streams(drive: Path) -> None:
    streams = read(drive, made.CHANNELS)
    np.testing.assert_allclose(matrix(streams["imu"], "accel")[0], np.multiply(made.ACCEL_G, 9.80665), rtol=1e-12)
    np.testing.assert_allclose(matrix(streams["imu"], "gyro")[0], np.radians(made.GYRO_DEG), rtol=1e-12)
    assert vector(streams["wheel"], "speed")[0] == pytest.approx(10.0)
    fix = streams["gnss"].to_pylist()[0]
    assert (fix["lat"], fix["lon"], fix["height"], fix["speed"]) == (44.5, 11.25, 54.5, pytest.approx(10.0))
    assert meta(streams["gnss"])["height_datum"] == "ellipsoid"


def test_axes_and_what_is_shown_at_rest_are_told(drive: Path) -> None:
    accel = {**made.CHANNELS["imu"]["accel"], "at_rest": "down"}
    x, y, z = np.multiply(made.ACCEL_G, 9.80665)
    turned = read(drive, {"imu": {**made.CHANNELS["imu"], "axes": "FRD", "accel": accel}})["imu"]
    np.testing.assert_allclose(matrix(turned, "accel")[0], [-x, y, z], rtol=1e-12)
    assert meta(turned)["axes"] == "FRD"


def test_channels_of_two_groups_in_one_stream_leave_gaps(drive: Path) -> None:
    wheel = {"speed": {"column": "Speed@1", "unit": "km/h"}, "speed_rear_left": {"column": "Speed@2", "unit": "km/h"}}
    table = read(drive, {"wheel": wheel})["wheel"]
    assert (table.num_rows, table["speed"].null_count, table["speed_rear_left"].null_count) == (50, 0, 45)


def test_only_channels_that_are_wanted_are_read(drive: Path) -> None:
    some = read(drive, made.CHANNELS, Wanted({"gnss": frozenset({"lat", "lon"})}))
    assert set(some) == {"gnss", "metrics"}
    assert some["gnss"].column_names == ["time", "lat", "lon"]


def test_without_a_mapping_the_channels_are_listed(drive: Path) -> None:
    with pytest.raises(NothingUsable, match="what its channels mean only a mapping tells") as caught:
        recon.read(drive)
    assert "group 1, 50 rows: time [s], Speed [km/h]" in caught.value.hint


def test_a_channel_that_is_not_there_or_not_alone_is_refused(drive: Path) -> None:
    with pytest.raises(ReadFailed, match="it has no channel 'Sped'") as caught:
        read(drive, {"wheel": {"speed": {"column": "Sped", "unit": "km/h"}}})
    assert caught.value.hint == "did you mean 'Speed'?"
    with pytest.raises(ReadFailed, match="several groups have a channel 'Speed'") as caught:
        read(drive, {"wheel": {"speed": {"column": "Speed", "unit": "km/h"}}})
    assert caught.value.hint == "write one of 'Speed@1', 'Speed@2'"


def test_a_damaged_file_is_refused_in_one_sentence(drive: Path, tmp_path: Path) -> None:
    path = tmp_path / "cut.mf4"
    path.write_bytes(drive.read_bytes()[:300])
    with pytest.raises(ReadFailed, match="asammdf cannot read it"):
        read(path, made.CHANNELS)


def test_a_file_that_takes_its_process_along_is_refused(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # asammdf is replaced by what damaged files do to it: an end without a word
    (tmp_path / "asammdf.py").write_text("import os\nos._exit(139)\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(_mf4_file, "_idle", [])
    with pytest.raises(ReadFailed, match="asammdf broke down at it") as caught:
        read(drive, made.CHANNELS)
    assert "copy it again" in caught.value.hint


def test_a_file_that_is_never_read_to_its_end_is_refused(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "asammdf.py").write_text("import time\ntime.sleep(60)\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(_mf4_file, "LONGEST_S", 1.0)
    monkeypatch.setattr(_mf4_file, "_idle", [])
    with pytest.raises(ReadFailed, match="did not come to an end"):
        read(drive, made.CHANNELS)


def test_a_process_that_was_broken_before_is_replaced(drive: Path) -> None:
    read(drive, made.CHANNELS)
    _mf4_file._idle[-1].kill()
    _mf4_file._idle[-1].wait()
    assert set(read(drive, made.CHANNELS)) == {"imu", "wheel", "gnss", "metrics"}


def test_a_file_that_its_recorder_left_open_is_read_as_far_as_it_goes(drive: Path, tmp_path: Path) -> None:
    path = made.left_open(Path(shutil.copy(drive, tmp_path / "open.mf4")))
    before = path.read_bytes()
    streams = read(path, made.CHANNELS)
    whole = read(drive, made.CHANNELS)
    assert all(streams[name].equals(whole[name]) for name in READ)
    assert any("the recorder did not close the file" in text for text in warnings_of(streams["metrics"]))
    assert path.read_bytes() == before


@pytest.mark.parametrize(("kind", "name"), [(2, "angle"), (3, "distance"), (4, "index")])
def test_rows_that_do_not_count_by_time_are_refused(tmp_path: Path, kind: int, name: str) -> None:
    path = tmp_path / "angle.mf4"
    with MDF(version="4.10") as file:
        file.append([Signal(np.ones(9), np.arange(9.0), name="Speed", unit="km/h", master_metadata=(name, kind))])
        file.save(path)
    with pytest.raises(ReadFailed, match=f"group 0 has no channel of time: its rows count by '{name}'"):
        read(path, WHEEL)


def test_a_unit_of_the_file_that_is_not_that_of_the_mapping_is_doubted(drive: Path) -> None:
    wheel = {"wheel": {"speed": {"column": "Speed@1", "unit": "m/s"}}}
    told = warnings_of(read(drive, wheel)["metrics"])
    assert told == ["Speed [km/h] of group 1, where the mapping says m/s: which of the two is right?"]
    assert not warnings_of(read(drive, made.CHANNELS)["metrics"])


def test_keys_that_mean_nothing_here_are_refused() -> None:
    for key, value in {"keep": "changes", "file": "*wheel*", "valid": {"column": "Ok", "values": [1]}}.items():
        with pytest.raises(ValidationError, match=f"'wheel.{key}' means something in tables of text only"):
            Mf4Params(channels={"wheel": {**WHEEL["wheel"], key: value}})


# --- starts of MDF 3 ------------------------------------------------------------------------------------------------


def mdf3(path: Path, version: str, hours: int) -> Path:
    return made.mf4(path, start=made.START.astimezone(timezone(timedelta(hours=hours))), version=version)


def test_a_start_without_a_zone_does_not_depend_on_that_of_the_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = mdf3(tmp_path / "old.mdf", "3.00", hours=2)
    for zone in ("UTC", "America/New_York"):
        monkeypatch.setenv("TZ", zone)
        _mf4_file._end_all()
        table = read(path, made.CHANNELS)["wheel"]
        assert (time_ns(table)[0], meta(table)["time_scale"]) == (made.START_NS + 2 * HOUR_NS, "local")
        assert time_ns(read(path, made.CHANNELS, zone="+02:00")["wheel"])[0] == made.START_NS
    _mf4_file._end_all()  # for what follows, those of another zone


def test_a_zone_that_the_file_tells_is_used(tmp_path: Path) -> None:
    path = mdf3(tmp_path / "new.mdf", "3.30", hours=-5)  # asammdf writes UTC beside the zone
    table = read(path, made.CHANNELS)["wheel"]
    assert (time_ns(table)[0], meta(table)["time_scale"]) == (made.START_NS, "UTC")
    data = bytearray(path.read_bytes())
    at = HEADER_3 + 164  # as other programs write it: local time, in ns
    assert int.from_bytes(data[at : at + 8], "little") == made.START_NS
    data[at : at + 8] = (made.START_NS - 5 * HOUR_NS).to_bytes(8, "little")
    path.write_bytes(data)
    assert time_ns(read(path, made.CHANNELS)["wheel"])[0] == made.START_NS


# --- real files -----------------------------------------------------------------------------------------------------


def test_a_measurement_of_a_control_unit(logs: Path) -> None:
    path = logs / "formats/mf4/ASAP2_Demo_V171.mf4"
    wheel = {"speed": {"column": "ASAM.M.SCALAR.UBYTE.IDENTICAL", "unit": "km/h"}}
    table = read(path, {"wheel": wheel})["wheel"]
    assert table.num_rows == 12_402  # a raster of 1 ms
    # 2018-11-22 15:26:35.4397 at UTC+1
    assert time_ns(table)[0] // 10**9 == 1_542_896_795


def test_local_time_without_a_zone_is_said_to_be_that(logs: Path) -> None:
    path = logs / "formats/mf4/test_metadata.mf4"
    wheel = {"wheel": {"speed": {"column": "ASAM.M.SCALAR.SBYTE.IDENTICAL.DISCRETE", "unit": "km/h"}}}
    streams = read(path, wheel)
    assert meta(streams["wheel"])["time_scale"] == "local"
    assert any("--set reader.mf4.zone=+01:00" in text for text in warnings_of(streams["metrics"]))
    told = read(path, wheel, zone="+01:00")["wheel"]
    assert meta(told)["time_scale"] == "UTC"
    np.testing.assert_array_equal(time_ns(told), time_ns(streams["wheel"]) - 3_600 * 10**9)
