"""Plain scalars by the core schema of YAML 1.2.2, section 10.3.2: `1e-3` is a number, `on` and `12:30` are text."""

from __future__ import annotations

import math
import re
from typing import TypeAlias

Scalar: TypeAlias = bool | int | float | str | None

_CONSTANTS: dict[str, Scalar] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_INTEGER = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_BASES = {"0o": 8, "0x": 16}
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


def reads_as_text(text: str) -> bool:
    """Would this text, written without quotes, be read back as the same text rather than a number or a constant?

    It tells only about types; characters that need quotes for YAML's syntax are the writer's business.
    """
    return plain_scalar(text) == text


def plain_scalar(text: str) -> Scalar:
    """What a scalar without quotes and without a tag stands for; a number that is too large to hold is not finite."""
    return _CONSTANTS[text] if text in _CONSTANTS else _parsed(text)


def _parsed(text: str) -> int | float | str:
    """The number that a plain scalar writes, not finite where it is too large to hold; otherwise the text itself."""
    if _INTEGER.fullmatch(text):
        try:
            whole = int(text, _BASES.get(text[:2], 10))
        except ValueError:  # more digits than Python converts
            return math.inf
        return whole if -(2**63) <= whole < 2**63 else math.inf
    if _FLOAT.fullmatch(text):
        return float(text)
    return float(text.replace(".", "")) if _NOT_FINITE.fullmatch(text) else text
