"""All results of a fleet in three files: ROOT/jobs.parquet, ROOT/events.parquet and ROOT/metrics.parquet.

They are made from the manifests and streams of the results, and from what failed. Rows are sorted by vehicle and drive.
A drive whose last attempt failed has no result; it is in `jobs` with its reason, and in the others not at all.
Rows that were made from the very manifest that is there are taken from the files that are there.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from itertools import islice
from pathlib import Path
from secrets import token_hex
from tempfile import TemporaryDirectory
from typing import Any, Final, TypeAlias
from urllib.parse import unquote

import numpy as np
import pyarrow as pa

from recon.fleet.compacted import (
    FAILED,
    JOBS,
    NAMES,
    OK,
    SCHEMAS,
    TOKEN,
    Index,
    Older,
    failed_before,
    is_settled,
    opened,
)
from recon.fleet.inputs import Drive
from recon.fleet.places import Stamp, fetch
from recon.fleet.root import Root
from recon.jobs import Outcome
from recon.storage import mcap
from recon.storage.atomic import storage_errors
from recon.storage.json_text import to_json

_FIGURES: Final = ("duration", "distance", "top_speed", "stops", "pos_std")
_CHUNK: Final = 512
"""Results that are in memory together."""
_THREADS: Final = 16
"""That ask a store, for which they mostly wait; a disk answers one as fast as many."""
_ABSENT: Final = -1
_UNKNOWN: Final = -2
"""In place of a row of the older files: there is no result, or one that they do not know."""

Rows: TypeAlias = list[dict[str, Any]]


@dataclass(frozen=True)
class Failure:
    """A drive that has no result, and why."""

    drive: Drive
    outcome: Outcome

    def row(self) -> dict[str, Any]:
        """As it stands in `jobs`."""
        size, modified = self.drive.stamp or (None, None)
        return {
            "vehicle": self.drive.vehicle,
            "drive": self.drive.drive,
            "status": FAILED,
            "code": self.outcome.code,
            "reason": self.outcome.text,
            "hint": self.outcome.hint,
            "input": str(self.drive.place),
            "input_bytes": size,
            "modified": modified,
            "seconds": self.outcome.seconds,
        }


def compact(root: Root, index: Index, failures: Mapping[str, dict[str, Any]]) -> None:
    """Write the three files anew, where they do not tell just what is there.

    index : of the files as they are; failures : rows of `jobs` by key, which count for drives without a result
    Raises StorageError.
    """
    keys = sorted({*root.keys(), *failures})
    with ThreadPoolExecutor(_THREADS) as pool, root.scratch() as scratch, storage_errors(scratch / JOBS):
        at_once = map if root.place.is_local else pool.map
        rows = _known(index, keys, at_once(root.stamp, keys))
        failed = {key: failures[key] for key, row in zip(keys, rows, strict=True) if row == _ABSENT and key in failures}
        kept = sum(row >= 0 for row in rows)
        if _UNKNOWN not in rows and kept + len(failed) == len(index.rows) and failed == failed_before(root):
            return
        with _writers(scratch) as writers, _older(root, index, any_kept=kept > 0) as older:
            source = zip(keys, rows, strict=True)
            while chunk := list(islice(source, _CHUNK)):
                parts = list(at_once(lambda one: _part(root, one[0], one[1], failed, scratch), chunk))
                for name in NAMES:
                    writers[name].write_table(_table(name, [row for _, row in chunk], parts, older[name]))
        for name in reversed(NAMES):
            root.put(scratch / f"{name}.parquet", f"{name}.parquet")


def _known(index: Index, keys: Iterable[str], stamps: Iterable[Stamp | None]) -> list[int]:
    """For each key the row of the older files; they rise, since these are read from their beginning to their end."""
    rows: list[int] = []
    last = -1
    for key, stamp in zip(keys, stamps, strict=True):
        row = _ABSENT if stamp is None else index.row(key, stamp)
        rows.append(_UNKNOWN if row is None or 0 <= row <= last else row)
        last = max(last, rows[-1])
    return rows


@contextmanager
def _writers(folder: Path) -> Iterator[Mapping[str, Any]]:
    """Of the three files in a folder, by name."""
    from pyarrow.parquet import ParquetWriter

    token = {TOKEN: token_hex(16)}
    with ExitStack() as stack:
        made = {
            name: ParquetWriter(folder / f"{name}.parquet", schema.with_metadata(token), compression="zstd")
            for name, schema in SCHEMAS.items()
        }
        yield {name: stack.enter_context(writer) for name, writer in made.items()}


@contextmanager
def _older(root: Root, index: Index, *, any_kept: bool) -> Iterator[Mapping[str, Older]]:
    """The files that are there, by name; they need not be there where nothing of them is kept."""
    with ExitStack() as stack:
        files = stack.enter_context(opened(root)) if any_kept else {}
        yield {name: Older(name, index, files.get(name)) for name in NAMES}


@dataclass(frozen=True)
class _Part:
    """What is new of one drive."""

    jobs: Rows = field(default_factory=list)
    metrics: Rows = field(default_factory=list)
    events: pa.Table = field(default_factory=SCHEMAS["events"].empty_table)

    def counts(self) -> Mapping[str, int]:
        """Rows by name."""
        return {"jobs": len(self.jobs), "metrics": len(self.metrics), "events": self.events.num_rows}


def _part(root: Root, key: str, row: int, failed: Mapping[str, dict[str, Any]], scratch: Path) -> _Part:
    if key in failed:
        return _Part([failed[key]])
    if row != _UNKNOWN:
        return _Part()
    stamp, manifest = root.stamp(key), root.manifest(key)  # in this order: what changes in between is read once more
    if stamp is None or manifest is None:
        return _Part()
    vehicle, drive = (unquote(part.partition("=")[2]) for part in key.split("/"))
    named = {"vehicle": vehicle, "drive": drive}
    learnt = [{**named, "step": step["id"], **row} for step in manifest["steps"] for row in step["metrics"]]
    events = SCHEMAS["events"].empty_table()
    if any(step["rows"].get("events") for step in manifest["steps"]):
        found = _events(root, key, manifest["store"], scratch)
        columns = {name: pa.array([text] * found.num_rows, pa.string()) for name, text in named.items()}
        columns |= {name: found[name] for name in found.column_names}
        events = pa.table([columns[name] for name in SCHEMAS["events"].names], SCHEMAS["events"])
    job = {**named, **_facts(manifest), "events": events.num_rows, "metrics": len(learnt), **_seen(stamp)}
    return _Part([job], learnt, events)


def _seen(stamp: Stamp) -> dict[str, int | None]:
    """The manifest's size and time of change, where a later change of it is sure to show in them."""
    settled = is_settled(stamp, time.time_ns())
    return {"manifest_bytes": stamp[0] if settled else None, "manifest_modified": stamp[1] if settled else None}


