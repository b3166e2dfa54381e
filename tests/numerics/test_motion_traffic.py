"""Long drives: as long as asked, all different, and made of what they promise."""

from __future__ import annotations

import numpy as np
import pytest

from recon.numerics.motion import TRAFFIC, Drive, ferry, traffic
from recon.numerics.rotation import Floats, conjugate, rotate, to_euler

EPS = np.finfo(float).eps
SEEDS = range(5)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def times(drive: Drive, step_s: float = 0.1) -> Floats:
    return np.arange(0.0, drive.duration_s, step_s)


def forward(drive: Drive, t_s: Floats) -> Floats:
    truth = drive.at(t_s)
    return rotate(conjugate(truth.q_nv), truth.vel_n)[:, 0]


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("kind", ["country", "mixed", "reverse"])
def test_a_drive_is_as_long_as_asked_and_stands_at_both_ends(kind: str, seed: int) -> None:
    drive = traffic(kind, 600.0, rng(seed), rest_s=25.0)
    assert drive.duration_s == pytest.approx(600.0, rel=1e-12)
    speed = forward(drive, np.array([0.0, 24.9, 598.0, 600.0]))
    np.testing.assert_allclose(speed, 0.0, atol=EPS)  # sin(pi) is 1e-16 and enters squared


@pytest.mark.parametrize("kind", TRAFFIC)
def test_each_seed_is_another_drive_and_the_same_seed_the_same(kind: str) -> None:
    first, again, other = (traffic(kind, 300.0, rng(seed)) for seed in (1, 1, 2))
    assert first == again
    assert first != other


@pytest.mark.parametrize("seed", SEEDS)
def test_nonstop_never_stops_once_it_moves(seed: int) -> None:
    drive = traffic("nonstop", 1200.0, rng(seed))
    t_s = np.arange(60.0, 1200.0, 0.1)
    assert forward(drive, t_s).min() >= 5.0  # the slowest turn and roundabout


@pytest.mark.parametrize("seed", SEEDS)
def test_reverse_only_goes_backwards(seed: int) -> None:
    speed = forward(drive := traffic("reverse", 600.0, rng(seed)), times(drive))
    assert -4.0 <= speed.min() < -1.0
    assert speed.max() <= 8.0 * EPS


def test_the_mixed_drive_has_all_that_it_promises() -> None:
    drive = traffic("mixed", 7200.0, rng(1))
    t_s = times(drive)
    truth, speed = drive.at(t_s), forward(drive, t_s)
    still = np.mean(speed == 0.0)
    assert 0.1 < still < 0.4
    assert speed.max() > 22.0
    assert speed.min() < -0.8, "no parking"
    assert rotate(conjugate(truth.q_nv), truth.acc_n)[:, 0].min() < -6.0, "no hard braking"
    assert np.mean((speed > 0.3) & (speed < 1.6)) > 0.01, "no creeping"
    assert np.ptp(to_euler(truth.q_nv)[0]) > np.pi


def test_grade_and_camber_have_their_sigmas_along_the_road() -> None:
    slopes, banks = [], []
    for seed in range(20):
        drive = traffic("country", 3600.0, rng(seed))
        t_s = times(drive, 1.0)
        moving = np.abs(forward(drive, t_s)) > 5.0
        _, pitch, roll = to_euler(drive.at(t_s[moving]).q_nv)
        slopes.append(-pitch)
        banks.append(roll)
    # Some 500 stretches of several correlation lengths in each of 20 drives: sigma is known to 1 % at the ends of the
    # segments; between two independent ends S(u) leaves sqrt(1 - 2 mean(S - S^2)) = 0.87 of it, between equal ones all.
    assert 0.86 * 0.03 < np.std(np.concatenate(slopes)) < 0.03
    assert 0.86 * 0.015 < np.std(np.concatenate(banks)) < 0.015


def test_drivers_keep_within_what_tyres_hold() -> None:
    drive = traffic("mixed", 7200.0, rng(2))
    truth = drive.at(times(drive))
    acc_v = rotate(conjugate(truth.q_nv), truth.acc_n)
    assert np.abs(acc_v[:, 0]).max() <= 9.0 * (1.0 + 1e-9)
    assert np.abs(acc_v[:, 1]).max() < 4.0


@pytest.mark.parametrize("seed", SEEDS)
def test_a_ferry_moves_between_two_stops(seed: int) -> None:
    drive, (start, end) = ferry(900.0, rng(seed))
    assert drive.duration_s == pytest.approx(900.0, rel=1e-12)
    assert end - start == pytest.approx(450.0)
    np.testing.assert_allclose(forward(drive, np.array([start - 0.01, start + 59.0, end - 59.0, end])), 0.0, atol=1e-5)
    sailing = forward(drive, np.arange(start, end, 0.1))
    assert sailing.min() < -2.4, "stern first out of the harbour"
    assert 6.0 <= sailing.max() <= 9.0


def test_what_leaves_no_time_to_drive_is_refused() -> None:
    with pytest.raises(ValueError, match=r"rests for 30 s never moves"):
        traffic("country", 30.0, rng())
    with pytest.raises(ValueError, match=r"with a ferry takes 480 s at least"):
        ferry(300.0, rng())
