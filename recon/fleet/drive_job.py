"""One drive through the pipeline of a batch: what an executor carries to a process and runs there.

The result appears as a whole or not at all. Its manifest says in `environment.job` which drive it is of, what the input
was known by when it was read, and a few figures of the result. It begins with `made_of`, a hash of all that a result
depends on, so that a batch that goes on finds what is done without taking every manifest apart.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from recon import manifest as manifests
from recon.api import Run, execute
from recon.api import open as open_run
from recon.errors import (
    ConfigError,
    ContractError,
    DataError,
    NotEnoughData,
    NothingToExport,
    PluginError,
    ReadFailed,
    ReconError,
    StageError,
    StorageError,
    UnknownFormat,
)
from recon.fleet.places import Place, Stamp, fetch, stamp, without_query
from recon.fleet.root import root_of
from recon.jobs import FAULT, OUT_OF_MEMORY, Outcome
from recon.overrides import Override
from recon.pipeline import Pipeline
from recon.registry import Registry
from recon.storage.json_text import to_json
from recon.tables import vector

_HEAD: Final = 200
"""Bytes of a manifest in which `made_of` stands."""


class InputChanged(DataError):
    """The input is another one than when the job began to read it."""


CODES: Final[Mapping[type[ReconError], str]] = {
    InputChanged: "input_changed",
    UnknownFormat: "unknown_format",
    ReadFailed: "unreadable",
    NotEnoughData: "not_enough_data",
    DataError: "bad_data",
    ContractError: "contract_broken",
    StageError: "stage_failed",
    StorageError: "not_written",
    PluginError: "plugin_unusable",
    ConfigError: "not_configured",
    ReconError: FAULT,
}
"""Why a job failed, in one word, by the error that ended it; the first class that fits."""


@dataclass(frozen=True)
class DriveJob:
    """One drive of a batch.

    key : folder of the result below `output`
    overrides : parameters set for all drives, and then for this vehicle
    """

    key: str
    vehicle: str
    drive: str
    source: Place
    output: Place
    pipeline: Pipeline
    overrides: tuple[Override, ...] = ()
    exports: tuple[str, ...] = ()
    timeout: float | None = None
    memory: int | None = None

    def run(self) -> Outcome:
        """Read, run, export, and put the result to its place."""
        started = time.perf_counter()
        try:
            left_out = self._make()
        except ReconError as error:
            return self._failed(error, time.perf_counter() - started)
        except OSError as error:
            return Outcome(self.key, "not_written", str(error), seconds=time.perf_counter() - started)
        return Outcome(self.key, text=left_out, seconds=time.perf_counter() - started)

    def lost(self, code: str, text: str) -> Outcome:
        """Its outcome, told by others."""
        return Outcome(self.key, code, text)

    def _make(self) -> str:
        """Which exports found nothing to show; "" where all are there."""
        root = root_of(self.output)
        with root.scratch() as scratch, _told_of(scratch / "result", root.place / self.key):
            before = _stamped(self.source)
            copy = fetch(self.source, scratch)
            folder = scratch / "result"
            finished, left_out = self._reconstructed(copy, folder)
            if stamp(self.source) != before:
                raise InputChanged(
                    f"{self.source} changed while it was read", "run the batch again when it is complete"
                )
            manifests.write(self._signed(finished, before, left_out), folder)
            root.commit(folder, self.key)
        return left_out

    def _reconstructed(self, source: Path, folder: Path) -> tuple[Run, str]:
        """The finished run, and which exports found nothing to show in it: it counts as done without them."""
        try:
            made = execute(self.pipeline, source, folder, self.overrides, registry=_registry(), exports=self.exports)
        except NothingToExport as error:
            return open_run(folder), str(error)
        return made, ""

    def _signed(self, finished: Run, stamped: Stamp, left_out: str) -> dict[str, Any]:
        """The manifest with what the batch needs to know."""
        about = {
            "vehicle": self.vehicle,
            "drive": self.drive,
            "input": str(self.source),
            "bytes": stamped[0],
            "modified_ns": stamped[1],
            "summary": {**finished.summary(), **_quality(finished)},
            **({"exports_left_out": left_out} if left_out else {}),
        }
        manifest = finished.manifest
        how = made_how(manifest["plan"], manifest["recon"], manifest["store"])
        mark = made_of(str(self.source), stamped, how)
        environment = {**manifest["environment"], "job": about}
        return {"made_of": mark, **manifest, "environment": environment}

    def _failed(self, error: ReconError, seconds: float) -> Outcome:
        memory = isinstance(error.__cause__, MemoryError)
        code = OUT_OF_MEMORY if memory else next(code for kind, code in CODES.items() if isinstance(error, kind))
        return Outcome(self.key, code, error.message, error.hint, seconds)


def made_how(plan: object, version: str, store: str) -> str:
    """Hash of what results of one vehicle have in common: the resolved plan, recon, the store."""
    return _hash(to_json([plan, version, store], sort_keys=True))


def made_of(source: str, stamped: Stamp, how: str) -> str:
    """Hash of all that a result depends on: the input's place, size and time, and `made_how`."""
    return _hash(to_json([source, *stamped, how]))


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def is_made_of(text: bytes, mark: str) -> bool:
    """Is this manifest, as it is kept, whole and that of a result made of `mark`?"""
    return f'"made_of": "{mark}"'.encode() in text[:_HEAD] and text.endswith(b"}\n")


@contextmanager
def _told_of(folder: Path, place: Place) -> Iterator[None]:
    """What cannot be written is told as what it would have been, not by its name of the moment."""
    try:
        yield
    except StorageError as error:
        error.message = error.message.replace(str(folder), str(place))
        raise


@cache
def _registry() -> Registry:
    """The stages of this process; to look through all that is installed takes longer than a small drive."""
    return Registry.installed()


def _stamped(place: Place) -> Stamp:
    """Raises ReadFailed where nothing is there."""
    try:
        found = stamp(place)
    except OSError as error:
        raise ReadFailed(str(place), f"it cannot be read: {without_query(error)}") from error
    if found is None:
        piped = place.is_local and Path(place.path).exists()
        raise ReadFailed(str(place), "this is a device or a pipe" if piped else "there is no such file or folder")
    return found


def _quality(finished: Run) -> dict[str, float]:
    """pos_std : m, median of the trajectory's own sigma of the horizontal position; left out where it tells none."""
    table = finished.recording.get("trajectory")
    if table is None or not {"pos_std_e", "pos_std_n"} <= set(table.column_names) or not table.num_rows:
        return {}
    sigma = np.hypot(vector(table, "pos_std_e", gaps=True), vector(table, "pos_std_n", gaps=True))
    known = sigma[np.isfinite(sigma)]
    return {"pos_std": float(np.median(known))} if len(known) else {}
