"""The records by which plugins declare stages, one class per role.

A stage is data about a pure function: what it is called, what parameters it takes, which streams and columns it
reads and writes, and the function itself. The framework calls the function with Arrow tables by name; anybody else
may call it just so.

    role                                             run
    Reader                                           run(path, params) -> Streams
    Simulator                                        run(params) -> Streams
    Filter Detector Aligner Integrator Fuser Analyzer  run(*, <stream> ..., params) -> Streams
    Exporter                                         run(*, <stream> ..., folder, about, params) -> list[Path]
    Executor                                         run(jobs, params) -> Iterator[Outcome]

The names of a function's arguments are the keys of `reads`. A stage may always return `metrics` rows; it neither
prints nor logs. Raise DataError or NotEnoughData for data that do not suffice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Final, Protocol

from recon.declaration import Stage
from recon.parameters import Params, setting
from recon.schema import APPENDED, unnumbered

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from recon.tables import Streams


@dataclass(frozen=True)
class Sniff:
    """How sure a reader is that a file is its own: confidence 0 to 1, and why, as a phrase that users read."""

    confidence: float
    reason: str


@dataclass(frozen=True)
class Wanted:
    """What the steps behind a reader read of its streams.

    columns : names by stream; None where everything is wanted
    """

    columns: Mapping[str, frozenset[str]] | None = None

    def of(self, stream: str, columns: Iterable[str]) -> tuple[str, ...]:
        """Those of a stream's columns that are wanted; none where the stream is not. A further sensor's stream, such
        as imu_2, is wanted together with the first.
        """
        names = tuple(columns)
        if self.columns is None:
            return names
        known = [wanted for name, wanted in self.columns.items() if unnumbered(name) == unnumbered(stream)]
        return tuple(name for name in names if any(name in wanted for wanted in known))


EVERYTHING: Final = Wanted()


class Delegation(Params):
    """Parameters of a reader that hands over to other readers."""

    readers: dict[str, dict[str, Any]] = setting({}, doc="Parameters of other readers, by their names.")


@dataclass(frozen=True, kw_only=True)
class Reader(Stage):
    """Reads one file or folder; what depends on the file is optional in `writes`.

    sniff : (path, the first 64 KiB, b"" for a folder) -> Sniff; None for a reader that must be named
    propose : (paths of a drive that no reader knows) -> YAML from which the user can start, with comments that say how
        to use it; None where there is nothing to propose
    lines : (path, params, stream, (n,) int64 ns since 1970) -> (n,) int64, the lines of the file, from 1, that hold the
        rows of a stream at these times, 0 where there is none; None for files without lines
    self_describing : its tables carry units, frames and quantities themselves, as files of our own do; streams and
        columns beyond `writes` are taken as they are
    selective : it can leave streams and columns in the file that no later step reads; its function also takes
        `wanted`, a Wanted
    params : a subclass of Delegation for a reader that hands over to others; its function also takes `registry`
    """

    role: ClassVar[str] = "reader"
    given: ClassVar[tuple[str, ...]] = ("path", "params")

    sniff: Callable[..., Sniff] | None = None
    propose: Callable[..., str | None] | None = None
    lines: Callable[..., NDArray[np.int64]] | None = None
    self_describing: bool = False
    selective: bool = False

    @property
    def delegates(self) -> bool:
        """Does it hand over to other readers?"""
        return issubclass(self.params, Delegation)

    def _also_given(self) -> set[str]:
        return set(["registry"] * self.delegates + ["wanted"] * self.selective)


@dataclass(frozen=True, kw_only=True)
class Simulator(Stage):
    """Makes a recording from parameters and a seed alone.

    ideal : parameters, in SI, with which its imu and gnss measure what its `reference` holds, without error; empty
        where it is not held to that
    """

    role: ClassVar[str] = "simulator"

    ideal: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Filter(Stage):
    """Gives streams of the same name, cleaned or completed.

    linear : scaling the vectors and scalars that it changes scales its result
    unit_gain : what is constant passes unchanged
    resamples : it may return rows at times that it was not given
    """

    role: ClassVar[str] = "filter"

    linear: bool = False
    unit_gain: bool = False
    resamples: bool = False


@dataclass(frozen=True, kw_only=True)
class Detector(Stage):
    """Finds events."""

    role: ClassVar[str] = "detector"


@dataclass(frozen=True, kw_only=True)
class Aligner(Stage):
    """Turns or shifts streams into another frame or clock.

    rotation : it turns vectors and does nothing else to them
    """

    role: ClassVar[str] = "aligner"

    rotation: bool = False


@dataclass(frozen=True, kw_only=True)
class Integrator(Stage):
    """Integrates rates to attitude, or accelerations to motion.

    order : its error on a smooth motion falls with this power of the step; 0 where none is claimed
    """

    role: ClassVar[str] = "integrator"

    order: int = 0


class Live(Protocol):
    """A stage that follows a drive while it goes on.

    since_ns : rows from this time on, ns since 1970, are needed again by one that goes on from what was saved
    awaits : what is missing before anything can be told, in a few words that follow "waiting for"; "" while it tells
    unused : what it was given and makes nothing of, though the same stage does of a whole drive, in a few words each
    """

    since_ns: int
    awaits: str
    unused: tuple[str, ...]

    def advance(self, new: Streams) -> Streams:
        """Take rows that follow those given before, by stream.

        returns : `trajectory`, the rows that are final and follow those returned before, and `latest`, the newest row
            that is known, which may still change; {} while nothing can be told yet
        """
        ...

    def finish(self) -> Streams:
        """The rest of `trajectory`, where no more rows will come."""
        ...

    def saved(self) -> bytes:
        """All that another one needs to go on from here; b"" while there is nothing."""
        ...


@dataclass(frozen=True, kw_only=True)
class Fuser(Stage):
    """Combines several sensors to one trajectory, or several of one kind to one.

    budget : m, root mean square of the horizontal error that it stays below on the drives of `recon.testing`, whose
        GNSS positions err by 1 m on each axis; None where none is claimed
    live : makes one that follows a drive while it goes on, from (params, lag, saved): lag in s, how long a row waits
        before it is final; saved, what an earlier one saved, or None. None where the stage needs the whole drive
    """

    role: ClassVar[str] = "fuser"

    budget: float | None = None
    live: Callable[[Any, float, bytes | None], Live] | None = None


@dataclass(frozen=True, kw_only=True)
class Analyzer(Stage):
    """Adds metrics, events, residuals and new streams; replaces none.

    compares : two of the streams that it reads, whose difference its metrics named *_error measure; they are zero
        where the two are the same; None where it compares nothing
    """

    role: ClassVar[str] = "analyzer"

    compares: tuple[str, str] | None = None

    def faults(self) -> list[str]:
        """As for every stage; also streams that it would replace."""
        replaced = sorted(set(self.writes) & set(self.reads) - set(APPENDED))
        return super().faults() + [
            f"it writes '{name}', which it reads: an analyzer replaces none" for name in replaced
        ]


@dataclass(frozen=True, kw_only=True)
class Exporter(Stage):
    """Writes files into a folder.

    repeats : the same streams, `about` and parameters give the same bytes again, so that `recon verify` can hold the
        files against the results; what `about` tells of the machine and the time of day is not in them
    made_with : distributions whose versions decide those bytes beside recon's own needs, such as "matplotlib"
    """

    role: ClassVar[str] = "exporter"
    given: ClassVar[tuple[str, ...]] = ("folder", "about", "params")

    repeats: bool = True
    made_with: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Executor(Stage):
    """Runs the jobs of a batch.

    isolates : a job that kills its process, takes more than its time or more than its memory ends alone
    """

    role: ClassVar[str] = "executor"
    given: ClassVar[tuple[str, ...]] = ("jobs", "params")

    isolates: bool = False


ROLES: Final[Mapping[str, type[Stage]]] = {
    record.role: record
    for record in (
        Reader, Simulator, Filter, Detector, Aligner, Integrator, Fuser, Analyzer, Exporter, Executor
    )
}  # fmt: skip


def role_of(key: str) -> str:
    """Role of "<role>.<name>"; "" where it is none."""
    role, dot, name = key.partition(".")
    return role if dot and name and role in ROLES else ""
