"""Two drawings of a crash: the vehicle from above with the direction of the force, and a line of what happened when."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from html import escape
from typing import Final, NamedTuple

from recon_exporters._labels import LETTER
from recon_exporters._page import shown

_SIZE: Final = 300
_MIDDLE: Final = _SIZE / 2
_FAR, _RING = 114.0, 134.0
_FORCE: Final = "#D55E00"
_HALF_LENGTH, _HALF_WIDTH = 64.0, 27.0

WIDTH: Final = 1000
_LEFT, _RIGHT, _LINE = 30.0, 970.0, 34.0
_STEP: Final = 17.0


class Moment(NamedTuple):
    """Something at t_s after time zero, told to two digits of sigma."""

    t_s: float
    text: str
    sigma: float = 0.01


def vehicle(pdof: float, low: float | None, high: float | None) -> str:
    """The vehicle from above, its front upwards, and the principal direction of force with its interval.

    pdof, low, high : deg, clockwise from the front
    """
    fan = "" if low is None or high is None else _fan(low, high)
    told = f"rincipal direction of force {shown(pdof, 1.0)}°, {_hour(pdof)} o'clock"
    return (
        f'<figure class="vehicle"><svg viewBox="0 0 {_SIZE} {_SIZE}" role="img" aria-label="p{told}">'
        f"{''.join(_clock())}{''.join(_body())}{fan}{_arrow(pdof)}</svg>"
        f"<figcaption>P{told}. The fan is the interval of 95 %; the arrow points to where the vehicle was pushed."
        "</figcaption></figure>"
    )


def _hour(pdof: float) -> int:
    return round(pdof / 30.0) % 12 or 12


def _at(angle: float, radius: float) -> tuple[float, float]:
    """A point at an angle in deg clockwise from the front."""
    return (
        _MIDDLE + radius * math.sin(math.radians(angle)),
        _MIDDLE - radius * math.cos(math.radians(angle)),
    )


def _clock() -> Iterator[str]:
    yield f'<circle class="ring" cx="{_MIDDLE}" cy="{_MIDDLE}" r="{_RING - 12}"/>'
    for hour in range(1, 13):
        x, y = _at(30.0 * hour, _RING)
        yield f'<text class="time" x="{x:.1f}" y="{y + 4:.1f}">{hour}</text>'


def _body() -> Iterator[str]:
    """Outline, wheels, windows of a car that nobody sells."""
    length, width = _HALF_LENGTH, _HALF_WIDTH
    left, top = _MIDDLE - width, _MIDDLE - length
    for side in (left - 4.0, left + 2.0 * width - 4.0):
        for end in (top + 16.0, top + 88.0):
            yield f'<rect class="tyre" x="{side:.1f}" y="{end:.1f}" width="8" height="24" rx="3"/>'
    yield (
        f'<path class="car" d="M{left} {top + 22} Q{left} {top} {_MIDDLE} {top} Q{left + 2 * width} {top} '
        f"{left + 2 * width} {top + 22} V{top + 2 * length - 12} Q{left + 2 * width} {top + 2 * length} {_MIDDLE} "
        f'{top + 2 * length} Q{left} {top + 2 * length} {left} {top + 2 * length - 12} Z"/>'
    )
    yield f'<path class="glass" d="M{left + 6} {top + 50} L{left + 11} {top + 37} Q{_MIDDLE} {top + 30} '
    yield f"{left + 2 * width - 11} {top + 37} L{left + 2 * width - 6} {top + 50} Q{_MIDDLE} {top + 44} {left + 6} "
    yield f'{top + 50} Z"/>'
    yield f'<path class="glass" d="M{left + 7} {top + 106} Q{_MIDDLE} {top + 111} {left + 2 * width - 7} {top + 106} '
    yield f'L{left + 2 * width - 12} {top + 116} Q{_MIDDLE} {top + 120} {left + 12} {top + 116} Z"/>'


def _fan(low: float, high: float) -> str:
    """The interval as a sector; its whole where it is wider than a turn."""
    if high - low >= 360.0:
        return f'<circle class="fan" cx="{_MIDDLE}" cy="{_MIDDLE}" r="{_FAR}" fill="{_FORCE}"/>'
    (x1, y1), (x2, y2) = _at(low, _FAR), _at(high, _FAR)
    wide = int(high - low > 180.0)
    return (
        f'<path class="fan" d="M{_MIDDLE} {_MIDDLE}L{x1:.1f} {y1:.1f}A{_FAR} {_FAR} 0 {wide} 1 {x2:.1f} {y2:.1f}Z" '
        f'fill="{_FORCE}"/>'
    )


def _arrow(angle: float) -> str:
    """From outside to the outline of the body."""
    (x1, y1), (x2, y2) = _at(angle, _FAR), _at(angle, _reach(angle) + 4.0)
    left, right = (_at_from(x2, y2, angle, side) for side in (-0.42, 0.42))
    head = f"M{x2:.1f} {y2:.1f}L{left[0]:.1f} {left[1]:.1f}L{right[0]:.1f} {right[1]:.1f}Z"
    return (
        f'<path class="force" d="M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}" stroke="{_FORCE}"/>'
        f'<path class="band force-head" d="{head}" fill="{_FORCE}"/>'
    )


def _reach(angle: float) -> float:
    """From the middle to the outline."""
    sine, cosine = abs(math.sin(math.radians(angle))), abs(math.cos(math.radians(angle)))
    return min(_HALF_LENGTH / max(cosine, 1e-9), _HALF_WIDTH / max(sine, 1e-9))


def _at_from(x: float, y: float, angle: float, turn: float) -> tuple[float, float]:
    way = math.radians(angle) + turn
    return x + 15.0 * math.sin(way), y - 15.0 * math.cos(way)


def time_line(moments: Sequence[Moment], first_s: float, last_s: float) -> str:
    """What happened when, from `first_s` to `last_s` after time zero.

    Labels that would meet stand below each other, the earlier one lower: no line to a label crosses another label.
    """
    inside = sorted((one for one in moments if first_s <= one.t_s <= last_s), key=lambda one: one.t_s)
    rows: list[float] = []
    marks = []
    for moment in reversed(inside):
        x = _LEFT + (moment.t_s - first_s) / (last_s - first_s) * (_RIGHT - _LEFT)
        text = f"{shown(moment.t_s, moment.sigma)} s  {moment.text}"
        width = LETTER * len(text)
        start = min(x, _RIGHT + 25.0 - width)
        row = next((index for index, left in enumerate(rows) if start + width + 14.0 < left), len(rows))
        rows[row : row + 1] = [start]
        y = _LINE + 22.0 + _STEP * row
        marks.append(
            f'<path class="tick" d="M{x:.1f} {_LINE - 5}V{y - 11:.1f}"/>'
            f'<circle class="moment" cx="{x:.1f}" cy="{_LINE}" r="4"/>'
            f'<text class="name" x="{start:.1f}" y="{y:.1f}">{escape(text)}</text>'
        )
    height = _LINE + 30.0 + _STEP * max(len(rows), 1)
    return (
        f'<figure class="moments"><svg viewBox="0 0 {WIDTH} {height:.0f}" role="img" aria-label="time line">'
        f'<path class="scale" d="M{_LEFT} {_LINE}H{_RIGHT}"/>{"".join(_seconds(first_s, last_s))}'
        f"{''.join(reversed(marks))}</svg></figure>"
    )


def _seconds(first_s: float, last_s: float) -> Iterator[str]:
    for second in range(math.ceil(first_s), math.floor(last_s) + 1):
        x = _LEFT + (second - first_s) / (last_s - first_s) * (_RIGHT - _LEFT)
        yield f'<path class="tick" d="M{x:.1f} {_LINE}v-7"/>'
        yield f'<text class="time" x="{x:.1f}" y="{_LINE - 12}">{shown(float(second))} s</text>'
