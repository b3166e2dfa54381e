"""All results of a fleet in three files: ROOT/jobs.parquet, ROOT/events.parquet and ROOT/metrics.parquet.

They are made from the manifests and streams of the results, and from what failed. Rows are sorted by vehicle and drive.
A drive whose last attempt failed has no result; it is in `jobs` with its reason, and in the others not at all.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, TypeAlias
from urllib.parse import unquote

import pyarrow as pa

from recon.fleet.inputs import Drive, key_of
from recon.fleet.places import fetch
from recon.fleet.root import Root
from recon.jobs import Outcome
from recon.schema import by_step
from recon.storage import mcap
from recon.storage.json_text import to_json

JOBS: Final = "jobs.parquet"
OK: Final = "ok"
FAILED: Final = "failed"

_TIME: Final = pa.timestamp("ns", tz="UTC")
_TEXTS: Final = ("status", "code", "reason", "hint", "input")
_FIGURES: Final = ("seconds", "duration", "distance", "top_speed", "stops", "pos_std")
_DRIVE: Final = (("vehicle", pa.string()), ("drive", pa.string()))
_SCHEMAS: Final[Mapping[str, pa.Schema]] = {
    "jobs": pa.schema(
        [
            *_DRIVE,
            *((name, pa.string()) for name in _TEXTS),
            *(("input_bytes", pa.int64()), ("modified", _TIME), ("started", _TIME)),
            *((name, pa.float64()) for name in _FIGURES),
            *(("warnings", pa.int64()), ("rows", pa.int64())),
            *(("pipeline", pa.string()), ("recon", pa.string()), ("versions", pa.string())),
        ]
    ),
    **{
        name: pa.schema([*_DRIVE, *((column.name, column.type) for column in by_step(name).columns)])
        for name in ("events", "metrics")
    },
}
_MARK: Final = b"recon.results"
"""Key in the metadata of jobs.parquet: a hash of what it was made from."""

_CHUNK: Final = 512
"""Results that are in memory together."""
_THREADS: Final = 16
"""That read from a store, for which they mostly wait; from a disk one is as fast as many."""

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


def is_current(root: Root, made: Mapping[str, str]) -> bool:
    """Do the three files hold just these results? made : time of making by key"""
    from pyarrow.parquet import read_metadata

    mark = _Mark()
    for key in sorted(made):
        mark.add(key, made[key])
    try:
        with root.place.filesystem.open_input_file((root.place / JOBS).path) as file:
            return dict(read_metadata(file).metadata or {}).get(_MARK) == mark.value()
    except (OSError, pa.ArrowException):
        return False


def compact(root: Root, failures: Mapping[str, dict[str, Any]]) -> None:
    """Write the three files anew. failures : rows of `jobs` by key. Raises StorageError."""
    from pyarrow.parquet import ParquetWriter

    keys = sorted({*root.keys(), *failures})
    mark = _Mark()
    with root.scratch() as scratch:
        with ThreadPoolExecutor(_THREADS) as pool, ExitStack() as stack:
            at_once = map if root.place.is_local else pool.map
            writers = {
                name: stack.enter_context(ParquetWriter(scratch / f"{name}.parquet", schema, compression="zstd"))
                for name, schema in _SCHEMAS.items()
            }
            for start in range(0, len(keys), _CHUNK):
                chunk = keys[start : start + _CHUNK]
                parts = list(at_once(lambda key: _part(root, key, failures.get(key), scratch), chunk))
                for key, part in zip(chunk, parts, strict=True):
                    mark.add(key, part.made)
                writers["jobs"].write_table(_table("jobs", [row for part in parts for row in part.jobs]))
                writers["metrics"].write_table(_table("metrics", [row for part in parts for row in part.metrics]))
                events = [part.events for part in parts if part.events is not None]
                writers["events"].write_table(pa.concat_tables([_SCHEMAS["events"].empty_table(), *events]))
            writers["jobs"].add_key_value_metadata({_MARK: mark.value()})
        for name in reversed(list(_SCHEMAS)):
            root.put(scratch / f"{name}.parquet", f"{name}.parquet")


def failed_before(root: Root) -> dict[str, dict[str, Any]]:
    """Rows of `jobs` that say why a drive failed, by key, of the file that is there."""
    from pyarrow.parquet import read_table

    try:
        with root.place.filesystem.open_input_file((root.place / JOBS).path) as file:
            table = read_table(file, filters=[("status", "=", FAILED)])
    except (OSError, pa.ArrowException):
        return {}
    numbers = table.set_column(table.schema.get_field_index("modified"), "modified", table["modified"].cast(pa.int64()))
    rows: Rows = numbers.drop_columns(["started"]).to_pylist()  # Python has no times of nanoseconds
    return {key_of(row["vehicle"], row["drive"]): row for row in rows}


class _Mark:
    """A hash of results: which there are, and when they were made."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def add(self, key: str, made: str) -> None:
        """Take in a result; in the order of the keys. made : "" for one that counts not"""
        self._hash.update(f"{key} {made}\n".encode())

    def value(self) -> bytes:
        """As it is kept."""
        return self._hash.hexdigest().encode()


@dataclass(frozen=True)
class _Part:
    """Rows of one drive. made : when, "" for one without a result"""

    made: str = ""
    jobs: Rows = field(default_factory=list)
    metrics: Rows = field(default_factory=list)
    events: pa.Table | None = None


def _part(root: Root, key: str, failure: dict[str, Any] | None, scratch: Path) -> _Part:
    if failure is not None:
        return _Part(jobs=[failure])
    manifest = root.manifest(key)
    if manifest is None:
        return _Part()
    vehicle, drive = (unquote(part.partition("=")[2]) for part in key.split("/"))
    named = {"vehicle": vehicle, "drive": drive}
    learnt = [{**named, "step": step["id"], **row} for step in manifest["steps"] for row in step["metrics"]]
    events = None
    if any(step["rows"].get("events") for step in manifest["steps"]):
        found = _events(root, key, manifest["store"], scratch)
        columns = {name: pa.array([text] * found.num_rows, pa.string()) for name, text in named.items()}
        columns |= {name: found[name] for name in found.column_names}
        events = pa.table([columns[name] for name in _SCHEMAS["events"].names], _SCHEMAS["events"])
    return _Part(manifest["environment"]["started"], [{**named, **_facts(manifest)}], learnt, events)


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
    }


def _events(root: Root, key: str, store: str, scratch: Path) -> pa.Table:
    from pyarrow.parquet import read_table

    if store == "parquet":
        with root.place.filesystem.open_input_file((root.place / key / "streams/events.parquet").path) as file:
            return read_table(file)
    with TemporaryDirectory(dir=scratch) as folder:
        return mcap.read_file(fetch(root.place / key / "streams.mcap", Path(folder)))["events"]


def _table(name: str, rows: Rows) -> pa.Table:
    return pa.Table.from_pylist(rows, _SCHEMAS[name])
