from __future__ import annotations

import numpy as np
import pytest

from recon import metrics
from recon.agreement import agreement, as_metrics
from recon.rows import warnings_of

T_S = np.arange(0.0, 100.0, 0.1)
T_NS = np.rint(T_S * 1e9).astype(np.int64)
SPEED = 10.0 - 10.0 * np.cos(2.0 * np.pi * T_S / 20.0)  # m/s, a stop every 20 s


def notes(speed, reference):
    return warnings_of(metrics(as_metrics(agreement(T_NS, speed, T_NS, reference), "ours", "theirs")))


def test_a_late_reference_agrees_and_its_lag_is_found():
    late = np.interp(T_S - 0.6, T_S, SPEED)
    found = agreement(T_NS, SPEED, T_NS, late)
    assert found.lag == pytest.approx(0.6)
    # The line between samples 0.1 s apart: h^2 / 8 of an acceleration's rate of 10 (2 pi / 20)^2 = 1 m/s^3.
    assert found.difference < 0.00125 * 1.01
    assert found.ratio == pytest.approx(1.0, abs=0.001)
    assert notes(SPEED, late) == []


def test_a_few_absurd_values_do_not_count():
    wild = SPEED.copy()
    wild[::10] = 1e6
    assert notes(wild, SPEED) == []


@pytest.mark.parametrize("factor", [0.0, 0.5, 2.0])
def test_a_strong_disagreement_is_said_without_a_guess(factor):
    (note,) = notes(factor * SPEED, SPEED)
    assert note.startswith("ours and theirs disagree")
    assert "perhaps" not in note


@pytest.mark.parametrize(
    ("factor", "cause"),
    [(3.6, "the ratio is 3.60: perhaps theirs was read in km/h where it is in m/s"),
     (1 / 3.6, "the ratio is 0.28: perhaps theirs was read in m/s where it is in km/h")],
)  # fmt: skip
def test_a_mistaken_unit_is_named(factor, cause):
    (note,) = notes(factor * SPEED, SPEED)
    assert note.endswith(cause)


def test_rest_and_nothing_compare_with_nothing():
    assert agreement(T_NS, 0.1 * np.ones(1000), T_NS, np.zeros(1000)) is None
    assert agreement(T_NS, SPEED, T_NS, np.full(1000, np.nan)) is None
    assert agreement(T_NS, SPEED, T_NS + 3600 * 10**9, SPEED) is None
    assert as_metrics(None, "ours", "theirs") == []
