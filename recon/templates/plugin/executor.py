"""Jobs in the threads of this process, for jobs that wait more than they compute.

A job that kills its process ends the batch: who needs more safety runs each job in a process and says `isolates=True`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from itertools import islice

from recon import Executor, Params, hookimpl, setting
from recon.jobs import Job, Outcome, attempt


class ThreadParams(Params):
    """Parameters of executor.$name."""

    workers: int = setting(2, gt=0, doc="Threads.")


def threads(jobs: Iterable[Job], params: ThreadParams) -> Iterator[Outcome]:
    """Outcomes in the order in which jobs end; `attempt` runs a job and turns what it raises into its outcome."""
    pending = iter(jobs)
    with ThreadPoolExecutor(params.workers) as pool:
        flight = {pool.submit(attempt, job) for job in islice(pending, params.workers)}
        while flight:
            done, flight = wait(flight, return_when=FIRST_COMPLETED)
            flight |= {pool.submit(attempt, job) for job in islice(pending, len(done))}
            yield from (future.result() for future in done)


@hookimpl
def declare_executors() -> Iterable[Executor]:
    """executor.$name."""
    yield Executor(
        name="$name",
        summary="Jobs in the threads of this process.",
        params=ThreadParams,
        run=threads,
    )
