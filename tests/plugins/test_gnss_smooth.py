from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recon.numerics.geodesy import Anchor, enu_to_geodetic, geodetic_to_enu
from recon.rows import Event, events, warnings_of
from recon.schema import GNSS
from recon.tables import Array, build, matrix, vector, with_meta
from recon_filters.gnss_smooth import GnssSmoothParams, declare_filters, gnss_smooth

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

from gnss_smooth import case

ANCHOR = Anchor(44.5, 11.3, 60.0)
T_S = np.arange(0.0, 200.0)
STOP = (T_S >= 50.0) & (T_S <= 150.0)
SPEED = np.where(STOP, 0.0, np.minimum(10.0, np.minimum(np.abs(T_S - 50.0), np.abs(T_S - 150.0))))
EAST = np.concatenate(([0.0], np.cumsum((SPEED[1:] + SPEED[:-1]) / 2.0)))
TRUTH = np.column_stack((EAST, np.zeros((200, 2))))


def star(seed: int = 3) -> Array:
    """An error (200, 3) m that changes in 100 s, as that of a receiver."""
    rng = np.random.default_rng(seed)
    error = rng.normal(0.0, 2.0, (1, 3))
    fade = np.exp(-0.01)
    for _ in T_S[1:]:
        error = np.vstack((error, fade * error[-1] + 2.0 * np.sqrt(1.0 - fade**2) * rng.standard_normal(3)))
    return error


def fixes(pos: Array, **more: Any) -> Any:
    lat, lon, height = enu_to_geodetic(np.nan_to_num(pos), ANCHOR)
    time = (T_S * 1e9).astype(np.int64)
    table = build(GNSS, **{"time": time, "lat": lat, "lon": lon, "height": height, "pos": pos, **more})
    return with_meta(table, anchor={"lat": ANCHOR.lat, "lon": ANCHOR.lon, "height": ANCHOR.height})


def smoothed(gnss: Any, stop: bool = True) -> Any:
    found = events([Event(50_000_000_000, 150_000_000_000, "standstill")] if stop else [])
    return gnss_smooth(gnss=gnss, events=found, params=GnssSmoothParams())["gnss"]


def way(pos: Array) -> float:
    """Length of a path (n, 3) m over ground."""
    return float(np.linalg.norm(np.diff(pos[:, :2], axis=0), axis=1).sum())


SEEN = {"speed": SPEED, "course": np.full(200, 0.5 * np.pi)}


def test_the_star_of_a_stop_disappears() -> None:
    raw, smooth = star()[STOP], matrix(smoothed(fixes(TRUTH + star(), **SEEN)), "pos")[STOP]
    assert np.ptp(raw, axis=0)[:2].min() > 2.0
    # A velocity held to 0.01 m/s in each of 100 rows sums up to 0.1 m; three times that.
    assert np.ptp(smooth, axis=0)[:2].max() < 0.3


def test_without_a_detector_the_reported_speed_alone_makes_it_stiff() -> None:
    raw, smooth = star()[STOP], matrix(smoothed(fixes(TRUTH + star(), **SEEN), stop=False), "pos")[STOP]
    # A velocity held to 0.15 m/s by each of the Doppler speeds may creep by 1.5 m in 100 s, but it cannot turn about.
    assert way(smooth) < 0.1 * way(raw)


def test_the_drive_is_not_moved() -> None:
    by = matrix(smoothed(fixes(TRUTH + star(), **SEEN)), "pos")[~STOP] - TRUTH[~STOP]
    assert np.sqrt(np.mean(by**2)) < np.sqrt(np.mean(star()[~STOP] ** 2))


def test_perfect_fixes_stay_where_they_are() -> None:
    smooth = smoothed(fixes(TRUTH, **SEEN))
    # The speed bends within a second where the car stops: sqrt(1/12) of 1 m/s^2 there, weighed against 0.5 m.
    assert matrix(smooth, "pos") == pytest.approx(TRUTH, abs=0.15)
    place = geodetic_to_enu(*(vector(smooth, name) for name in ("lat", "lon", "height")), ANCHOR)
    assert place == pytest.approx(matrix(smooth, "pos"), abs=1e-7)


def test_velocity_is_that_of_the_spline_and_what_was_missing_stays_missing() -> None:
    pos = TRUTH + star()
    pos[70:75] = np.nan
    vel = np.gradient(pos, axis=0)
    smooth = smoothed(fixes(pos, vel=vel, acc=np.gradient(vel, axis=0), **SEEN))
    for group, given in (("pos", pos), ("vel", vel)):
        assert (np.isnan(matrix(smooth, group, gaps=True)) == np.isnan(given)).all()
    known = np.isfinite(matrix(smooth, "vel", gaps=True)[:, 0])
    # A Doppler velocity of 0.15 m/s sigma in each of 200 rows holds it that near or nearer.
    assert matrix(smooth, "vel", gaps=True)[known, 0] == pytest.approx(SPEED[known], abs=0.45)


def test_too_few_positions_pass_unchanged_and_it_is_said() -> None:
    given = fixes(np.full((200, 3), np.nan))
    streams = gnss_smooth(gnss=given, events=None, params=GnssSmoothParams())
    assert streams["gnss"].equals(given)
    assert warnings_of(streams["metrics"]) == ["fewer than three positions in gnss: nothing is smoothed"]


@pytest.mark.parametrize("seed", [0, 5])
def test_on_a_city_drive_the_wander_goes_and_the_errors_shrink(seed: int) -> None:
    without, with_it = case(seed, 240.0)
    assert with_it.wander < 0.01 * without.wander
    assert with_it.stops < without.stops
    assert with_it.motion < without.motion


def test_the_declaration_has_no_fault() -> None:
    assert [stage.faults() for stage in declare_filters()] == [[]]
