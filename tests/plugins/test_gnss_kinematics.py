from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from recon.numerics.geodesy import Anchor, enu_to_geodetic
from recon.parameters import Params
from recon.rows import warnings_of
from recon.schema import GNSS
from recon.tables import Array, build, conform, matrix, meta, vector, with_meta
from recon_filters.gnss_kinematics import GnssKinematicsParams, declare_filters, gnss_kinematics

ANCHOR = Anchor(lat=44.5, lon=11.3, height=60.0)
T_S = np.array([0.0, 0.9, 2.1, 3.0, 3.9, 5.2])  # irregular, no step longer than the default max_gap
VEL_0, ACC = np.array([20.0, -5.0, 0.5]), np.array([-2.0, 0.4, 0.1])

# Latitudes, longitudes and Earth-fixed coordinates are doubles of about 6.4e6 m: each of the some ten operations that
# lead to degrees and back rounds by up to 1e-9 m.
POSITION_ROUNDING = 2e-8
# The first and last three-point derivatives weigh positions with at most 3 / (shortest step, 0.9 s).
VELOCITY_ROUNDING = POSITION_ROUNDING * 2 * 3 / 0.9
ACCELERATION_ROUNDING = VELOCITY_ROUNDING * 2 * 3 / 0.9


def positions(t_s: Array) -> Array:
    return VEL_0 * t_s[:, None] + 0.5 * ACC * t_s[:, None] ** 2


def velocities(t_s: Array) -> Array:
    return VEL_0 + ACC * t_s[:, None]


def fixes(t_s: Array, **more: Any) -> Any:
    lat, lon, height = enu_to_geodetic(positions(t_s), ANCHOR)
    return build(GNSS, **{"time": ns(t_s), "lat": lat, "lon": lon, "height": height, **more})


def ns(t_s: Array) -> Any:
    return np.rint(t_s * 1e9).astype(np.int64)


def test_constant_acceleration_is_recovered_at_irregular_times() -> None:
    gnss = gnss_kinematics(gnss=fixes(T_S), params=GnssKinematicsParams())["gnss"]
    assert matrix(gnss, "pos") == pytest.approx(positions(T_S), abs=POSITION_ROUNDING)
    assert matrix(gnss, "vel") == pytest.approx(velocities(T_S), abs=VELOCITY_ROUNDING)
    assert matrix(gnss, "acc") == pytest.approx(np.tile(ACC, (len(T_S), 1)), abs=ACCELERATION_ROUNDING)


def test_the_anchor_is_the_first_valid_fix() -> None:
    lat, lon, height = enu_to_geodetic(positions(T_S), ANCHOR)
    lat[0] = np.nan
    fix = np.array([3, 0, 1, 3, 3, 3])
    gnss = gnss_kinematics(gnss=fixes(T_S, lat=lat, fix=fix), params=GnssKinematicsParams())["gnss"]
    assert meta(gnss)["anchor"] == {"lat": lat[3], "lon": lon[3], "height": height[3]}
    assert meta(gnss)["earth"] == "wgs84"
    assert np.isnan(matrix(gnss, "pos", gaps=True)).all(axis=1).tolist() == [True, True, True, False, False, False]


def test_other_facts_of_the_stream_are_kept() -> None:
    given = with_meta(fixes(T_S), time_scale="UTC")
    gnss = gnss_kinematics(gnss=given, params=GnssKinematicsParams())["gnss"]
    assert meta(gnss)["time_scale"] == "UTC"
    assert gnss.select(given.column_names).equals(given)


def test_earth_chooses_the_figure_on_which_distances_are_measured() -> None:
    step = 1e-3  # deg north of the equator
    gnss = build(GNSS, time=ns(np.array([0.0, 10.0])), lat=np.array([0.0, step]), lon=np.zeros(2), height=np.zeros(2))
    north = {
        earth: vector(gnss_kinematics(gnss=gnss, params=GnssKinematicsParams(earth=earth))["gnss"], "pos_n")[1]
        for earth in ("wgs84", "sphere")
    }
    # Radius of the meridian at the equator: a (1 - e^2) = 6 335 439.3 m. The plane and the arc differ by angle^2 / 6.
    assert north["wgs84"] == pytest.approx(6_335_439.327 * np.radians(step), rel=1e-9)
    assert north["sphere"] == pytest.approx(6_371_000.0 * np.radians(step), rel=1e-9)


