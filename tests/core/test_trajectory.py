"""Questions to a trajectory: poses between rows, times in every form, movements, lengths."""

from __future__ import annotations

from dataclasses import asdict, fields
from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pyarrow as pa
import pytest
from pyquaternion import Quaternion

from recon.errors import DataError
from recon.knots import POSITION, SIZE, VELOCITY, Knots
from recon.moments import HINT
from recon.movement import Movement, Movements
from recon.numerics.geodesy import SPHERE, WGS84, Anchor, enu_to_geodetic, geodesic, geodetic_to_enu
from recon.numerics.rotation import Floats, from_euler, to_euler
from recon.schema import FRAMES, KNOTS, TRAJECTORY
from recon.tables import build, replace, with_meta
from recon.trajectory import Pose, Trajectory

EPS = np.finfo(float).eps
START = "2024-05-01T08:00:00Z"
START_NS = 1714550400_000000000
HERE = Anchor(44.5, 11.3, 60.0)
ROUNDING = 1e-8
"""m; positions on the Earth, 6.4e6 m from its centre, resolve 1e-9 m."""


def trajectory(
    pos: Floats, vel: Floats, yaw: Floats, *, anchor: Anchor | None = None, earth: str = "wgs84"
) -> pa.Table:
    """One row per second; pos, vel (n, 3); yaw (n,) rad."""
    zero = np.zeros(len(yaw))
    time = START_NS + np.arange(len(yaw)) * 1_000_000_000
    table = build(TRAJECTORY, time=time, pos=pos, vel=vel, q=from_euler(yaw, zero, zero))
    if anchor is None:
        return table
    lat, lon, height = enu_to_geodetic(pos, anchor, {"wgs84": WGS84, "sphere": SPHERE}[earth])
    return with_meta(replace(table, lat=lat, lon=lon, height=height), anchor=asdict(anchor), earth=earth)


def line(anchor: Anchor | None = None, *, rows: int = 11, earth: str = "wgs84") -> pa.Table:
    """Ten seconds at (3, 4, 0) m/s, the yaw rising by 0.1 rad/s from 3.0: past pi."""
    t_s = np.arange(float(rows))
    vel = np.tile([3.0, 4.0, 0.0], (rows, 1))
    return trajectory(t_s[:, None] * vel, vel, 3.0 + 0.1 * t_s, anchor=anchor, earth=earth)


@pytest.mark.parametrize(
    "moment",
    [
        2.5,
        np.float32(2.5),
        "2024-05-01T08:00:02.5Z",
        "2024-05-01T08:00:02.500",
        "2024-05-01T10:00:02.5+02:00",
        datetime(2024, 5, 1, 8, 0, 2, 500_000),
        datetime(2024, 5, 1, 8, 0, 2, 500_000, tzinfo=UTC),
        datetime(2024, 5, 1, 3, 0, 2, 500_000, tzinfo=timezone(timedelta(hours=-5))),
        np.datetime64("2024-05-01T08:00:02.500"),
        np.datetime64("2024-05-01T08:00:02.500000000"),
    ],
)
def test_a_time_may_be_written_in_any_form(moment: object) -> None:
    pose = Trajectory(line()).at(moment)  # type: ignore[call-overload]
    assert isinstance(pose, Pose)
    assert pose.time == np.datetime64("2024-05-01T08:00:02.500000000")
    np.testing.assert_allclose(pose.position, [7.5, 10.0, 0.0], rtol=4.0 * EPS)
    np.testing.assert_allclose(pose.velocity, [3.0, 4.0, 0.0], rtol=4.0 * EPS)


def test_attitude_goes_the_short_way_round_and_is_a_quaternion() -> None:
    pose = Trajectory(line()).at(1.5)
    assert isinstance(pose.attitude, Quaternion)
    # Between the yaws 3.1 and 3.2, on both sides of pi.
    forward = pose.attitude.rotate([1.0, 0.0, 0.0])
    np.testing.assert_allclose(forward, [np.cos(3.15), np.sin(3.15), 0.0], rtol=0.0, atol=16.0 * EPS)


