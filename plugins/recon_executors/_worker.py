"""A process of its own for one job after the other, which can be ended from outside without harm to anything else.

Every worker has pipes of its own. A pool whose processes share a pipe and its lock (as those of the standard library
and of pebble do) stands still for ever when one of them is killed while it holds the lock.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path
from signal import Signals
from types import TracebackType
from typing import Final

from recon.jobs import DIED, OUT_OF_MEMORY, TIMED_OUT, Job, Outcome
from recon.units import format_quantity
from recon_executors import _frames as frames

LOOK_S: Final = 0.05
"""Between two looks at a job."""
MOST_JOBS: Final = 500
"""Of one process, which takes a second or two to begin. What a stage leaks, as files that stay open, fails no drive
behind it then."""

_THREADS: Final = ("OMP", "OPENBLAS", "MKL", "VECLIB_MAXIMUM", "NUMEXPR", "BLIS")
"""Numeric libraries whose threads are counted by the environment: <name>_NUM_THREADS."""


class Worker:
    """Runs jobs in another process, which is started again when it has ended. `stop` may come from another thread.

    threads : of each numeric library in that process
    """

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._stopped = False
        self._jobs = 0
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - `stop` closes it

    def __enter__(self) -> Worker:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def stop(self) -> None:
        """End the process, and start no other."""
        with self._lock:
            self._stopped = True
            self._end()
            self._said.close()

    def run(self, job: Job) -> Outcome:
        """The job's outcome, in any case: also when its process dies, or is ended since it goes beyond its limits."""
        process = self._running()
        if process is None or process.stdin is None or process.stdout is None:
            return job.lost(DIED, "the batch was stopped")
        watch = _Watch(process, job)
        try:
            frames.send(process.stdin, job)
            with watch:
                frame = frames.receive(process.stdout)
        except OSError:
            frame = None
        if frame is not None:
            outcome: Outcome = frames.unpack(frame)
            return outcome
        code = process.wait()
        return job.lost(*(watch.reason or (DIED, self._last_words(code))))

    def _running(self) -> subprocess.Popen[bytes] | None:
        with self._lock:
            if self._stopped:
                return None
            self._said.seek(0)
            self._said.truncate()
            if self._process is None or self._process.poll() is not None or self._jobs == MOST_JOBS:
                self._end()
                self._process, self._jobs = _started(self._threads, self._said.fileno()), 0
            self._jobs += 1
            return self._process

    def _end(self) -> None:
        if self._process is None:
            return
        end_tree(self._process.pid)
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        self._process = None

    def _last_words(self, code: int) -> str:
        """How the process ended, and the last line that it wrote to standard error."""
        with self._lock:
            if self._stopped:
                return "the batch was stopped"
            self._said.seek(0)
            lines = self._said.read().decode(errors="replace").strip().splitlines()
        how = f"by {_signal_name(-code)}" if code < 0 else f"with exit code {code}"
        return f"its process ended {how}{f': {lines[-1].strip()}' if lines else ''}"


class _Watch:
    """While it is entered, ends a process that takes more than its job may, and what is left of one that died.

    reason : why it was ended, if it was
    """

    def __init__(self, process: subprocess.Popen[bytes], job: Job) -> None:
        self._process = process
        self._job = job
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)
        self.reason: tuple[str, str] | None = None

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()

    def _look(self) -> None:
        started = time.monotonic()
        while not self._over.wait(LOOK_S):
            if _is_dead(self._process.pid):  # what it began may live, and hold the pipe open for ever
                end_tree(self._process.pid)
                return
            held = _held(self._process.pid) if self._job.memory is not None else 0
            if self._job.timeout is not None and time.monotonic() - started > self._job.timeout:
                self.reason = (TIMED_OUT, f"it took more than {format_quantity(self._job.timeout, 's')}")
            elif self._job.memory is not None and held > self._job.memory:
                limit = f"{self._job.memory / 1e9:g} GB"
                self.reason = (OUT_OF_MEMORY, f"it held {held / 1e9:.3g} GB of memory; the limit is {limit}")
            if self.reason is not None:
                end_tree(self._process.pid)
                return


def _started(threads: int, errors: int) -> subprocess.Popen[bytes]:
    environment = {
        **os.environ,
        **{f"{library}_NUM_THREADS": str(threads) for library in _THREADS},
        "PYTHONPATH": os.pathsep.join(path or str(Path.cwd()) for path in sys.path),
    }
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "recon_executors._child"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=errors,
        env=environment,
        process_group=None if sys.platform == "win32" else 0,  # by which what it began is found when it is dead
    )


def _held(pid: int) -> int:
    """Bytes of memory that a process and its children hold."""
    import psutil

    try:
        process = psutil.Process(pid)
        family = [process, *process.children(recursive=True)]
    except psutil.Error:
        return 0
    held = 0
    for member in family:
        with suppress(psutil.Error):
            held += member.memory_info().rss
    return held


def cores() -> int:
    """Those that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


def end_tree(pid: int) -> None:
    """Kill a process that `_started` began, and all that it began, also where it is dead but not yet waited for."""
    import psutil

    try:
        process = psutil.Process(pid)
        family = [*process.children(recursive=True), process]
    except psutil.Error:
        return
    for member in family:
        with suppress(psutil.Error):
            member.kill()
    if sys.platform != "win32":
        with suppress(OSError):
            os.killpg(pid, Signals.SIGKILL)


def _is_dead(pid: int) -> bool:
    import psutil

    try:
        return bool(psutil.Process(pid).status() in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD))
    except psutil.Error:
        return True


def _signal_name(number: int) -> str:
    try:
        return f"signal {number} ({Signals(number).name})"
    except ValueError:
        return f"signal {number}"
