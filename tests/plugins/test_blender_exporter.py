from __future__ import annotations

import json
import sys

import numpy as np
import pytest
from exporter_tables import SECOND, START_NS, drive, fixes, happened
from scipy.interpolate import RegularGridInterpolator

from recon.errors import DataError, NothingToExport, PluginError
from recon.manifest import RunInfo
from recon.numerics.geodesy import Anchor, enu_to_geodetic
from recon.numerics.rotation import from_euler, rotate
from recon.recording import Recording
from recon.storage import write_recording
from recon.tables import matrix, time_ns, with_meta
from recon_exporters.blender import BlenderParams, blender, find_blender, run_builder

PROGRAM = "a program that nobody has"


def export(folder, trajectory, *, gnss=None, events=None, warnings=(), streams=None, **params):
    """What the plan holds: its facts and its arrays."""
    folder.mkdir(exist_ok=True)
    paths = blender(
        trajectory=trajectory,
        gnss=gnss,
        events=events,
        streams=streams or {},
        folder=folder,
        about=RunInfo("a drive", {"warnings": list(warnings)}),
        params=BlenderParams(**{"blender": "none", **params}),
    )
    assert {path.name for path in paths} >= {"scene.json", "scene.npz", "build_scene.py", "HOW_TO_OPEN.txt"}
    with np.load(folder / "scene.npz") as stored:
        return json.loads((folder / "scene.json").read_text(encoding="utf-8")), dict(stored)


def straight(t_s, speed=5.0, **groups):
    """East at constant speed, pointing east."""
    t_s = np.asarray(t_s, dtype=np.float64)
    velocity = np.tile((speed, 0.0, 0.0), (len(t_s), 1))
    columns = {"pos": np.outer(t_s, (speed, 0.0, 0.0)), "vel": velocity, "q": from_euler(np.zeros(len(t_s)), 0.0, 0.0)}
    return drive(t_s, **{**columns, **groups})


# --- keys -----------------------------------------------------------------------------------------------------------


def test_every_key_is_a_row_of_the_trajectory_to_the_last_digit(tmp_path):
    trajectory = drive(np.arange(0.0, 10.0, 0.01), pos=np.random.default_rng(1).normal(size=(1000, 3)) * 100.0)
    facts, keys = export(tmp_path, trajectory)
    rows = np.searchsorted(time_ns(trajectory), keys["time"])
    assert time_ns(trajectory)[rows].tolist() == keys["time"].tolist()
    # One subtraction and one addition of numbers below 1000 m.
    assert np.abs(keys["position"] + facts["origin"] - matrix(trajectory, "pos")[rows]).max() < 1e-12
    assert np.array_equal(np.abs(keys["q"]), np.abs(matrix(trajectory, "q")[rows]))