def test_many_times_give_arrays_in_their_order() -> None:
    poses = Trajectory(line()).at([10.0, 0.0, 2.5])
    assert len(poses) == 3
    assert poses.attitude.shape == (3, 4)
    np.testing.assert_allclose(poses.position[:, 0], [30.0, 0.0, 7.5], rtol=4.0 * EPS)
    yaw = to_euler(poses.attitude)[0]
    np.testing.assert_allclose(np.cos(yaw - [4.0, 3.0, 3.25]), 1.0, rtol=0.0, atol=16.0 * EPS)
    assert poses.time.dtype == np.dtype("datetime64[ns]")


def test_an_array_of_datetime64_is_taken_to_the_nanosecond() -> None:
    times = np.datetime64("2024-05-01T08:00:00", "ns") + np.array([0, 1, 9_999_999_999])
    poses = Trajectory(line()).at(times)
    np.testing.assert_array_equal(poses.time, times)


def test_a_text_is_taken_to_the_nanosecond() -> None:
    assert Trajectory(line()).at("2024-05-01T08:00:02.123456789Z").time == np.datetime64(
        "2024-05-01T08:00:02.123456789"
    )


def test_no_times_give_no_poses() -> None:
    assert len(Trajectory(line()).at([])) == 0


@pytest.mark.parametrize("moment", [-0.001, 10.001, "2024-05-01T07:59:59Z", datetime(2025, 1, 1, tzinfo=UTC)])
def test_a_time_outside_is_refused_with_the_span(moment: object) -> None:
    with pytest.raises(DataError, match=r"from 2024-05-01T08:00:00.* to 2024-05-01T08:00:10"):
        Trajectory(line()).at(moment)  # type: ignore[call-overload]
    with pytest.raises(DataError, match="outside"):
        Trajectory(line()).at([1.0, moment])


@pytest.mark.parametrize(
    "moment",
    [
        *(np.nan, np.inf, -1e300, "x", "", None, np.datetime64("NaT", "ns"), {}, b"x"),
        *(timedelta(seconds=1), np.timedelta64(1, "s"), np.timedelta64(5, "ns")),
    ],
)
def test_what_is_no_time_is_refused_with_what_is_one(moment: object) -> None:
    for asked in (moment, [1.0, moment]):
        with pytest.raises(DataError, match="is no time") as caught:
            Trajectory(line()).at(asked)  # type: ignore[call-overload]
        assert caught.value.hint == HINT


@pytest.mark.parametrize("seconds", [1e12, -(10**30)])
def test_a_time_that_no_int64_holds_is_outside(seconds: float) -> None:
    with pytest.raises(DataError, match="outside"):
        Trajectory(line()).at(seconds)


@pytest.mark.parametrize("moment", ["2024-05-01T08:00:00Z", 0.0])
def test_an_empty_trajectory_has_no_time_inside(moment: str | float) -> None:
    empty = Trajectory(line().slice(0, 0))
    with pytest.raises(DataError, match="has no rows"):
        empty.at(moment)
    assert (len(empty), empty.duration, empty.path_length) == (0, 0.0, 0.0)


def test_place_on_the_earth_is_nan_without_an_anchor_and_the_place_with_one() -> None:
    unplaced = Trajectory(line()).at(5.0)
    assert np.isnan([unplaced.lat, unplaced.lon, unplaced.height]).all()
    placed = Trajectory(line(HERE)).at(5.5)
    pos = geodetic_to_enu([placed.lat], [placed.lon], [placed.height], HERE)
    # Between rows 5 m apart the chord leaves the arc of the Earth by 5^2 / (8 R) = 5e-7 m.
    np.testing.assert_allclose(pos[0], placed.position, rtol=0.0, atol=5e-7 + ROUNDING)


