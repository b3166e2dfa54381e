"""Memory that a process keeps for its next arrays, in place of fresh pages that the system must clear each time.

glibc gives arrays of more than a few hundred kilobytes back to the system as soon as they are dropped, and a drive's
columns of some megabytes come and go by the hundred: half of all page faults of a run.

References
    mallopt(3): M_MMAP_THRESHOLD, M_TRIM_THRESHOLD.
"""

from __future__ import annotations

import os
import sys
from typing import Final

_TRIM_THRESHOLD: Final = -1
_MMAP_THRESHOLD: Final = -3
_LARGEST_KEPT: Final = 32 << 20
"""Bytes; glibc before 2.35 takes no more."""
_NEVER: Final = 2**31 - 1
_TOLD: Final = ("MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_", "GLIBC_TUNABLES")


def keep_freed() -> None:
    """Keep what arrays give back until the process ends. Only where the C library is glibc and nobody told it else."""
    if sys.platform != "linux" or any(name in os.environ for name in _TOLD):
        return
    import ctypes  # slow import: only when used

    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _LARGEST_KEPT)
        mallopt(_TRIM_THRESHOLD, _NEVER)
