"""Executors: the laws, and what the first-party ones say of a job that did not come back."""

from __future__ import annotations

import platform
from pathlib import Path

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


class Allocating(Calm):
    """Takes 20 MB in arrays, gives them back and takes them again: pages of 4 kB that were new the second time."""

    def run(self) -> Outcome:
        import resource

        import numpy as np

        new = []
        for _ in range(2):
            before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
            held = [np.ones(250_000) for _ in range(10)]
            new.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
            del held
        return Outcome(self.key, text=str(new[1]))


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


def test_a_module_in_the_working_folder_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "psutil.py").write_text("raise SystemExit(9)\n", encoding="utf-8")
    (tmp_path / "numpy.py").write_text("raise SystemExit(9)\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert outcomes(Threaded(0), workers=1)[0].ok


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the setting is one of glibc")
def test_memory_that_was_given_back_is_taken_again_without_new_pages(monkeypatch: pytest.MonkeyPatch):
    """20 MB are 4880 pages."""
    (found,) = outcomes(Allocating(0), workers=1)
    assert int(found.text) < 500
    monkeypatch.setenv("MALLOC_MMAP_THRESHOLD_", "65536")
    (found,) = outcomes(Allocating(0), workers=1)
    assert int(found.text) > 4000, "what the user has set himself counts"


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