def test_each_frame_has_the_first_of_its_rows_and_the_film_ends_with_the_last_row(tmp_path):
    facts, keys = export(tmp_path, straight(np.arange(0.0, 2.001, 0.005)), fps=20)
    assert keys["time"].tolist() == [START_NS + index * SECOND // 20 for index in range(41)]
    assert np.abs(keys["frame"] - np.arange(1, 42)).max() < 1e-9  # seconds times 20, each rounded once
    assert (facts["fps"], facts["frames"]) == (20, 41)


def test_a_quaternion_that_changes_sign_in_the_log_does_not_in_the_film(tmp_path):
    q = from_euler(np.linspace(0.0, 1.0, 101), 0.0, 0.0)
    q[::2] *= -1.0
    _, keys = export(tmp_path, straight(np.arange(101) * 0.04, q=q))
    assert (np.sum(keys["q"][1:] * keys["q"][:-1], axis=1) > 0.99).all()


def test_rows_without_a_place_an_attitude_or_a_velocity_are_left_out(tmp_path):
    position = np.outer(np.arange(5.0), (1.0, 0.0, 0.0))
    velocity, q = np.ones((5, 3)), from_euler(np.zeros(5), 0.0, 0.0)
    position[1], velocity[2, 0], q[3] = np.nan, np.nan, np.nan
    _, keys = export(tmp_path, straight(np.arange(5.0), pos=position, vel=velocity, q=q))
    assert ((keys["time"] - START_NS) // SECOND).tolist() == [0, 4]


def test_a_drive_without_any_place_is_refused(tmp_path):
    with pytest.raises(NothingToExport, match="a position, an attitude and a velocity"):
        export(tmp_path, straight(np.arange(3.0), pos=np.full((3, 3), np.nan)))


def test_the_film_shows_the_window_and_begins_with_frame_one(tmp_path):
    facts, keys = export(tmp_path, straight(np.arange(0.0, 10.0, 0.04)), start=2.0, end=4.0)
    assert keys["elapsed"][[0, -1]].tolist() == pytest.approx([2.0, 4.0], abs=1e-9)
    assert (keys["frame"][0], facts["frames"]) == (1.0, 51)
    assert facts["origin"] == pytest.approx([10.0, 0.0, 0.0], abs=1e-12)


def test_a_window_beside_the_drive_is_refused(tmp_path):
    with pytest.raises(NothingToExport, match="from 20 s to"):
        export(tmp_path, straight(np.arange(0.0, 10.0, 0.1)), start=20.0)


def test_slow_motion_stretches_the_time_around_a_crash_and_no_other(tmp_path):
    crash = happened((5.0, 5.1), kind="crash")
    _, keys = export(tmp_path, straight(np.arange(0.0, 10.0001, 0.001)), events=crash, slow_motion=10.0, slow_span=0.45)
    times = [0.0, 4.55, 5.55, 10.0]
    frames = 1.0 + 25.0 * np.array([0.0, 4.55, 14.55, 19.0])
    # Times to 1e-12 s of numbers below 10, frames to 1e-13 of numbers below 500, ten times stretched.
    assert keys["frame"] == pytest.approx(np.interp(keys["elapsed"], times, frames), abs=1e-9)
    slowly = (keys["elapsed"] > 4.6) & (keys["elapsed"] < 5.5)
    assert np.median(np.diff(keys["elapsed"][slowly])) == pytest.approx(0.004, abs=1e-9)


def test_without_vertical_motion_everything_lies_in_one_plane(tmp_path):
    t_s = np.arange(0.0, 10.0, 0.04)
    position = np.column_stack((5.0 * t_s, np.zeros((len(t_s), 1)), t_s))
    for vertical, rise in ((True, 9.96), (False, 0.0)):
        _, keys = export(tmp_path / str(vertical), straight(t_s, pos=position), vertical=vertical)
        assert [np.ptp(keys[name][:, 2]) for name in ("position", "path_position")] == pytest.approx(
            [rise, rise], abs=0.2
        )
        assert (keys["follow"][:, 2] > keys["position"][:, 2] + 3.0).all()


# --- what moves -----------------------------------------------------------------------------------------------------


def test_wheels_roll_as_far_as_the_vehicle_goes(tmp_path):
    facts, keys = export(tmp_path, straight(np.arange(0.0, 10.001, 0.01), speed=8.0))
    assert keys["wheel_angle"][-1] * facts["wheel_radius"] == pytest.approx(80.0, abs=1e-9)  # exact for a constant
    assert keys["steering"] == pytest.approx(0.0, abs=1e-12)


def test_wheels_roll_back_in_reverse(tmp_path):
    _, keys = export(tmp_path, straight(np.arange(0.0, 2.0, 0.01), speed=-2.0))
    assert (np.diff(keys["wheel_angle"]) < 0.0).all()
    assert keys["speed"] == pytest.approx(2.0)


def test_front_wheels_point_to_where_a_circle_of_that_radius_asks(tmp_path):
    """tan(steering) = wheelbase / radius; the fade at a crawl takes 1 m^2/s^2 of 100 away, and averages 0.5 s a 24th
    of the square of that angle, nothing of a constant rate.
    """
    t_s, radius, speed = np.arange(0.0, 20.0, 0.01), 20.0, 10.0
    yaw = speed / radius * t_s
    position = radius * np.column_stack((np.sin(yaw), 1.0 - np.cos(yaw), np.zeros(len(yaw))))
    velocity = speed * np.column_stack((np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))))
    trajectory = straight(t_s, pos=position, vel=velocity, q=from_euler(yaw, 0.0, 0.0))
    facts, keys = export(tmp_path, trajectory)
    wanted = np.arctan(facts["wheelbase"] / radius / (1.0 + 1.0 / speed**2))
    assert keys["steering"] == pytest.approx(wanted, abs=1e-9)
    behind = rotate(from_euler(yaw, 0.0, 0.0), (-1.0, 0.0, 0.0))
    rows = np.searchsorted(time_ns(trajectory), keys["time"])
    away = keys["follow"] - keys["position"]
    assert (np.sum(away * behind[rows], axis=1)[50:-50] > 6.0).all()


def test_a_spin_steers_no_further_than_wheels_can(tmp_path):
    t_s = np.arange(0.0, 3.0, 0.01)
    _, keys = export(tmp_path, straight(t_s, q=from_euler(20.0 * t_s, 0.0, 0.0)))
    assert np.abs(keys["steering"]).max() <= np.radians(38.0)


