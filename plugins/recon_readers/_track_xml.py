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
from recon.tables import Array
from recon_readers._time_order import Mask, Times
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
    numbers: dict[str, array[float]] = field(init=False)
    _texts: list[str] = field(default_factory=list)
    _t_ns: list[Times] = field(default_factory=list)
    _good: list[Mask] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.numbers = {name: array("d") for name in self.names}

    def add(self, time: str, values: Mapping[str, float]) -> None:
        """One more point."""
        self._texts.append(time)
        for name, column in self.numbers.items():
            column.append(values.get(name, np.nan))
        if len(self._texts) >= _ROWS:
            self._flush()

    def _flush(self) -> None:
        t_ns, good = moments(pa.array(self._texts, pa.string()))
        self._t_ns.append(t_ns)
        self._good.append(good)
        self._texts.clear()

    def times(self) -> tuple[Times, Mask]:
        """Times of all points, (n,) ns since 1970, and which have none, (n,) bool."""
        self._flush()
        return np.concatenate(self._t_ns), ~np.concatenate(self._good)

    def column(self, name: str) -> Array:
        """Numbers of all points: (n,)."""
        return np.array(self.numbers[name], dtype=np.float64)


def number(text: str | None) -> float:
    """A decimal number, NaN where the text is none."""
    try:
        return float(text) if text and text.isascii() and "_" not in text else np.nan
    except ValueError:
        return np.nan


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
