from __future__ import annotations

import pickle
from pathlib import Path

import pytest

from recon.errors import (
    ConfigError,
    ContractError,
    DataError,
    NotEnoughData,
    PluginBroken,
    PluginConflict,
    PluginError,
    PluginInvalid,
    PluginNotFound,
    ReadFailed,
    ReconError,
    StageError,
    StorageError,
)
from recon.problems import Problem, Where

PROBLEM = Problem(Where("a.yaml", 1, 2), "unknown-key", "no such key", "look", ((Where("a.yaml", 3), "first"),))
ERRORS = [
    ReconError("it failed", "do this"),
    ConfigError([PROBLEM, Problem(None, "no-steps", "no steps")]),
    PluginNotFound("no stage", "install it"),
    PluginBroken("broken"),
    PluginConflict("two of them"),
    PluginInvalid("badly declared"),
    DataError("no data", "bring some"),
    ReadFailed(Path("log.txt"), "no number", line=3, column=7, hint="mend it"),
    NotEnoughData("standstill", needed="2 s", found="1 s", hint="wait"),
    StageError("filter.a", "failed", "look"),
    ContractError("filter.a", "returned nothing"),
    StorageError("no room"),
]


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_an_error_crosses_process_borders_whole(error):
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert again.__dict__ == error.__dict__
    assert again.args == error.args


def test_the_text_is_the_message_and_the_hint_below():
    assert str(DataError("no data", "bring some")) == "no data\n  bring some"
    assert str(DataError("no data")) == "no data"


def test_every_problem_of_the_configuration_is_told():
    assert str(ERRORS[1]) == ("a.yaml:1:2: error: no such key; look\n    a.yaml:3: note: first\nerror: no steps")


@pytest.mark.parametrize(
    ("line", "column", "place"), [(3, 7, "log.txt:3:7"), (3, None, "log.txt:3"), (None, None, "log.txt")]
)
def test_a_file_that_cannot_be_read_is_placed_as_far_as_known(line, column, place):
    assert ReadFailed("log.txt", "no number", line=line, column=column).message == f"{place}: no number"


@pytest.mark.parametrize(
    ("kind", "code"),
    [(ReconError, 1), (ConfigError, 2), (PluginError, 3), (DataError, 4), (StageError, 5), (StorageError, 8)],
)
def test_each_kind_has_its_exit_code(kind, code):
    assert kind.exit_code == code
    assert all(error.exit_code == code for error in ERRORS if isinstance(error, kind) and kind is not ReconError)
