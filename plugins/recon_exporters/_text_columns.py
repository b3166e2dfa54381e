"""Numbers and times as columns of text, for files that are written row by row, and text inside XML."""

from __future__ import annotations

import re
from typing import Any, Final
from xml.sax.saxutils import escape

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.tables import Array

PLACE_DIGITS: Final = 9
"""Digits of a degree behind the point: 0.1 mm on the ground."""
DIGITS: Final = 3
"""Digits behind the point of everything else."""
_NOT_IN_XML: Final = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def iso_8601(t_ns: NDArray[np.int64]) -> pa.Array:
    """Times as text, (n,): 2024-05-01T08:00:00.010Z, with as many of 3, 6 or 9 digits as all of them need."""
    import pyarrow.compute as pc  # slow import: only when used

    unit, step = next(((u, s) for u, s in (("ms", 1_000_000), ("us", 1_000)) if not (t_ns % s).any()), ("ns", 1))
    text = pa.array(t_ns // step).cast(pa.timestamp(unit)).cast(pa.string())
    return pc.binary_join_element_wise(pc.replace_substring(text, " ", "T"), "Z", "")


def decimals(values: Array, digits: int = DIGITS) -> pa.Array:
    """Numbers as text with a fixed number of digits and no exponent, (n,); null for NaN."""
    known = np.isfinite(values)
    return fixed_point(
        pa.array(np.rint(np.where(known, values, 0.0) * 10**digits).astype(np.int64), mask=~known), digits
    )


def fixed_point(scaled: pa.Array, digits: int) -> pa.Array:
    """Integers that count units of 10^-digits, as text: 1500 with three digits is 1.500; null stays null."""
    import pyarrow.compute as pc  # slow import: only when used

    size = pc.abs(scaled)
    whole = pc.divide(size, 10**digits)
    part = pc.subtract(size, pc.multiply(whole, 10**digits)).cast(pa.string())
    sign = pc.if_else(pc.less(scaled, 0), "-", "")
    text = pc.binary_join_element_wise(whole.cast(pa.string()), pc.utf8_lpad(part, digits, "0"), ".")
    return pc.binary_join_element_wise(sign, text, "")


def elements(tag: str, texts: pa.Array) -> pa.Array:
    """Each text as an XML element, (n,); "" where it is null."""
    import pyarrow.compute as pc  # slow import: only when used

    return pc.fill_null(pc.binary_join_element_wise(f"<{tag}>", texts, f"</{tag}>", ""), "")


def joined(*parts: Any) -> pa.Array:
    """Texts side by side, row by row: (n,); a part is an (n,) array or one text for all rows."""
    import pyarrow.compute as pc  # slow import: only when used

    return pc.binary_join_element_wise(*parts, "")


def xml(value: object) -> str:
    """A value as text between two tags of XML 1.0, or in its attributes; characters that XML cannot hold left out."""
    return escape(_NOT_IN_XML.sub("", str(value)), {'"': "&quot;"})
