"""Drives under executors of all kinds: none is lost, none is done twice."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from itertools import islice

import pytest

from recon.errors import StageError, StorageError
from recon.fleet.drive_job import DriveJob
from recon.fleet.flight import Flight
from recon.fleet.inputs import Drive, Drives
from recon.fleet.places import Place
from recon.jobs import FAULT, Job, Outcome
from recon.parameters import NoParams
from recon.pipeline import Pipeline
from recon.stages import Executor

DRIVES = Drives.of(Drive("A", f"d{number}", Place(f"/logs/d{number}"), (1, 1)) for number in range(5))
KEYS = [drive.key for drive in DRIVES]


def job(drive: Drive) -> DriveJob:
    return DriveJob(drive.key, drive.vehicle, drive.drive, drive.place, Place("/out"), Pipeline("p", ()))


def calm(jobs: Iterable[Job], params: NoParams) -> Iterator[Outcome]:
    return (Outcome(one.key) for one in jobs)


def twice(jobs: Iterable[Job], params: NoParams) -> Iterator[Outcome]:
    for one in jobs:
        yield Outcome(one.key)
        yield Outcome(one.key, FAULT)
        yield Outcome("vehicle=B/drive=of another batch")


def backwards(jobs: Iterable[Job], params: NoParams) -> list[Outcome]:
    return [Outcome(one.key) for one in jobs][::-1]


def leaves_some(jobs: Iterable[Job], params: NoParams) -> Iterator[Outcome]:
    return (Outcome(one.key) for one in islice(jobs, 2))


def forgets_some(jobs: Iterable[Job], params: NoParams) -> Iterator[Outcome]:
    return (Outcome(one.key) for number, one in enumerate(jobs) if number < 2)


def raises_at_once(jobs: Iterable[Job], params: NoParams) -> Iterator[Outcome]:
    raise ConnectionError("the cluster is gone")


def raises_later(jobs: Iterable[Job], params: NoParams) -> Iterator[Outcome]:
    yield Outcome(next(iter(jobs)).key)
    raise ConnectionError("the cluster is gone")


def flown(run: Callable[..., object]) -> list[tuple[Drive, Outcome]]:
    return list(Flight(Executor(name="toy", summary="For tests.", run=run), NoParams(), DRIVES, job).outcomes())


@pytest.mark.parametrize("run", [calm, twice, backwards])
def test_every_drive_has_one_outcome(run: Callable[..., object]) -> None:
    found = flown(run)
    assert sorted(drive.key for drive, _ in found) == KEYS
    assert all(outcome.ok and outcome.job == drive.key for drive, outcome in found)


@pytest.mark.parametrize("run", [leaves_some, forgets_some])
def test_a_drive_that_the_executor_does_not_answer_for_is_lost(run: Callable[..., object]) -> None:
    found = flown(run)
    assert [drive.key for drive, _ in found] == KEYS
    assert [outcome.code for _, outcome in found] == ["", "", FAULT, FAULT, FAULT]
    assert found[-1][1].text == "executor.toy did not say what became of it"


@pytest.mark.parametrize("run", [raises_at_once, raises_later])
def test_an_executor_that_raises_is_named(run: Callable[..., object]) -> None:
    with pytest.raises(StageError, match=r"step executor\.toy: ConnectionError: the cluster is gone"):
        flown(run)


def test_what_an_executor_says_on_purpose_stays_as_it_is() -> None:
    def full(jobs: Iterable[Job], params: NoParams) -> Iterator[Outcome]:
        raise StorageError("the disk is full")

    with pytest.raises(StorageError, match="the disk is full"):
        flown(full)


def test_who_leaves_a_flight_ends_the_executor() -> None:
    ended = []

    def minds(jobs: Iterable[Job], params: NoParams) -> Iterator[Outcome]:
        try:
            for one in jobs:
                yield Outcome(one.key)
        finally:
            ended.append(True)

    with closing(
        Flight(Executor(name="toy", summary="For tests.", run=minds), NoParams(), DRIVES, job).outcomes()
    ) as all_:
        next(all_)
    assert ended == [True]
