"""Laws of fusers: the answer turns and moves with the world, and is as good as it claims to be.

PYTEST_DONT_REWRITE: what a law says is a sentence already.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np
import pyarrow as pa

from recon.errors import DataError
from recon.knots import ATTITUDE, SIZE, Knots
from recon.numerics.rotation import Floats, angle, from_euler, multiply, rotate, to_euler, to_matrix
from recon.numerics.rotation_series import slerp
from recon.numerics.signals import interpolate, wrap_angle
from recon.recording import Recording
from recon.schema import spread
from recon.stages import Fuser
from recon.tables import has, matrix, time_ns
from recon.testing.contract import law
from recon.testing.drives import Conditions, drive
from recon.testing.serving import serve
from recon.testing.subject import Subject

ON_EARTH: Final = Conditions(earth=True, slow=1.0)
"""What real logs show and a fuser may count on: a rotating Earth, and fixes whose errors stay for minutes."""
YAW: Final = 2.0
"""rad: no multiple of a right angle, so that it mixes east and north."""
SHIFT_N: Final = (300.0, -200.0, 2.0)
"""m."""
SAME: Final = 1e-3
"""m, m/s, rad. What may change is gravity with height (3e-6 m/s^2 per metre) and rounding; a thousandth of the noise
of a fix is far above both and far below what a forgotten axis does.
"""
SAME_SIGMAS: Final = 0.1
"""Of the sigma, where one is given: the Earth does not turn with the world; a forgotten axis is off by many sigmas."""
SEEDS: Final = range(1, 11)
HONEST: Final = (0.054, 4.13)
"""The 1e-5 and 1 - 1e-5 quantiles of chi^2 with a degree of freedom for each seed, divided by their number: the mean
square of error over sigma if the error of a drive were one number, and no drive told more than its seed.
"""
NOT_TRIED: Final = ("att_roll", "att_pitch")
"""May be far better than their sigmas: these roads have neither bank nor slope and the body no springs, all of which a
fuser that finds the mounting must doubt.
"""
SINGLE: Final = 1e-5
"""Of a sigma: covariances of knots are kept as numbers that are wrong by 6e-8, some hundreds of them in a row."""


@law(Fuser, when=lambda stage: "trajectory" in stage.writes)
def yawing_the_world_yaws_the_answer(subject: Subject) -> None:
    """East and north are names: a drive and its errors turned about the vertical give the same answer, turned."""
    turned = replace(ON_EARTH, yaw=YAW)
    usual, found = (_trajectory(subject, drive(one)) for one in (ON_EARTH, turned))
    for group in _given(usual):
        expected = rotate(turned.turn, matrix(usual, group, gaps=True))
        _assert_equal(found, group, expected, f"turned by {YAW:g} rad")
    if has(usual, "q"):
        _assert_turned(found, multiply(turned.turn, matrix(usual, "q", gaps=True)))


@law(Fuser, when=lambda stage: "trajectory" in stage.writes)
def moving_the_origin_moves_the_answer(subject: Subject) -> None:
    """Where the origin lies is a choice: a drive moved as a whole gives the same answer, moved."""
    usual, found = (_trajectory(subject, drive(one)) for one in (ON_EARTH, replace(ON_EARTH, shift_n=SHIFT_N)))
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


@law(Fuser, when=lambda stage: "trajectory" in stage.writes)
def the_error_is_as_large_as_its_sigma_says(subject: Subject) -> None:
    """Over simulated drives the mean square of error over sigma is about one, on each axis for which sigma is given."""
    squares: dict[str, list[float]] = {}
    for seed in SEEDS:
        recording = drive(replace(ON_EARTH, seed=seed))
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
        low = 0.0 if column in NOT_TRIED else HONEST[0]
        assert low <= mean <= HONEST[1], (
            f"the error of {column} is {np.sqrt(mean):.2f} times its sigma over {len(each)} drives, "
            f"where {np.sqrt(low):.2f} to {np.sqrt(HONEST[1]):.2f} is what chance explains"
        )


@law(Fuser, when=lambda stage: "knots" in stage.writes)
def covariances_of_knots_are_those_of_the_trajectory(subject: Subject) -> None:
    """The sigmas at a knot are those of the trajectory there, and no covariance is larger than its sigmas allow."""
    returned = subject.run()
    try:
        known = Knots.of(returned["knots"])
    except DataError as error:
        raise AssertionError(error.message) from error
    every = range(len(known.t_ns))
    sigma = np.sqrt(np.maximum([np.diag(known.covariance(k, k)) for k in every], np.finfo(float).tiny))
    for i, j in [(0, every[-1]), *pairwise(every)]:
        joint = np.block([[known.covariance(a, b) for b in (i, j)] for a in (i, j)])
        least = float(np.linalg.eigvalsh(joint / np.outer(*(np.concatenate((sigma[i], sigma[j])),) * 2))[0])
        assert least >= -SINGLE, (
            f"errors at the knots {i} and {j} have no such covariance: in units of their sigmas its least eigenvalue "
            f"is {least:.3g}"
        )
    _assert_sigmas(known, returned["trajectory"])


@law(Fuser, when=lambda stage: stage.budget is not None)
def the_error_stays_inside_the_budget(subject: Subject) -> None:
    """On every one of the suite's plain drives the horizontal error stays below what the record declares."""
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


