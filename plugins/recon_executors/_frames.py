"""Objects through a pipe: each pickled, behind its length as eight bytes.

Both ends are processes of one batch; nothing else can write into the pipe.
"""

from __future__ import annotations

import struct
from multiprocessing.reduction import ForkingPickler
from typing import IO, Any, Final

_LENGTH: Final = struct.Struct("<Q")


def send(pipe: IO[bytes], value: object) -> None:
    """Write an object. Raises OSError where nobody reads any more, and what pickling it raises."""
    frame = ForkingPickler.dumps(value)
    pipe.write(_LENGTH.pack(len(frame)))
    pipe.write(frame)
    pipe.flush()


def receive(pipe: IO[bytes]) -> bytes | None:
    """The next object, still pickled; None where the other end is gone."""
    head = pipe.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        return None
    (length,) = _LENGTH.unpack(head)
    frame = pipe.read(length)
    return frame if len(frame) == length else None


def unpack(frame: bytes) -> Any:
    """The object."""
    return ForkingPickler.loads(frame)
