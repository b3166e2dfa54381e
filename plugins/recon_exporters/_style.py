"""How each role is drawn: colours of Okabe and Ito, that every eye tells apart, and marks that differ without them.

References
    Okabe, Ito (2008), "Color universal design: how to make figures and presentations that are friendly to colorblind
    people".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal


@dataclass(frozen=True)
class Style:
    """Colour, kind of mark, its width in px, and the dashes of a line."""

    color: str
    mark: Literal["line", "dots", "squares"] = "line"
    width: float = 1.4
    dashes: tuple[float, ...] = ()


_LINES: Final = (("#0072B2", ()), ("#CC79A7", (7.0, 2.0)), ("#009E73", (2.0, 2.0)), ("#56B4E9", (7.0, 2.0, 2.0, 2.0)))
_FIXES: Final = ("#E69F00", "#009E73", "#CC79A7")
STYLES: Final[Mapping[str, Style]] = {
    **{f"trajectory {number}": Style(color, dashes=dashes) for number, (color, dashes) in enumerate(_LINES, start=1)},
    "reference": Style("#000000", width=1.0, dashes=(4.0, 2.5)),
    **{f"gnss {number}": Style(color, "dots", 3.2) for number, color in enumerate(_FIXES, start=1)},
    "wheel": Style("#56B4E9", "dots", 2.2),
    "accepted": Style("#0072B2", "dots", 2.6),
    "rejected": Style("#D55E00", "squares", 5.0),
    "east": Style("#0072B2"),
    "north": Style("#D55E00", dashes=(7.0, 2.0)),
    "up": Style("#009E73", dashes=(2.0, 2.0)),
    "x": Style("#0072B2"),
    "y": Style("#D55E00"),
    "z": Style("#009E73"),
    "raw x": Style("#56B4E9", width=4.0),
    "raw y": Style("#E69F00", width=4.0),
}
EVENTS: Final[Mapping[str, str]] = {
    "standstill": "#999999",
    "outage": "#E69F00",
    "crash": "#D55E00",
    "impact": "#D55E00",
    "trip": "#0072B2",
    "harsh_acceleration": "#009E73",
    "harsh_cornering": "#56B4E9",
}
OTHER_EVENT: Final = "#CC79A7"
_ON_DARK: Final[Mapping[str, str]] = {
    "trajectory 1": "#56B4E9",
    "trajectory 4": "#F0E442",
    "reference": "#999999",
    "wheel": "#F0E442",
    "accepted": "#56B4E9",
    "east": "#56B4E9",
}
"""Where that of the charts on white paper is too dark on black, or on a picture from above."""


_REPEATED: Final = {"trajectory": len(_LINES), "gnss": len(_FIXES)}


def role_of_fixes(stream: str) -> str:
    """The role of a stream of GNSS: "gnss_2" is "gnss 2", "gnss" is the first."""
    number = stream.removeprefix("gnss").removeprefix("_") or "1"
    return f"gnss {number}"


def style_of(role: str) -> Style:
    """Style of a role; trajectories beyond the fourth, and receivers beyond the third, look like the first again."""
    kind, _, number = role.rpartition(" ")
    if role not in STYLES and kind in _REPEATED:
        role = f"{kind} {(int(number) - 1) % _REPEATED[kind] + 1}"
    return STYLES[role]


def on_dark(role: str) -> str:
    """The colour of a role that is seen on black and on white, #RRGGBB."""
    return _ON_DARK.get(role, style_of(role).color)


def layer(role: str) -> int:
    """Lines lie over clouds of points, and what was rejected over both."""
    return ("dots", "line", "squares").index(style_of(role).mark)
