"""Colours and clock of a Rerun file. Its viewer is dark or light, as its user likes: no colour is near either end."""

from __future__ import annotations

from typing import Final

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from recon_exporters._style import on_dark

AXIS_COLORS: Final = np.array((0xD55E00FF, 0x009E73FF, 0x56B4E9FF), dtype=np.uint32)
"""x, y, z; Okabe and Ito as in _style."""


def packed(color: str) -> int:
    """The colour #RRGGBB as Rerun counts it: 0xRRGGBBAA."""
    return int(f"{color[1:]}FF", 16)


def color_of(role: str) -> int:
    """The colour of a role."""
    return packed(on_dark(role))


def times(t_ns: NDArray[np.int64]) -> rr.TimeColumn:
    """The one clock: (n,) ns since 1970."""
    return rr.TimeColumn("time", timestamp=t_ns.view("datetime64[ns]"))