def test_longitude_goes_the_short_way_over_the_date_line() -> None:
    pose = Trajectory(line(Anchor(0.0, 180.0 - 1e-4, 0.0))).at(3.5)
    # 10.5 m of the equator, 111.3 km a degree, are 0.94e-4 deg: the next row lies on the other side.
    assert pose.lon == pytest.approx(180.0 - 1e-4 + np.degrees(10.5 / 6378137.0), abs=1e-11)


def test_speed_path_length_and_duration() -> None:
    found = Trajectory(line())
    np.testing.assert_allclose(found.speed, 5.0, rtol=2.0 * EPS)
    assert found.path_length == pytest.approx(50.0, rel=10.0 * EPS)
    assert (found.duration, len(found)) == (10.0, 11)
    assert "50.0 m" in found._repr_html_()
    assert repr(found) == "Trajectory(rows 11, duration 10.0 s, path 50.0 m, top speed 5.00 m/s)"


def knots(shared: Floats) -> pa.Table:
    """Knots at 0, 5 and 10 s; `shared` (3, 9, g) is all that errs."""
    own = np.zeros((3, SIZE, SIZE))
    time = START_NS + np.arange(3) * 5_000_000_000
    return build(KNOTS, time=time, **Knots(time, own, own[1:], shared, np.zeros(3), np.zeros(3)).columns())


def test_a_movement_is_the_difference_of_two_poses() -> None:
    found = Trajectory(line()).between(2.5, "2024-05-01T08:00:06.5Z")
    assert isinstance(found, Movement)
    assert (found.start, found.stop) == (
        np.datetime64("2024-05-01T08:00:02.500000000"),
        np.datetime64("2024-05-01T08:00:06.500000000"),
    )
    assert (found.duration, found.distance, found.delta_v) == pytest.approx((4.0, 20.0, 0.0), rel=8.0 * EPS)
    np.testing.assert_allclose(found.displacement, [12.0, 16.0, 0.0], rtol=8.0 * EPS)
    # The yaw rises from 3.25, past pi, to 3.65; heading is clockwise.
    assert found.heading_change == pytest.approx(-0.4, rel=64.0 * EPS)


def test_a_movement_backwards_in_time_is_the_opposite() -> None:
    there, back = Trajectory(line()).between(2.0, 6.0), Trajectory(line()).between(6.0, 2.0)
    assert back.duration == -there.duration
    np.testing.assert_array_equal(back.displacement, -there.displacement)
    assert (back.distance, back.heading_change) == (there.distance, -there.heading_change)


def test_a_change_of_speed_has_a_length() -> None:
    t_s = np.arange(11.0)
    vel = t_s[:, None] * [0.3, 0.4, 0.0]
    found = Trajectory(trajectory(0.5 * t_s[:, None] * vel, vel, np.zeros(11))).between(1.0, 5.0)
    np.testing.assert_allclose(found.velocity_change, [1.2, 1.6, 0.0], rtol=16.0 * EPS)
    assert found.delta_v == pytest.approx(2.0, rel=16.0 * EPS)


def test_without_knots_the_sigmas_of_a_movement_are_not_known() -> None:
    found = Trajectory(line()).between(2.0, 6.0)
    assert np.isnan([found.distance_sigma, found.delta_v_sigma, found.heading_sigma]).all()
    assert np.isnan([found.displacement_covariance, found.velocity_covariance]).all()


def test_what_two_times_err_in_common_is_no_error_of_the_movement() -> None:
    shared = np.zeros((3, SIZE, 3))
    shared[:, POSITION] = 5.0 * np.eye(3)
    found = Trajectory(line(), knots(shared)).between(1.0, 9.0)
    # Differences of variances of 25 m^2, rounded.
    limit = 5.0 * np.sqrt(8.0 * EPS)
    assert (found.distance_sigma, found.delta_v_sigma, found.heading_sigma) == pytest.approx((0.0, 0.0, 0.0), abs=limit)


