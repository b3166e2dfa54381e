"""Where the axes x, y, z of a log point, as three letters: FLU is x forward, y left, z up; NED north, east, down."""

from __future__ import annotations

from typing import Final

_BOX: Final = {"F": (0, 1.0), "B": (0, -1.0), "L": (1, 1.0), "R": (1, -1.0), "U": (2, 1.0), "D": (2, -1.0)}
_EARTH: Final = {"E": (0, 1.0), "W": (0, -1.0), "N": (1, 1.0), "S": (1, -1.0), "U": (2, 1.0), "D": (2, -1.0)}


def is_earth(axes: str) -> bool:
    """Do the letters name directions of the Earth?"""
    return bool(set(axes) & set("EWNS"))


def turn(axes: str) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Where in a log's x, y, z the axes forward, left, up are found, or east, north, up, and with which signs.

    axes : where x, y and z point: three letters of F B L R U D, or of E W N S U D. Raises ValueError.
    """
    known = _EARTH if is_earth(axes) else _BOX
    lines = [known[letter] for letter in axes if letter in known]
    if len(axes) != 3 or sorted(line for line, _ in lines) != [0, 1, 2]:
        raise ValueError(
            f"'{axes:.20}' does not say where x, y and z point: write three letters such as FLU (forward, left, up), "
            "FRD, RFU, ENU or NED"
        )
    found = sorted((line, index, sign) for index, (line, sign) in enumerate(lines))
    return tuple(index for _, index, _ in found), tuple(sign for _, _, sign in found)
