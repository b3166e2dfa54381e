"""fuser.map while the drive goes on, next to fuser.map of the whole drive."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from recon.numerics.signals import interpolate
from recon.tables import matrix, meta, replace, select_rows, time_ns, times
from recon_fusers._map_live import LiveMap
from recon_fusers.map import MapParams, fuse_map
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams

LAG = 10.0
PARAMS = MapParams()


@pytest.fixture(scope="module")
def drive():
    """Seven minutes of a town at 50 Hz, the receiver never silent."""
    params = DriveParams(
        motion="city", sensors="study_two", duration=420.0, imu_rate=50.0, seed=5, route=5, outages=(), outage_rate=0.0
    )
    return simulate_drive(params)


def between(table, first_s, stop_s, zero_ns):
    at = (time_ns(table) - zero_ns) * 1e-9
    return select_rows(table, (at >= first_s) & (at < stop_s))


def follow(live, drive, first_s, stop_s, step_s=10.0):
    """The rows that are final."""
    zero_ns = int(time_ns(drive["imu"])[0])
    parts = []
    for start in np.arange(first_s, stop_s, step_s):
        told = live.advance(
            {name: between(drive[name], start, min(start + step_s, stop_s), zero_ns) for name in ("imu", "gnss")}
        )
        parts += [told["trajectory"]] if "trajectory" in told else []
    return pa.concat_tables(parts) if parts else None


@pytest.fixture(scope="module")
def live():
    return LiveMap(PARAMS, LAG)


@pytest.fixture(scope="module")
def followed(live, drive):
    rows = follow(live, drive, 0.0, 421.0)
    return pa.concat_tables([rows, live.finish()["trajectory"]])


def rms(found, drive, group, since_s):
    zero_ns = int(time_ns(drive["imu"])[0])
    found = between(found, since_s, 1e9, zero_ns)
    true = interpolate(time_ns(found), time_ns(drive["reference"]), matrix(drive["reference"], group))
    return float(np.sqrt(np.nanmean(np.sum((matrix(found, group) - true)[:, :2] ** 2, axis=1))))


def test_every_row_is_given_once_and_in_its_order(followed, drive):
    assert time_ns(followed).tolist() == time_ns(drive["imu"]).tolist()


def test_ten_seconds_later_it_is_hardly_worse_than_the_whole_drive(followed, drive):
    whole = fuse_map(imu=drive["imu"], gnss=drive["gnss"], wheel=None, attitude=None, events=None, params=PARAMS)
    # What GNSS says of a slow error after the lag is missing: of 100 s of its correlation ten are known.
    assert rms(followed, drive, "pos", 100.0) < 2.0 * rms(whole["trajectory"], drive, "pos", 100.0)
    assert rms(followed, drive, "vel", 100.0) < 3.0 * rms(whole["trajectory"], drive, "vel", 100.0)


def test_its_sigmas_hold(followed, drive):
    later = between(followed, 100.0, 1e9, int(time_ns(drive["imu"])[0]))
    true = interpolate(time_ns(later), time_ns(drive["reference"]), matrix(drive["reference"], "vel"))
    ratio = (matrix(later, "vel") - true) / matrix(later, "vel_std")
    # One drive: the errors of a velocity are the same for seconds, so that its mean square scatters by a factor of two.
    assert 0.2 < np.mean(ratio**2) < 3.0


def test_a_window_tells_the_noise_anew_but_for_what_is_as_slow_as_it_is_long(live, followed):
    assert followed.num_rows
    first, now = live.noise, live.held.noise
    assert (now.velocity != first.velocity).all()
    assert now.accel != first.accel
    assert (now.drift == first.drift).all()
    assert now.drift_tau == first.drift_tau


def test_nothing_is_told_before_a_minute_has_passed(drive):
    live = LiveMap(PARAMS, LAG)
    assert follow(live, drive, 0.0, 55.0) is None
    assert live.saved() == b""


def test_one_that_goes_on_from_what_was_saved_gives_the_same(followed, drive):
    live = LiveMap(PARAMS, LAG)
    follow(live, drive, 0.0, 360.0)
    saved = live.saved()
    assert saved
    again = LiveMap(PARAMS, LAG, saved)
    zero_ns = int(time_ns(drive["imu"])[0])
    since_s = (again.since_ns - zero_ns) * 1e-9
    assert 0.0 < since_s < 360.0
    rows = follow(again, drive, since_s, 421.0)
    there = time_ns(rows)
    assert (np.diff(there) > 0).all()
    assert there[0] > zero_ns + round((360.0 - 3 * LAG) * 1e9)
    expected = select_rows(followed, np.isin(time_ns(followed), there))
    # Outliers are told apart anew, from where less was known: far below the sigma of the position itself.
    away = (matrix(rows, "pos") - matrix(expected, "pos")) / matrix(expected, "pos_std")
    assert np.sqrt(np.mean(away**2)) < 0.3


def test_it_goes_on_through_an_outage(drive):
    zero_ns = int(time_ns(drive["imu"])[0])
    at = (time_ns(drive["gnss"]) - zero_ns) * 1e-9
    silent = {**drive, "gnss": select_rows(drive["gnss"], (at < 330.0) | (at > 390.0))}
    live = LiveMap(PARAMS, LAG)
    rows = pa.concat_tables([follow(live, silent, 0.0, 421.0), live.finish()["trajectory"]])
    assert rows.num_rows == drive["imu"].num_rows
    sigma = np.hypot(*matrix(rows, "pos_std")[:, :2].T)
    seen = (time_ns(rows) - zero_ns) * 1e-9
    assert sigma[(seen > 360.0) & (seen < 375.0)].mean() > sigma[(seen > 300.0) & (seen < 320.0)].mean()


def test_after_hours_without_the_imu_it_starts_anew_about_the_same_origin(drive):
    zero_ns, pause_ns = int(time_ns(drive["imu"])[0]), 7_200 * 10**9
    live, parts = LiveMap(PARAMS, LAG), []
    parts.append(follow(live, drive, 0.0, 210.0))
    for start in np.arange(220.0, 421.0, 10.0):
        later = {name: between(drive[name], start, start + 10.0, zero_ns) for name in ("imu", "gnss")}
        later = {name: replace(table, time=times(time_ns(table) + pause_ns)) for name, table in later.items()}
        told = live.advance(later)
        parts += [told["trajectory"]] if "trajectory" in told else []
        if start == 220.0:
            assert live.awaits == "a new start after a pause of 2 h"
            assert time_ns(parts[-1])[-1] == time_ns(between(drive["imu"], 0.0, 210.0, zero_ns))[-1]
    assert len({str(meta(part)["anchor"]) for part in parts}) == 1
    found = between(pa.concat_tables(parts), 7_200.0, 1e9, zero_ns)
    true = interpolate(time_ns(found) - pause_ns, time_ns(drive["reference"]), matrix(drive["reference"], "pos"))
    sigma = np.sqrt(np.mean(matrix(found, "pos_std")[:, :2] ** 2))
    assert np.sqrt(np.mean((matrix(found, "pos") - true)[:, :2] ** 2)) < 4.0 * sigma


def test_a_barometer_tells_climbs():
    params = DriveParams(
        motion="country", duration=150.0, imu_rate=25.0, baro_rate=5.0, gnss_vector=False, seed=1, route=1
    )
    hills = simulate_drive(params)
    errors = []
    for left_out in ("baro", ""):
        live = LiveMap(PARAMS, LAG)
        told = live.advance({name: hills[name] for name in ("imu", "gnss", "baro") if name != left_out})["trajectory"]
        true = interpolate(time_ns(told), time_ns(hills["reference"]), matrix(hills["reference"], "vel"))
        errors.append(float(np.sqrt(np.mean((matrix(told, "vel") - true)[:, 2] ** 2))))
    assert errors[1] < errors[0]