# --- what stands ----------------------------------------------------------------------------------------------------


def test_the_path_goes_through_keys_half_a_metre_apart(tmp_path):
    _, keys = export(tmp_path, straight(np.arange(0.0, 20.0, 0.02), speed=2.0), gnss=fixes(np.arange(0.0, 20.5, 1.0)))
    assert np.array_equal(keys["path_position"], keys["position"][keys["path_row"]])
    # A step of a key, 0.08 m, more or less.
    assert np.diff(keys["path_position"][:, 0]) == pytest.approx(0.5, abs=0.0801)
    assert keys["path_drawn"].all()


def test_a_vehicle_that_stands_has_a_path_of_one_point(tmp_path):
    _, keys = export(tmp_path, straight(np.arange(0.0, 3.0, 0.01), speed=0.0))
    assert len(keys["path_position"]) == 1
    assert keys["strip"].shape == (161, 2, 3)  # and 40 m to each side, 0.5 m apart


def test_the_path_is_dashed_where_gnss_is_silent(tmp_path):
    told = [0.0, 1, 2, 3, 4, 5, 15, 16, 17, 18, 19, 20]
    facts, keys = export(tmp_path, straight(np.arange(0.0, 20.001, 0.02), speed=10.0), gnss=fixes(told))
    elapsed = keys["elapsed"][keys["path_row"]]
    silent = (elapsed > 5.0) & (elapsed < 15.0)
    assert keys["path_drawn"][~silent].all()
    assert 0.4 < keys["path_drawn"][silent].mean() < 0.6
    assert [(mark["kind"], mark["frame"], mark["name"]) for mark in facts["markers"]] == [
        ("outage", 126, "outage 10.0 s")
    ]


def test_without_gnss_all_of_the_path_is_dashed_and_no_outage_is_marked(tmp_path):
    facts, keys = export(tmp_path, straight(np.arange(0.0, 20.0, 0.02)))
    assert 0.4 < keys["path_drawn"].mean() < 0.6
    assert facts["markers"] == []


def test_the_ground_lies_below_the_path_and_ends_far_away(tmp_path):
    t_s = np.arange(0.0, 60.0, 0.04)
    position = np.column_stack((10.0 * t_s, np.zeros(len(t_s)), 0.5 * t_s))  # a slope of 5 %
    _, keys = export(tmp_path, straight(t_s, speed=10.0, pos=position))
    x, z = keys["ground_x"], keys["ground_z"]
    assert z.shape == (len(x), len(keys["ground_y"]))
    assert (x[0], x[-1]) < (-6000.0, 6000.0)
    middle = np.argmin(np.abs(keys["ground_y"]))
    beside = np.interp(keys["path_position"][:, 0], x, z[:, middle])
    # Points of a support lie 3 m apart; lines of the grid 10 m, in which the path rises 0.5 m.
    assert np.abs(keys["path_position"][:, 2] - beside).max() < 0.25 + 0.5 + 0.5


def test_the_ground_is_nowhere_above_the_strip_of_a_long_drive_over_hills(tmp_path):
    """30 km on, 30 m up and down again every 8 km: the squares of the ground are 230 m wide."""
    t_s = np.arange(0.0, 1000.0, 0.1)
    position = np.column_stack((30.0 * t_s, 500.0 * np.sin(t_s / 100.0), 30.0 * np.sin(t_s / 40.0)))
    _, keys = export(tmp_path, straight(t_s, pos=position))
    ground = RegularGridInterpolator((keys["ground_x"], keys["ground_y"]), keys["ground_z"])
    strip = keys["strip"].reshape(-1, 3)
    assert (strip[:, 2] - ground(strip[:, :2])).min() > 0.25 - 1e-9


def test_the_road_goes_on_above_the_ground_where_the_drive_rolled_back_from_its_end(tmp_path):
    """Uphill for 40 m, and 10 m back: what goes on from the lower end lies under the hill."""
    t_s = np.arange(0.0, 50.0, 0.1)
    way = np.where(t_s < 40.0, t_s, 80.0 - t_s)
    position = np.column_stack((way, 0.0 * way, 0.1 * way))
    _, keys = export(tmp_path, straight(t_s, pos=position))
    ground = RegularGridInterpolator((keys["ground_x"], keys["ground_y"]), keys["ground_z"])
    middle = keys["strip"].mean(axis=1)
    assert middle[:, 0].max() > 70.0
    assert (middle[:, 2] - ground(middle[:, :2])).min() > 0.2


