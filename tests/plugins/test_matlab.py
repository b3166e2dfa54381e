"""Structures of .mat files, held against SciPy, which writes and reads them on its own road."""

from __future__ import annotations

import struct
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
from array_logs import navego_gnss, navego_imu, save_mat
from scipy.io import loadmat

from recon_readers import _matlab
from recon_readers._matlab import byte_order, structures

KINDS = ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8")


@pytest.mark.parametrize("compressed", [True, False])
def test_fields_of_all_kinds_of_numbers_are_those_that_scipy_reads(tmp_path: Path, compressed: bool) -> None:
    rng = np.random.default_rng(1)
    fields = {f"of_{kind}": rng.integers(0, 100, (7, 3)).astype(kind) for kind in KINDS}
    fields |= {"one": 5.0, "row": np.arange(4.0)[None], "column": np.arange(4.0)[:, None], "none": np.zeros((0, 0))}
    path = save_mat(tmp_path / "x.mat", compressed, some=fields, other={"a": 1.0}, number=3.0, text="none")
    found = structures(path.read_bytes())
    assert list(found) == ["some", "other"]
    peer = loadmat(path)["some"][0, 0]
    assert set(found["some"]) == set(peer.dtype.names)
    for name, values in found["some"].items():
        np.testing.assert_array_equal(values, peer[name], strict=False)
        assert values.shape == peer[name].shape


def test_fields_that_hold_no_real_numbers_are_none(tmp_path: Path) -> None:
    path = save_mat(tmp_path / "x.mat", some={"text": "word", "inner": {"a": 1.0}, "complex": 1j, "number": 2.0})
    found = structures(path.read_bytes())["some"]
    assert [name for name, values in found.items() if values is None] == ["text", "inner", "complex"]


def big_endian(kind: int, contents: bytes) -> bytes:
    return struct.pack(">II", kind, len(contents)) + contents + bytes(-len(contents) % 8)


def test_a_file_of_big_endian_numbers_is_read() -> None:
    """As the format's document lays it out: flags, dimensions, name, then numbers or fields."""
    one_by_one = big_endian(5, struct.pack(">ii", 1, 1))
    number = big_endian(6, struct.pack(">II", 6, 0)) + one_by_one + big_endian(1, b"")
    number = big_endian(14, number + big_endian(9, struct.pack(">d", 2.5)))
    short = struct.pack(">HHi", 4, 5, 8)  # tag and contents in eight bytes: the length of names
    fields = big_endian(6, struct.pack(">II", 2, 0)) + one_by_one + big_endian(1, b"some")
    whole = big_endian(14, fields + short + big_endian(1, b"a".ljust(8, b"\0")) + number)
    data = b"MATLAB 5.0".ljust(124) + b"\x01\x00MI" + whole
    assert byte_order(data) == ">"
    assert structures(data)["some"]["a"].tolist() == [[2.5]]


@pytest.mark.parametrize("compressed", [True, False])
def test_a_damaged_or_cut_file_gives_structures_or_value_error(tmp_path: Path, compressed: bool) -> None:
    data = save_mat(tmp_path / "x.mat", compressed, imu=navego_imu(), gnss=navego_gnss()).read_bytes()
    rng = np.random.default_rng(4)
    refused = 0
    for position in rng.integers(128, 2000, 300).tolist():
        for damaged in (data[:position] + bytes([rng.integers(256)]) + data[position + 1 :], data[:position]):
            try:
                structures(damaged)
            except ValueError:
                refused += 1
    assert refused > 100  # half of them are cut, a few of these between two structures


@pytest.mark.parametrize("data", [b"", b"MATLAB 5.0".ljust(128), b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + b"\1"])
def test_what_is_no_file_of_matlab_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError):
        structures(data)


def test_real_files_are_read_as_scipy_reads_them(logs: Path) -> None:
    for path in sorted(logs.glob("navego_*/**/*.mat")):
        peer = {name: value[0, 0] for name, value in loadmat(path).items() if not name.startswith("__")}
        found = structures(path.read_bytes())
        assert set(found) == set(peer)
        for name, fields in found.items():
            assert set(fields) == set(peer[name].dtype.names)
            for field, values in fields.items():
                np.testing.assert_array_equal(values, peer[name][field])


def test_a_small_file_that_unpacks_to_all_memory_is_refused_before_it_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Zeros pack a thousandfold. Two elements that fit alone are refused together."""
    monkeypatch.setattr(_matlab, "LARGEST_UNPACKED", 1_500_000)
    small = save_mat(tmp_path / "small.mat", imu={"a": np.zeros(100_000)})
    assert small.stat().st_size < 3000
    assert structures(small.read_bytes())["imu"]["a"].size == 100_000
    for name, many in (
        ("one", {"imu": {"a": np.zeros(200_000)}}),
        ("two", {"imu": {"a": np.zeros(100_000)}, "gps": {"a": np.zeros(100_000)}}),
    ):
        path = save_mat(tmp_path / f"{name}.mat", **many)
        assert path.stat().st_size < 6000
        with pytest.raises(ValueError, match="unpacks to more than 2 MB"):
            structures(path.read_bytes())


def test_small_numbers_that_become_doubles_are_counted_as_such(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_matlab, "LARGEST_UNPACKED", 1_500_000)
    path = save_mat(tmp_path / "bytes.mat", imu={"a": np.zeros(100_000, "i1"), "b": np.zeros(100_000, "i1")})
    with pytest.raises(ValueError, match="take more than 2 MB as doubles"):
        structures(path.read_bytes())


def little_endian(kind: int, contents: bytes) -> bytes:
    return struct.pack("<II", kind, len(contents)) + contents + bytes(-len(contents) % 8)


ONE_BY_ONE = little_endian(5, struct.pack("<ii", 1, 1))
NAME = little_endian(1, b"imu")
MANY = 2_000_000


@pytest.mark.parametrize(
    ("inner", "told"),
    [
        (ONE_BY_ONE + NAME + bytes(MANY), "more than 10,000 parts"),
        (little_endian(1, b"\1" * MANY) + NAME, "2,000,000 bytes"),
        (ONE_BY_ONE + NAME + little_endian(1, b"\1" * MANY) + NAME, "2,000,000 bytes"),
        (ONE_BY_ONE + NAME + little_endian(5, struct.pack("<i", 1)) + little_endian(1, b"a" * MANY), "2,000,000 names"),
    ],
    ids=["parts", "shape", "width of names", "names"],
)
def test_what_unpacks_to_many_small_parts_is_refused_before_they_fill_the_memory(inner: bytes, told: str) -> None:
    """Python takes some hundred bytes for each part, a hundredfold of what is in the file."""
    flags = little_endian(6, struct.pack("<II", 2, 0))
    packed = zlib.compress(little_endian(14, flags + inner))
    data = b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + struct.pack("<II", 15, len(packed)) + packed
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=told):
            structures(data)
        assert tracemalloc.get_traced_memory()[1] < 4 * MANY
    finally:
        tracemalloc.stop()
