"""Ctrl-C, SIGTERM, and SIGHUP of a terminal that is gone: each ends a command in order, as a KeyboardInterrupt that
takes away what is half written.

Nothing but `signal` is imported, so that all are heeded from the first moment on.
"""

from __future__ import annotations

import signal
from typing import Final

_HEEDED: Final = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Windows has no SIGHUP."""


class Terminated(KeyboardInterrupt):
    """SIGTERM or SIGHUP came. exit_code : 128 and the signal's number"""

    exit_code = 128 + signal.SIGTERM


def heed() -> None:
    """Have them raise Terminated, unless they are handled or ignored already, as by nohup.

    Outside of the main thread: nothing.
    """
    for number in _HEEDED:
        if signal.getsignal(number) is signal.SIG_DFL:
            try:
                signal.signal(number, _terminate)
            except ValueError:  # this is no main thread, and signals are another's business
                return


def hold() -> None:
    """Let none of them spoil what is done: to be called when a result is complete and told, until the process ends.

    It does nothing where `heed` did nothing, as for a caller who has the process for himself.
    """
    ours = [number for number in _HEEDED if signal.getsignal(number) in (_terminate, _pass_over)]
    for number in (*ours, signal.SIGINT) if ours else ():
        signal.signal(number, signal.SIG_IGN)


def _terminate(number: int, frame: object) -> None:
    for one in _HEEDED:  # some senders send twice, or both: the second must not stop the cleaning
        if signal.getsignal(one) is _terminate:
            signal.signal(one, _pass_over)
    came = Terminated()
    came.exit_code = 128 + number
    raise came


def _pass_over(number: int, frame: object) -> None:
    """It has come before."""