def test_the_tube_is_as_wide_and_high_as_the_sigmas_say(tmp_path):
    t_s = np.arange(0.0, 10.0, 0.04)
    std = np.tile((3.0, 0.5, 0.25), (len(t_s), 1))
    _, keys = export(tmp_path, straight(t_s, pos_std=std), tube=2.0)
    away = keys["tube"] - keys["path_position"][:, None, :]
    # It drives east, so across is north.
    assert np.abs(away).max(axis=(0, 1)) == pytest.approx([0.0, 1.0, 0.5], abs=1e-12)


@pytest.mark.parametrize(("tube", "known"), [(0.0, True), (2.0, False)])
def test_there_is_no_tube_unless_it_is_wanted_and_known(tmp_path, tube, known):
    std = np.full((100, 3), 0.5 if known else np.nan)
    _, keys = export(tmp_path, straight(np.arange(100) * 0.1, pos_std=std), tube=tube)
    assert "tube" not in keys


def test_fixes_lie_where_they_were_at_the_height_of_the_path(tmp_path):
    anchor = Anchor(44.5, 11.3, 100.0)
    there = np.column_stack((np.arange(5.0) * 5.0, np.arange(5.0) - 2.0, np.full(5, 50.0)))
    lat, lon, height = enu_to_geodetic(there, anchor)
    facts = {"lat": 44.5, "lon": 11.3, "height": 100.0}
    trajectory = with_meta(straight(np.arange(0.0, 4.001, 0.04)), anchor=facts, earth="wgs84")
    plan, keys = export(tmp_path, trajectory, gnss=fixes(np.arange(5.0), lat=lat, lon=lon, height=height))
    assert plan["anchor"] == facts
    # There and back over the ellipsoid: 1e-9 deg are 0.1 mm; heights 50 m up move the place by 50 m * 20 m / 6371 km.
    assert np.abs(keys["fixes"] - np.column_stack((there[:, :2], np.zeros(5)))).max() < 1e-3


def test_events_become_markers_with_their_value(tmp_path):
    events = happened((2.0, 2.1), kind="crash", value=62.79, unit="m/s^2")
    facts, _ = export(tmp_path, straight(np.arange(0.0, 4.0, 0.01)), events=events, slow_motion=1.0)
    assert facts["markers"] == [{"frame": 51, "kind": "crash", "name": "crash 62.8 m/s²"}]
    assert facts["look"]["still"] == pytest.approx(51.0, abs=1e-6)


def test_a_crash_runs_ten_times_slower_unless_told_otherwise(tmp_path):
    """At 25 frames a second: 1 s as it was, the second before the crash in 10 s; a drive without a crash as it was."""
    crash = happened((2.0, 2.1), kind="crash", value=62.79, unit="m/s^2")
    facts, _ = export(tmp_path / "crash", straight(np.arange(0.0, 4.0, 0.01)), events=crash)
    assert facts["markers"][0]["frame"] == 1 + 25 + 250
    quiet, _ = export(tmp_path / "quiet", straight(np.arange(0.0, 4.0, 0.01)))
    assert quiet["frames"] == pytest.approx(100, abs=1)


def test_events_outside_of_the_film_are_no_markers(tmp_path):
    facts, _ = export(tmp_path, straight(np.arange(0.0, 9.0, 0.01)), events=happened((1.0, 2.0)), start=3.0)
    assert facts["markers"] == []


def test_an_event_that_lasts_into_the_film_is_marked_at_its_beginning(tmp_path):
    """What is over when it begins is not: it only touches the first frame."""
    events = happened((1.0, 3.0), (1.0, 4.0), kind="standstill")
    facts, _ = export(tmp_path, straight(np.arange(0.0, 9.0, 0.01)), events=events, start=3.0)
    assert facts["markers"] == [{"frame": 1, "kind": "standstill", "name": "standstill"}]


# --- a second run ---------------------------------------------------------------------------------------------------


def test_a_ghost_moves_as_the_stream_of_that_name(tmp_path):
    t_s = np.arange(0.0, 4.001, 0.04)
    other = straight(t_s, pos=np.outer(t_s, (5.0, 0.0, 0.0)) + np.array([1.0, 2.0, 0.0]))
    _, keys = export(tmp_path, straight(t_s), streams={"reference": other}, ghost="reference")
    assert np.abs(keys["ghost_position"] - keys["position"] - (1.0, 2.0, 0.0)).max() < 1e-12
    assert keys["ghost_frame"].tolist() == keys["frame"].tolist()