def test_nothing_is_derived_across_an_outage() -> None:
    t_s = np.array([0.0, 1.0, 2.0, 10.0, 11.0, 12.0])
    pos = np.column_stack((10.0 * t_s, np.zeros(6), np.zeros(6)))
    pos[3:, 1] += 500.0  # where it went in the outage is unknown
    lat, lon, height = enu_to_geodetic(pos, ANCHOR)
    streams = gnss_kinematics(gnss=fixes(t_s, lat=lat, lon=lon, height=height), params=GnssKinematicsParams())
    expected = np.tile([10.0, 0.0, 0.0], (6, 1))
    assert matrix(streams["gnss"], "vel") == pytest.approx(expected, abs=VELOCITY_ROUNDING)
    assert value_of(streams, "outages") == 1.0


def test_a_fix_that_stands_alone_has_a_position_but_no_velocity() -> None:
    gnss = gnss_kinematics(gnss=fixes(np.array([0.0, 1.0, 2.0, 9.0])), params=GnssKinematicsParams())["gnss"]
    assert np.isfinite(matrix(gnss, "pos", gaps=True)).all()
    for group in ("vel", "acc"):
        assert np.isnan(matrix(gnss, group, gaps=True)).all(axis=1).tolist() == [False, False, False, True]


def test_rows_without_a_fix_do_not_interrupt_the_derivative() -> None:
    lat = enu_to_geodetic(positions(T_S), ANCHOR)[0]
    lat[4] = np.nan
    gnss = gnss_kinematics(gnss=fixes(T_S, lat=lat), params=GnssKinematicsParams(max_gap=3.0))["gnss"]
    vel = matrix(gnss, "vel", gaps=True)
    assert np.isnan(vel[4]).all()
    assert np.delete(vel, 4, axis=0) == pytest.approx(np.delete(velocities(T_S), 4, axis=0), abs=VELOCITY_ROUNDING)


def test_a_missing_height_is_taken_as_zero_and_said() -> None:
    streams = gnss_kinematics(gnss=fixes(T_S).drop_columns(["height"]), params=GnssKinematicsParams())
    assert meta(streams["gnss"])["anchor"]["height"] == 0.0
    assert warnings_of(streams["metrics"]) == ["no height in gnss: 0 m is used"]


def test_heights_that_are_missing_in_some_fixes_are_filled_in_time_and_said() -> None:
    height = np.array([60.0, np.nan, 62.1, 63.0, 63.9, np.nan])
    streams = gnss_kinematics(gnss=fixes(T_S, height=height), params=GnssKinematicsParams())
    up = vector(streams["gnss"], "pos_u")
    # 0.9 s of 2.1 s on the way up by 2.1 m; the drop of the plane below the curved Earth is under d^2 / R / 2 = 1e-3 m
    assert up[[1, 5]] == pytest.approx([0.9, 3.9], abs=1e-3)
    assert warnings_of(streams["metrics"]) == ["height is missing in 2 fixes: filled from the fixes around them"]


def test_reported_velocity_is_used_where_it_is_there() -> None:
    given = velocities(T_S) + 1.0
    gnss = gnss_kinematics(gnss=fixes(T_S, vel=given), params=GnssKinematicsParams(velocity="reported"))["gnss"]
    assert (matrix(gnss, "vel") == given).all()
    assert matrix(gnss, "acc") == pytest.approx(np.tile(ACC, (len(T_S), 1)), abs=ACCELERATION_ROUNDING)


def test_derived_velocity_takes_the_place_of_a_reported_one() -> None:
    gnss = gnss_kinematics(gnss=fixes(T_S, vel=velocities(T_S) + 1.0), params=GnssKinematicsParams())["gnss"]
    assert matrix(gnss, "vel") == pytest.approx(velocities(T_S), abs=VELOCITY_ROUNDING)


def test_reported_speed_and_course_give_the_horizontal_velocity() -> None:
    speed, course = np.full(6, 10.0), np.radians([0.0, 90.0, 180.0, 270.0, 359.0, 30.0])
    given = fixes(T_S, speed=speed, course=course)
    gnss = gnss_kinematics(gnss=given, params=GnssKinematicsParams(velocity="reported"))["gnss"]
    vel = matrix(gnss, "vel")
    assert vel[:4, :2] == pytest.approx(np.array([[0, 10], [10, 0], [0, -10], [-10, 0]]), abs=1e-14)
    assert vel[:, 2] == pytest.approx(velocities(T_S)[:, 2], abs=VELOCITY_ROUNDING)


