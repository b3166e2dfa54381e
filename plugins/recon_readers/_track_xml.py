"""Points of tracks in XML, as far as a file is whole, in blocks, so that no tree is built.

The parser is that of the standard library (expat); a file that declares entities, which can be made to grow without
bound, is refused.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Protocol
from xml.parsers import expat

import numpy as np
import pyarrow as pa

from recon.errors import ReadFailed
from recon.rows import Metric, warning
from recon.schema import GNSS
from recon_readers._columns import Columns, Grown
from recon_readers._streams import Source, stream
from recon_readers._time_text import moments

BLOCK: Final = 1 << 20
LONGEST: Final = 200
"""Characters of a number or time; longer texts are cut."""
_ROWS: Final = 8192


class Elements(Protocol):
    """What is told of each element; names are without prefix."""

    def start(self, name: str, attributes: Mapping[str, str]) -> None:
        """An element begins."""

    def end(self, name: str, text: str) -> None:
        """An element ends; `text` : its own, without blanks around."""


@dataclass
class Points:
    """Points as they come: numbers by name, NaN where there is none, and times."""

    names: Sequence[str]
    _texts: list[str] = field(default_factory=list)
    _numbers: array[float] = field(default_factory=lambda: array("d"))
    _columns: dict[str, Grown] = field(init=False)

    def __post_init__(self) -> None:
        kinds = {"time": np.int64, "missing": np.bool_, **dict.fromkeys(self.names, np.float64)}
        self._columns = {name: Grown(kind, _ROWS) for name, kind in kinds.items()}

    def add(self, time: str, values: Mapping[str, float]) -> None:
        """One more point."""
        self._texts.append(time)
        self._numbers.extend(values.get(name, np.nan) for name in self.names)
        if len(self._texts) >= _ROWS:
            self._flush()

    def _flush(self) -> None:
        t_ns, good = moments(pa.array(self._texts, pa.string()))
        self._columns["time"].add(t_ns)
        self._columns["missing"].add(~good)
        for name, values in zip(self.names, np.array(self._numbers).reshape(-1, len(self.names)).T, strict=True):
            self._columns[name].add(values)
        self._texts.clear()
        self._numbers = array("d")

    def columns(self) -> Columns:
        """All points: `time` (n,) ns since 1970, `missing` (n,) bool where there is none, and the numbers by name.

        Those that no point has are not among them.
        """
        self._flush()
        found = Columns(self._columns)
        self._columns = {}
        for name in self.names:
            if not np.isfinite(found[name]).any():
                del found[name]
        return found


def number(text: str | None) -> float:
    """A decimal number, NaN where the text is none."""
    try:
        return float(text) if text and text.isascii() and "_" not in text else np.nan
    except ValueError:
        return np.nan


def unread(count: int) -> list[Metric]:
    """The warning where texts are no numbers."""
    return [warning(f"{count} texts of points are no numbers, and are left out")] if count else []


def fixes(path: Path, columns: Columns, count: int, line: int) -> tuple[pa.Table, list[Metric]]:
    """The stream gnss of `Points.columns`, what they are and what was left out.

    count : of the points; line : where the file is damaged, 0 where it is whole

    Raises ReadFailed where no point has a time and a place.
    """
    gnss, told = stream(Source(path, "gnss"), GNSS, columns.pop("time"), columns.pop("missing"), columns)
    if gnss is None:
        what = "none of its points has a time and a place"
        raise ReadFailed(path, what, line=line or 1, hint="is it the right file?")
    return gnss, [Metric("points", float(count)), *told]


def damage(path: Path, line: int, reason: str) -> list[Metric]:
    """The warning where a file is damaged; `reason` : "" where it is whole."""
    text = f"{path.name} is damaged in line {line} ({reason}): what comes behind is not read"
    return [warning(text)] if reason else []


def parse(path: Path, elements: Elements) -> tuple[int, str]:
    """Tell all elements of a file. Returns line and reason where it is damaged, 0 and "" where it is whole.

    Raises ReadFailed where it declares entities.
    """
    parser = expat.ParserCreate()
    parser.buffer_text = True
    texts: list[str] = [""]

    def start(name: str, attributes: dict[str, str]) -> None:
        texts.append("")
        elements.start(name.rpartition(":")[2], attributes)

    def end(name: str) -> None:
        elements.end(name.rpartition(":")[2], texts.pop().strip())

    def characters(text: str) -> None:
        if len(texts[-1]) < LONGEST:
            texts[-1] += text[:LONGEST]

    def refuse(*declared: object) -> None:
        what = "it declares entities, which no track needs"
        raise ReadFailed(path, what, line=parser.CurrentLineNumber, hint="take the declarations out")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.EntityDeclHandler = characters, refuse
    try:
        with path.open("rb") as file:
            while block := file.read(BLOCK):
                parser.Parse(block, False)
        parser.Parse(b"", True)
    except (expat.ExpatError, ValueError, LookupError) as error:  # the others: encodings that expat asks Python for
        return max(parser.CurrentLineNumber, 1), str(error).partition(":")[0]
    return 0, ""
