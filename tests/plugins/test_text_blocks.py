"""Texts in blocks: what is read does not depend on where a block ends."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import phone_logs
import pytest
from fuzz import log_files
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import recon
from recon import ReadFailed
from recon_readers import _nmea_sentences, _novatel_logs, _text_blocks, sbet
from recon_readers._columns import Columns
from recon_readers._text_blocks import Text, plain

TEXTS = st.text(alphabet='ab,\n\r"\ufeffé', max_size=60)


def streams(path: Path, **parameters: object) -> dict[str, object]:
    """What was read, without the names of files."""
    found = recon.read(path, **parameters)
    return {name: found[name] for name in found if name != "metrics"}


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=TEXTS, size=st.integers(3, 12), encoding=st.sampled_from(["utf-8", "utf-16", None]))
def test_blocks_make_up_the_text(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, size: int, encoding: str | None
) -> None:
    monkeypatch.setattr(_text_blocks, "BLOCK", size)
    path = tmp_path / "log.txt"
    path.write_bytes(text.encode(encoding or "utf-8"))
    opened = Text.open(path, encoding)
    assert opened.whole() == plain(text.encode())
    assert (opened.size, opened.lines) == (len(opened.whole()), opened.whole().count(b"\n"))
    for quoted in (False, True):
        blocks = list(opened.blocks(quoted=quoted))
        assert b"".join(blocks) == opened.whole()
        assert all(block.endswith(b"\n") for block in blocks[:-1])
        assert not quoted or all(block.count(b'"') % 2 == 0 for block in blocks[:-1])


@given(text=TEXTS, ends=st.tuples(st.integers(0, 70), st.integers(0, 70)))
def test_a_part_of_a_text_is_that_part(text: str, ends: tuple[int, int]) -> None:
    start, end = sorted(ends)
    whole = text.encode()
    assert b"".join(Text.of(Path("a"), whole).blocks(start, end)) == whole[start:end]


@given(st.lists(st.lists(st.floats(), max_size=5), max_size=5), st.booleans())
def test_columns_that_grow_hold_what_came(blocks: list[list[float]], repeated: bool) -> None:
    arrays = [np.array(block, dtype=np.float64) for block in blocks]
    made = Columns.of(((0.5, {"a": block}) for block in arrays), repeated=["a"] if repeated else [])
    if arrays:
        np.testing.assert_array_equal(made["a"], np.concatenate(arrays))


def test_a_column_that_a_block_lacks_is_nan_there() -> None:
    made = Columns.of([(0.3, {"a": np.ones(2)}), (0.7, {"a": np.ones(1), "b": np.ones(1)}), (1.0, {"a": np.ones(2)})])
    np.testing.assert_array_equal(made["b"], [np.nan, np.nan, 1.0, np.nan, np.nan])


def rows_of_csv(count: int) -> str:
    rng = np.random.default_rng(1)
    rows = [f"{n / 100:.2f},{x:.6f},{y:.6f},{z + 9.8:.6f}" for n, (x, y, z) in enumerate(rng.normal(size=(count, 3)))]
    rows[7] = "# a comment"
    rows[31] = "   "
    return "t,ax,ay,az\r\n" + "\r\n".join(rows) + "\r\n"


MAPPING = {
    "imu": {
        "time": {"column": "t", "format": "relative", "unit": "s"},
        "accel": {"columns": ["ax", "ay", "az"], "unit": "m/s^2"},
    }
}


def test_a_csv_is_read_alike_in_blocks_of_any_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(rows_of_csv(100).encode())
    whole = streams(path, **{"reader.csv.columns": MAPPING})
    for size in (16, 100, 999):
        monkeypatch.setattr(_text_blocks, "BLOCK", size)
        assert streams(path, **{"reader.csv.columns": MAPPING}) == whole


@pytest.mark.parametrize(("bad", "column"), [("x", 6), ("1.0,2.0", None)])
def test_a_fault_is_found_in_its_line_whatever_the_block(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bad: str, column: int | None
) -> None:
    lines = rows_of_csv(100).split("\r\n")
    time, *others = lines[61].split(",")
    lines[61] = ",".join([time, bad, *others[1:]])
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    monkeypatch.setattr(_text_blocks, "BLOCK", 100)
    with pytest.raises(ReadFailed) as raised:
        recon.read(path, **{"reader.csv.columns": MAPPING})
    assert (raised.value.line, raised.value.column) == (62, column)


def test_a_quote_that_is_never_closed_is_found_though_it_is_megabytes_before_the_end(tmp_path: Path) -> None:
    lines = rows_of_csv(60_000).split("\r\n")
    lines[10_000] += '"'
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(ReadFailed, match="never closed") as raised:
        recon.read(path, **{"reader.csv.columns": MAPPING})
    assert raised.value.line == 10_001


def test_a_physycom_log_is_read_alike_in_blocks_of_any_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    path = tmp_path / "log.txt"
    with path.open("w", encoding="ascii", newline="") as file:
        for n, imu in enumerate(rng.normal(size=(400, 6)) * 0.01 + (0, 0, 1, 0, 0, 0)):
            gnss = (44.5 + n // 100 * 1e-5, 11.3, 60 + n // 100, 90, 36)
            numbers = "\t".join(f"{value:.6f}" for value in (*gnss, *imu, np.linalg.norm(imu[:3]), n / 100))
            file.write(f"{400_000_000 + n // 100}.{n % 100:02}\t{numbers}\n")
    whole = streams(path)
    assert set(whole) == {"imu", "gnss"}
    for size in (100, 5000):
        monkeypatch.setattr(_text_blocks, "BLOCK", size)
        assert streams(path) == whole


FILES = {
    "vbox": {"drive.vbo": log_files.vbo()},
    "rtklib": {"drive.pos": log_files.rtklib()},
    "kf_gins": log_files.kf_gins(),
    "nhtsa": log_files.nhtsa(),
    "novatel": {"drive.log": log_files.novatel_ascii()},
    "novatel, binary": {"drive.pcap": log_files.novatel_packets()},
    "sbet": {"drive.sbet": log_files.sbet()},
    "sensor_logger": {name: text.encode() for name, text in phone_logs.sensor_logger(phone_logs.logged()).items()},
    "phyphox": {name: text.encode() for name, text in phone_logs.phyphox(phone_logs.logged(), ";", ",").items()},
    "gnsslogger": {"log.txt": phone_logs.gnsslogger(phone_logs.logged()).encode()},
}
"""Files of a log by the reader that knows it."""


@pytest.mark.parametrize("name", FILES)
def test_a_log_is_read_alike_in_blocks_of_any_size_also_where_a_line_is_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """Blocks of novatel cannot be smaller than a log of it, those of SBET than its sample is."""
    for damaged in (False, True):
        folder, binary = tmp_path / str(damaged), name in ("sbet", "novatel, binary")
        for file, content in FILES[name].items():
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            at = content.find(b"\n", 2 * len(content) // 3)
            torn = content[:at] + b"\nx y z" + content[at:] if damaged and not binary else content
            (folder / file).write_bytes(torn)
        path = folder if len(FILES[name]) > 1 else next(folder.iterdir())
        with monkeypatch.context() as small:
            whole = recon.read(path)
            small.setattr(_text_blocks, "BLOCK", 1000)
            small.setattr(_novatel_logs, "BLOCK", 10_000)
            small.setattr(sbet, "_stretches", lambda path, count: _in_sevens(path, count))
            assert dict(recon.read(path).items()) == dict(whole.items())


def _in_sevens(path: Path, count: int) -> Iterator[tuple[int, np.ndarray]]:
    records = np.fromfile(path, dtype="<f8")[: count * 17].reshape(-1, 17)
    yield from ((min(at + 7, count), records[at : at + 7]) for at in range(0, count, 7))


def test_nmea_is_read_alike_in_blocks_of_any_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sentences = []
    for second in range(300):
        clock = f"12{second // 60:02}{second % 60:02}.00"
        bodies = [
            f"GPRMC,{clock},A,4430.{second:05},N,01118.0,E,19.4,90.0,010625,,,A",
            "GPVTG,91.0,T,,M,19.9,N,36.0,K,A",
            f"GPGGA,{clock},4430.{second:05},N,01118.0,E,4,12,0.7,60.1,M,44.5,M,,",
        ]
        for body in bodies:
            sum_ = int(np.bitwise_xor.reduce(np.frombuffer(body.encode(), dtype=np.uint8)))
            sentences.append(f"${body}*{sum_:02X}\r\n")
    path = tmp_path / "log.nmea"
    path.write_text("".join(sentences), encoding="ascii", newline="")
    whole = streams(path)
    for size in (300, 1000, 7777):
        monkeypatch.setattr(_nmea_sentences, "BLOCK", size)
        assert streams(path) == whole