def test_a_ghost_moves_as_the_trajectory_of_another_run(tmp_path):
    t_s = np.arange(0.0, 4.001, 0.04)
    other = straight(t_s, pos=np.outer(t_s, (4.0, 0.0, 0.0)))
    write_recording(Recording({"trajectory": other}), tmp_path / "other")
    _, keys = export(tmp_path / "out", straight(t_s), ghost=str(tmp_path / "other"))
    assert keys["ghost_position"][-1] == pytest.approx([16.0, 0.0, 0.0], abs=1e-12)


def test_a_ghost_about_another_anchor_is_brought_to_this_one(tmp_path):
    t_s = np.arange(0.0, 4.001, 0.04)
    first, second = Anchor(44.5, 11.3, 100.0), Anchor(44.5005, 11.3, 90.0)
    tables = []
    for anchor in (first, second):
        position = np.outer(t_s, (5.0, 0.0, 0.0))
        lat, lon, height = enu_to_geodetic(position, anchor)
        table = straight(t_s, pos=position, lat=lat, lon=lon, height=height)
        facts = {"lat": anchor.lat, "lon": anchor.lon, "height": anchor.height}
        tables.append(with_meta(table, anchor=facts, earth="wgs84"))
    _, keys = export(tmp_path, tables[0], streams={"reference": tables[1]}, ghost="reference")
    # 0.0005 deg of a meridian whose radius at 44.5 deg is 6 367 km + 0.1 km.
    north = np.radians(0.0005) * 6_366_800.0
    assert np.abs((keys["ghost_position"] - keys["position"])[0] - (0.0, north, -10.0)).max() < 0.01


@pytest.mark.parametrize("name", ["reference", "no such folder"])
def test_a_ghost_that_is_not_there_is_told_in_one_sentence(tmp_path, name):
    with pytest.raises(DataError, match=name):
        export(tmp_path, straight(np.arange(3.0)), ghost=name)


def test_a_ghost_of_another_day_is_refused(tmp_path):
    t_s = np.arange(0.0, 3.0, 0.1)
    with pytest.raises(DataError, match="no row of the ghost"):
        export(tmp_path, straight(t_s), streams={"reference": straight(t_s + 1e6)}, ghost="reference")


# --- the solver -----------------------------------------------------------------------------------------------------


def test_the_solver_takes_over_after_the_first_crash_and_keeps_the_pace_of_the_film(tmp_path):
    crash = happened((2.0, 2.1), (3.0, 3.1), kind="crash")
    trajectory = straight(np.arange(0.0, 4.001, 0.01))
    facts, _ = export(tmp_path, trajectory, events=crash, solver=True, slow_motion=5.0, slow_span=0.5, mass=900.0)
    told = facts["look"]["solver"]
    # Slow from 1.5 s on: 1 + 25 * (1.5 + 5 * 0.6) = 113.5.
    assert (told["frame"], told["mass"]) == (114, 900.0)
    frame, share = np.array(told["pace"]).T
    assert np.interp([10.0, 60.0, 300.0, facts["frames"] - 2.0], frame, share) == pytest.approx([1.0, 0.2, 0.2, 1.0])


def test_the_solver_without_a_crash_is_refused(tmp_path):
    with pytest.raises(NothingToExport, match="no event of kind 'crash'"):
        export(tmp_path, straight(np.arange(3.0)), events=happened((1.0, 2.0)), solver=True)


# --- Blender --------------------------------------------------------------------------------------------------------


def test_a_program_that_is_not_there_is_told_before_anything_is_written(tmp_path):
    with pytest.raises(PluginError, match=PROGRAM):
        export(tmp_path, straight(np.arange(3.0)), blender=PROGRAM)
    assert list(tmp_path.iterdir()) == []


def test_a_python_runs_the_builder_itself():
    assert find_blender(sys.executable) == [sys.executable]
    assert find_blender("none") == []


def test_what_blender_said_last_is_told_when_it_fails(tmp_path):
    export(tmp_path, straight(np.arange(3.0)))
    (tmp_path / "build_scene.py").write_text("raise ValueError('no such socket')", encoding="utf-8")
    with pytest.raises(PluginError, match="ValueError: no such socket"):
        run_builder([sys.executable], tmp_path)


def test_a_video_that_is_not_there_is_told_in_one_sentence(tmp_path):
    with pytest.raises(DataError, match=r"^video: there is no file 'dashcam\.mp4'$"):
        export(tmp_path, straight(np.arange(0.0, 4.0, 0.01)), video="dashcam.mp4")
