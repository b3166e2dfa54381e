"""reader.parquet and reader.mcap: a recording that recon keeps becomes the start of a pipeline."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import recon
import recon_readers.mcap
import recon_readers.parquet
from recon import Registry, Streams
from recon.errors import ReadFailed
from recon.recording import Recording
from recon.rows import Event, events, warnings_of
from recon.schema import IMU, Change, Column, by_step
from recon.storage import STORES, write_recording
from recon.tables import build, conform, with_meta

READERS = {"parquet": recon_readers.parquet, "mcap": recon_readers.mcap}


def imu() -> pa.Table:
    values = np.arange(30.0).reshape(10, 3)
    return with_meta(build(IMU, time=np.arange(10) * 10_000_000, accel=values, gyro=values / 100), time_scale="utc")


def stored_imu(tmp_path: Path, store: str) -> Path:
    write_recording(Recording({"imu": imu()}), tmp_path / "run", store)
    return tmp_path / "run"


def read(path: Path, store: str) -> dict[str, pa.Table]:
    (reader,) = READERS[store].declare_readers()
    return dict(reader.run(path=path, params=reader.params()))


def confidences(path: Path) -> dict[str, float]:
    head = b"" if path.is_dir() else path.read_bytes()[:65536]
    return {name: module.sniff(path, head).confidence for name, module in READERS.items()}


def test_the_records_keep_the_rules_of_their_role() -> None:
    records = [record for module in READERS.values() for record in module.declare_readers()]
    assert [record.faults() for record in records] == [[], []]
    assert set(Registry.of(*records)) == {"reader.parquet", "reader.mcap"}


@pytest.mark.parametrize("store", STORES)
def test_streams_come_back_as_they_were_kept(tmp_path: Path, store: str) -> None:
    streams = read(stored_imu(tmp_path, store), store)
    assert list(streams) == ["imu"]
    assert streams["imu"].equals(imu(), check_metadata=True)


@pytest.mark.parametrize("store", STORES)
def test_a_run_folder_is_claimed_by_one_reader(tmp_path: Path, store: str) -> None:
    found = confidences(stored_imu(tmp_path, store))
    assert found.pop(store) == 1.0
    assert set(found.values()) == {0.0}


def test_a_file_is_claimed_by_its_magic_number_whatever_its_name(tmp_path: Path) -> None:
    parquet = stored_imu(tmp_path / "a", "parquet") / "streams" / "imu.parquet"
    mcap = stored_imu(tmp_path / "b", "mcap") / "streams.mcap"
    assert confidences(parquet.rename(tmp_path / "x.bin")) == {"parquet": 0.9, "mcap": 0.0}
    assert confidences(mcap.rename(tmp_path / "y.bin")) == {"parquet": 0.0, "mcap": 1.0}


@pytest.mark.parametrize("content", [b"", b"PAR", b"time,speed\n", b"\x89MCAP9\r\n"])
def test_other_files_are_not_claimed(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "log.parquet"
    path.write_bytes(content)
    assert confidences(path) == {"parquet": 0.0, "mcap": 0.0}
    assert confidences(tmp_path) == {"parquet": 1.0, "mcap": 0.0}  # by the file's name; reading it says what is wrong


def test_an_empty_folder_is_not_claimed(tmp_path: Path) -> None:
    assert confidences(tmp_path) == {"parquet": 0.0, "mcap": 0.0}


def test_an_mcap_file_of_another_program_is_claimed_less_surely(tmp_path: Path) -> None:
    from mcap.writer import Writer

    with (tmp_path / "other.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        writer.finish()
    assert confidences(tmp_path / "other.mcap") == {"parquet": 0.0, "mcap": 0.9}


@pytest.mark.parametrize("store", STORES)
def test_events_keep_the_step_of_the_run_that_found_them(tmp_path: Path, store: str) -> None:
    happened = append_step(events([Event(1, 2, "crash")]), "events", "detector.shock")
    write_recording(Recording({"imu": imu(), "events": happened}), tmp_path, store)
    again = recon.read(tmp_path)
    assert again["events"].column("step").to_pylist() == ["detector.shock"]


@pytest.mark.parametrize("store", STORES)
def test_frames_quantities_and_foreign_columns_come_back_through_a_pipeline(tmp_path: Path, store: str) -> None:
    planned = Change(frames={"accel": "vehicle"}, quantities={"accel": "acceleration"}, adds=(Column("smell"),))
    more = imu().append_column("smell", pa.array(np.ones(10)))
    turned = conform(more, planned.apply(IMU), stream="imu", step="test")
    write_recording(Recording({"imu": turned, "knots": imu()}), tmp_path, store)
    again = recon.read(tmp_path)
    assert again["imu"].equals(turned, check_metadata=True)
    assert again["knots"].equals(imu(), check_metadata=True)


def append_step(table: pa.Table, stream: str, step: str) -> pa.Table:
    columns = {name: table[name] for name in table.column_names}
    return build(by_step(stream), step=pa.array([step] * table.num_rows), **columns)


def test_damage_is_reported_as_such(tmp_path: Path) -> None:
    path = stored_imu(tmp_path, "parquet") / "streams" / "imu.parquet"
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(ReadFailed, match="cut short or damaged"):
        read(path, "parquet")


def test_a_plain_table_of_another_program_is_read(tmp_path: Path) -> None:
    plain = {"time": pa.array([1, 2], pa.timestamp("ns")), "pressure": [1e5, 1e5]}
    pq.write_table(pa.table(plain), tmp_path / "baro.parquet")
    assert read(tmp_path / "baro.parquet", "parquet")["baro"].num_rows == 2


def receiver(folder: Path, lat: list[float]) -> Streams:
    rows = len(lat)
    times = pa.array(range(rows), pa.timestamp("s")).cast(pa.timestamp("us"))
    sigmas = {f"pos_std_{axis}": [0.0] + [2.0] * (rows - 1) for axis in "enu"}
    table = pa.table({"time": times, "lat": lat, "lon": [11.0] * rows, "satellites": [7] * rows, **sigmas})
    pq.write_table(table, folder / "gnss.parquet")
    return read(folder / "gnss.parquet", "parquet")


def test_what_no_vehicle_shows_is_left_out_of_a_plain_table(tmp_path: Path) -> None:
    streams = receiver(tmp_path, [44.0, 444.0, *[44.0] * 200])
    gnss = streams["gnss"]
    assert (gnss["lat"].null_count, gnss["lat"][1].as_py(), gnss["pos_std_e"][0].as_py()) == (1, None, None)
    assert gnss["satellites"].to_pylist() == [7] * 202
    (text,) = warnings_of(streams["metrics"])
    assert "gnss.lat is 444 in row 1, outside -90 to 90" in text


def test_a_plain_table_of_another_unit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ReadFailed, match=r"gnss\.lat is 4\.4e\+08 in row 0, outside -90 to 90"):
        receiver(tmp_path, [44e7] * 3)
