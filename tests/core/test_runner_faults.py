"""What stages return and raise that they should not, and how the runner tells it."""

from __future__ import annotations

import pickle

import pytest
from helpers import filter_of, gnss_table, imu_table, pipeline_of, run_steps
from runner_stages import MADE, TWO, log_file, run_work, text_reader

from recon.errors import ContractError, NotEnoughData, StageError
from recon.rows import Metric, metrics
from recon.schema import IMU, SAME


def raising(error):
    def work(*, imu, params):
        raise error

    return filter_of(work, writes={"imu": SAME})


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        (None, "it did not return a mapping of stream names to Arrow tables but None"),
        (imu_table(), "it did not return a mapping of stream names to Arrow tables but a Table"),
        ({"imu": [1]}, "it did not return a mapping of stream names to Arrow tables but a list for 'imu'"),
        ({"imu": {}}, "it did not return a mapping of stream names to Arrow tables but a dict for 'imu'"),
        ({"imu": imu_table(), "mag": imu_table()}, "it returned the stream 'mag', which it does not declare"),
        ({"imu": imu_table(), "imu_2": imu_table()}, "it returned the stream 'imu_2', which it does not declare"),
        ({}, "it did not return the stream 'imu', which it declares"),
        ({"imu": gnss_table()}, "stream 'imu': it returned ['speed'], which it does not declare and did not return"),
    ],
)
def test_a_stage_that_breaks_its_contract(returned, message):
    with pytest.raises(ContractError) as caught:
        run_work(lambda *, imu, params: returned)
    assert caught.value.message.startswith(f"step filter.work: {message}")
    assert caught.value.hint.startswith("this is a fault of ")
    assert caught.value.exit_code == 5


def test_a_reader_that_breaks_its_contract_is_named(tmp_path):
    with pytest.raises(ContractError, match=r"step reader.log: it returned the stream 'gnss'"):
        run_steps(
            pipeline_of("use: reader.log"), text_reader(writes={"imu": IMU.possible()}), source=[log_file(tmp_path, 1)]
        )


def test_a_metric_that_is_not_finite_is_kept_in_the_table_alone():
    outcome = run_work(lambda *, imu, params: {"imu": imu, "metrics": metrics([Metric("a", float("inf"), "s")])})
    assert outcome.recording["metrics"]["value"].to_pylist() == [float("inf")]
    assert outcome.reports[1].metrics == [{"name": "a", "unit": "s"}]


def test_an_unforeseen_error_becomes_a_stage_error_that_keeps_its_cause():
    cause = ZeroDivisionError("division by zero")
    with pytest.raises(StageError) as caught:
        run_steps(TWO, MADE, raising(cause))
    assert caught.value.__cause__ is cause
    assert caught.value.step == "filter.work"
    assert str(caught.value) == (
        f"step filter.work: ZeroDivisionError: division by zero\n  this is a fault of {__name__}; '-v' shows where"
    )
    assert not isinstance(caught.value, ContractError)


def test_a_simulator_that_fails_on_a_file_is_a_stage_error():
    def run(params):
        raise OSError(28, "No space left on device")

    failing = type(MADE)(name="made", summary="Fails.", run=run, writes={"imu": IMU})
    with pytest.raises(StageError, match=r"step simulator.made: OSError: \[Errno 28\]"):
        run_steps(pipeline_of("use: simulator.made"), failing)


def test_too_little_memory_is_said_in_words():
    with pytest.raises(StageError, match=r"step filter.work: there is not enough memory"):
        run_steps(TWO, MADE, raising(MemoryError()))


def test_a_data_error_names_the_step_and_keeps_its_kind_and_facts():
    with pytest.raises(NotEnoughData) as caught:
        run_steps(TWO, MADE, raising(NotEnoughData("standstill", needed="2 s", found="0.5 s", hint="wait longer")))
    assert str(caught.value) == ("step filter.work: not enough standstill: needs 2 s, found 0.5 s\n  wait longer")
    assert caught.value.exit_code == 4
    again = pickle.loads(pickle.dumps(caught.value))
    assert (str(again), again.needed) == (str(caught.value), "2 s")


def test_an_interruption_passes_through():
    interruption = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt) as caught:
        run_steps(TWO, MADE, raising(interruption))
    assert caught.value is interruption


@pytest.mark.parametrize("exit", [SystemExit(0), GeneratorExit()])
def test_a_stage_that_exits_ends_its_step_and_not_the_program(exit):
    with pytest.raises(StageError, match=type(exit).__name__):
        run_steps(TWO, MADE, raising(exit))
