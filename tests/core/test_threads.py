"""Linear algebra keeps to one thread inside a step, unless the environment says how many."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import filter_of, imu_table, pipeline_of, run_steps, source_of
from threadpoolctl import threadpool_info, threadpool_limits

from recon.schema import SAME
from recon.threads import one_thread

TOLD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS")


def blas_threads():
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


@pytest.fixture
def untold(monkeypatch):
    for name in TOLD:
        monkeypatch.delenv(name, raising=False)
    # NumPy brings its library along; two threads are set so that one is a change on every machine.
    assert np.eye(2).sum() == 2.0
    with threadpool_limits(limits=2, user_api="blas"):
        yield


def test_inside_it_is_one_thread_and_afterwards_what_it_was(untold):
    before = blas_threads()
    with one_thread():
        assert blas_threads() == {1}
    assert blas_threads() == before


@pytest.mark.parametrize("name", TOLD)
def test_what_the_environment_says_stands(untold, monkeypatch, name):
    monkeypatch.setenv(name, "2")
    before = blas_threads()
    with one_thread():
        assert blas_threads() == before


def test_a_step_of_a_pipeline_runs_on_one_thread(untold):
    seen = []

    def work(*, imu, params):
        seen.append(blas_threads())
        return {"imu": imu}

    run_steps(
        pipeline_of("use: simulator.made", "use: filter.work"),
        source_of({"imu": imu_table()}),
        filter_of(work, writes={"imu": SAME}),
    )
    assert seen == [{1}]
