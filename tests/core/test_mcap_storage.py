"""recon.storage.mcap on damaged files: what is whole is salvaged, what is lost is counted, nothing is made up.

The conformance files of the MCAP specification are made anew as its repository makes them (github.com/foxglove/mcap,
tests/conformance): the same records with every combination of features; padding, which no writer of ours adds, aside.
Two of them are held to the checksum that the repository keeps.
"""

from __future__ import annotations

import hashlib
from io import BytesIO
from itertools import chain, combinations
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from mcap.records import Attachment, Channel, Footer, McapRecord, Message, Metadata, Schema
from mcap.writer import CompressionType, IndexType, Writer

import recon
from recon.errors import ReadFailed
from recon.recording import Recording
from recon.rows import Metric, metrics
from recon.schema import BARO, IMU
from recon.storage import read_recording, salvage_recording, write_recording
from recon.storage.mcap import BATCH_ROWS, whole_records
from recon.tables import build, with_meta

INDEXES = {
    "ax": IndexType.ATTACHMENT,
    "chx": IndexType.CHUNK,
    "mdx": IndexType.METADATA,
    "mx": IndexType.MESSAGE,
}
FEATURES = (*INDEXES, "ch", "rch", "rsh", "st", "sum")
SCHEMA = Schema(id=1, name="Example", encoding="c", data=b"\4\5\6")
CHANNEL = Channel(id=1, topic="example", schema_id=1, message_encoding="a", metadata={"foo": "bar"})
ORDER_OF_TEN = (0, 2, 1, 3, 3, 5, 4, 7, 8, 9)
INPUTS: dict[str, list[McapRecord]] = {
    "NoData": [],
    "OneMessage": [SCHEMA, CHANNEL, Message(1, 2, b"\1\2\3", 1, 10)],
    "TenMessages": [
        SCHEMA,
        CHANNEL,
        *(Message(1, time, b"\1\2\3", time, number) for number, time in enumerate(ORDER_OF_TEN)),
    ],
    "OneAttachment": [Attachment(1, 2, "myFile", "application/octet-stream", b"\1\2\3")],
    "OneMetadata": [Metadata("myMetadata", {"foo": "bar"})],
}
KEPT = {
    "TenMessages-ch-chx-mx-rch-rsh-st-sum": "813c4eb55e1195e5af9482f60d9b214cd083a8805720ec1663812637d716e4d5",
    "OneMetadata-mdx-st-sum": "6d7681e1536e3c61a0d9755b1b10b9a7ad4c2042855a839ce96c8c024bc64316",
}


def conformance_file(records: list[McapRecord], features: tuple[str, ...]) -> bytes:
    out = BytesIO()
    index_types = IndexType.NONE
    for feature in set(features) & set(INDEXES):
        index_types |= INDEXES[feature]
    writer = Writer(
        out,
        index_types=index_types,
        compression=CompressionType.NONE,
        repeat_channels="rch" in features,
        repeat_schemas="rsh" in features,
        use_chunking="ch" in features,
        use_statistics="st" in features,
        use_summary_offsets="sum" in features,
        enable_data_crcs=True,
    )
    writer.start("", "")
    for record in records:
        match record:
            case Schema():
                writer.register_schema(record.name, record.encoding, record.data)
            case Channel():
                writer.register_channel(record.topic, record.message_encoding, record.schema_id, record.metadata)
            case Message():
                writer.add_message(
                    record.channel_id, record.log_time, record.data, record.publish_time, record.sequence
                )
            case Attachment():
                writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type, record.data)
            case Metadata():
                writer.add_metadata(record.name, record.metadata)
    writer.finish()
    return out.getvalue()


def records_of(content: bytes) -> list[McapRecord | Exception]:
    return list(whole_records(BytesIO(content), len(content)))


def test_made_files_are_those_of_the_conformance_set() -> None:
    for name, checksum in KEPT.items():
        base, *features = name.split("-")
        assert hashlib.sha256(conformance_file(INPUTS[base], tuple(features))).hexdigest() == checksum


@pytest.mark.parametrize("name", INPUTS)
def test_every_conformance_file_gives_the_records_that_were_written(name: str) -> None:
    """All 512 combinations of features; the records of the data section come before its end, in their order."""
    all_features = chain.from_iterable(combinations(FEATURES, count) for count in range(len(FEATURES) + 1))
    for features in all_features:
        found = records_of(conformance_file(INPUTS[name], features))
        assert not any(isinstance(record, Exception) for record in found), features
        assert isinstance(found[-1], Footer)
        kinds = tuple({type(record) for record in INPUTS[name]})
        written = [record for record in found if isinstance(record, kinds)][: len(INPUTS[name])]
        assert written == INPUTS[name], features


@pytest.mark.parametrize("name", INPUTS)
@pytest.mark.parametrize("features", [("ch", "chx", "mx", "rch", "rsh", "st", "sum", "ax", "mdx"), ()])
def test_a_conformance_file_cut_anywhere_gives_its_first_records_and_one_error(
    name: str, features: tuple[str, ...]
) -> None:
    content = conformance_file(INPUTS[name], features)
    whole = records_of(content)
    for length in range(len(content)):
        *found, error = records_of(content[:length])
        assert isinstance(error, Exception), length
        assert found == whole[: len(found)], length


def imu(rows: int) -> pa.Table:
    """Random bits: incompressible, so that a cut of the file is a cut of the rows."""
    values = np.random.default_rng(2).normal(size=(rows, 3))
    return with_meta(build(IMU, time=np.arange(rows) * 10_000_000, accel=values, gyro=-values))


