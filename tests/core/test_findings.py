"""Findings of the doctor as people read them: values with units, sentences that fit what they are about."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recon.doctor import as_data
from recon.findings import value_text
from recon.numerics.doctor import Claims, Imu
from recon.numerics.doctor.clocks import Clocks
from recon.numerics.doctor.finding import confirmed, contradicted, unknown
from recon.numerics.doctor.lags import velocity_lag
from recon.numerics.doctor.log import Gnss
from recon.numerics.doctor.receiver import height_datum
from recon.numerics.doctor.samples import clipping, gaps
from recon.numerics.smoothing.lag import Lag


@pytest.mark.parametrize(
    ("code", "value", "text"),
    [
        ("gaps", 2.0218, "2.02 s"),
        ("jitter", 0.0035462, "3.55 ms"),
        ("gaps", 0.0, "0 s"),
        ("clock_drift", 54.3, "54.3 ppm"),
        ("clock_drift", "jump", "jump"),
        ("time_zone", -2.0, "-2 h"),
        ("height_datum", 3.8, "3.8 m"),
        ("mounting", 178.2, "178 deg"),
        ("mounting", "z is 2 deg from upright", "z is 2 deg from upright"),
        ("noise_class", 5.0, "5 times"),
        ("reversals", 0.0, "0 rows"),
        ("clipping", None, ""),
    ],
)
def test_a_value_has_its_unit(code: str, value: float | str | None, text: str) -> None:
    assert value_text(as_data(contradicted(code, value, "So it is."))) == text


def test_the_unit_of_a_limit_is_that_of_the_sensor_that_reaches_it() -> None:
    rng, t_s = np.random.default_rng(1), np.arange(0.0, 30.0, 0.01)
    free = rng.normal(size=(3000, 3))
    swing = np.clip(free + 4.0 * np.sin(t_s)[:, None], -3.0, 3.0)
    assert clipping(Imu(t_s, swing, free)).unit == "m/s^2"
    assert clipping(Imu(t_s, free, swing)).unit == "rad/s"


@pytest.mark.parametrize(
    ("holes", "told"), [(1, "is silent once, for 2 s, at 9.9 s."), (2, "is silent 2 times, for 4 s in")]
)
def test_holes_are_counted_in_words(holes: int, told: str) -> None:
    t_s = np.arange(0.0, 60.0, 0.1)
    for hole in range(holes):
        t_s[100 * (hole + 1) :] += 1.9
    assert told in gaps(Imu(t_s, np.ones((600, 3)), np.ones((600, 3)))).explanation


def fixes(speed: float) -> Gnss:
    """Ten fixes that tell nothing but a speed."""
    nothing, vectors = np.full(10, np.nan), np.full((10, 3), np.nan)
    return Gnss(np.arange(10.0), *[nothing] * 3, np.full(10, speed), nothing, vectors, vectors, vectors)


@pytest.mark.parametrize(
    ("seconds", "told"), [(-0.011, "0.01 s early,"), (0.011, "0.01 s late,"), (0.0, "0.00 s late,")]
)
def test_a_lag_is_late_or_early_and_has_no_sign(seconds: float, told: str) -> None:
    imu = Imu(np.arange(10.0), np.ones((10, 3)), np.ones((10, 3)))
    found = velocity_lag(Clocks(0.0, Lag(seconds, 0.05), None), imu, fixes(8.0))
    assert (found.status, told in found.explanation) == ("confirmed", True)


def test_from_where_heights_count_is_told_in_words() -> None:
    t_s, height = np.arange(30.0), np.full(30, 100.0)
    plain = Claims()
    assert "does not say which is meant" in height_datum({"gnss": (t_s, height)}, plain).explanation
    told = height_datum({"gnss": (t_s, height)}, replace(plain, height_datum="ellipsoid")).explanation
    assert told.endswith("they are taken to count from the ellipsoid.")
    assert height_datum({"gnss": (t_s, height * np.nan)}, plain) == unknown("height_datum", "The log holds no heights.")
    assert height_datum({}, plain) == unknown("height_datum", "The log holds no heights.")


def test_what_is_right_without_a_number_has_no_unit() -> None:
    assert confirmed("clipping", None, "None does.").unit == ""
