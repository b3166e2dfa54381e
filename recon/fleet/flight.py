"""One pass of an executor over drives, whatever the executor does: every drive has an outcome, and one only."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from itertools import chain
from typing import TypeAlias

from recon.errors import ReconError, StageError
from recon.fleet.drive_job import DriveJob
from recon.fleet.inputs import Drive, Drives
from recon.jobs import FAULT, Outcome
from recon.parameters import Params
from recon.stages import Executor

Ended: TypeAlias = Generator[tuple[Drive, Outcome], None, None]


class Flight:
    """One pass of an executor over drives.

    job : makes the work that a drive is
    out : by key, the drives that the executor has taken and not yet answered for
    """

    def __init__(self, executor: Executor, params: Params, drives: Drives, job: Callable[[Drive], DriveJob]) -> None:
        self._executor = executor
        self._params = params
        self._left = iter(drives)
        self._job = job
        self.out: dict[str, Drive] = {}

    def outcomes(self) -> Ended:
        """Each drive with its outcome; one that the executor never answers for, or never takes, counts as lost.

        Raises StageError where the executor raises.
        """
        with closing(self._answers()) as answers:
            for outcome in answers:
                drive = self.out.pop(outcome.job, None)
                if drive is not None:  # answered twice: the first answer counts
                    yield drive, outcome
        for drive in chain(list(self.out.values()), self._left):
            self.out.pop(drive.key, None)
            yield drive, self._job(drive).lost(FAULT, f"{self._executor.key} did not say what became of it")

    def _answers(self) -> Generator[Outcome, None, None]:
        try:
            yield from self._executor.run(jobs=self._jobs(), params=self._params)
        except ReconError:
            raise
        except Exception as error:  # an executor may be somebody else's code
            text = f"{type(error).__name__}: {error}"
            raise StageError(self._executor.key, text, "what is done is kept; '-v' shows where it failed") from error

    def _jobs(self) -> Iterator[DriveJob]:
        for drive in self._left:
            self.out[drive.key] = drive
            yield self._job(drive)
