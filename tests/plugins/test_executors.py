"""Executors: the laws, and what the first-party ones say of a job that did not come back."""

from __future__ import annotations

import pytest

from recon.jobs import DIED, Outcome
from recon.registry import Registry
from recon.testing import Case, contract
from recon.testing.laws.executors import Calm, Killing
from recon_executors.dask import DaskParams
from recon_executors.local import LocalParams


@contract("executor.serial")
def test_contract_of_serial(law):
    law()


@contract("executor.local", cases=[Case("two", params=LocalParams(workers=2))])
def test_contract_of_local(law):
    law()


@contract("executor.dask", cases=[Case("two", params=DaskParams(workers=2))])
def test_contract_of_dask(law):
    pytest.importorskip("distributed")
    law()


class Threaded(Calm):
    def run(self) -> Outcome:
        import os

        return Outcome(self.key, text=os.environ["OMP_NUM_THREADS"])


class Chatty(Calm):
    def run(self) -> Outcome:
        import os
        import sys

        sys.stdout.write("spoken where outcomes are written\n")
        sys.stdout.flush()
        sys.stderr.write("last words\n")
        sys.stderr.flush()
        os._exit(self.number)


def outcomes(*jobs, **params) -> list[Outcome]:
    local = Registry.installed().get("executor.local")
    return list(local.run(jobs=iter(jobs), params=LocalParams(**params)))


def test_numeric_libraries_have_one_thread_unless_told_otherwise():
    assert [found.text for found in outcomes(Threaded(0), workers=1)] == ["1"]
    assert [found.text for found in outcomes(Threaded(0), workers=1, threads=3)] == ["3"]


def test_the_outcome_of_a_dead_job_tells_how_it_ended_and_its_last_words():
    (found,) = outcomes(Chatty(7), workers=1)
    assert found == Outcome("7", DIED, "its process ended with exit code 7: last words")


def test_a_dead_process_is_replaced():
    found = outcomes(Killing(0), Calm(1), Killing(2), Calm(3), workers=1)
    assert [outcome.code for outcome in found] == [DIED, "", DIED, ""]


def test_a_job_list_that_raises_raises_where_outcomes_are_read():
    def jobs():
        yield Calm(0)
        raise OSError("the list is gone")

    local = Registry.installed().get("executor.local")
    with pytest.raises(OSError, match="the list is gone"):
        list(local.run(jobs=jobs(), params=LocalParams(workers=1)))
