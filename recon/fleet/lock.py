"""One batch at a time on one root.

On a file system the lock is one of the operating system and dies with the process that holds it. An object store has
no locks: there the holder renews an object every few seconds, and one that is renewed no more counts for nothing.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from secrets import token_hex
from threading import Event, Thread
from typing import Final

from recon.errors import ConfigError
from recon.fleet.places import Place
from recon.problems import Problem
from recon.storage.atomic import storage_errors

NAME: Final = ".lock"
BEAT_S: Final = 3.0
"""Between two renewals of a lease."""
DEAD_S: Final = 10.0
"""A lease that was not renewed for so long is that of a dead process; more than three beats."""
SETTLE_S: Final = 0.5
"""Of two that take a lease at once, the one that wrote last has it; so long each waits before it looks."""


@contextmanager
def locked(root: Path) -> Iterator[None]:
    """Hold the lock of a folder, which is there. Raises ConfigError where another process holds it, StorageError.

    The lock is on the file, not the file: it stays behind and means nothing.
    """
    with storage_errors(root / NAME):
        descriptor = os.open(root / NAME, os.O_RDWR | os.O_CREAT)  # not inherited by children (PEP 446)
    try:
        if not _taken(descriptor):
            raise _busy(str(root))
        yield
    finally:
        with suppress(OSError):
            os.close(descriptor)


def _taken(descriptor: int) -> bool:
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


@contextmanager
def leased(root: Place) -> Iterator[None]:
    """Hold the lease of a prefix in an object store. Raises ConfigError where another process holds it, OSError.

    Clocks are not compared: whoever finds a lease waits whether it is renewed.
    """
    place, owner = root / NAME, token_hex(8)
    held = _content(place)
    if held:
        time.sleep(DEAD_S)
        if _content(place) not in ("", held):
            raise _busy(str(root))
    _write(place, owner, 0)
    time.sleep(SETTLE_S)
    if not _content(place).startswith(owner):
        raise _busy(str(root))
    over = Event()
    beats = Thread(target=_beat, args=(place, owner, over), daemon=True)
    beats.start()
    try:
        yield
    finally:
        over.set()
        beats.join()
        with suppress(OSError):
            place.filesystem.delete_file(place.path)


def _beat(place: Place, owner: str, over: Event) -> None:
    number = 0
    while not over.wait(BEAT_S):
        number += 1
        with suppress(OSError):  # the next beat may get through
            _write(place, owner, number)


def _content(place: Place) -> str:
    """Owner and number of the last beat; "" where there is no lease."""
    try:
        with place.filesystem.open_input_stream(place.path) as file:
            return bytes(file.read()).decode(errors="replace")
    except FileNotFoundError:
        return ""


def _write(place: Place, owner: str, number: int) -> None:
    with place.filesystem.open_output_stream(place.path) as file:
        file.write(f"{owner} {number}".encode())


def _busy(root: str) -> ConfigError:
    text = f"another batch is at work on {root}"
    return ConfigError([Problem(None, "output-busy", text, "wait for it, or choose another output")])
