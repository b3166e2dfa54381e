"""How many threads linear algebra may use: one, so that a result does not hang on how many cores a machine has.

A BLAS library that shares a product out among threads adds in an order that depends on their number, and older ones
even on how busy the machine is; the last digits then differ from run to run. The matrices of a drive are small, so
threads gain nothing, and with several processes side by side they stand in each other's way.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

_TOLD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS")


@contextmanager
def one_thread() -> Iterator[None]:
    """Hold linear algebra to one thread inside, unless the environment says how many it may use."""
    if any(name in os.environ for name in _TOLD):
        yield
        return
    with threadpool_limits(limits=1, user_api="blas"):
        yield
