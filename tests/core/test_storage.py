"""recon.storage: what is written is read, in either store, and the damaged is refused."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from recon.errors import ConfigError, ReadFailed, StorageError
from recon.recording import Recording
from recon.rows import Event, Metric, events, metrics
from recon.schema import BARO, FRAMES, GNSS, IMU, KNOTS, TIME_TYPE, by_step
from recon.storage import STORES, mcap, read_recording, store_of, write_recording
from recon.tables import build, with_meta

START_NS = 1_501_762_930_123_456_789


def imu(rows: int = 40_000) -> pa.Table:
    """More rows than one batch of the MCAP store; doubles of all kinds, and nulls."""
    rng = np.random.default_rng(1)
    t_ns = START_NS + np.arange(rows) * 10_000_000 + rng.integers(0, 1000, rows)
    gyro = rng.normal(size=(rows, 3))
    gyro[::7, 1] = np.nan
    gyro[:3, 0] = [-0.0, 5e-324, 1.7976931348623157e308]
    table = build(IMU, time=t_ns, accel=rng.normal(size=(rows, 3)), gyro=gyro)
    return with_meta(table, time_scale="utc", anchor=[44.5, 11.3, 54.0])


def recording() -> Recording:
    """Every kind of column: times, doubles, integers, text, lists; a stream without time and one without rows."""
    t_ns = START_NS + np.arange(5) * 1_000_000_000
    gnss = build(
        GNSS, time=t_ns, lat=np.full(5, 44.5), lon=np.full(5, 11.3), fix=pa.array([3, 3, None, 0, 1], pa.int32())
    )
    streams = {
        "imu": imu(),
        "imu_2": imu(10),
        "gnss": with_meta(gnss, height_datum="ellipsoid"),
        "events": with_meta(events([Event(START_NS, START_NS + 1, "crash", 12.5, "m/s", 'said "stop"\n')])),
        "metrics": with_meta(metrics([Metric("yaw", 1.25, "deg"), Metric("warning", note="naïve")])),
        "frames": with_meta(build(FRAMES, time=t_ns, index=np.arange(5), file=pa.array(list("abcde")))),
        "knots": with_meta(build(KNOTS, time=t_ns[:3], chain=pa.array([[1.5, -0.0], [0.1, 2.0], []]))),
        "baro": with_meta(build(BARO, time=np.zeros(0, dtype=np.int64), pressure=np.zeros(0))),
    }
    return Recording(streams, {"sources": ["drive.txt"], "note": "ü"})


@pytest.mark.parametrize("store", STORES)
def test_what_is_written_is_read_bit_for_bit(tmp_path: Path, store: str) -> None:
    written = recording()
    files = write_recording(written, tmp_path / "run", store)
    read = read_recording(tmp_path / "run")
    assert all(path.is_file() for path in files)
    assert list(read) == list(written)
    assert read.meta == written.meta
    for name, table in written.items():
        assert read[name].equals(table, check_metadata=True), name
        assert read[name].schema.equals(table.schema, check_metadata=True), name


@pytest.mark.parametrize("store", STORES)
def test_negative_zero_keeps_its_sign(tmp_path: Path, store: str) -> None:
    write_recording(Recording({"imu": imu(8)}), tmp_path, store)
    assert np.signbit(read_recording(tmp_path)["imu"]["gyro_x"][0].as_py())


@pytest.mark.parametrize("store", STORES)
def test_an_empty_recording_keeps_its_meta(tmp_path: Path, store: str) -> None:
    write_recording(Recording({}, {"sources": []}), tmp_path, store)
    read = read_recording(tmp_path)
    assert dict(read) == {}
    assert read.meta == {"sources": []}


@pytest.mark.parametrize("store", STORES)
def test_times_before_1970_are_kept(tmp_path: Path, store: str) -> None:
    table = with_meta(build(BARO, time=np.array([-5, 7]), pressure=np.ones(2)))
    write_recording(Recording({"baro": table}), tmp_path, store)
    assert read_recording(tmp_path)["baro"].equals(table, check_metadata=True)


@pytest.mark.parametrize("store", STORES)
def test_equal_tables_give_equal_bytes_whatever_their_chunks(tmp_path: Path, store: str) -> None:
    table = imu()
    chunked = pa.concat_tables([table.slice(0, 11), table.slice(11, 20_000), table.slice(20_011)])
    assert chunked["time"].num_chunks > 1
    first = write_recording(Recording({"imu": table}), tmp_path / "first", store)
    second = write_recording(Recording({"imu": chunked}), tmp_path / "second", store)
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]


@pytest.mark.parametrize("store", STORES)
def test_what_stands_behind_a_null_does_not_change_the_bytes(tmp_path: Path, store: str) -> None:
    files = []
    for hidden in (7.0, 8.0):
        buffers = [pa.py_buffer(b"\x05"), pa.py_buffer(np.array([1.0, hidden, 2.0]).tobytes())]
        pressure = pa.Array.from_buffers(pa.float64(), 3, buffers)
        table = build(BARO, time=np.arange(3), pressure=pressure)
        files.append(write_recording(Recording({"baro": table}), tmp_path / str(hidden), store))
    assert [path.read_bytes() for path in files[0]] == [path.read_bytes() for path in files[1]]


def test_a_table_without_metadata_is_stamped(tmp_path: Path) -> None:
    table = build(BARO, time=np.arange(3), pressure=np.ones(3))
    write_recording(Recording({"baro": table}), tmp_path)
    assert read_recording(tmp_path)["baro"].equals(with_meta(table), check_metadata=True)


@pytest.mark.parametrize("name", ["../imu", "a/b", "a\\b", "", ".", "C:x", "IMU", "imu.2"])
def test_names_that_are_no_plain_words_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(StorageError, match="no stream can be kept as"):
        write_recording(Recording({name: imu(3)}), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_an_unknown_store_names_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no store 'hdf5'; use 'parquet' or 'mcap'"):
        write_recording(recording(), tmp_path, "hdf5")


@pytest.mark.parametrize("first", STORES)
@pytest.mark.parametrize("second", STORES)
def test_a_second_recording_in_one_folder_is_refused(tmp_path: Path, first: str, second: str) -> None:
    write_recording(Recording({"imu": imu(3)}), tmp_path, first)
    with pytest.raises(ConfigError, match="is there already"):
        write_recording(Recording({"gnss": imu(3)}), tmp_path, second)
    assert list(read_recording(tmp_path)) == ["imu"]


def test_other_tools_read_numbers_and_times_from_the_parquet_files(tmp_path: Path) -> None:
    write_recording(Recording({"imu": imu(100)}), tmp_path)
    table = pq.read_table(tmp_path / "streams" / "imu.parquet")
    assert table["accel_x"].to_pylist() == imu(100)["accel_x"].to_pylist()
    assert table.schema.field("time").type == pa.timestamp("ns", "UTC")


def test_each_mcap_message_is_a_complete_arrow_stream_at_the_time_of_its_first_row(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    table = imu()
    write_recording(Recording({"imu": table}), tmp_path, "mcap")
    starts = []
    with (tmp_path / "streams.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            rows = pa.ipc.open_stream(message.data).read_all()
            assert schema is not None
            assert pa.ipc.read_schema(pa.py_buffer(schema.data)).equals(table.schema, check_metadata=True)
            assert (channel.topic, channel.message_encoding) == ("imu", "arrow-ipc-stream")
            assert message.log_time == rows["time"].cast(pa.int64())[0].as_py()
            starts.append(message.log_time)
    assert len(starts) == -(-table.num_rows // mcap.BATCH_ROWS)


def test_single_files_and_plain_folders_are_read(tmp_path: Path) -> None:
    written = Recording({"imu": imu(9), "gnss": imu(4)})
    write_recording(written, tmp_path / "a")
    write_recording(written, tmp_path / "b", "mcap")
    (tmp_path / "a" / "streams" / "recording.json").unlink()
    assert list(read_recording(tmp_path / "a" / "streams" / "imu.parquet")) == ["imu"]
    assert list(read_recording(tmp_path / "a" / "streams")) == ["gnss", "imu"]
    assert list(read_recording(tmp_path / "b" / "streams.mcap")) == ["imu", "gnss"]


def test_a_folder_name_with_an_equals_sign_adds_no_column(tmp_path: Path) -> None:
    write_recording(Recording({"imu": imu(3)}), tmp_path / "vehicle=A12" / "drive=d1")
    assert read_recording(tmp_path / "vehicle=A12" / "drive=d1")["imu"].equals(imu(3))


@pytest.mark.parametrize("content", [None, b"", b"hello"])
def test_what_holds_no_recording_is_refused(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "log.parquet"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ReadFailed, match=r"log\.parquet"):
        read_recording(path)
    with pytest.raises(ReadFailed):
        read_recording(tmp_path / "nowhere")


def test_an_empty_folder_holds_no_recording(tmp_path: Path) -> None:
    assert store_of(tmp_path) == ""
    with pytest.raises(ReadFailed, match="no result of recon"):
        read_recording(tmp_path)


@pytest.mark.parametrize("store", STORES)
def test_a_file_cut_short_anywhere_is_refused(tmp_path: Path, store: str) -> None:
    path = write_recording(Recording({"imu": imu(500)}), tmp_path, store)[0]
    whole = path.read_bytes()
    for length in [*range(8, len(whole), len(whole) // 60), len(whole) - 1]:
        path.write_bytes(whole[:length])
        with pytest.raises(ReadFailed, match="cut short or damaged"):
            read_recording(path)


@pytest.mark.parametrize("store", STORES)
def test_a_flipped_bit_in_the_data_never_gives_other_numbers(tmp_path: Path, store: str) -> None:
    table = imu(500)
    path = write_recording(Recording({"imu": table}), tmp_path, store)[0]
    whole = path.read_bytes()
    refused = 0
    end = len(whole)
    if store == "parquet":  # Parquet has no checksum of its footer; its length stands before the last magic number
        end -= 8 + int.from_bytes(whole[-8:-4], "little")
    for position in range(8, end, max(1, end // 200)):
        path.write_bytes(whole[:position] + bytes([whole[position] ^ 0x10]) + whole[position + 1 :])
        try:
            assert read_recording(path)["imu"].equals(table), position
        except ReadFailed:
            refused += 1
    assert refused > 100


def test_a_listed_stream_that_is_gone_is_named(tmp_path: Path) -> None:
    write_recording(Recording({"imu": imu(3), "gnss": imu(3)}), tmp_path)
    (tmp_path / "streams" / "gnss.parquet").unlink()
    with pytest.raises(ReadFailed, match=r"gnss\.parquet"):
        read_recording(tmp_path)


@pytest.mark.parametrize("text", ["{", "[]", "\x00", '{"streams": 5}', '{"streams": ["../imu"]}', '{"streams": [1]}'])
def test_a_damaged_recording_json_is_refused(tmp_path: Path, text: str) -> None:
    write_recording(Recording({"imu": imu(3)}), tmp_path)
    (tmp_path / "streams" / "recording.json").write_text(text)
    with pytest.raises(ReadFailed, match=r"recording\.json"):
        read_recording(tmp_path)


@pytest.mark.parametrize("store", STORES)
@pytest.mark.parametrize("meta", [{"sources": 3}, {"sources": [1]}])
def test_sources_that_are_no_names_are_refused(tmp_path: Path, meta: dict[str, object], store: str) -> None:
    write_recording(Recording({"imu": imu(3)}, meta), tmp_path, store)
    with pytest.raises(ReadFailed, match="what it says of its sources is damaged"):
        read_recording(tmp_path)


@pytest.mark.parametrize("number", ["2", "x"])
def test_a_newer_schema_number_asks_for_a_newer_recon(tmp_path: Path, number: str) -> None:
    table = imu(3).replace_schema_metadata({"recon.schema": number})
    pq.write_table(table, tmp_path / "imu.parquet")
    with pytest.raises(ReadFailed, match="newer recon"):
        read_recording(tmp_path / "imu.parquet")


def test_an_mcap_file_of_another_program_is_refused_by_what_it_holds(tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        channel = writer.register_channel("/imu", "cdr", writer.register_schema("Imu", "ros2msg", b""))
        writer.add_message(channel, 1, b"abc", 1)
        writer.finish()
    with pytest.raises(ReadFailed, match=r"not written by recon; it holds /imu \(cdr\)"):
        read_recording(path)


def test_a_canonical_table_of_another_program_is_taken(tmp_path: Path) -> None:
    plain = pa.table({"time": pa.array([1, 2], pa.timestamp("us")), "pressure": pa.array([1e5, 2e5], pa.float32())})
    pq.write_table(plain, tmp_path / "baro_2.parquet")
    taken = read_recording(tmp_path / "baro_2.parquet")["baro_2"]
    expected = build(BARO, time=np.array([1000, 2000]), pressure=np.array([1e5, 2e5]))
    assert taken.equals(expected, check_metadata=True)


def test_a_foreign_table_is_refused_by_what_it_lacks_and_what_is_unknown(tmp_path: Path) -> None:
    pq.write_table(pa.table({"stamp": [1], "pressure": [1.0]}), tmp_path / "baro.parquet")
    with pytest.raises(ReadFailed, match=r"as 'baro' it lacks \['time'\] and it has \['stamp'\]"):
        read_recording(tmp_path / "baro.parquet")


def test_a_stream_of_recon_with_other_times_is_refused(tmp_path: Path) -> None:
    kept = with_meta(build(BARO, time=np.array([1000, 2000]), pressure=np.array([1e5, 2e5])))
    seconds = kept.set_column(0, "time", kept["time"].cast(pa.timestamp("us", "UTC")))
    for table, told in ((seconds, r"times of type timestamp\[us, tz=UTC\]"), (kept.drop_columns(["time"]), "no times")):
        pq.write_table(table.replace_schema_metadata(kept.schema.metadata), tmp_path / "baro.parquet")
        with pytest.raises(ReadFailed, match=f"stream 'baro' has {told}"):
            read_recording(tmp_path / "baro.parquet")


def test_whole_numbers_are_no_times(tmp_path: Path) -> None:
    pq.write_table(pa.table({"time": [1_715_934_600_000], "pressure": [1.0]}), tmp_path / "baro.parquet")
    with pytest.raises(ReadFailed, match="column time is int64, which cannot be taken as timestamp") as caught:
        read_recording(tmp_path / "baro.parquet")
    assert caught.value.hint == "whole numbers do not tell what they count: write them as timestamps"


def test_a_foreign_table_with_a_column_twice_is_refused(tmp_path: Path) -> None:
    times, pressure = pa.array([1], pa.timestamp("us")), pa.array([1e5])
    pq.write_table(
        pa.Table.from_arrays([times, pressure, pressure], ["time", "pressure", "pressure"]), tmp_path / "baro.parquet"
    )
    with pytest.raises(ReadFailed, match=r"it has \['pressure'\] more than once"):
        read_recording(tmp_path / "baro.parquet")


def test_numbers_that_are_none_and_the_index_of_pandas_are_left_out_of_a_foreign_table(tmp_path: Path) -> None:
    plain = {"time": pa.array([1, 2], pa.timestamp("us")), "pressure": [1e5, float("nan")], "__index_level_0__": [4, 7]}
    pq.write_table(pa.table(plain), tmp_path / "baro.parquet")
    taken = read_recording(tmp_path / "baro.parquet")["baro"]
    assert taken["pressure"].to_pylist() == [1e5, None]
    assert taken.column_names == ["time", "pressure"]


def test_a_foreign_table_of_another_name_gets_the_nearest_one(tmp_path: Path) -> None:
    pq.write_table(pa.table({"time": [1]}), tmp_path / "gns.parquet")
    with pytest.raises(ReadFailed, match="did you mean 'gnss'") as caught:
        read_recording(tmp_path / "gns.parquet")
    assert caught.value.exit_code == 4


def test_a_foreign_column_of_a_wrong_type_is_named(tmp_path: Path) -> None:
    pq.write_table(pa.table({"time": [1.5], "pressure": [1.0]}), tmp_path / "baro.parquet")
    with pytest.raises(ReadFailed, match="column time is double"):
        read_recording(tmp_path / "baro.parquet")


LIMITED = """
import resource, sys
from pathlib import Path
import numpy as np
from recon.errors import StorageError
from recon.recording import Recording
from recon.schema import IMU
from recon.storage import write_recording
from recon.tables import build
rng = np.random.default_rng(1)
table = build(IMU, time=np.arange(50_000), accel=rng.normal(size=(50_000, 3)), gyro=rng.normal(size=(50_000, 3)))
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
try:
    write_recording(Recording({"imu": table}), Path(sys.argv[1]), sys.argv[2])
