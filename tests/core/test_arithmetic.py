"""What computes can be told and asked for, and linear algebra keeps to one thread inside a step."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest
import scipy
from evidence_runs import older_arithmetic
from helpers import filter_of, imu_table, pipeline_of, run_steps, source_of
from threadpoolctl import threadpool_info, threadpool_limits

from recon.arithmetic import Arithmetic, one_thread
from recon.schema import SAME

TOLD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS")
CHOICES = ("OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES", "NPY_ENABLE_CPU_FEATURES")
USED = "import json, numpy; print(json.dumps(arithmetic.Arithmetic.used().as_data()))"


def used_after(code: str, env: dict[str, str]) -> Arithmetic:
    """What computes in a process of that environment once it ran that code."""
    command = [sys.executable, "-c", f"from recon import arithmetic\n{code}\n{USED}"]
    told = subprocess.run(command, env=env, capture_output=True, text=True, check=True).stdout
    found = Arithmetic.from_data(json.loads(told))
    assert found is not None
    return found


@pytest.fixture
def unchosen():
    """The environment of somebody who chose nothing."""
    return {name: value for name, value in os.environ.items() if name not in (*CHOICES, *TOLD)}


# --- what computes ---------------------------------------------------------------------------------------------------


def test_what_computes_is_told_as_data_and_read_again():
    found = Arithmetic.used()
    assert Arithmetic.from_data(json.loads(json.dumps(found.as_data()))) == found
    assert str(found).startswith(f"{' and '.join(found.blas) or 'no BLAS'}, NumPy with ")


@pytest.mark.parametrize(
    "data",
    [
        None,
        {},
        "Haswell",
        {"blas": ["openblas Haswell"], "simd": ["X86_V3"]},
        {"blas": "openblas", "simd": [], "threads": 1},
        {"blas": ["a\0b"], "simd": [], "threads": 1},
        {"blas": [], "simd": [["X86_V3"]], "threads": 1},
        {"blas": [], "simd": [], "threads": True},
    ],
)
def test_what_is_no_arithmetic_is_none(data):
    """It comes from files that anybody may have written, and goes into the environment of a process."""
    assert Arithmetic.from_data(data) is None


def test_a_process_computes_as_it_is_asked_to(unchosen):
    found = used_after("", unchosen)
    wanted = older_arithmetic(found)
    assert wanted != found
    assert used_after("", wanted.environment()) == wanted


def test_threads_are_part_of_what_is_asked_for(unchosen):
    found = used_after("", unchosen)
    if not found.blas or (os.cpu_count() or 1) < 2:
        pytest.skip("here is no library of linear algebra, or one core")
    two = Arithmetic(found.blas, found.simd, 2)
    assert used_after("", two.environment()) == two


def test_what_cannot_be_had_is_left_out(unchosen):
    found = used_after("", unchosen)
    assert used_after("", Arithmetic(("openblas Abacus",), ("BEADS",), 1).environment()) == found


# --- what every processor has ----------------------------------------------------------------------------------------


def test_portable_arithmetic_needs_no_avx512(unchosen):
    found = used_after("arithmetic.portable()", unchosen)
    native = used_after("", unchosen)
    wide = [name for name in native.simd if name.startswith(("AVX512", "X86_V4"))]
    builds = [package.show_config(mode="dicts")["Build Dependencies"]["blas"] for package in (np, scipy)]
    if wide and all(str(build.get("openblas configuration")).startswith("OpenBLAS ") for build in builds):
        assert found == Arithmetic(("openblas Haswell",), tuple(n for n in native.simd if n not in wide), 1)
    else:
        assert found == native


def test_it_is_left_alone_by_those_who_choose_and_once_numpy_is_loaded(unchosen):
    native = used_after("", unchosen)
    chosen = unchosen | {"OPENBLAS_CORETYPE": ""}
    assert used_after("arithmetic.portable()", chosen) == native
    assert used_after("import numpy\narithmetic.portable()", unchosen) == native


# --- one thread ------------------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize(("given", "threads"), [({}, 1), ({"OPENBLAS_NUM_THREADS": "2"}, 2)])
def test_a_process_starts_no_threads_of_openblas_unless_it_is_told_to(unchosen, given, threads):
    if not any(library["internal_api"] == "openblas" for library in threadpool_info()):
        pytest.skip("NumPy computes with another library than OpenBLAS")
    if (os.cpu_count() or 1) < threads:
        pytest.skip("OpenBLAS starts no more threads than there are processors")
    code = (
        "from recon import arithmetic; arithmetic.threadless(); import numpy, threadpoolctl;"
        "print(max(library['num_threads'] for library in threadpoolctl.threadpool_info()))"
    )
    command = [sys.executable, "-c", code]
    told = subprocess.run(command, env=unchosen | given, capture_output=True, text=True, check=True).stdout
    assert int(told) == threads
