"""Every law of fusers fails for a fuser that is wrong in that one way."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from broken_laws import broken

from recon import GNSS, KNOTS, SAME, TRAJECTORY, Fuser, build, matrix, replace, time_ns
from recon.knots import SIZE as UNKNOWNS
from recon.knots import Knots
from recon.numerics.rotation import from_rotvec, multiply
from recon.testing.laws import fusers

SIGMA = 1.3
"""m. On the line between two fixes of sigma 1 m the mean square is the mean of (1 - s)^2 + s^2, 2/3; with the slow
error of 1 m it is 5/3: sigma 1.29 m.
"""


def follow(trajectory, gnss):
    """(n, 3) m, GNSS by straight lines at the times of the trajectory."""
    pos = matrix(gnss, "pos")
    return np.column_stack([np.interp(time_ns(trajectory), time_ns(gnss), pos[:, axis]) for axis in range(3)])


def fuser_of(place=follow, sigma=None, **declared):
    """A fuser whose position a function makes, with a constant sigma where one is given."""

    def fuse(*, trajectory, gnss, params):
        fused = replace(trajectory, pos=place(trajectory, gnss))
        known = {} if sigma is None else {"pos_std": np.full((trajectory.num_rows, 3), sigma)}
        return {"trajectory": replace(fused, **known)}

    return Fuser(
        name="follow",
        summary="Position from GNSS.",
        run=fuse,
        reads={"trajectory": TRAJECTORY.need("pos", "vel"), "gnss": GNSS.need("pos")},
        writes={"trajectory": SAME},
        **declared,
    )


def test_a_fuser_that_is_what_it_declares_breaks_no_law():
    assert broken(fusers, fuser_of(sigma=SIGMA, budget=1.5)) == {}


def test_a_fuser_may_leave_the_velocity_unknown_but_not_the_position():
    def without(group):
        def fuse(*, trajectory, gnss, params):
            return {"trajectory": replace(trajectory, **{group: np.full((trajectory.num_rows, 3), np.nan)})}

        return dataclasses.replace(fuser_of(budget=50.0), run=fuse)

    assert broken(fusers, without("vel")) == {}
    assert {*broken(fusers, without("pos")).values()} == {"a fuser must return 'trajectory' with positions"}


def test_an_axis_treated_otherwise_breaks_the_law_of_yaw():
    def east_alone(trajectory, gnss):
        return np.column_stack([follow(trajectory, gnss)[:, 0], matrix(trajectory, "pos")[:, 1:]])

    ((name, message),) = broken(fusers, fuser_of(east_alone)).items()
    assert name == "yawing_the_world_yaws_the_answer"
    assert message.startswith("a world turned by 2 rad gave another pos by up to ")


def test_distances_from_the_origin_break_the_law_of_the_origin():
    ((name, message),) = broken(fusers, fuser_of(lambda *tables: 1.001 * follow(*tables))).items()
    assert name == "moving_the_origin_moves_the_answer"
    # A thousandth of 300 m.
    assert message == "a world moved by (300.0, -200.0, 2.0) m gave another pos by up to 0.3 m or m/s"


def test_a_negative_sigma_breaks_the_law_of_sigmas():
    assert broken(fusers, fuser_of(sigma=-SIGMA)) == {
        "sigmas_are_positive": "trajectory.pos_std_e is -1.3 in one of 6550 rows; where sigma is unknown, give null"
    }


@pytest.mark.parametrize("sigma", [0.2, 10.0])
def test_a_sigma_that_is_wrong_breaks_the_law_of_honesty(sigma):
    ((name, message),) = broken(fusers, fuser_of(sigma=sigma)).items()
    assert name == "the_error_is_as_large_as_its_sigma_says"
    told = re.fullmatch(r"the error of pos_e is (.+) times its sigma over 10 drives, where (.+) is what .+", message)
    # The slow error is about one number a drive: ten of them tell their mean square to sqrt(2 / 10) = 45 %, and so
    # the root of 5/3 to 13 %; three times that.
    assert told[2] == "0.23 to 2.03"
    assert float(told[1]) == pytest.approx(np.sqrt(5.0 / 3.0) / sigma, rel=0.4)


@pytest.mark.parametrize(("att_sigma", "laws"), [(0.01, []), (0.001, ["the_error_is_as_large_as_its_sigma_says"])])
def test_the_sigma_of_the_attitude_is_held_to_honesty_as_well(att_sigma, laws):
    def fuse(*, trajectory, params):
        shake = 0.01 * np.random.default_rng(7).standard_normal((trajectory.num_rows, 3))
        shaken = multiply(
            matrix(trajectory, "q"), from_rotvec(shake)
        )  # on a flat road the axes are those of the angles
        known = np.full((trajectory.num_rows, 3), att_sigma)
        return {"trajectory": replace(trajectory, q=shaken, att_std=known)}

    shaking = Fuser(
        name="shake",
        summary="Attitude with an error.",
        run=fuse,
        reads={"trajectory": TRAJECTORY.need("q")},
        writes={"trajectory": SAME},
    )
    assert [*broken(fusers, shaking)] == laws


def knotted(factor=1.0, step=-1e-3, spoil=None):
    """A fuser that writes knots, `factor` times as unsure as its trajectory; `step` is that of their chain."""

    def fuse(*, trajectory, params):
        time = time_ns(trajectory)[::200]
        sizes = np.array([0.5, 0.6, 1.2, 0.03, 0.04, 0.05, 0.02, 0.02, 0.01])  # alike about both level axes
        root = np.broadcast_to(factor * np.diag(sizes), (len(time), UNKNOWNS, UNKNOWNS)) + 0.0
        chain = np.broadcast_to(step * np.eye(UNKNOWNS), (len(time) - 1, UNKNOWNS, UNKNOWNS)) + 0.0
        nothing = np.zeros((len(time), UNKNOWNS, 1))
        known = Knots(time, root, chain, nothing, np.zeros(len(time)), np.zeros(len(time)))
        table = build(KNOTS, time=time, **known.columns())
        std = {
            f"{group}_std": np.tile(sizes[3 * n : 3 * n + 3], (trajectory.num_rows, 1))
            for n, group in enumerate(("pos", "vel", "att"))
        }
        return {"trajectory": replace(trajectory, **std), "knots": table if spoil is None else spoil(table)}

    return Fuser(
        name="knots",
        summary="Sigmas and covariances.",
        run=fuse,
        reads={"trajectory": TRAJECTORY.need("pos", "vel", "q")},
        writes={"trajectory": SAME, "knots": KNOTS},
    )


LAW_OF_KNOTS = "covariances_of_knots_are_those_of_the_trajectory"


def test_knots_with_the_sigmas_of_the_trajectory_keep_their_law():
    assert LAW_OF_KNOTS not in broken(fusers, knotted())


def test_a_fuser_without_knots_has_no_law_of_knots():
    assert not fusers.covariances_of_knots_are_those_of_the_trajectory.applies(fuser_of())


def test_knots_with_other_sigmas_than_the_trajectory_break_their_law():
    assert broken(fusers, knotted(factor=1.01))[LAW_OF_KNOTS] == (
        "at knot 0 the covariance says 0.505 where pos_std_e of the trajectory is 0.5"
    )


def test_errors_that_have_more_in_common_than_they_are_break_the_law_of_knots():
    # A correlation of 1.001 has the eigenvalue 1 - 1.001; over 32 knots it is 1.001^32 = 1.033.
    assert broken(fusers, knotted(step=1e-3))[LAW_OF_KNOTS] == (
        "errors at the knots 0 and 32 have no such covariance: in units of their sigmas its least eigenvalue is -0.0325"
    )


def test_knots_that_cannot_be_read_break_their_law():
    assert broken(fusers, knotted(spoil=lambda table: table.slice(0, 1)))[LAW_OF_KNOTS] == (
        "the stream 'knots' has 1 rows; there is no change to tell of"
    )


def test_a_zero_sigma_is_neither_positive_nor_honest():
    assert [*broken(fusers, fuser_of(sigma=0.0))] == ["sigmas_are_positive", "the_error_is_as_large_as_its_sigma_says"]


def test_an_error_beyond_the_budget_breaks_its_law():
    ((name, message),) = broken(fusers, fuser_of(budget=0.5)).items()
    assert name == "the_error_stays_inside_the_budget"
    # Two axes of 0.82 m make 1.15 m.
    assert message.startswith("on the drive with seed 1 the horizontal error is 1.1")
    assert message.endswith("its record declares a budget of 0.5 m")


def test_an_inertial_trajectory_alone_is_outside_of_any_budget_that_fixes_allow():
    drifting = fuser_of(lambda trajectory, gnss: matrix(trajectory, "pos"), budget=2.0)
    assert [*broken(fusers, drifting)] == ["the_error_stays_inside_the_budget"]
