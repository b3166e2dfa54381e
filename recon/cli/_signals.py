"""Ctrl-C and SIGTERM: both end a command in order, as a KeyboardInterrupt that takes away what is half written.

Nothing but `signal` is imported, so that both are heeded from the first moment on.
"""

from __future__ import annotations

import signal
from typing import Final

EXIT_TERMINATED: Final = 143
"""128 + SIGTERM."""


class Terminated(KeyboardInterrupt):
    """SIGTERM came."""


def heed() -> None:
    """Have SIGTERM raise Terminated, unless it is handled or ignored already. Outside of the main thread: nothing."""
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        try:
            signal.signal(signal.SIGTERM, _terminate)
        except ValueError:  # this is no main thread, and signals are another's business
            return


def hold() -> None:
    """Let neither of them spoil what is done: to be called when a result is complete and told, until the process ends.

    It does nothing where `heed` did nothing, as for a caller who has the process for himself.
    """
    if signal.getsignal(signal.SIGTERM) is _terminate:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


def _terminate(number: int, frame: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # some senders send it twice; the second must not stop the cleaning
    raise Terminated
