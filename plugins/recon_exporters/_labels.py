"""Where the names of points go so that none lies over another, nor over the edge of the drawing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

LETTER: Final = 6.6
"""Width of a letter of the drawings' 13 px, the widest that is usual."""
_LINE: Final = 16.0
"""px, height of a line."""
_NEAR: Final = 12.0
"""px from a point to its name."""
_MARK: Final = 8.0
"""Half of the size of what is drawn at a point."""
_ROWS: Final = (-0.5, 0.5, -1.5, 1.5, -2.5, 2.5, -3.5, 3.5)
"""Lines above or below the point."""


class Label(NamedTuple):
    """A name at the left end of its base line, and the point that it is of."""

    text: str
    x: float
    y: float
    point: tuple[float, float]


class _Box(NamedTuple):
    left: float
    top: float
    right: float
    bottom: float

    def meets(self, other: _Box) -> bool:
        return (
            self.left < other.right and other.left < self.right and self.top < other.bottom and other.top < self.bottom
        )


def placed(
    names: Sequence[tuple[str, tuple[float, float]]], points: Sequence[tuple[float, float]], width: float, height: float
) -> list[Label]:
    """Names beside their points, the first ones closest; those for which there is no room are left out.

    names : text, point; points : all that must stay visible; width, height : of the drawing
    """
    taken = [_Box(x - _MARK, y - _MARK, x + _MARK, y + _MARK) for x, y in points]
    sheet = _Box(2.0, 2.0, width - 2.0, height - 2.0)
    found = []
    for text, point in names:
        for box in _boxes(LETTER * len(text), point):
            inside = sheet.left <= box.left and box.right <= sheet.right
            inside = inside and sheet.top <= box.top and box.bottom <= sheet.bottom
            if inside and not any(box.meets(other) for other in taken):
                taken.append(box)
                found.append(Label(text, box.left, box.bottom - 4.0, point))
                break
    return found


def _boxes(length: float, point: tuple[float, float]) -> Iterator[_Box]:
    """To the right or to the left of the point, first beside it, then further above and below."""
    x, y = point
    for row in _ROWS:
        middle = y + _LINE * row
        for left in (x + _NEAR, x - _NEAR - length):
            yield _Box(left, middle - 0.5 * _LINE, left + length, middle + 0.5 * _LINE)