except StorageError as error:
    sys.stdout.write(str(error))
    sys.exit(error.exit_code)
"""


@pytest.mark.skipif(os.name != "posix", reason="limits of a file's size are those of POSIX")
@pytest.mark.parametrize("store", STORES)
def test_a_file_that_may_not_grow_leaves_nothing_behind(tmp_path: Path, store: str) -> None:
    """100 kB is less than the 2.4 MB of noise in the table, which no compression makes 24 times smaller."""
    command = [sys.executable, "-c", LIMITED, str(tmp_path / "run"), store]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, env=environment, check=False)
    assert done.returncode == 8, done.stderr
    assert "could not be written: file too large" in done.stdout
    assert not any(tmp_path.rglob("*streams*"))


@pytest.mark.parametrize("store", STORES)
def test_rows_with_their_step_and_nothing_but_times_are_kept(tmp_path: Path, store: str) -> None:
    nothing = {column.name: pa.nulls(2, column.type) for column in by_step("events").columns}
    times = dict.fromkeys(("time", "end_time"), pa.array([1, 2], TIME_TYPE))
    table = with_meta(build(by_step("events"), **{**nothing, **times}))
    write_recording(Recording({"events": table}), tmp_path, store)
    assert read_recording(tmp_path)["events"].equals(table, check_metadata=True)


@pytest.mark.parametrize("store", STORES)
def test_events_without_times_are_refused_as_damage_of_the_file(tmp_path: Path, store: str) -> None:
    nothing = {column.name: pa.nulls(2, column.type) for column in by_step("events").columns}
    write_recording(Recording({"events": with_meta(build(by_step("events"), **nothing))}), tmp_path, store)
    with pytest.raises(ReadFailed, match="stream 'events': 2 rows have no time"):
        read_recording(tmp_path)


@pytest.mark.parametrize("store", STORES)
def test_times_that_fall_are_refused_as_damage_of_the_file(tmp_path: Path, store: str) -> None:
    falling = build(BARO, time=np.array([5, 3]), pressure=np.ones(2))
    write_recording(Recording({"baro": falling}), tmp_path, store)
    with pytest.raises(ReadFailed, match="stream 'baro': time does not rise at row 1"):
        read_recording(tmp_path)


@pytest.mark.parametrize("store", STORES)
def test_facts_of_a_column_that_are_no_text_are_refused(tmp_path: Path, store: str) -> None:
    table = imu(4)
    field = table.schema.field("accel_x").with_metadata({"unit": b"m/s\xff2"})
    damaged = table.set_column(table.column_names.index("accel_x"), field, table["accel_x"])
    write_recording(Recording({"imu": damaged}), tmp_path, store)
    with pytest.raises(ReadFailed, match="what it says of stream 'imu' is damaged"):
        read_recording(tmp_path)


@pytest.mark.parametrize("store", STORES)
def test_metrics_with_a_strange_column_are_refused(tmp_path: Path, store: str) -> None:
    table = metrics([Metric("yaw", 1.0)])
    strange = table.rename_columns(["lmw" if name == "low" else name for name in table.column_names])
    write_recording(Recording({"metrics": strange}), tmp_path, store)
    with pytest.raises(ReadFailed, match="what it says of stream 'metrics' is damaged"):
        read_recording(tmp_path)


def test_text_that_is_no_utf8_is_refused(tmp_path: Path) -> None:
    """Checksums vouch for what was written, not for its being right."""
    offsets, text = pa.py_buffer(np.array([0, 3], np.int32)), pa.py_buffer(b"a\xffc")
    wrong = pa.table({"file": pa.Array.from_buffers(pa.string(), 1, [None, offsets, text])})
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, wrong.schema) as stream:
        stream.write_table(wrong)
    _mcap_of(sink.getvalue().to_pybytes(), tmp_path / "drive.mcap")
    with pytest.raises(ReadFailed, match="cut short or damaged"):
        read_recording(tmp_path / "drive.mcap")


def _mcap_of(message: bytes, path: Path) -> None:
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile=mcap.PROFILE)
        channel = writer.register_channel("frames", mcap.MESSAGE_ENCODING, schema_id=0)
        writer.add_message(channel, 0, message, 0)
        writer.finish()
