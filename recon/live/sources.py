"""Where the bytes of a log come from while it is written: a file that grows, standard input, a socket."""

from __future__ import annotations

import os
import queue
import socket
import sys
import threading
from collections.abc import Callable
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol, cast
from urllib.parse import urlsplit

from recon.errors import ConfigError, ReadFailed
from recon.problems import Problem, Where

if TYPE_CHECKING:
    from io import BufferedReader

STANDARD_INPUT: Final = "-"
_MOST: Final = 1 << 22
"""Bytes that are taken at once."""


class ByteSource(Protocol):
    """Bytes as they come. name : for messages; ended : will there be no more?; broken : why, where nobody meant it"""

    name: str
    ended: bool
    broken: str

    def take(self) -> bytes:
        """What has come since; b"" where nothing has."""
        ...

    def close(self) -> None:
        """Leave it."""
        ...


def open_source(where: str, offset: int = 0) -> ByteSource:
    """The source that a user names: "-", "tcp://127.0.0.1:5000", or a file, from an offset on.

    Raises ConfigError for an address that is not on this machine, ReadFailed where there is nothing to read.
    """
    if where == STANDARD_INPUT:
        # past the buffer: a thread that waits inside it holds its lock, and the interpreter cannot end then
        return Pipe("standard input", cast("BufferedReader", sys.stdin.buffer).raw.read, lambda: None)
    if where.startswith("tcp://"):
        return _socket(where)
    return GrowingFile(Path(where), offset)


class GrowingFile:
    """A file that another program appends to."""

    def __init__(self, path: Path, offset: int = 0) -> None:
        try:
            self._file = path.open("rb")
        except FileNotFoundError as error:
            raise ReadFailed(path, "there is no such file", hint="start the logger first") from error
        except IsADirectoryError as error:
            raise ReadFailed(path, "this is a folder", hint="name the log that grows in it") from error
        except OSError as error:
            raise ReadFailed(path, f"it cannot be read: {error.strerror or error}") from error
        self._file.seek(offset)
        self.name, self.ended, self.broken = str(path), False, ""

    def take(self) -> bytes:
        """What was appended since; it ends where the file has become shorter, for its rows are others then."""
        data = self._file.read(_MOST)
        if not data and os.fstat(self._file.fileno()).st_size < self._file.tell():
            self.ended, self.broken = True, "the file was begun anew"
        return data

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class Pipe:
    """Bytes that block until they come, read by a thread of its own. read : up to so many bytes, b"" at the end."""

    def __init__(self, name: str, read: Callable[[int], bytes], close: Callable[[], None]) -> None:
        self.name, self.ended, self.broken, self._close = name, False, "", close
        self._left = False
        self._come: queue.Queue[bytes] = queue.Queue(maxsize=64)
        threading.Thread(target=self._follow, args=(read,), daemon=True).start()

    def _follow(self, read: Callable[[int], bytes]) -> None:
        data = b" "
        while data:
            try:
                data = read(1 << 16)
            except OSError as error:
                data = b""
                self.broken = "" if self._left else error.strerror or str(error)
            self._come.put(data)

    def take(self) -> bytes:
        """What has come since."""
        parts = []
        while not self._come.empty() and not self.ended:
            parts.append(self._come.get())
            self.ended = not parts[-1]
        return b"".join(parts)

    def close(self) -> None:
        """Leave it."""
        self._left = True
        self._close()


def _socket(where: str) -> Pipe:
    parts = urlsplit(where)
    option = Where("SOURCE")
    try:
        host, port = parts.hostname or "", parts.port
    except ValueError:
        host, port = "", None
    if not host or port is None:
        text = f"'{where}' is no address"
        raise ConfigError([Problem(option, "bad-option", text, "write tcp://127.0.0.1:5000")])
    if host != "localhost" and not _loopback(host):
        text = f"{host} is not an address of this machine"
        raise ConfigError(
            [Problem(option, "bad-option", text, "let a program here forward it to tcp://127.0.0.1:PORT")]
        )
    try:
        line = socket.create_connection((host, port), timeout=10.0)
    except OSError as error:
        raise ReadFailed(where, f"nobody answers: {error.strerror or error}", hint="start the sender first") from error
    line.settimeout(None)
    return Pipe(where, line.recv, line.close)


def _loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False