def test_a_magnetic_course_is_said() -> None:
    given = with_meta(fixes(T_S, speed=np.ones(6), course=np.ones(6)), heading_kind="magnetic")
    streams = gnss_kinematics(gnss=given, params=GnssKinematicsParams(velocity="reported"))
    assert any("magnetic" in note for note in warnings_of(streams["metrics"]))


def test_without_a_reported_velocity_the_derived_one_is_used_and_said() -> None:
    streams = gnss_kinematics(gnss=fixes(T_S), params=GnssKinematicsParams(velocity="reported"))
    assert matrix(streams["gnss"], "vel") == pytest.approx(velocities(T_S), abs=VELOCITY_ROUNDING)
    assert any("derived from positions" in note for note in warnings_of(streams["metrics"]))


def test_a_log_without_positions_passes_unchanged() -> None:
    given = build(GNSS, time=ns(T_S), speed=np.arange(6.0))
    streams = gnss_kinematics(gnss=given, params=GnssKinematicsParams())
    assert streams["gnss"].equals(given)
    assert streams["metrics"]["note"][0].as_py().startswith("no positions")


def test_empty_columns_of_positions_keep_what_the_plan_promises() -> None:
    nothing = np.full(6, np.nan)
    given = build(GNSS, time=ns(T_S), lat=nothing, lon=nothing, vel=velocities(T_S))
    streams = gnss_kinematics(gnss=given, params=GnssKinematicsParams())
    assert streams["gnss"]["pos_e"].null_count == streams["gnss"]["acc_u"].null_count == 6
    assert (matrix(streams["gnss"], "vel") == velocities(T_S)).all()
    assert streams["metrics"]["note"][0].as_py().startswith("no positions")


def test_an_empty_stream_passes() -> None:
    assert gnss_kinematics(gnss=fixes(np.zeros(0)), params=GnssKinematicsParams())["gnss"].num_rows == 0


@pytest.mark.parametrize("certain", [True, False])
def test_the_plan_adds_columns_as_certain_as_positions_are(certain: bool) -> None:
    (stage,) = declare_filters()
    schema = GNSS.only("lat", "lon", "height") if certain else GNSS.only(maybe=("lat", "lon", "height"))
    planned = stage.outputs({"gnss": schema}, GnssKinematicsParams())["gnss"]
    assert {planned[name].optional for name in ("pos_e", "vel_n", "acc_u")} == {not certain}
    result = gnss_kinematics(gnss=fixes(T_S), params=GnssKinematicsParams())["gnss"]
    assert conform(result, planned, stream="gnss", step="test").num_columns == 13


def test_the_plan_leaves_a_stream_without_positions_alone_and_a_certain_velocity_certain() -> None:
    (stage,) = declare_filters()
    params: Params = GnssKinematicsParams()
    speed_only = GNSS.only("speed")
    assert stage.outputs({"gnss": speed_only}, params)["gnss"] == speed_only
    with_vel = GNSS.only("vel", maybe=("lat", "lon"))
    assert not stage.outputs({"gnss": with_vel}, params)["gnss"]["vel_e"].optional


def test_the_declaration_has_no_fault() -> None:
    assert [stage.faults() for stage in declare_filters()] == [[]]


RATE_10HZ_S = np.arange(0.0, 10.0, 0.1)


def straight(t_s: Array, speed: float = 15.0) -> Array:
    return np.column_stack((speed * t_s, np.zeros((len(t_s), 2))))


def fixes_at(t_s: Array, pos: Array, **more: Any) -> Any:
    lat, lon, height = enu_to_geodetic(pos, ANCHOR)
    return build(GNSS, **{"time": ns(t_s), "lat": lat, "lon": lon, "height": height, **more})