def kept(folder: Path, rows: int = 3 * BATCH_ROWS) -> Path:
    baro = with_meta(build(BARO, time=np.arange(5) * 1_000_000_000, pressure=np.full(5, 1e5)))
    streams = {"metrics": with_meta(metrics([Metric("yaw", 1.0)])), "imu": imu(rows), "baro": baro}
    (path,) = write_recording(Recording(streams, {"sources": ["a.txt"]}), folder, "mcap")
    return path


def test_a_whole_file_has_no_loss(tmp_path: Path) -> None:
    recording, loss = salvage_recording(kept(tmp_path))
    assert loss == ""
    assert recording["imu"].equals(imu(3 * BATCH_ROWS), check_metadata=True)


@pytest.mark.parametrize("part", [0.5, 0.9, 0.999])
def test_of_a_file_cut_short_all_whole_batches_come_back_and_the_rest_is_counted(tmp_path: Path, part: float) -> None:
    """Of three equal batches of rows, as many are whole as fit into what is left of the file."""
    path = kept(tmp_path)
    content = path.read_bytes()
    path.write_bytes(content[: int(part * len(content))])
    recording, loss = salvage_recording(path)
    rows = {0.5: 1, 0.9: 2, 0.999: 3}[part] * BATCH_ROWS
    assert recording["imu"].equals(imu(3 * BATCH_ROWS).slice(0, rows), check_metadata=True)
    assert recording.meta == {"sources": ["a.txt"]}
    lost = 3 * BATCH_ROWS - rows
    assert (f"{lost:,} of {3 * BATCH_ROWS:,} rows of imu" in loss) == (lost > 0)
    assert "cut short or damaged" in loss


def test_a_stream_that_is_lost_as_a_whole_is_counted_too(tmp_path: Path) -> None:
    path = kept(tmp_path)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    recording, loss = salvage_recording(path)
    assert "baro" not in recording
    assert "5 of 5 rows of baro are lost" in loss


def test_a_file_that_lost_only_its_end_says_that_every_row_is_there(tmp_path: Path) -> None:
    path = kept(tmp_path)
    path.write_bytes(path.read_bytes()[:-1])
    recording, loss = salvage_recording(path)
    assert loss == "the MCAP file is cut short or damaged: every row is salvaged"
    assert recording["baro"].num_rows == 5


def test_of_a_file_damaged_in_the_middle_the_chunks_behind_come_back(tmp_path: Path) -> None:
    """A flipped bit in the second third of incompressible data lies in the second of three batches."""
    path = kept(tmp_path)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x10
    path.write_bytes(content)
    recording, loss = salvage_recording(path)
    table = imu(3 * BATCH_ROWS)
    behind = recording["imu"].slice(BATCH_ROWS)
    assert recording["imu"].slice(0, BATCH_ROWS).equals(table.slice(0, BATCH_ROWS))
    assert behind.equals(table.slice(2 * BATCH_ROWS))
    assert f"{BATCH_ROWS:,} of {3 * BATCH_ROWS:,} rows of imu are lost" in loss


def test_a_flipped_bit_anywhere_never_gives_other_rows(tmp_path: Path) -> None:
    """Whatever comes back is a part of what was written: three batches of which some are left out."""
    path = kept(tmp_path, rows=BATCH_ROWS + 1)
    content, table = path.read_bytes(), imu(BATCH_ROWS + 1)
    parts = [table, table.slice(0, BATCH_ROWS), table.slice(BATCH_ROWS)]
    for position in range(8, len(content), len(content) // 100):
        path.write_bytes(content[:position] + bytes([content[position] ^ 0x10]) + content[position + 1 :])
        try:
            recording, _ = salvage_recording(path)
        except ReadFailed:
            continue
        assert "imu" not in recording or any(recording["imu"].equals(part) for part in parts), position


def test_a_file_in_which_nothing_is_whole_is_refused(tmp_path: Path) -> None:
    path = kept(tmp_path)
    path.write_bytes(path.read_bytes()[:600])
    with pytest.raises(ReadFailed, match="cut short or damaged, and nothing in it is whole"):
        salvage_recording(path)


def test_a_finished_run_is_refused_rather_than_salvaged(tmp_path: Path) -> None:
    path = kept(tmp_path)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(ReadFailed, match=r"cut short or damaged(.|\n)*reader\.mcap salvages"):
        read_recording(tmp_path)


def test_a_file_without_row_counts_says_that_the_loss_is_not_known(tmp_path: Path) -> None:
    """Files of the first version of the layout had no rows in their metadata."""
    path = kept(tmp_path)
    content = path.read_bytes().replace(b"\4\0\0\0rows", b"\4\0\0\0none", 1)
    path.write_bytes(content[: len(content) // 2])
    assert salvage_recording(path)[1].endswith(
        f"1 rows of metrics, {BATCH_ROWS:,} rows of imu are salvaged, how many are lost is not known"
    )


def test_the_reader_warns_of_what_is_lost(tmp_path: Path) -> None:
    path = kept(tmp_path)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    recording = recon.read(path)
    assert recording["imu"].num_rows == BATCH_ROWS
    rows = recording["metrics"].select(["name", "note"]).to_pylist()
    assert "yaw" in [row["name"] for row in rows]
    (told,) = [row["note"] for row in rows if row["name"] == "warning"]
    assert f"{2 * BATCH_ROWS:,} of {3 * BATCH_ROWS:,} rows of imu, 5 of 5 rows of baro are lost" in told
