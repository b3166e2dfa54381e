"""One job after the other, in this process: for a debugger, and to be compared with.

It cannot end a job: a time or memory limit of the batch is not kept, and a job that kills its process ends the batch.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from recon import Executor, hookimpl
from recon.jobs import Job, Outcome, attempt
from recon.parameters import NoParams


def serial(jobs: Iterable[Job], params: NoParams) -> Iterator[Outcome]:
    """Outcomes in the order of the jobs."""
    return map(attempt, jobs)


@hookimpl
def declare_executors() -> Iterable[Executor]:
    """executor.serial."""
    yield Executor(name="serial", summary="One job after the other, in this process.", run=serial)