@pytest.mark.parametrize(("row", "axis", "metres"), [(50, 1, 55_000.0), (50, 2, 99_999.0), (0, 0, -1e6), (99, 0, 40.0)])
def test_a_fix_that_jumps_out_and_back_is_left_out_and_said(row: int, axis: int, metres: float) -> None:
    pos = straight(RATE_10HZ_S)
    pos[row, axis] += metres
    streams = gnss_kinematics(gnss=fixes_at(RATE_10HZ_S, pos), params=GnssKinematicsParams())
    missing = np.isnan(matrix(streams["gnss"], "pos", gaps=True)).any(axis=1)
    assert np.flatnonzero(missing).tolist() == [row]
    # Near by, axes turn by 10 m / R with the first fix that is used: 1e-5 of the speed at most.
    assert np.nanmax(np.abs(matrix(streams["gnss"], "vel", gaps=True) - [15.0, 0.0, 0.0])) < 1e-3
    (note,) = warnings_of(streams["metrics"])
    assert note.startswith(
        "1 of 100 gnss positions can only be reached faster than 400 km/h and are left out, first at"
    )
    assert f"{row / 10:.1f} s after" in note


@pytest.mark.parametrize(("jump", "lost"), [(30, slice(0, 30)), (70, slice(70, 100))])
def test_of_a_record_that_jumps_for_good_the_longer_part_is_kept(jump: int, lost: slice) -> None:
    pos = straight(RATE_10HZ_S)
    pos[jump:, 1] += 500_000.0
    streams = gnss_kinematics(gnss=fixes_at(RATE_10HZ_S, pos), params=GnssKinematicsParams())
    missing = np.isnan(matrix(streams["gnss"], "pos", gaps=True)).any(axis=1)
    assert np.flatnonzero(missing).tolist() == list(range(100))[lost]


def test_a_small_jump_for_good_costs_the_fixes_beside_it_only() -> None:
    pos = straight(RATE_10HZ_S)
    pos[50:, 1] += 30.0
    streams = gnss_kinematics(gnss=fixes_at(RATE_10HZ_S, pos), params=GnssKinematicsParams())
    # Fixes scatter by 15 m. At 400 km/h, 111 m/s, the other 15 m need 0.14 s: the fix 0.1 s after the last before it.
    assert value_of(streams, "positions_impossible") == 1.0


@pytest.mark.parametrize("told", [False, True])
@pytest.mark.parametrize("noise", [1.0, 3.5, 5.0, 12.0])
@pytest.mark.parametrize("rate", [1.0, 20.0, 100.0])
def test_the_scatter_of_the_fixes_of_a_fast_receiver_is_no_speed(rate: float, noise: float, told: bool) -> None:
    t_s = np.arange(0.0, 600.0 / np.sqrt(rate), 1.0 / rate)
    # Five sigmas of a difference in two dimensions that err alike: exp(-25 / 2) of at most 6000 steps is 0.02 of one.
    # Sigma itself is known to 1.17 / sqrt(600) = 5 % or better: five of it are then at least 4.7, and 0.1 of a step.
    # At 12 m the sigma of the fixes asks for 85 m. The speed that the receiver tells allows less than the largest one.
    pos = straight(t_s) + np.random.default_rng(3).normal(size=(len(t_s), 3)) * [noise, noise, 0.0]
    more = {"speed": np.full(len(t_s), 15.0)} if told else {}
    streams = gnss_kinematics(gnss=fixes_at(t_s, pos, **more), params=GnssKinematicsParams())
    assert value_of(streams, "positions_impossible") == 0.0
    assert np.isfinite(matrix(streams["gnss"], "pos")).all()


def test_an_excursion_beyond_the_scatter_of_fixes_is_found_among_noisy_ones() -> None:
    t_s = np.arange(0.0, 60.0, 0.05)
    pos = straight(t_s) + np.random.default_rng(4).normal(size=(len(t_s), 3)) * [5.0, 5.0, 0.0]
    pos[500:520, 1] += 100.0  # scatter of 35 m, 6 m of speed, two fixes of noise
    streams = gnss_kinematics(gnss=fixes_at(t_s, pos), params=GnssKinematicsParams())
    missing = np.isnan(matrix(streams["gnss"], "pos", gaps=True)).any(axis=1)
    assert np.flatnonzero(missing).tolist() == list(range(500, 520))
    # 5 x sqrt(2) x 5 m, the sigma known to 1.17 / sqrt(1200): three of that
    assert value_of(streams, "positions_scatter") == pytest.approx(35.4, rel=0.1)


def test_where_all_positions_are_noise_the_scatter_has_an_end() -> None:
    t_s = np.arange(0.0, 30.0, 0.1)
    pos = np.random.default_rng(5).normal(size=(len(t_s), 3)) * [1000.0, 1000.0, 0.0]
    streams = gnss_kinematics(gnss=fixes_at(t_s, pos), params=GnssKinematicsParams())
    assert value_of(streams, "positions_scatter") == 100.0
    assert value_of(streams, "positions_impossible") > 200.0


