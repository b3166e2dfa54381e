"""Laws of fusers: the answer turns and moves with the world, and is as good as it claims to be.

PYTEST_DONT_REWRITE: what a law says is a sentence already.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import pyarrow as pa

from recon.numerics.rotation import Floats, angle, multiply, rotate, slerp, to_euler
from recon.numerics.signals import interpolate, wrap_angle
from recon.recording import Recording
from recon.schema import spread
from recon.stages import Fuser
from recon.tables import has, matrix, time_ns
from recon.testing.contract import law
from recon.testing.drives import Conditions, drive, serve
from recon.testing.subject import Subject

YAW: Final = 2.0
"""rad: no multiple of a right angle, so that it mixes east and north."""
SHIFT_N: Final = (300.0, -200.0, 2.0)
"""m."""
SAME: Final = 1e-3
"""m, m/s, rad. What may change is gravity with height (3e-6 m/s^2 per metre) and rounding; a thousandth of the noise
of a fix is far above both and far below what a forgotten axis does.
"""
SEEDS: Final = range(1, 11)
HONEST: Final = (0.054, 4.13)
"""1e-5 and 1 - 1e-5 quantiles of chi^2 with a degree of freedom for each seed, divided by their number: bounds of the
mean square of error over sigma were the error of a drive one number; the more numbers, the closer it is to one.
"""


@law(Fuser)
def yawing_the_world_yaws_the_answer(subject: Subject) -> None:
    """East and north are names: a drive and its errors turned about the vertical give the same answer, turned."""
    turned = Conditions(yaw=YAW)
    usual, found = _trajectory(subject, drive()), _trajectory(subject, drive(turned))
    for group in _given(usual):
        expected = rotate(turned.turn, matrix(usual, group, gaps=True))
        _assert_equal(found, group, expected, f"turned by {YAW:g} rad")
    if has(usual, "q"):
        _assert_turned(found, multiply(turned.turn, matrix(usual, "q", gaps=True)))


@law(Fuser)
def moving_the_origin_moves_the_answer(subject: Subject) -> None:
    """Where the origin lies is a choice: a drive moved as a whole gives the same answer, moved."""
    usual, found = _trajectory(subject, drive()), _trajectory(subject, drive(Conditions(shift_n=SHIFT_N)))
    for group in _given(usual):
        moved_n = np.array(SHIFT_N) if group == "pos" else np.zeros(3)
        _assert_equal(found, group, matrix(usual, group, gaps=True) + moved_n, f"moved by {SHIFT_N} m")


@law(Fuser)
def sigmas_are_positive(subject: Subject) -> None:
    """A standard deviation that is given is a number above zero."""
    for name, table in subject.run().items():
        for column in (column for column in table.column_names if "_std_" in column or column == "sigma"):
            given = table[column].drop_null().to_numpy()
            wrong = ~(np.isfinite(given) & (given > 0.0))
            assert not wrong.any(), (
                f"{name}.{column} is {given[wrong][0]:g} in one of {int(wrong.sum())} rows; where sigma is unknown, "
                "give null"
            )


@law(Fuser)
def the_error_is_as_large_as_its_sigma_says(subject: Subject) -> None:
    """Over simulated drives the mean square of error over sigma is about one, on each axis for which sigma is given."""
    squares: dict[str, list[float]] = {}
    for seed in SEEDS:
        recording = drive(Conditions(seed=seed))
        found = _trajectory(subject, recording)
        for group, error in (("pos", _error), ("vel", _error), ("att", _attitude_error)):
            names = spread(f"{group}_std", found.column_names)
            if not has(found, f"{group}_std"):
                continue
            with np.errstate(divide="ignore"):
                ratio = error(found, recording, group) / matrix(found, f"{group}_std", gaps=True)
            for name, square in zip(names, np.nanmean(ratio**2, axis=0), strict=True):
                squares.setdefault(name.replace("_std", ""), []).append(float(square))
    for column, each in squares.items():
        mean = float(np.mean(each))
        assert HONEST[0] <= mean <= HONEST[1], (
            f"the error of {column} is {np.sqrt(mean):.2f} times its sigma over {len(each)} drives, "
            f"where {np.sqrt(HONEST[0]):.2f} to {np.sqrt(HONEST[1]):.2f} is what chance explains"
        )


@law(Fuser, when=lambda stage: stage.budget is not None)
def the_error_stays_inside_the_budget(subject: Subject) -> None:
    """On every one of the suite's drives the horizontal error stays below what the record declares."""
    assert isinstance(subject.stage, Fuser)
    assert subject.stage.budget is not None
    for seed in SEEDS:
        recording = drive(Conditions(seed=seed))
        error_n = _error(_trajectory(subject, recording), recording, "pos")[:, :2]
        size = float(np.sqrt(np.nanmean(np.sum(error_n**2, axis=1))))
        assert size <= subject.stage.budget, (
            f"on the drive with seed {seed} the horizontal error is {size:.2f} m (root mean square); "
            f"its record declares a budget of {subject.stage.budget:g} m"
        )


def _trajectory(subject: Subject, recording: Recording) -> pa.Table:
    returned = subject.run(serve(recording, subject.stage.reads))
    found = returned.get("trajectory")
    assert has(found, "pos"), "a fuser must return 'trajectory' with positions"
    return found


def _given(table: pa.Table) -> list[str]:
    """Groups of vectors in the local frame that hold values."""
    return [group for group in ("pos", "vel") if has(table, group)]


def _error(found: pa.Table, recording: Recording, group: str) -> Floats:
    """Difference from the truth at the times of the answer: (n, 3), NaN where either is not known."""
    truth = recording["reference"]
    return matrix(found, group, gaps=True) - interpolate(time_ns(found), time_ns(truth), matrix(truth, group))


def _attitude_error(found: pa.Table, recording: Recording, group: str) -> Floats:
    """Difference of roll, pitch and yaw from the truth: (n, 3) rad."""
    truth = recording["reference"]
    true_q = slerp(time_ns(found), time_ns(truth), matrix(truth, "q"))
    here, there = (np.column_stack(to_euler(q)[::-1]) for q in (matrix(found, "q", gaps=True), true_q))
    return wrap_angle(here - there)


def _assert_equal(found: pa.Table, group: str, expected: Floats, where: str) -> None:
    here = matrix(found, group, gaps=True)
    assert here.shape == expected.shape, f"a world {where} gave {len(here)} rows, where it gave {len(expected)} before"
    error = float(np.nanmax(np.abs(here - expected)))
    assert error <= SAME, f"a world {where} gave another {group} by up to {error:.3g} m or m/s"


def _assert_turned(found: pa.Table, expected: Floats) -> None:
    error = float(np.nanmax(angle(matrix(found, "q", gaps=True), expected)))
    assert error <= SAME, f"a world turned by {YAW:g} rad gave another attitude by up to {error:.3g} rad"
