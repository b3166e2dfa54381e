"""The errors that recon raises, and the exit code that each one means.

    ReconError                      1
      ConfigError(problems)         2   a pipeline, a batch file or an option is wrong
      PluginError                   3   a stage is missing, broken, claimed twice or badly declared
        PluginNotFound, PluginBroken, PluginConflict, PluginInvalid
      DataError                     4   a log cannot be read, or does not hold what a step needs
        ReadFailed, UnknownFormat, NothingUsable, NotEnoughData, NothingToExport
      StageError                    5   anything else that came out of a stage
        ContractError                   what it returned is not what it declared
      Difference                    7   a sealed run is not as it was, or does not come out again
      StorageError                  8   a result could not be written

A user sees `message` and `hint`, never a traceback. `message` is one sentence that says what is wrong and where;
`hint` is one sentence that says what to do.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import ClassVar

from recon.problems import Problem

EXIT_INTERRUPTED = 130


class ReconError(Exception):
    """Base of every error that recon raises on purpose."""

    exit_code: ClassVar[int] = 1

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint

    def __str__(self) -> str:
        return f"{self.message}\n  {self.hint}" if self.hint else self.message

    def __reduce__(self) -> tuple[object, ...]:
        """Errors cross process borders: rebuild them from their state, not from a constructor's arguments."""
        return (_rebuild, (type(self), self.args, self.__dict__.copy()))


def _rebuild(cls: type[ReconError], args: tuple[object, ...], state: dict[str, object]) -> ReconError:
    error = cls.__new__(cls)
    error.args = args
    error.__dict__.update(state)
    return error


class ConfigError(ReconError):
    """Every problem found in pipelines, batch files and options, reported together."""

    exit_code = 2

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems: Sequence[Problem] = tuple(problems)
        super().__init__("\n".join(problem.as_text() for problem in self.problems))


class PluginError(ReconError):
    """A stage that cannot be used."""

    exit_code = 3


class PluginNotFound(PluginError):
    """No installed distribution declares a stage of that name."""


class PluginBroken(PluginError):
    """The module of a stage cannot be imported, declares nothing under its name, or is made for a newer recon."""


class PluginConflict(PluginError):
    """Two distributions claim one stage name."""


class PluginInvalid(PluginError):
    """A record breaks the rules of its role: argument names, parameter class, streams."""


class DataError(ReconError):
    """A log that cannot be read or does not hold what is needed."""

    exit_code = 4


class ReadFailed(DataError):
    """An input file that cannot be read.

    path : the file; line and column : where in it, 1-based, None where the format has no lines; what : what is wrong.
    """

    def __init__(
        self, path: Path | str, what: str, *, line: int | None = None, column: int | None = None, hint: str = ""
    ) -> None:
        self.path, self.what, self.line, self.column = Path(path), what, line, column
        place = ":".join(str(part) for part in (path, line, column) if part is not None)
        super().__init__(f"{place}: {what}", hint)


class UnknownFormat(ReadFailed):
    """An input file that no reader knows."""


class NothingUsable(ReadFailed):
    """An input file of a known format that holds no stream of those that recon uses."""


class NotEnoughData(DataError):
    """A stage needs more of something than the log holds: `what`, how much is `needed`, how much was `found`."""

    def __init__(self, what: str, *, needed: str, found: str, hint: str = "") -> None:
        self.what, self.needed, self.found = what, needed, found
        super().__init__(f"not enough {what}: needs {needed}, found {found}", hint)


class NothingToExport(DataError):
    """The drive holds nothing of what an exporter shows, as a map without a place: the run and its other exports stand.

    What the exporter was told to use and cannot find is another error.
    """


class StageError(ReconError):
    """A step failed in a way that its author did not foresee."""

    exit_code = 5

    def __init__(self, step: str, message: str, hint: str = "") -> None:
        self.step = step
        super().__init__(f"step {step}: {message}", hint)


class ContractError(StageError):
    """A step returned something else than its record declares."""


class Difference(ReconError):
    """A sealed run is not as it was sealed, or does not come out again: the first difference.

    streams : where it was run again, how alike each stream came out, as JSON holds it
    """

    exit_code = 7
    streams: tuple[Mapping[str, object], ...] = ()


class StorageError(ReconError):
    """A result could not be written; nothing that looks whole is left behind."""

    exit_code = 8