def test_a_relative_clock_has_no_date_in_a_warning() -> None:
    pos = straight(RATE_10HZ_S)
    pos[50, 1] += 55_000.0
    (note,) = warnings_of(gnss_kinematics(gnss=fixes_at(RATE_10HZ_S, pos), params=GnssKinematicsParams())["metrics"])
    assert note.endswith("first at 5.0 s after the first row")


def excursion(speed: np.ndarray, shift: float = 60.0) -> Any:
    """100 s at 7 m/s and one fix a second, two of which lie aside."""
    t_s = np.arange(100.0)
    pos = np.column_stack((7.0 * t_s, np.zeros(100), np.zeros(100)))
    pos[40:42, 1] += shift
    return gnss_kinematics(gnss=fixes_at(t_s, pos, speed=speed), params=GnssKinematicsParams())


def test_positions_that_the_receivers_own_speed_refutes_are_left_out() -> None:
    # From fix to fix 7 m, over the jump 60 m: more than 1.5 x 7 m and the 15 m by which fixes scatter.
    streams = excursion(np.full(100, 7.0))
    missing = np.isnan(matrix(streams["gnss"], "pos", gaps=True)).any(axis=1)
    assert np.flatnonzero(missing).tolist() == [40, 41]
    (note,) = warnings_of(streams["metrics"])
    assert note.startswith("2 of 100 gnss positions contradict the speed that gnss itself tells and are left out")
    assert warnings_of(excursion(np.full(100, 7.0), shift=15.0)["metrics"]) == []


def test_a_speed_that_is_not_known_refutes_no_position() -> None:
    for speed in (np.zeros(100), np.full(100, np.nan)):
        assert np.isfinite(matrix(excursion(speed)["gnss"], "pos")).all()


def test_a_speed_that_most_positions_refute_is_not_heard() -> None:
    t_s = np.arange(100.0)
    pos = np.column_stack((30.0 * t_s, np.zeros(100), np.zeros(100)))
    gnss = fixes_at(t_s, pos, speed=np.full(100, 30.0 / 3.6))  # taken for km/h
    assert np.isfinite(matrix(gnss_kinematics(gnss=gnss, params=GnssKinematicsParams())["gnss"], "pos")).all()


def test_a_position_repeated_beside_a_new_speed_is_no_fix() -> None:
    t_s = np.sort(np.concatenate((RATE_10HZ_S, RATE_10HZ_S + 0.006)))
    pos = np.repeat(straight(RATE_10HZ_S), 2, axis=0)
    streams = gnss_kinematics(gnss=fixes_at(t_s, pos, speed=np.full(200, 15.0)), params=GnssKinematicsParams())
    vel = matrix(streams["gnss"], "vel", gaps=True)
    assert np.isfinite(vel).all(axis=1).tolist() == [True, False] * 100
    assert vel[::2] == pytest.approx(np.tile([15.0, 0.0, 0.0], (100, 1)), abs=1e-3)  # curvature of the Earth over 150 m
    assert value_of(streams, "positions_repeated") == 100.0
    assert warnings_of(streams["metrics"]) == []


def test_a_standing_receiver_that_repeats_its_position_stands() -> None:
    pos = straight(RATE_10HZ_S)
    pos[30:60] = pos[30]
    streams = gnss_kinematics(gnss=fixes_at(RATE_10HZ_S, pos), params=GnssKinematicsParams(max_speed=1000.0))
    assert value_of(streams, "positions_repeated") == 0.0
    # Weights of 1 / 0.1 s on equal positions of up to 150 m cancel to rounding.
    assert np.abs(matrix(streams["gnss"], "vel")[31:59]).max() < 1e-11


def test_positions_that_move_otherwise_than_the_reported_speed_are_warned_of() -> None:
    given = fixes_at(RATE_10HZ_S, straight(RATE_10HZ_S), speed=np.full(100, 4.0))
    (note,) = warnings_of(gnss_kinematics(gnss=given, params=GnssKinematicsParams())["metrics"])
    assert note.startswith(
        "the speed of gnss positions and the reported gnss speed disagree: they differ by more than 11"
    )


def value_of(streams: Any, name: str) -> float:
    return float({row["name"]: row["value"] for row in streams["metrics"].to_pylist()}[name])