def test_sigmas_of_a_movement_are_those_along_it() -> None:
    shared = np.zeros((3, SIZE, 3))
    shared[:, POSITION.start, 0] = [0.0, 1.0, 2.0]  # east, 0.2 m/s
    shared[:, POSITION.start + 1, 1] = [0.0, 0.5, 1.0]  # north, 0.1 m/s
    shared[:, VELOCITY.start, 0], shared[:, VELOCITY.start + 1, 1] = 0.2, 0.1
    shared[:, 8, 2] = [0.0, 0.01, 0.02]
    found = Trajectory(line(), knots(shared)).between(2.5, 6.5)
    # Four seconds; the numbers of a stream are of single precision.
    single = 8.0 * float(np.finfo(np.float32).eps)
    np.testing.assert_allclose(found.displacement_covariance, np.diag([0.64, 0.16, 0.0]), rtol=single, atol=1e-7)
    assert found.distance_sigma == pytest.approx(np.hypot(0.6 * 0.8, 0.8 * 0.4), rel=single)
    assert found.heading_sigma == pytest.approx(0.008, rel=single)
    # The velocity errs by the same all the time.
    np.testing.assert_allclose(found.velocity_covariance, 0.0, rtol=0.0, atol=1e-12)


def test_knots_of_another_trajectory_tell_nothing() -> None:
    other = replace(knots(np.zeros((3, SIZE, 3))), pos=np.full((3, 3), 1.0))
    assert np.isnan(Trajectory(line(), other).between(2.0, 6.0).distance_sigma)


def test_a_movement_of_no_length_has_the_sigma_of_all_directions() -> None:
    shared = np.zeros((3, SIZE, 3))
    shared[:, POSITION.start, 0], shared[:, POSITION.start + 2, 1] = [0.0, 3.0, 6.0], [0.0, 4.0, 8.0]
    resting = trajectory(np.zeros((11, 3)), np.zeros((11, 3)), np.zeros(11))
    found = Trajectory(resting, knots(shared)).between(0.0, 10.0)
    assert (found.distance, found.distance_sigma) == pytest.approx((0.0, 10.0))


def test_a_movement_outside_is_refused() -> None:
    with pytest.raises(DataError, match="outside"):
        Trajectory(line()).between(1.0, 11.0)


def test_a_distance_on_the_ground_is_the_geodesic_and_bearings_are_from_true_north() -> None:
    found = Trajectory(line(HERE)).between(1.0, 9.0)
    lat, lon, _ = enu_to_geodetic(np.array([[3.0, 4.0, 0.0], [27.0, 36.0, 0.0]]), HERE)
    # The points are 60 m above the ellipsoid, where a metre is longer by 60 / 6.4e6 than below, and 40 m of a chord are
    # shorter than the arc by 7e-11 m. The line between two rows of `lat` and `lon` is passed through at its ends.
    assert found.ground_distance == pytest.approx(40.0 / (1.0 + 60.0 / 6.38e6), rel=1e-6)
    assert found.ground_distance == pytest.approx(float(geodesic(lat[0], lon[0], lat[1], lon[1])[0]), abs=ROUNDING)
    # Meridians converge by sin(lat) dlon: 24 m of 4.6e6 m around the axis. The anchor's east and north are exact there.
    assert found.initial_bearing == pytest.approx(np.arctan2(3.0, 4.0), abs=1e-5)
    assert found.final_bearing - found.initial_bearing == pytest.approx(
        np.sin(np.radians(44.5)) * np.radians(lon[1] - lon[0]), rel=1e-3
    )
    back = Trajectory(line(HERE)).between(9.0, 1.0)
    assert back.initial_bearing == pytest.approx(found.final_bearing + np.pi, abs=1e-9)
    assert (back.height_difference, back.path_length) == (-found.height_difference, found.path_length)