def _assert_sigmas(known: Knots, trajectory: pa.Table) -> None:
    """The attitude's sigmas are about the axes that roll, pitch and yaw turn, in a level vehicle."""
    _, knots, rows = np.intersect1d(known.t_ns, time_ns(trajectory), return_indices=True)
    yaw = to_euler(matrix(trajectory, "q", gaps=True)[rows])[0]
    names = [name for group in ("pos", "vel", "att") for name in spread(f"{group}_std", trajectory.column_names)]
    given = np.column_stack([matrix(trajectory, f"{group}_std", gaps=True)[rows] for group in ("pos", "vel", "att")])
    for knot, ahead, wanted in zip(knots, yaw, given, strict=True):
        axes = np.eye(SIZE)
        axes[ATTITUDE, ATTITUDE] = to_matrix(from_euler(ahead, 0.0, 0.0)).T
        found = np.sqrt(np.diag(axes @ known.covariance(int(knot), int(knot)) @ axes.T))
        wrong = np.abs(found - wanted) > SINGLE * wanted
        assert not wrong.any(), (
            f"at knot {knot} the covariance says {found[wrong][0]:.6g} where {names[int(wrong.argmax())]} of the "
            f"trajectory is {wanted[wrong][0]:.6g}"
        )


def _assert_equal(found: pa.Table, group: str, expected: Floats, where: str) -> None:
    here = matrix(found, group, gaps=True)
    assert here.shape == expected.shape, f"a world {where} gave {len(here)} rows, where it gave {len(expected)} before"
    error = np.abs(here - expected)
    assert (error <= _allowed(found, group))[np.isfinite(error)].all(), (
        f"a world {where} gave another {group} by up to {float(np.nanmax(error)):.3g} m or m/s"
    )


def _assert_turned(found: pa.Table, expected: Floats) -> None:
    error = angle(matrix(found, "q", gaps=True), expected)
    assert (error <= _allowed(found, "att")[:, 0])[np.isfinite(error)].all(), (
        f"a world turned by {YAW:g} rad gave another attitude by up to {float(np.nanmax(error)):.3g} rad"
    )


def _allowed(found: pa.Table, group: str) -> Floats:
    """How far two answers may be apart: (n, 1), more where the fuser says how unsure it is."""
    if not has(found, f"{group}_std"):
        return np.full((found.num_rows, 1), SAME)
    sigma = np.abs(np.nan_to_num(matrix(found, f"{group}_std", gaps=True))).max(axis=1, keepdims=True)
    return np.asarray(SAME + SAME_SIGMAS * sigma)
