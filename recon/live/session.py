"""`recon live`: a pipeline of a reader and a fuser that can follow, over a log that is still being written.

Bytes come from the source; whole lines of them, with the log's header before, are read by the reader of the pipeline as
a small log of their own; the fuser takes the rows, and gives those of the trajectory that are final. What comes at once
because the log is older than the session is taken in steps of ten seconds of the log, each with its result. A line that
the reader refuses is left out and counted.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from recon import __version__
from recon.check import check
from recon.errors import ConfigError, ReadFailed, ReconError
from recon.live.clock import Clock, times_of
from recon.live.output import GrowingResult
from recon.live.pieces import Pieces
from recon.live.sources import ByteSource, GrowingFile, open_source
from recon.live.units import Units
from recon.overrides import Override
from recon.pipeline import Pipeline
from recon.plan import PlannedStep
from recon.problems import Problem
from recon.recording import Recording
from recon.registry import Registry
from recon.runner import read_one
from recon.schema import APPENDED
from recon.stages import Fuser, Live, Reader
from recon.storage.atomic import staged_file, storage_errors
from recon.tables import Streams, select_rows, time_ns

_STEP_NS: Final = 10_000_000_000
_HEAD: Final = 1 << 16
"""Bytes that hold the header of a log."""
_MOST_BAD: Final = 100
"""Lines that cannot be read, with none between that can, of a log that is not what its reader takes."""
_OVERLAP: Final = 1 << 19
"""Bytes of rows that are read once more before new ones: some seconds of any IMU, several fixes of any receiver."""


@dataclass(frozen=True)
class Following:
    """The steps of a pipeline that a live run takes. left_out : ids of the others, which want the whole drive."""

    pipeline: str
    reader: PlannedStep
    fuser: PlannedStep
    left_out: tuple[str, ...]


def following(pipeline: Pipeline, registry: Registry, overrides: Iterable[Override] = ()) -> Following:
    """The reader and the first fuser that can follow; the steps between them may only add what it can do without.

    Raises ConfigError where the pipeline does not begin so.
    """
    plan, problems = check(pipeline, registry, overrides)
    if problems:
        raise ConfigError(problems)
    reader, *others = plan.steps
    fuser = next((step for step in others if isinstance(step.stage, Fuser)), None)
    between = others[: others.index(fuser)] if fuser is not None else []
    if (
        not isinstance(reader.stage, Reader)
        or fuser is None
        or not _follows(fuser)
        or not all(_spared(step, fuser) for step in between)
    ):
        text = f"recon live cannot follow '{pipeline.name}': it takes a reader and then a fuser that can, as fuser.map"
        raise ConfigError([Problem(reader.step.where, "not-live", text, "try recon live best_accuracy")])
    return Following(pipeline.name, reader, fuser, tuple(step.id for step in others if step is not fuser))


def _spared(step: PlannedStep, fuser: PlannedStep) -> bool:
    """Does a step change nothing that it reads, and add at most what the fuser can do without?"""
    made = set(step.outputs) - set(APPENDED)
    needed = {name for name, need in fuser.stage.reads.items() if not need.optional}
    return made.isdisjoint(step.inputs.values()) and made.isdisjoint(needed)


def _follows(step: PlannedStep) -> bool:
    return isinstance(step.stage, Fuser) and step.stage.live is not None


class Session:
    """A live run. Call `new` once in a while; `close` when it is over.

    out : MCAP file of the result; one that is there is gone on with, as is what lies beside it as `.state`
    lag : s, how long a row waits before it is final

    goes_on : were rows there already?; resumed : is the part of the log that they are of not read again?
    bad : what is wrong with each line that was left out

    Raises ReadFailed where there is nothing to read, ConfigError where what is there is of another log.
    """

    def __init__(self, steps: Following, source: str, out: Path, lag: float, registry: Registry) -> None:
        self.steps, self.registry = steps, registry
        self._state = out.with_suffix(".state")
        stage = steps.fuser.stage
        self._made_by = f"{stage.name} {stage.version}"
        kept = _Kept.read(self._state, source, self._made_by)
        self.source: ByteSource = open_source(source, kept.offset if kept else 0)
        made_by = {
            "pipeline": steps.pipeline, "sources": [source], "steps": [steps.reader.resolved(), steps.fuser.resolved()]
        }  # fmt: skip
        try:
            self.result = GrowingResult(out, made_by)
        except ReconError:
            self.source.close()
            raise
        self.goes_on = self.result.begun
        self._pieces, self._file = Pieces(_OVERLAP), Path(source) if isinstance(self.source, GrowingFile) else None
        if kept is not None and self._file is not None:
            with self._file.open("rb") as file:
                self._pieces = Pieces.going_on(file.read(_HEAD), kept.offset, _OVERLAP)
        self.resumed = kept is not None and self._file is not None
        self.live: Live = _live(steps, lag, kept.saved if kept is not None and self.resumed else None)
        self._begins: list[tuple[int, int]] = []
        self.clock = Clock()
        self.units = Units(steps.reader, registry)
        self._kept_ns = 0
        self._heard: pa.Table | None = None
        self.bad: list[str] = []
        self._scratch = tempfile.TemporaryDirectory(prefix="recon-live-")

    @property
    def ended(self) -> bool:
        """Will no more come?"""
        return self.source.ended

    @property
    def awaits(self) -> str:
        """What is missing before the fuser can tell anything; "" where it does."""
        return self.live.awaits if self.clock.newest_ns is not None else f"the first row of {self.source.name}"

    @property
    def heard(self) -> pa.Table | None:
        """The newest row of gnss, for as long as there is nothing better."""
        return self._heard

    def new(self, last: bool = False) -> Iterator[Streams]:
        """Take what has come, step by step until there is no more; nothing where nothing has come.

        last : no more will come: take also a line without an end, and all rows are final
        yields : `latest`, a row, and `trajectory`, the rows that became final, if there are any

        Raises DataError, StageError, StorageError, ReadFailed.
        """
        while data := self.source.take():
            if not self._pieces.begins and b"\0" in data:
                raise ReadFailed(self.source.name, "this is no text", hint="once it is whole, 'recon run' may read it")
            yield from self._take(self._pieces.cut(data))
        if last:
            yield from self._take(self._pieces.last())
            self.clock.end()
            if not self.result.begun:
                raise ReadFailed(self.source.name, "no row of a log came", hint="is it the right source?")
            rest = self.live.finish()
            self.result.append(rest)
            yield rest

    def close(self) -> None:
        """Make the result whole."""
        self.source.close()
        self.result.close({"recon": __version__, "lines_left_out": len(self.bad)}, self.warnings)
        self._scratch.cleanup()

    @property
    def warnings(self) -> list[str]:
        """What the user should know before he believes the result."""
        lines = "1 line" if len(self.bad) == 1 else f"{len(self.bad)} lines"
        unread = [f"{lines} that could not be read left out, the first: {self.bad[0]}"] if self.bad else []
        more = f" ({len(self.clock.wrong) - 1} more of this kind)" if len(self.clock.wrong) > 1 else ""
        broken = [f"{self.source.name} broke off: {self.source.broken}"] if self.source.broken else []
        return unread + [f"{note}{more}" for note in self.clock.wrong[:1]] + self.units.doubts + broken

    def _take(self, piece: bytes) -> Iterator[Streams]:
        read, begins = self._read(piece), self._pieces.begins
        if read is None:
            return
        known = {name: read[name] for name in read if name in self.steps.fuser.stage.reads}
        streams = self.clock.fresh(known, self._pieces.overlaps)
        if "imu" in streams and streams["imu"].num_rows:
            self._begins.append((int(time_ns(streams["imu"])[0]), begins))
        for part in _in_steps(streams):
            self.units.take(part, read.get("metrics"))
            told = dict(self.live.advance(part))
            self.result.append({**part, **{name: told[name] for name in ("trajectory",) if name in told}})
            if "gnss" in part and part["gnss"].num_rows:
                self._heard = part["gnss"].slice(part["gnss"].num_rows - 1)
            yield told
        self._keep()

    def _read(self, piece: bytes) -> Recording | None:
        """All streams of a piece, less the lines that the reader refuses; None where no row is left.

        Raises ReadFailed with the place in the log where it is not single lines that are wrong, StorageError.
        """
        path = Path(self._scratch.name, self._file.name if self._file is not None else "log.txt")
        for _ in range(_MOST_BAD):
            if not piece:
                return None
            with storage_errors(path):
                path.write_bytes(piece)
            try:
                return read_one(self.steps.reader, path, self.registry)
            except ReadFailed as error:
                line = self._pieces.line(error.line)
                what, hint = (text.replace(str(path), str(self._file or "FILE")) for text in (error.what, error.hint))
                told = ReadFailed(self.source.name, what, line=line, column=error.column, hint=hint)
                if error.line is None:
                    raise told from error
                if (behind := self._set_back(path)) is not None:
                    return behind
                try:
                    piece = self._pieces.without(error.line)
                except IndexError:
                    raise told from error
                self.bad.append(str(told).splitlines()[0])
        raise ReadFailed(self.source.name, f"{_MOST_BAD} lines cannot be read, the last: {self.bad[-1]}")

    def _set_back(self, path: Path) -> Recording | None:
        """The rows of a piece that cannot be read behind earlier ones, for their clock was set back; else None."""
        newest = self.clock.newest_ns
        if newest is None or not self._pieces.overlaps:
            return None
        with storage_errors(path):
            path.write_bytes(self._pieces.alone)
        try:
            read = read_one(self.steps.reader, path, self.registry)
        except ReadFailed:
            return None
        at_ns = times_of({name: read[name] for name in read if name in self.steps.fuser.stage.reads})
        if not len(at_ns) or at_ns[-1] >= newest:
            return None
        self._pieces.forget()
        return read

    def _keep(self) -> None:
        """What a later session goes on from, whenever that has changed."""
        since_ns = self.live.since_ns
        usable = [offset for at_ns, offset in self._begins if at_ns <= since_ns]
        if self._file is None or not usable or since_ns == self._kept_ns:
            return
        if saved := self.live.saved():
            self._begins, self._kept_ns = self._begins[len(usable) - 1 :], since_ns
            _Kept(str(self._file), self._made_by, usable[-1], saved).write(self._state)


def _live(steps: Following, lag: float, saved: bytes | None) -> Live:
    stage = steps.fuser.stage
    assert isinstance(stage, Fuser)
    assert stage.live is not None
    return stage.live(steps.fuser.params, lag, saved)


def _in_steps(streams: Streams) -> Iterator[Streams]:
    """The rows in parts of at most ten seconds."""
    filled = [time_ns(table) for table in streams.values() if table.num_rows]
    if not filled:
        return
    first = min(int(at[0]) for at in filled)
    for step in np.unique(np.concatenate([(at - first) // _STEP_NS for at in filled])).tolist():
        yield {
            name: select_rows(table, (time_ns(table) - first) // _STEP_NS == step) for name, table in streams.items()
        }


@dataclass(frozen=True)
class _Kept:
    """source : its name; fuser : name and version; offset : byte from which the source is needed again."""

    source: str
    fuser: str
    offset: int
    saved: bytes

    def write(self, path: Path) -> None:
        """Replace the file as a whole."""
        head = json.dumps({"source": self.source, "fuser": self.fuser, "offset": self.offset}).encode()
        with staged_file(path) as scratch:
            scratch.write_bytes(head + b"\n" + self.saved)

    @classmethod
    def read(cls, path: Path, source: str, fuser: str) -> _Kept | None:
        """None where there is none, or that of another source or of a fuser that counts otherwise."""
        try:
            head, _, saved = path.read_bytes().partition(b"\n")
            facts = json.loads(head)
            kept = cls(facts["source"], facts["fuser"], int(facts["offset"]), saved)
            return kept if (kept.source, kept.fuser) == (source, fuser) else None
        except (OSError, ValueError, KeyError, TypeError):
            return None