def test_without_a_place_the_distance_is_level_and_there_are_no_bearings() -> None:
    found = Trajectory(line()).between(1.0, 9.0)
    assert (found.ground_distance, found.height_difference) == pytest.approx((40.0, 0.0))
    assert np.isnan([found.initial_bearing, found.final_bearing, found.bearing_sigma]).all()


def test_the_path_is_followed_and_not_cut_short() -> None:
    t_s = np.arange(11.0)
    pos = np.column_stack([np.abs(t_s - 5.0), np.zeros(11), np.zeros(11)])
    found = Trajectory(trajectory(pos, np.zeros((11, 3)), np.zeros(11))).between(2.5, 7.5)
    assert (found.path_length, found.distance) == pytest.approx((5.0, 0.0))


def test_many_movements_are_those_of_each_pair() -> None:
    shared = np.random.default_rng(5).normal(size=(3, SIZE, 4))
    found = Trajectory(line(HERE), knots(shared))
    starts, stops = [0.0, 2.5, 9.0, 4.0], [10.0, 2.6, 1.0, 4.0]
    many = found.between(starts, stops)
    assert isinstance(many, Movements)
    assert len(many) == 4
    for row, (start, stop) in enumerate(zip(starts, stops, strict=True)):
        alone = found.between(start, stop)
        for field in fields(Movement):
            np.testing.assert_array_equal(getattr(many, field.name)[row], getattr(alone, field.name), field.name)
    assert isinstance(found.between(0.0, [1.0]), Movements)
    np.testing.assert_allclose(found.between(0.0, np.arange(11.0)).path_length, 5.0 * np.arange(11.0), rtol=8.0 * EPS)


def test_the_sigma_of_a_bearing_is_that_across_the_way() -> None:
    shared = np.zeros((3, SIZE, 1))
    # Across the direction (3, 4) / 5: 1 m after ten seconds, in which it went 50 m.
    shared[:, POSITION.start, 0], shared[:, POSITION.start + 1, 0] = [0.0, -0.4, -0.8], [0.0, 0.3, 0.6]
    found = Trajectory(line(HERE), knots(shared)).between(0.0, 10.0)
    single = 8.0 * float(np.finfo(np.float32).eps)
    assert found.bearing_sigma == pytest.approx(1.0 / 50.0, rel=2e-5)  # on the ellipsoid the way is 1e-5 shorter
    assert (found.ground_distance_sigma, found.height_sigma) == pytest.approx((0.0, 0.0), abs=np.sqrt(single))


def test_a_bearing_of_which_nothing_is_known_has_the_sigma_of_all_directions() -> None:
    shared = np.zeros((3, SIZE, 2))
    shared[2, POSITION.start : POSITION.start + 2] = 1e6 * np.eye(2)
    found = Trajectory(line(HERE), knots(shared)).between(0.0, 10.0)
    assert found.bearing_sigma == pytest.approx(np.pi / np.sqrt(3.0))


def test_frames_and_durations_name_times() -> None:
    time = START_NS + np.array([500_000_000, 2_500_000_000])
    frames = build(FRAMES, time=time, index=np.array([7, 12]), file=pa.array(["a.jpg", "b.jpg"]))
    found = Trajectory(line(), frames=frames)
    assert found.at("#12").position == pytest.approx([7.5, 10.0, 0.0])
    assert found.at("2.5s").time == found.at("0.05 min").time - np.timedelta64(500, "ms") == found.at("#12").time
    assert found.between("#7", "#12").duration == 2.0
    with pytest.raises(DataError, match="is no time"):
        found.at("#" + 5000 * "9")  # more digits than Python makes a number of
    with pytest.raises(DataError, match="there is no frame #9; there are #7 to #12"):
        found.at("#9")
    with pytest.raises(DataError, match="no stream 'frames'"):
        Trajectory(line()).at("#12")
    for wrong in ("#", "#-1", "#x", "12 m", "s"):
        with pytest.raises(DataError, match="is no time"):
            found.at(wrong)
