"""The result of a live run: `NAME.mcap`, always whole, and beside it `NAME.part.mcap`, which grows.

Every message of the growing file is a chunk of its own and is handed to the operating system at once, so that a process
that is killed loses nothing that was written. At the end, and when a later run goes on, its rows join the whole file.
`NAME.state` is what a later run needs to go on; it is replaced as a whole. What made it and what the user should know
is kept in the whole file, as `manifest` among its facts and as warnings in `metrics`. The growing file holds from its
start what made it, so that the rows of another log, or of other parameters, never get in between.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from recon.errors import ConfigError, ReadFailed
from recon.problems import Problem
from recon.recording import Recording
from recon.rows import metrics, warning, warnings_of
from recon.storage.atomic import staged_file, storage_errors
from recon.storage.json_text import to_json
from recon.storage.mcap import Appending, salvage_file, write_file
from recon.tables import Streams, select_rows, time_ns


class GrowingResult:
    """Streams that are appended to. path : of the MCAP file; one that is there is gone on with.

    made_by : `pipeline`, `sources` and `steps`, each with `use` and `params`, as JSON data
    Raises ConfigError where what is there was made by something else.
    """

    def __init__(self, path: Path, made_by: Mapping[str, Any]) -> None:
        self.path, self._part = path, path.with_suffix(".part.mcap")
        self._made_by = dict(made_by)
        for file in (path, self._part):
            _refuse_other(file, self._made_by)
        self._join({}, ())
        before = _whole_of(path)
        timed = {name: table for name, table in before.items() if "time" in table.column_names}
        self._until = {name: int(time_ns(table)[-1]) for name, table in timed.items() if table.num_rows}
        self._columns = {name: table.column_names for name, table in timed.items()}
        with storage_errors(self._part):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = Appending(self._part, {"meta": to_json({"manifest": self._made_by}, sort_keys=True)})

    @property
    def begun(self) -> bool:
        """Has it rows?"""
        return bool(self._until)

    def append(self, streams: Streams) -> None:
        """Add the rows that are later than those that are there.

        Raises StorageError; ConfigError where those that are there have other columns.
        """
        for name, table in streams.items():
            if (known := self._columns.get(name, table.column_names)) != table.column_names:
                other = ", ".join(sorted(set(known) ^ set(table.column_names))) or "their order"
                raise _other_result(f"{self.path} holds rows of {name} that differ in columns: {other}")
        with storage_errors(self._part):
            for name, table in streams.items():
                fresh = _after(table, self._until.get(name))
                if fresh.num_rows:
                    self._file.append(name, fresh)
                    self._until[name] = int(time_ns(fresh)[-1])

    def close(self, manifest: Mapping[str, Any] | None = None, warnings: Sequence[str] = ()) -> None:
        """Make the file whole. Raises StorageError.

        manifest : what is to be kept with what made it; warnings : what its user should know
        """
        with storage_errors(self._part):
            self._file.finish()
            self._file.close()
        facts = {**self._made_by, **(manifest or {}), "warnings": list(warnings)}
        self._join({"manifest": facts}, warnings)

    def _join(self, facts: Mapping[str, Any], warnings: Sequence[str]) -> None:
        """Rows of the growing file come behind those of the whole one, and warnings behind its warnings."""
        new = _whole_of(self._part)
        if new:
            before = _whole_of(self.path)
            joined = dict(before)
            for name, table in new.items():
                old = joined.get(name)
                until = int(time_ns(old)[-1]) if old is not None and old.num_rows else None
                fresh = _after(table, until)
                joined[name] = fresh if old is None else pa.concat_tables([old, fresh.cast(old.schema)])
            told = [*warnings_of(joined.get("metrics")), *warnings]
            if told:
                joined["metrics"] = metrics(warning(note) for note in told)
            with staged_file(self.path) as scratch:
                write_file(Recording(joined, {**before.meta, **new.meta, **facts}), scratch)
        with storage_errors(self._part):
            self._part.unlink(missing_ok=True)


def _whole_of(path: Path) -> Recording:
    """All that is whole in a file; nothing where there is none, or where nothing was written yet."""
    if not path.exists():
        return Recording({})
    try:
        return salvage_file(path)[0]
    except ReadFailed:
        if path.suffixes[-2:] == [".part", ".mcap"]:
            return Recording({})  # killed before its first row
        raise


def _refuse_other(file: Path, made_by: Mapping[str, Any]) -> None:
    """Raises ConfigError for a file with rows that something else made."""
    found = _whole_of(file)
    kept = found.meta.get("manifest", {})
    if not found or _made(kept) == _made(made_by):
        return
    if "sources" not in kept:
        text = f"{file} is no result of recon live"
    elif (kept.get("pipeline"), kept["sources"]) == (made_by["pipeline"], made_by["sources"]):
        text = f"{file} holds what other parameters made of this log"
    else:
        text = f"{file} holds what pipeline '{kept.get('pipeline')}' made of {', '.join(kept['sources'])}"
    raise _other_result(text)


def _other_result(text: str) -> ConfigError:
    return ConfigError([Problem(None, "bad-option", text, "choose another file with --out, or move it away")])


def _made(manifest: Mapping[str, Any]) -> str:
    """What decides whether rows belong together: source, pipeline and parameters, whichever version of them."""
    steps = [(step["use"], step["params"]) for step in manifest.get("steps", [])]
    return to_json([manifest.get("pipeline"), manifest.get("sources"), steps], sort_keys=True)


def _after(table: pa.Table, until_ns: int | None) -> pa.Table:
    return table if until_ns is None else select_rows(table, np.asarray(time_ns(table) > until_ns))
