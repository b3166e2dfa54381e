"""Jobs on a Dask cluster: one that others built and keep, or one of this machine for the time of the batch.

Each job runs in a process of its own beside the Dask worker, so that a job that dies, hangs or fills the memory leaves
the worker unharmed; the worker of a cluster of this machine is therefore a part of this process. When a worker itself
is lost, Dask gives its jobs to others; a job whose workers are lost again and again
(`distributed.scheduler.allowed-failures`) is given up and reported.
Machines that are not this one must reach input and output under the same paths, and have the same recon installed.

References
    Rocklin (2015), "Dask: parallel computation with blocked algorithms and task scheduling", SciPy;
    distributed, "Resilience".
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from importlib import import_module
from itertools import islice
from queue import Empty, SimpleQueue
from typing import Any, Final
from uuid import uuid4

from recon import Executor, Params, hookimpl, setting
from recon.errors import PluginBroken
from recon.extras import needs
from recon.jobs import DIED, FAULT, Job, Outcome
from recon_executors._worker import Worker, cores

AHEAD: Final = 2
"""Jobs on the cluster for each thread of its workers: so that none waits for the next."""


class DaskParams(Params):
    """Parameters of executor.dask."""

    address: str = setting(
        "", doc="Of the scheduler, such as tcp://10.0.0.1:8786; empty for a cluster of this machine."
    )
    workers: int | None = setting(None, gt=0, doc="Jobs at a time on this machine; by default one for each core.")
    threads: int = setting(1, gt=0, doc="Threads of the numeric libraries for each job.")


def dask(jobs: Iterable[Job], params: DaskParams) -> Iterator[Outcome]:
    """Outcomes in the order in which jobs end. Raises PluginBroken without distributed, or without an answer."""
    distributed = _distributed()
    pending = iter(jobs)
    batch = uuid4().hex
    flight: dict[Any, Job] = {}
    with _client(params, distributed) as client:

        def submit(count: int) -> list[Any]:
            begun = {
                client.submit(_run, job, batch, params.threads, key=f"{batch}-{job.key}", pure=False): job
                for job in islice(pending, count)
            }
            flight.update(begun)
            return list(begun)

        first = submit(AHEAD * max(sum(client.nthreads().values()), 1))
        done = distributed.as_completed(first, loop=client.loop)
        try:
            for future in done:
                yield _outcome(future, flight.pop(future), distributed.KilledWorker)
                done.update(submit(1))
        finally:
            client.cancel(list(flight))
            client.run(_stop, batch, on_error="ignore")  # a worker that is lost has nothing left to stop


def _distributed() -> Any:
    """The package, which has no types for what is used here."""
    with needs("executor.dask", "Dask", extra="dask"):
        return import_module("distributed")


@contextmanager
def _client(params: DaskParams, distributed: Any) -> Iterator[Any]:
    with ExitStack() as stack:
        if params.address:
            cluster: Any = params.address
        else:
            made = distributed.LocalCluster(
                processes=False,
                n_workers=1,
                threads_per_worker=params.workers or cores(),
                dashboard_address="127.0.0.1:0",
            )
            cluster = stack.enter_context(made)
        try:
            client = distributed.Client(cluster, set_as_default=False)
        except (OSError, ValueError) as error:
            text = f"executor.dask: no scheduler answers at {params.address}: {error}"
            raise PluginBroken(text, "start one with 'dask scheduler', or leave the address away") from error
        yield stack.enter_context(client)


def _outcome(future: Any, job: Job, killed: type[BaseException]) -> Outcome:
    if future.cancelled():
        return job.lost(FAULT, "the cluster cancelled it")
    error = future.exception()
    if error is None:
        outcome: Outcome = future.result()
        return outcome
    if isinstance(error, killed):
        return job.lost(DIED, f"the workers that had it were lost, one after the other: {error}")
    return job.lost(FAULT, f"{type(error).__name__}: {error}")


# --- on the cluster's workers ---------------------------------------------------------------------------------------


class _Processes:
    """The processes beside one Dask worker for one batch: as many as it ever ran jobs at a time."""

    def __init__(self) -> None:
        self._all: list[Worker] = []
        self._idle: SimpleQueue[Worker] = SimpleQueue()

    def run(self, job: Job, threads: int) -> Outcome:
        """A job, in a process that is idle or new."""
        try:
            worker = self._idle.get_nowait()
        except Empty:
            worker = Worker(threads)
            self._all.append(worker)
        outcome = worker.run(job)
        self._idle.put(worker)
        return outcome

    def stop(self) -> None:
        """End all of them, and what they do."""
        for worker in self._all:
            worker.stop()


@cache
def _processes(batch: str) -> _Processes:
    """Those of this Dask worker: they live as long as the batch, and end with the worker at the latest."""
    return _Processes()


def _run(job: Job, batch: str, threads: int) -> Outcome:
    return _processes(batch).run(job, threads)


def _stop(batch: str) -> None:
    _processes(batch).stop()


@hookimpl
def declare_executors() -> Iterable[Executor]:
    """executor.dask."""
    yield Executor(
        name="dask",
        summary="Jobs on a Dask cluster, each in a process that ends alone.",
        params=DaskParams,
        run=dask,
        isolates=True,
        references=("Rocklin (2015), Dask: parallel computation with blocked algorithms and task scheduling, SciPy",),
    )
