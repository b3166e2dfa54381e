"""Laws of executors: every job once, and what happens to one is no other's business.

PYTEST_DONT_REWRITE: what a law says is a sentence already.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Final

from recon.jobs import DIED, FAULT, OUT_OF_MEMORY, TIMED_OUT, Job, Outcome
from recon.stages import Executor
from recon.testing.contract import law
from recon.testing.subject import Subject

COUNT: Final = 12
"""Jobs of a batch: more than an executor of a few workers begins at once."""
MIDDLE: Final = 5
"""The one that goes wrong, where one does."""

GREED: Final = 600_000_000
"""Bytes that a process may hold: above a Python with recon, far below what a computer has."""
PIECE: Final = 50_000_000


@dataclass(frozen=True)
class Calm:
    """A job that does nothing; the base of those that go wrong."""

    number: int
    timeout: float | None = None
    memory: int | None = None

    @property
    def key(self) -> str:
        """Its number."""
        return str(self.number)

    def run(self) -> Outcome:
        """Done at once."""
        return Outcome(self.key)

    def lost(self, code: str, text: str) -> Outcome:
        """Told by the executor."""
        return Outcome(self.key, code, text)


class Raising(Calm):
    """Raises, which a job should not."""

    def run(self) -> Outcome:
        """Raise."""
        raise ValueError("out of cheese")


class Killing(Calm):
    """Ends its process without a word, as a crash of native code does."""

    def run(self) -> Outcome:
        """End."""
        os._exit(13)


class Endless(Calm):
    """Never ends."""

    def run(self) -> Outcome:
        """Wait."""
        while True:
            time.sleep(60.0)


class Greedy(Calm):
    """Takes memory without end."""

    def run(self) -> Outcome:
        """Allocate, and touch what is allocated: memory that nobody touched is not held."""
        held = []
        while True:
            held.append(bytes(PIECE).replace(b"\0", b"x"))


@law(Executor)
def every_job_is_done_once(subject: Subject) -> None:
    """All jobs have an outcome, each one; their order is free."""
    _assert_each_once(_outcomes(subject, [Calm(number) for number in range(COUNT)]))


@law(Executor)
def no_job_is_no_work(subject: Subject) -> None:
    """A batch in which everything is done already has no jobs."""
    found = _outcomes(subject, [])
    assert not found, f"without a job there are {len(found)} outcomes"


@law(Executor)
def a_raising_job_is_reported(subject: Subject) -> None:
    """A job that raises has an outcome with the code `fault` that says what it raised; the others are done."""
    found = _with_one(subject, Raising(MIDDLE), FAULT)
    assert "ValueError: out of cheese" in found.text, f"the outcome does not say what was raised: {found.text!r}"


@law(Executor)
def jobs_are_taken_as_they_are_needed(subject: Subject) -> None:
    """A fleet has more jobs than memory holds: those are taken that are begun soon, not all at once."""
    taken = 0

    def counted() -> Iterator[Job]:
        nonlocal taken
        for number in range(100_000):
            taken = number + 1
            yield Calm(number)

    outcomes = subject.stage.run(jobs=counted(), params=subject.params)
    next(outcomes)
    if hasattr(outcomes, "close"):
        outcomes.close()
    assert taken < 50_000, f"when the first outcome is told, {taken} of 100000 jobs are taken"


@law(Executor, when=lambda stage: stage.isolates)
def a_job_that_kills_its_process_ends_alone(subject: Subject) -> None:
    """It has an outcome with the code `died`; the others are done."""
    _with_one(subject, Killing(MIDDLE), DIED)


@law(Executor, when=lambda stage: stage.isolates)
def a_job_that_takes_too_long_ends_alone(subject: Subject) -> None:
    """It has an outcome with the code `timed_out`; the others are done."""
    _with_one(subject, Endless(MIDDLE, timeout=1.0), TIMED_OUT)


@law(Executor, when=lambda stage: stage.isolates)
def a_job_that_takes_too_much_memory_ends_alone(subject: Subject) -> None:
    """It has an outcome with the code `out_of_memory`; the others are done."""
    _with_one(subject, Greedy(MIDDLE, memory=GREED), OUT_OF_MEMORY)


@law(Executor, when=lambda stage: stage.isolates)
def an_executor_that_is_left_ends_its_jobs(subject: Subject) -> None:
    """Who closes the outcomes, as an interrupted batch does, waits for no job."""
    jobs: list[Job] = [Calm(0), *(Endless(number) for number in range(1, COUNT))]
    with closing(subject.stage.run(jobs=iter(jobs), params=subject.params)) as outcomes:
        first = next(outcomes)
    assert first.job == "0", f"an endless job has the outcome {first}"


def _outcomes(subject: Subject, jobs: Sequence[Job]) -> list[Outcome]:
    return list(subject.stage.run(jobs=iter(jobs), params=subject.params))


def _with_one(subject: Subject, wrong: Calm, code: str) -> Outcome:
    """The outcome of a job that goes wrong among calm ones, which are all done."""
    found = _outcomes(subject, [wrong if number == MIDDLE else Calm(number) for number in range(COUNT)])
    _assert_each_once(found)
    (told,) = [outcome for outcome in found if outcome.job == wrong.key]
    others = [outcome for outcome in found if not outcome.ok and outcome is not told]
    assert told.code == code, f"its outcome has the code {told.code!r} ({told.text}) in place of {code!r}"
    assert told.text, "its outcome does not say what happened"
    assert not others, f"{len(others)} other jobs are not done, the first since: {others[0].code}: {others[0].text}"
    return told


def _assert_each_once(outcomes: Sequence[Outcome]) -> None:
    counts = Counter(outcome.job for outcome in outcomes)
    expected = {str(number) for number in range(COUNT)}
    missing, foreign = sorted(expected - set(counts)), sorted(set(counts) - expected)
    twice = sorted(job for job, count in counts.items() if count > 1)
    assert not missing, f"{len(missing)} of {COUNT} jobs have no outcome, such as job {missing[0]}"
    assert not twice, f"job {twice[0]} has {counts[twice[0]]} outcomes"
    assert not foreign, f"there is an outcome of {foreign[0]}, which was no job"
