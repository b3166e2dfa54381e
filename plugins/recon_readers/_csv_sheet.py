"""A delimited text whose form is known: its columns as Arrow arrays, and the place of every field.

Only where the columnar reader fails are records looked at one by one, so that every complaint names line and column.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa

from recon.errors import ReadFailed
from recon.problems import did_you_mean
from recon.tables import Array
from recon_readers._csv_records import DELIMITERS, WITH_COMMA, Record, raw_fields, records
from recon_readers._delimited import BLANK, SPACE, single_spaces
from recon_readers._text_blocks import Text

_SHOWN: Final = 30
_NUMBER_RE2: Final = r"^[+-]?(?:(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?|(?i:inf(?:inity)?))$"


class Cells(NamedTuple):
    """Columns of a block of a sheet by index: (n,) doubles, NaN where blank; (n,) texts, null where blank.

    first : number of its first row, from 0; share : what part of the sheet has come with this block
    """

    numbers: Mapping[int, Array]
    texts: Mapping[int, pa.ChunkedArray]
    first: int
    share: float


@dataclass(frozen=True)
class Sheet:
    """A text whose form is known.

    start, end : offsets of the first row and behind the last whole one
    names : words of the header, none where there is no header; header_line : its line number, 0 for none
    above : how many lines above the first row are neither header nor comments
    cut_line : number of the last line if it was cut off and is left out
    """

    path: Path
    text: Text
    encoding: str
    delimiter: str
    decimal: str
    comment: bytes
    names: tuple[str, ...]
    header_line: int
    above: int
    width: int
    start: int
    first_line: int
    end: int
    cut_line: int | None

    @property
    def about(self) -> str:
        """Its form, as a phrase."""
        header = f"header in line {self.header_line}" if self.header_line else "no header"
        return f"{self.width} columns, {self.delimiter}, {header}, decimal {self.decimal}, {self.encoding}"

    def find(self, column: int | str) -> int | None:
        """Index of a column that is given by its word or by its number; None where it is not there.

        Raises ReadFailed where the header has the word twice.
        """
        if isinstance(column, int):
            return column - 1 if column <= self.width else None
        count = self.names.count(column)
        if count > 1:
            what = f"its header has '{column}' {count} times"
            raise ReadFailed(self.path, what, line=self.header_line, hint="give the number of the column instead")
        return self.names.index(column) if count else None

    def lacks(self, column: int | str) -> str:
        """Why a column is not there, as a phrase."""
        if isinstance(column, int):
            return f"there is no column {column}: it has {self.width}"
        if not self.names:
            return f"there is no column '{column}': it has no header, so columns go by number, 1 to {self.width}"
        shown = ", ".join(self.names[:20]) + ", ..." * (len(self.names) > 20)
        return f"there is no column '{column}'; {did_you_mean(column, self.names) or f'its columns are {shown}'}"

    def read(self, numbers: Iterable[int], texts: Iterable[int]) -> Iterator[Cells]:
        """Columns by index, some as numbers, some as texts, or as both, block by block.

        Raises ReadFailed with line and column for a row of another width and for text where a number belongs.
        """
        wanted, as_text = sorted(set(numbers)), sorted(set(texts))
        kinds = {**dict.fromkeys(wanted, pa.float64()), **dict.fromkeys(as_text, pa.string())}
        first, done = 0, self.start
        for block in self.text.blocks(self.start, self.end, quoted=self.text.quotes > 0):
            done += len(block)
            try:
                found = self._columns(block, kinds)
            except pa.ArrowInvalid:
                found = self._texts(block, list(kinds))
            yield Cells(
                {index: self._as_numbers(index, found[index], first) for index in wanted},
                {index: trimmed(found[index]) for index in as_text},
                first,
                done / self.end,
            )
            first += len(next(iter(found.values())))

    def _texts(self, block: bytes, indices: Sequence[int]) -> dict[int, pa.ChunkedArray]:
        try:
            return self._columns(_tidied(block, self.delimiter, self.comment), dict.fromkeys(indices, pa.string()))
        except pa.ArrowInvalid as error:
            raise self._first_fault(str(error)) from error

    def _columns(self, rows: bytes, kinds: dict[int, pa.DataType]) -> dict[int, pa.ChunkedArray]:
        from pyarrow import csv as arrow_csv

        if not rows.strip(b" \n"):
            return {index: pa.chunked_array([pa.array([], kind)]) for index, kind in kinds.items()}
        names = [str(index) for index in range(self.width)]
        quoted = self.text.quotes > 0
        table = arrow_csv.read_csv(
            pa.BufferReader(rows),
            read_options=arrow_csv.ReadOptions(column_names=names),
            parse_options=arrow_csv.ParseOptions(
                delimiter=DELIMITERS[self.delimiter].decode(),
                quote_char='"' if quoted else False,
                newlines_in_values=quoted,
            ),
            convert_options=arrow_csv.ConvertOptions(
                column_types={str(index): kind for index, kind in kinds.items()},
                include_columns=[str(index) for index in kinds],
                null_values=list(BLANK),
                strings_can_be_null=True,
                decimal_point="," if self.decimal == "comma" else ".",
            ),
        )
        return {index: table[str(index)] for index in kinds}

    def _as_numbers(self, index: int, values: pa.ChunkedArray, first: int) -> Array:
        """A column as (n,) doubles, NaN where blank. Raises ReadFailed at the first text that is no number.

        first : number of its first row
        """
        if values.type == pa.string():
            from pyarrow import compute

            texts = trimmed(values)
            if self.decimal == "comma":
                texts = compute.replace_substring(texts, ",", ".")
            row = compute.index(compute.match_substring_regex(texts, _NUMBER_RE2), False).as_py()
            if row >= 0:
                raise self.no(first + row, index, values[row].as_py(), "number")
            values = texts.cast(pa.float64())
        return np.asarray(values.to_numpy(), dtype=np.float64)

    def title(self, index: int) -> str:
        """How messages call a column."""
        return self.names[index] if self.names and self.names[index] else f"column {index + 1}"

    def no(self, row: int, index: int, value: str, what: str, hint: str = "") -> ReadFailed:
        """The error that a field is no number, or no time of its format."""
        shown = value if len(value) <= _SHOWN else f"{value[:_SHOWN]}..."
        if self.decimal == "point" and what == "number" and WITH_COMMA.fullmatch(value.encode()):
            return self.refused(row, index, f"'{shown}' has a decimal comma", "set reader.csv's decimal to comma")
        text = f"{self.title(index)} is {shown!r}, which is no {what}"
        return self.refused(row, index, text, hint or "repair the line or delete it, or map another column")

    def refused(self, row: int, index: int, what: str, hint: str) -> ReadFailed:
        """The error that names a field; both its numbers count from 0."""
        line, column = self.place(row, index)
        return ReadFailed(self.path, what, line=line, column=column, hint=hint)

    def place(self, row: int, index: int) -> tuple[int, int | None]:
        """Line and column, 1-based, of a field; both its numbers count from 0."""
        record = next(islice(self._rows(), row, None), None)
        if record is None:
            return self.first_line, None
        parts = [*raw_fields(record[2], self.delimiter), b""]
        before = b"".join(parts[:index])
        before += parts[index][: len(parts[index]) - len(parts[index].lstrip(SPACE))]
        return record[0] + before.count(b"\n"), len(before) - (before.rfind(b"\n") + 1) + 1

    def _rows(self) -> Iterator[Record]:
        first = self.first_line
        for block in self.text.blocks(self.start, self.end, quoted=self.text.quotes > 0):
            for number, offset, text in records(block, self.comment):
                yield number + first - 1, offset, text
            first += block.count(b"\n")

    def _first_fault(self, reason: str) -> ReadFailed:
        """Look for the record that the columnar reader did not take."""
        for number, _, text in self._rows():
            count = len(raw_fields(text, self.delimiter))
            if count != self.width:
                what = f"a row of {count} columns among rows of {self.width}"
                return ReadFailed(self.path, what, line=number, hint="repair the line or delete it")
        what = f"it cannot be taken apart into columns: {reason.splitlines()[0][:200]}"
        return ReadFailed(self.path, what, hint="check its quotes, or set reader.csv's delimiter")


def trimmed(values: pa.ChunkedArray) -> pa.ChunkedArray:
    """Texts without spaces around them, null where nothing is left."""
    from pyarrow import compute

    plain = compute.utf8_trim_whitespace(values)
    blank = compute.is_in(plain, value_set=pa.array(BLANK))
    return compute.if_else(blank, pa.scalar(None, pa.string()), plain)


def _tidied(body: bytes, delimiter: str, comment: bytes) -> bytes:
    """The rows without comments and blank lines of spaces. Lines stay where they are."""
    if comment and comment in body:
        body = re.sub(rb"(?m)^[ \t]*%s.*$" % re.escape(comment), b"", body)
    if delimiter != "space":
        return re.sub(rb"(?m)^ +$", b"", body)
    return single_spaces(body)
