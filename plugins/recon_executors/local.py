"""Jobs on the cores of this machine, each in a process that ends alone.

A job that kills its process, hangs or fills the memory costs its own process only; the next job gets a new one. When
this process dies, however it dies, its workers end too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import Final

from recon import Executor, Params, hookimpl, setting
from recon.jobs import Job, Outcome
from recon_executors._worker import Worker, cores

HEED_S: Final = 0.5
"""Longest time to Ctrl-C, which Windows delivers only between two waits."""


class LocalParams(Params):
    """Parameters of executor.local."""

    workers: int | None = setting(None, gt=0, doc="Processes; by default one for each core that this process may use.")
    threads: int = setting(1, gt=0, doc="Threads of the numeric libraries in each of them.")


def local(jobs: Iterable[Job], params: LocalParams) -> Iterator[Outcome]:
    """Outcomes in the order in which jobs end. A job is taken from `jobs` when a worker is free for it."""
    shared = _Shared(jobs)
    ended: SimpleQueue[Outcome | BaseException | None] = SimpleQueue()
    workers = [Worker(params.threads) for _ in range(params.workers or cores())]
    lanes = [Thread(target=_lane, args=(worker, shared, ended), daemon=True) for worker in workers]
    for lane in lanes:
        lane.start()
    try:
        open_lanes = len(lanes)
        while open_lanes:
            try:
                outcome = ended.get(timeout=HEED_S)
            except Empty:
                continue
            if outcome is None:
                open_lanes -= 1
            elif isinstance(outcome, BaseException):
                raise outcome
            else:
                yield outcome
    finally:
        shared.close()
        for worker in workers:
            worker.stop()
        for lane in lanes:
            lane.join()


class _Shared:
    """An iterable that several threads take from; closed, it gives no more."""

    def __init__(self, jobs: Iterable[Job]) -> None:
        self._jobs = iter(jobs)
        self._lock = Lock()
        self._closed = False

    def take(self) -> Job | None:
        """The next job; None where there is none."""
        with self._lock:
            return None if self._closed else next(self._jobs, None)

    def close(self) -> None:
        """Give no more."""
        with self._lock:
            self._closed = True


def _lane(worker: Worker, jobs: _Shared, ended: SimpleQueue[Outcome | BaseException | None]) -> None:
    """One worker's share of the jobs, then None; or what went wrong with the pool itself."""
    try:
        while (job := jobs.take()) is not None:
            ended.put(worker.run(job))
        worker.stop()
        ended.put(None)
    except BaseException as error:  # it is raised where the outcomes are read
        ended.put(error)


@hookimpl
def declare_executors() -> Iterable[Executor]:
    """executor.local."""
    yield Executor(
        name="local",
        summary="Jobs on the cores of this machine, each in a process that ends alone.",
        params=LocalParams,
        run=local,
        isolates=True,
    )
