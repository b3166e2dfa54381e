"""Questions to a trajectory: poses between rows, times in every form, lengths, deviation from a reference."""

from __future__ import annotations

from dataclasses import asdict
from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pyarrow as pa
import pytest
from pyquaternion import Quaternion

from recon.errors import DataError
from recon.knots import POSITION, SIZE, VELOCITY, Knots
from recon.numerics.geodesy import SPHERE, WGS84, Anchor, enu_to_geodetic, geodetic_to_enu
from recon.numerics.rotation import Floats, from_euler, to_euler
from recon.schema import GNSS, KNOTS, TRAJECTORY
from recon.tables import build, replace, time_ns, times, with_meta
from recon.trajectory import Deviation, Movement, Pose, Trajectory, deviation, summarize

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


def test_no_times_give_no_poses() -> None:
    assert len(Trajectory(line()).at([])) == 0


@pytest.mark.parametrize("moment", [-0.001, 10.001, "2024-05-01T07:59:59Z", datetime(2025, 1, 1, tzinfo=UTC)])
def test_a_time_outside_is_refused_with_the_span(moment: object) -> None:
    with pytest.raises(DataError, match=r"from 2024-05-01 08:00:00.* to 2024-05-01 08:00:10"):
        Trajectory(line()).at(moment)  # type: ignore[call-overload]
    with pytest.raises(DataError, match="outside"):
        Trajectory(line()).at([1.0, moment])


@pytest.mark.parametrize(
    "moment", [np.nan, np.inf, -1e300, "x", "", None, timedelta(seconds=1), np.datetime64("NaT", "ns"), {}, b"x"]
)
def test_what_is_no_time_is_refused_with_what_is_one(moment: object) -> None:
    for asked in (moment, [1.0, moment]):
        with pytest.raises(DataError, match="is no time") as caught:
            Trajectory(line()).at(asked)  # type: ignore[call-overload]
        assert caught.value.hint == "give seconds after the first row, ISO text, a datetime or a numpy.datetime64"


@pytest.mark.parametrize("seconds", [1e12, -(10**30)])
def test_a_time_that_no_int64_holds_is_outside(seconds: float) -> None:
    with pytest.raises(DataError, match="outside"):
        Trajectory(line()).at(seconds)


@pytest.mark.parametrize("moment", ["2024-05-01T08:00:00Z", 0.0])
def test_an_empty_trajectory_has_no_time_inside(moment: str | float) -> None:
    empty = Trajectory(line().slice(0, 0))
    with pytest.raises(DataError, match="over no row"):
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


def test_deviation_is_zero_from_itself() -> None:
    assert deviation(line(), line()) == Deviation(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_deviation_tells_each_kind_of_error_apart() -> None:
    reference = line()
    t_s = np.arange(11.0)
    vel = np.tile([3.3, 4.4, 0.0], (11, 1))
    moved = t_s[:, None] * vel + np.array([0.0, 0.0, 2.0])
    found = deviation(trajectory(moved, vel, 3.0 + 0.1 * t_s + 0.02), reference)
    # Half a metre per second apart: the mean of t^2 over 0, ..., 10 is 35.
    assert found.horizontal == pytest.approx(0.5 * np.sqrt(35.0), rel=64.0 * EPS)
    assert found.final == pytest.approx(5.0, rel=64.0 * EPS)
    assert found.vertical == pytest.approx(2.0)
    assert found.velocity == pytest.approx(0.5, rel=64.0 * EPS)
    assert found.heading == pytest.approx(np.degrees(0.02), rel=64.0 * EPS / 0.02)
    assert found.tilt == pytest.approx(0.0, abs=np.degrees(8.0 * EPS))


def test_tilt_is_the_angle_between_the_verticals_whatever_the_heading() -> None:
    reference = line()
    yaw, zero = 3.0 + 0.1 * np.arange(11.0), np.zeros(11)
    tilted = replace(reference, q=from_euler(yaw + 2.5, zero + 0.03, zero))
    found = deviation(tilted, reference)
    assert found.tilt == pytest.approx(np.degrees(0.03), rel=64.0 * EPS / 0.03)
    assert found.heading == pytest.approx(np.degrees(2.5), rel=64.0 * EPS)


def test_heading_differences_are_wrapped() -> None:
    reference = line()
    around = replace(reference, q=from_euler(3.0 + 0.1 * np.arange(11.0) + 6.2, np.zeros(11), np.zeros(11)))
    assert deviation(around, reference).heading == pytest.approx(np.degrees(2.0 * np.pi - 6.2), rel=1e-12)


def test_deviation_looks_between_the_rows_of_the_reference() -> None:
    half_second = line().take(pa.array([2, 3, 4]))
    shifted = replace(half_second, time=times(time_ns(half_second) + 500_000_000))
    assert deviation(shifted, line()).horizontal == pytest.approx(2.5, rel=64.0 * EPS)


def test_only_the_common_time_counts() -> None:
    late = line(rows=21).slice(8)
    assert deviation(late, line()) == Deviation(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_without_common_time_there_is_no_deviation() -> None:
    for reference in (line(rows=21).slice(15), line().slice(0, 0)):
        with pytest.raises(DataError, match="no time in common"):
            deviation(line(), reference)


@pytest.mark.parametrize("earth", ["wgs84", "sphere"])
def test_a_reference_with_another_anchor_is_seen_from_that_of_the_trajectory(earth: str) -> None:
    lat, lon, height = enu_to_geodetic(np.array([[3.0, -2.0, 1.5]]), HERE, {"wgs84": WGS84, "sphere": SPHERE}[earth])
    other = Anchor(float(lat[0]), float(lon[0]), float(height[0]))
    reference = line(HERE, earth=earth)
    # The same path, as someone sees it whose origin lies (3, -2, 1.5) m away.
    t_s = np.arange(11.0)
    vel = np.tile([3.0, 4.0, 0.0], (11, 1))
    seen = trajectory(t_s[:, None] * vel - [3.0, -2.0, 1.5], vel, 3.0 + 0.1 * t_s, anchor=other, earth=earth)
    found = deviation(seen, reference)
    # The axes of the two anchors differ by 3.6 m / 6.4e6 m, over 50 m.
    atol = ROUNDING + 50.0 * 3.7 / 6.3e6
    assert (found.horizontal, found.vertical) == pytest.approx((0.0, 0.0), abs=atol)


@pytest.mark.parametrize("anchors", [(None, HERE), (HERE, None), (None, None)])
def test_positions_are_compared_as_they_are_where_a_place_is_not_known(anchors: tuple[Anchor | None, ...]) -> None:
    given, truth = (line(anchor) for anchor in anchors)
    assert deviation(given, truth) == Deviation(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_a_summary_comes_from_the_trajectory_else_from_gnss() -> None:
    found = summarize(line(), None)
    assert found == pytest.approx({"distance": 50.0, "duration": 10.0, "top_speed": 5.0}, rel=10.0 * EPS)
    gnss = build(GNSS, time=START_NS + np.arange(3), speed=np.array([1.0, np.nan, 7.0]))
    assert summarize(None, gnss) == {"top_speed": 7.0}
    assert summarize(line().slice(0, 0), None) == summarize(None, None) == {}
