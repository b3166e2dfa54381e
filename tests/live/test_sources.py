"""Bytes from files that grow, from sockets of this machine, and from nowhere else."""

from __future__ import annotations

import socket
import struct
import sys
import time

import pytest

from recon.errors import ConfigError, ReadFailed
from recon.live.sources import open_source

_LINGER = "hh" if sys.platform == "win32" else "ii"


def all_of(source, seconds=5.0):
    data, until = b"", time.monotonic() + seconds
    while not source.ended and time.monotonic() < until:
        data += source.take()
        time.sleep(0.01)
    return data


def test_a_file_gives_what_is_appended(tmp_path):
    path = tmp_path / "log.txt"
    path.write_bytes(b"one\n")
    source = open_source(str(path))
    assert source.take() == b"one\n"
    assert source.take() == b""
    with path.open("ab") as file:
        file.write(b"two\n")
    assert source.take() == b"two\n"
    assert not source.ended
    source.close()


def test_a_file_is_read_from_an_offset(tmp_path):
    path = tmp_path / "log.txt"
    path.write_bytes(b"one\ntwo\n")
    source = open_source(str(path), 4)
    assert source.take() == b"two\n"
    source.close()


def test_a_file_that_is_begun_anew_ends_and_says_so(tmp_path):
    path = tmp_path / "log.txt"
    path.write_bytes(b"one\ntwo\n")
    source = open_source(str(path))
    source.take()
    assert not source.ended
    path.write_bytes(b"1\n")
    assert source.take() == b""
    assert source.ended
    assert source.broken == "the file was begun anew"
    source.close()


def test_a_file_that_is_not_there_is_a_sentence(tmp_path):
    with pytest.raises(ReadFailed, match="there is no such file"):
        open_source(str(tmp_path / "none.txt"))


def test_a_socket_gives_all_until_the_sender_ends():
    with socket.create_server(("127.0.0.1", 0)) as server:
        source = open_source(f"tcp://127.0.0.1:{server.getsockname()[1]}")
        line, _ = server.accept()
        with line:
            line.sendall(b"one\n" * 50_000)
        assert all_of(source) == b"one\n" * 50_000
        assert source.ended
        assert not source.broken
        source.close()


def test_a_socket_that_breaks_off_says_why():
    with socket.create_server(("127.0.0.1", 0)) as server:
        source = open_source(f"tcp://127.0.0.1:{server.getsockname()[1]}")
        line, _ = server.accept()
        line.sendall(b"one\n")
        until = time.monotonic() + 5.0
        while not source.take() and time.monotonic() < until:
            time.sleep(0.01)
        line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack(_LINGER, 1, 0))  # close resets the connection
        line.close()
        all_of(source)
        assert source.ended
        assert source.broken
        source.close()


@pytest.mark.parametrize(
    "where", ["tcp://192.0.2.1:5000", "tcp://example.org:80", "tcp://127.0.0.1", "tcp://127.0.0.1:x"]
)
def test_addresses_elsewhere_are_refused(where):
    with pytest.raises(ConfigError):
        open_source(where)


def test_nobody_there_is_a_sentence():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(ReadFailed, match="nobody answers"):
        open_source(f"tcp://127.0.0.1:{port}")
