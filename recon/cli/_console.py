"""Standard output and error: plain text as wide as it is, never cut or coloured."""

from __future__ import annotations

import errno
import json
import os
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from contextvars import ContextVar
from io import TextIOWrapper
from typing import Any, Final, TextIO

from recon.errors import StorageError

_VISIBLE: Final = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160)) if code != ord("\n")}
"""Control characters, which a log may hold and a terminal obeys, as text."""


_OUTPUT: Final[ContextVar[TextIO | None]] = ContextVar("output", default=None)
"""Standard output, while sys.stdout is another stream."""


def prepare() -> None:
    """Have both streams there, and replace what they cannot show instead of failing at it."""
    sys.stdout = sys.stdout or os.fdopen(os.open(os.devnull, os.O_WRONLY), "w")  # None where the caller closed it
    sys.stderr = sys.stderr or os.fdopen(os.open(os.devnull, os.O_WRONLY), "w")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")


@contextmanager
def only_results() -> Iterator[None]:
    """In this block standard output has what `write` gives; what stages print goes to standard error."""
    before = _OUTPUT.set(_output())
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        _OUTPUT.reset(before)


def _output() -> TextIO:
    return _OUTPUT.get() or sys.stdout


def write(text: str) -> None:
    """A line, or several, on standard output. Raises BrokenPipeError, or StorageError where it cannot be written."""
    try:
        _output().write(text.translate(_VISIBLE) + "\n")
        _output().flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        if error.errno == errno.EINVAL and os.name == "nt":  # how Windows says that a pipe is broken
            raise BrokenPipeError from error
        abandon_output()
        raise StorageError(f"the output could not be written: {error.strerror or error}") from error


def write_error(text: str) -> None:
    """A line, or several, on standard error. On a terminal that is gone nobody reads it. Raises BrokenPipeError."""
    try:
        sys.stderr.write(text.translate(_VISIBLE) + "\n")
        sys.stderr.flush()
    except OSError as error:
        if error.errno != errno.EIO:
            raise


def abandon_output() -> None:
    """Let what is still buffered go nowhere, so that the interpreter does not complain of it at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), _output().fileno())


def write_json(data: Any) -> None:
    """JSON of ASCII characters, which every console and pipe carries."""
    write(json.dumps(data, indent=2, allow_nan=False))


def width() -> int | None:
    """Columns of the terminal that reads standard output, 120 at most; None where it is no terminal."""
    return min(shutil.get_terminal_size().columns, 120) if _output().isatty() else None


def table(rows: Sequence[Sequence[str]], indent: int = 2) -> str:
    """Rows of cells as aligned columns; columns that are empty throughout are left out."""
    used = [index for index in range(max(map(len, rows), default=0)) if any(row[index] for row in rows)]
    widths = {index: max(len(row[index]) for row in rows) for index in used}
    lines = ("  ".join(row[index].ljust(widths[index]) for index in used).rstrip() for row in rows)
    return "\n".join(" " * indent + line for line in lines)
