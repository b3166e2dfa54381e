"""The decorator makes tests of laws: their names, their cases, expected failures, the lines at the end."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
from broken_laws import broken_laws

import recon
from recon import IMU, SAME, Filter, Params, Registry, setting
from recon.errors import PluginNotFound, StageError
from recon.testing import Case, contract, laws_of
from recon.testing.contract import Contract
from recon.testing.laws import MODULES

HEAD = """
from recon import IMU, SAME, Filter, Registry, replace, time_ns, vector
from recon.testing import Case, contract

def keep(*, imu, params):
    return {"imu": imu}

def dated(*, imu, params):
    return {"imu": replace(imu, gyro_x=vector(imu, "gyro_x") + 1e-18 * time_ns(imu))}

def stage(name, run):
    return Filter(name=name, summary="Keeps.", run=run, reads={"imu": IMU.need("gyro")}, writes={"imu": SAME})

HERE = Registry.of(stage("keep", keep), stage("dated", dated))
"""
LATE = "shifting_all_times_shifts_the_result"


class Width(Params):
    width: int = setting(doc="Rows of the window.")


def keep(*, imu, params):
    return {"imu": imu}


def stage(**declared) -> Filter:
    reads = {"imu": IMU.need("accel")}
    return Filter(name="keep", summary="Keeps.", run=keep, reads=reads, writes={"imu": SAME}, **declared)


def pytest_on(folder: Path, text: str, *options: str) -> str:
    """What pytest prints about a test file, in a process of its own."""
    (folder / "test_it.py").write_text(HEAD + text, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-v", "-rA", *options, str(folder)]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment).stdout


def test_ids_name_the_stage_and_the_law(tmp_path: Path):
    text = '@contract("filter.keep", registry=HERE)\ndef test_contract(law):\n    law()\n'
    printed = pytest_on(tmp_path, text)
    laws = len(laws_of(stage()))
    assert "test_contract[filter.keep-same_input_twice_gives_same_output] PASSED" in printed
    assert f"filter.keep: {laws} laws run, {laws} held, 0 expected to fail, 0 broken" in printed
    assert f"{laws} passed" in printed


def test_a_broken_law_is_told_in_words_and_counted_per_stage(tmp_path: Path):
    text = '@contract("filter.keep", "filter.dated", registry=HERE)\ndef test_contract(law):\n    law()\n'
    printed = pytest_on(tmp_path, text)
    assert f"test_contract[filter.dated-{LATE}] FAILED" in printed
    assert "AssertionError: all times shifted by a day: imu: gyro_x is another" in printed
    ran = len(laws_of(stage()))
    assert f"filter.keep: {ran} laws run, {ran} held, 0 expected to fail, 0 broken" in printed
    assert f"filter.dated: {ran} laws run, {ran - 1} held, 0 expected to fail, 1 broken" in printed


def test_processes_side_by_side_run_the_same_laws(tmp_path: Path):
    text = '@contract("filter.keep", registry=HERE)\ndef test_contract(law):\n    law()\n'
    printed = pytest_on(tmp_path, text, "-n", "2")
    laws = len(laws_of(stage()))
    assert f"filter.keep: {laws} laws run, {laws} held, 0 expected to fail, 0 broken" in printed


def test_a_run_without_contracts_ends_as_ever(tmp_path: Path):
    assert " laws " not in pytest_on(tmp_path, "def test_nothing():\n    pass\n")


def test_an_expected_failure_passes_and_is_counted(tmp_path: Path):
    text = (
        f'@contract("filter.dated", registry=HERE, expected_failures={{"{LATE}": "it drifts with the date"}})\n'
        "def test_contract(law):\n    law()\n"
    )
    printed = pytest_on(tmp_path, text)
    laws = len(laws_of(stage()))
    assert f"test_contract[filter.dated-{LATE}] PASSED" in printed
    assert f"filter.dated: {laws} laws run, {laws - 1} held, 1 expected to fail, 0 broken" in printed


def contract_of(**given) -> Contract:
    return Contract(("filter.keep",), registry=Registry.of(stage()), **given)


def test_a_law_that_holds_although_it_should_fail_fails():
    laws = {law.law.name: law for law in contract_of(expected_failures={LATE: "it drifts"}).laws()}
    with pytest.raises(AssertionError, match=f"{LATE} holds, but was expected to fail: it drifts"):
        laws[LATE]()


def stumble(*, imu, params):
    return {"imu": imu[None]}


def test_an_error_of_the_stage_is_a_failure_that_may_be_expected():
    record = Filter(name="keep", summary="Stumbles.", run=stumble, reads=stage().reads, writes={"imu": SAME})
    given = Contract(("filter.keep",), expected_failures={LATE: "it stumbles"}, registry=Registry.of(record))
    laws = {law.law.name: law for law in given.laws()}
    laws[LATE]()
    with pytest.raises(StageError, match=r"step filter\.keep: "):
        laws["same_input_twice_gives_same_output"]()


def test_an_unknown_law_gets_the_nearest_name():
    with pytest.raises(ValueError, match=r"'same_input_twice_gives_the_same'.*did you mean 'same_input_twice_gives"):
        contract_of(expected_failures={"same_input_twice_gives_the_same": "?"}).laws()


def test_an_unknown_stage_is_named():
    with pytest.raises(PluginNotFound, match=r"filter\.keeps"):
        Contract(("filter.keeps",), registry=Registry.of(stage())).laws()


def test_cases_multiply_the_laws_and_are_named():
    cases = (Case("narrow"), Case("wide"))
    ids = [law.id for law in contract_of(cases=cases).laws()]
    assert len(set(ids)) == len(ids) == 2 * len(laws_of(stage()))
    assert f"filter.keep[wide]-{LATE}" in ids


def test_the_parameters_and_streams_of_a_case_are_used():
    given = stage(params=Width)
    assert (
        "filter.keep needs ['width']: contract(..., cases=[Case(params=...)])"
        in (broken_laws(given)["same_input_twice_gives_same_output"])
    )
    assert broken_laws(given, Case(params=Width(width=2))) == {}
    assert "the inputs do not serve filter.keep" in broken_laws(given, Case(params=Width(width=2), streams={}))[LATE]


def test_the_decorator_leaves_the_function_as_it_is():
    def check(law):
        return law

    assert contract("filter.keep")(check) is check


def test_every_law_says_in_one_line_what_it_is():
    laws = [law for module in MODULES for law in vars(module).values() if type(law).__name__ == "Law"]
    assert [law.name for law in laws if not (law.holds.__doc__ or "").strip()] == []
    names = [law.name for law in laws]
    assert sorted(names) == sorted(set(names))


def test_nothing_in_recon_imports_pytest():
    folder = Path(recon.__file__).parent
    imports = [
        (path.name, name)
        for path in folder.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in ([alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or ""])
        if name.partition(".")[0] in ("pytest", "_pytest")
    ]
    assert imports == []