def _facts(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """A manifest as a row of `jobs`."""
    environment = manifest["environment"]
    job = environment.get("job", {})
    summary = job.get("summary", {})
    versions = {step["distribution"]: step["distribution_version"] for step in manifest["plan"]}
    return {
        **{name: summary.get(name) for name in _FIGURES},
        "status": OK,
        "reason": job.get("exports_left_out"),
        "input": job.get("input"),
        "input_bytes": job.get("bytes"),
        "modified": job.get("modified_ns"),
        "started": datetime.fromisoformat(environment["started"]),
        "seconds": environment["seconds"],
        "warnings": len(manifest["warnings"]),
        "rows": sum(manifest["steps"][0]["rows"].values()),
        "pipeline": manifest["pipeline"]["name"],
        "recon": manifest["recon"],
        "versions": to_json(versions, sort_keys=True),
        "made_of": manifest.get("made_of"),
    }


def _events(root: Root, key: str, store: str, scratch: Path) -> pa.Table:
    from pyarrow.parquet import read_table

    if store == "parquet":
        with root.place.filesystem.open_input_file((root.place / key / "streams/events.parquet").path) as file:
            return read_table(file)
    with TemporaryDirectory(dir=scratch) as folder:
        return mcap.read_file(fetch(root.place / key / "streams.mcap", Path(folder)))["events"]


def _table(name: str, rows: Sequence[int], parts: Sequence[_Part], older: Older) -> pa.Table:
    """Rows of one file for some drives in their order, taken over and new ones."""
    taken, counts = older.take([row for row in rows if row >= 0])
    if name == "events":
        new = pa.concat_tables([part.events for part in parts])
    else:
        new = pa.Table.from_pylist([row for part in parts for row in getattr(part, name)], SCHEMAS[name])
    if not new.num_rows:
        return taken
    drive = np.concatenate(
        [
            np.repeat(np.flatnonzero(np.array(rows) >= 0), counts),
            np.repeat(np.arange(len(parts)), [part.counts()[name] for part in parts]),
        ]
    )
    return pa.concat_tables([taken, new]).take(pa.array(np.argsort(drive, kind="stable")))
