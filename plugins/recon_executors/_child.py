"""The process that runs jobs for `_worker.Worker`: `python -m recon_executors._child`.

Jobs come through standard input, outcomes go through standard output; what jobs print goes to standard error. When
standard input ends, the worker's owner has closed it or is dead, and this process ends at once, whatever it is doing.
"""

from __future__ import annotations

import os
import signal
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import BinaryIO

from recon.jobs import attempt
from recon.memory import keep_freed
from recon_executors import _frames as frames


def main() -> None:
    """Run jobs until there are no more."""
    keep_freed()  # one drive takes the memory of the last: many processes at once pay most for fresh pages
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the owner decides what it means
    jobs_pipe, outcomes_pipe = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    with Path(os.devnull).open("rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)
    received: SimpleQueue[bytes] = SimpleQueue()
    Thread(target=_listen, args=(jobs_pipe, received), daemon=True).start()
    while True:
        frames.send(outcomes_pipe, attempt(frames.unpack(received.get())))


def _listen(pipe: BinaryIO, received: SimpleQueue[bytes]) -> None:
    while (frame := frames.receive(pipe)) is not None:
        received.put(frame)
    os._exit(0)


if __name__ == "__main__":
    main()
