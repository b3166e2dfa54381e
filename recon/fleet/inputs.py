"""The drives that a batch file names: globs and lists, and the rules that name vehicle and drive."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, islice
from pathlib import PurePosixPath
from typing import Any, Final, NamedTuple
from urllib.parse import quote

import pyarrow as pa

from recon.batch import BatchFile, Inputs
from recon.errors import ConfigError
from recon.fleet.places import Place, Stamp, glob, stamp, stamp_of, without_query
from recon.problems import Problem, Where, shortened

_SAFE: Final = " !#$&'()+,;@[]^`{}~"
"""Kept in the names of folders; what Windows or the readers of partitions do not take is percent-encoded."""

_COLUMNS: Final = ("path", "vehicle", "drive")
_SCHEMA: Final = pa.schema(
    [
        *((name, pa.string()) for name in ("vehicle", "drive", "path")),
        *((name, pa.dictionary(pa.int32(), pa.string())) for name in ("head", "query")),
        *((name, pa.int64()) for name in ("bytes", "modified_ns")),
    ]
)
_CHUNK: Final = 1024

_LONGEST: Final = 255
"""Bytes that file systems allow in the name of a folder."""
_WIDEST: Final = 12
"""Bytes that one character becomes at most."""


class Drive(NamedTuple):
    """One recording of a fleet. stamp : None where nothing is at its place."""

    vehicle: str
    drive: str
    place: Place
    stamp: Stamp | None

    @property
    def key(self) -> str:
        """Folder of its result below the root: a Hive partition."""
        return key_of(self.vehicle, self.drive)


class Drives:
    """Drives in columns: a hundred thousand of them take some megabytes."""

    def __init__(self, table: pa.Table) -> None:
        self._table = table

    @classmethod
    def of(cls, drives: Iterable[Drive]) -> Drives:
        """Take in drives as they come."""
        source = iter(drives)
        parts = [_SCHEMA.empty_table()]
        while chunk := list(islice(source, _CHUNK)):
            rows = [
                (d.vehicle, d.drive, d.place.path, d.place.head, d.place.query, *(d.stamp or (None, None)))
                for d in chunk
            ]
            columns = zip(*rows, strict=True)
            arrays = [pa.array(column, kind) for column, kind in zip(columns, _SCHEMA.types, strict=True)]
            parts.append(pa.Table.from_arrays(arrays, schema=_SCHEMA))
        return cls(pa.concat_tables(parts))

    def __len__(self) -> int:
        return int(self._table.num_rows)

    def __iter__(self) -> Iterator[Drive]:
        for batch in self._table.to_batches(_CHUNK):
            yield from map(_drive, batch.to_pylist())

    @property
    def vehicles(self) -> list[str]:
        """Their names, sorted."""
        return sorted(self._table["vehicle"].unique().to_pylist())

    def below(self, place: Place) -> Drives:
        """Those whose input lies in a folder."""
        import pyarrow.compute as pc  # slow import: only when used

        inside = pc.starts_with(self._table["path"], f"{place.path.rstrip('/')}/")
        return Drives(self._table.filter(pc.and_(inside, pc.equal(self._table["head"], place.head))))

    def where(self, mask: Sequence[bool]) -> Drives:
        """Those for which the mask, of the same length, is true."""
        return Drives(self._table.filter(pa.array(mask, pa.bool_())))


def _drive(row: Mapping[str, Any]) -> Drive:
    stamped = None if row["bytes"] is None else (row["bytes"], row["modified_ns"])
    return Drive(row["vehicle"], row["drive"], Place(row["path"], row["head"], row["query"]), stamped)


def key_of(vehicle: str, drive: str) -> str:
    """vehicle=<vehicle>/drive=<drive>, encoded so that every file system takes it."""
    return f"vehicle={_encoded(vehicle)}/drive={_encoded(drive)}"


def _encoded(name: str) -> str:
    text = quote(name, safe=_SAFE)
    return f"{text[:-1]}%{ord(text[-1]):02X}" if text[-1] in ". " else text  # Windows takes neither at an end


def find(batch: BatchFile) -> Drives:
    """Every drive, in the order of the file. Raises ConfigError with all problems: what matches nothing, cannot be
    listed, gives two files one name, or lies in the output.
    """
    parts: list[Drives] = []
    problems: list[Problem] = []
    for index, inputs in enumerate(batch.inputs):
        where = batch.root.at(["inputs", index]).where
        try:
            found = Drives.of(_named_shortly((_listed if inputs.list_file else _globbed)(inputs, batch, where), where))
        except ConfigError as error:
            problems += error.problems
            continue
        except (OSError, ValueError) as error:
            text = f"{inputs.list_file or inputs.glob} cannot be listed: {error}"
            problems.append(Problem(where, "unreadable-input", without_query(text)))
            continue
        parts.append(found)
        if not len(found):
            text = f"nothing matches {inputs.glob}" if inputs.glob else f"{inputs.list_file} lists no drive"
            problems.append(
                Problem(where, "no-input", without_query(text), "paths are relative to the folder of the batch file")
            )
    problems += [*_doubles(parts, batch), *_own_results(parts, batch)]
    if problems:
        raise ConfigError(problems)
    return Drives.of(chain.from_iterable(parts))


def _named_shortly(drives: Iterable[Drive], where: Where) -> Iterator[Drive]:
    """The drives. Raises ConfigError where one has a name that no folder can have."""
    for drive in drives:
        for key, name in (("vehicle", drive.vehicle), ("drive", drive.drive)):
            if _WIDEST * len(name) + len(key) < _LONGEST or len(f"{key}={_encoded(name)}") <= _LONGEST:
                continue
            place = shortened(str(drive.place), 120)
            text = f"the {key} {shortened(name, 40)} of {place} has too long a name for a folder"
            raise ConfigError([Problem(where, "long-name", text, f"write a rule for '{key}' that gives a shorter one")])
        yield drive


def _globbed(inputs: Inputs, batch: BatchFile, where: Where) -> Iterator[Drive]:
    vehicle, drive = _rule(inputs.vehicle), _rule(inputs.drive)
    for place, stamped in glob(Place.of(inputs.glob, batch.folder)):
        path = PurePosixPath(place.path)
        named = (_named(vehicle, path, "vehicle"), _named(drive, path, "drive"))
        if not all(named):
            key, rule = ("drive", inputs.drive) if named[0] else ("vehicle", inputs.vehicle)
            raise ConfigError([Problem(where, "no-name", f"'{rule}' finds no {key} in {place}", "change the rule")])
        yield Drive(*named, place, stamped)


def _rule(rule: str) -> int | str | re.Pattern[str]:
    """Number of folders up, "stem", or a pattern."""
    parent, _, count = rule.partition(" ")
    if parent == "parent" and count.isdecimal():
        return int(count)
    return rule if rule == "stem" else re.compile(rule)


def _named(rule: int | str | re.Pattern[str], path: PurePosixPath, key: str) -> str:
    """Name of the vehicle or drive, "" where the rule finds none."""
    if isinstance(rule, int):
        return path.parts[-1 - rule].strip("/") if rule < len(path.parts) else ""
    if isinstance(rule, str):
        return path.stem
    found = rule.search(path.as_posix())
    return (found[key] or "") if found else ""


def _listed(inputs: Inputs, batch: BatchFile, where: Where) -> Iterator[Drive]:
    place = Place.of(inputs.list_file, batch.folder)
    with place.filesystem.open_input_stream(place.path) as file:
        rows = csv.DictReader(io.StringIO(file.read().decode("utf-8-sig"), newline=""))
    missing = [column for column in _COLUMNS if column not in (rows.fieldnames or ())]
    if missing:
        text = f"{inputs.list_file} has no column {missing[0]}"
        raise ConfigError([Problem(where, "bad-list", text, f"its columns are {', '.join(_COLUMNS)}")])
    found = []
    for row in rows:
        values = [(row[column] or "").strip() for column in _COLUMNS]
        if not all(values):
            text = f"line {rows.line_num} has no {_COLUMNS[values.index('')]}"
            raise ConfigError([Problem(Where(inputs.list_file, rows.line_num), "bad-list", text)])
        found.append((Place.of(values[0], batch.folder), values[1], values[2]))
    stamps = _stamps([place for place, _, _ in found])
    for (place, vehicle, drive), stamped in zip(found, stamps, strict=True):
        yield Drive(vehicle, drive, place, stamped)


def _stamps(places: Sequence[Place]) -> list[Stamp | None]:
    """Stamps of many places, asked for together where they are in one filesystem."""
    from pyarrow import fs

    if len({(place.head, place.query) for place in places}) > 1:
        return [stamp(place) for place in places]
    infos = places[0].filesystem.get_file_info([place.path for place in places]) if places else []
    folder = fs.FileType.Directory
    return [stamp(place) if info.type == folder else stamp_of(info) for place, info in zip(places, infos, strict=True)]


def _own_results(parts: Sequence[Drives], batch: BatchFile) -> Iterator[Problem]:
    """Inputs that lie in the output, whose results would be drives of the next batch."""
    output = Place.of(batch.output, batch.folder)
    where = batch.root.at(["output"]).where
    for drive in islice(chain.from_iterable(part.below(output) for part in parts), 1):
        text = f"the input {drive.place} lies in the output"
        yield Problem(where, "output-is-input", text, "write the name of a folder of its own")


def _doubles(parts: Sequence[Drives], batch: BatchFile) -> list[Problem]:
    """Drives of one name: also where only upper and lower case tell them apart, which not every file system sees."""
    counts = Counter(hash(drive.key.casefold()) for drive in chain.from_iterable(parts))
    suspects = {name for name, count in counts.items() if count > 1}
    if not suspects:
        return []
    first: dict[str, Drive] = {}
    where = batch.root.at(["inputs"]).where
    found = []
    for drive in chain.from_iterable(parts):
        name = drive.key.casefold()
        other = first.setdefault(name, drive) if hash(name) in suspects else drive
        if other is not drive:
            text = f"{other.place} and {drive.place} are both drive '{drive.drive}' of vehicle '{drive.vehicle}'"
            hint = "change 'vehicle' or 'drive'"
            if drive.place == other.place:
                text = f"{drive.place} is named twice as drive '{drive.drive}' of vehicle '{drive.vehicle}'"
                hint = "leave one of the two away"
            found.append(Problem(where, "double-drive", shortened(text, 300), hint))
    return found
