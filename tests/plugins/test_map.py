"""fuser.map keeps its contract: streams, metrics, events, residuals, errors that say what is missing, doubts."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from map_drives import drive, errors, fused, numbers, scaled, without

from recon import KNOTS, RESIDUALS, TRAJECTORY, Streams, matrix, meta, seconds, time_ns, vector
from recon.errors import DataError
from recon.rows import spans, warnings_of
from recon.tables import conform, select_rows, times

OUTAGE = (150.0, 190.0)


@pytest.fixture(scope="module")
def streams() -> Streams:
    return drive("mixed", seed=31, duration=300.0, outages=(OUTAGE,))


@pytest.fixture(scope="module")
def found(streams: Streams) -> Streams:
    return fused(streams)


def test_the_streams_have_the_columns_that_are_declared(found):
    for name, schema in (("trajectory", TRAJECTORY), ("knots", KNOTS), ("residuals", RESIDUALS)):
        conform(found[name], schema, stream=name, step="fuser.map")


def test_the_trajectory_has_the_rows_of_the_imu(streams, found):
    assert (time_ns(found["trajectory"]) == time_ns(streams["imu"])).all()


def test_fewer_rows_may_be_asked_for_and_are_the_same(streams, found):
    thin = fused(streams, output_rate=10.0)["trajectory"]
    assert thin.num_rows == 3000
    at = np.searchsorted(time_ns(found["trajectory"]), time_ns(thin))
    np.testing.assert_allclose(matrix(thin, "pos"), matrix(found["trajectory"], "pos")[at], rtol=0.0, atol=1e-9)


def test_position_and_place_are_the_same_point(found):
    trajectory = found["trajectory"]
    anchor = meta(trajectory)["anchor"]
    # Near the anchor a degree of latitude is 111.1 km; the drive is some km long, the formula good to a thousandth.
    north = (vector(trajectory, "lat") - anchor["lat"]) * 111.1e3
    assert np.abs(north - matrix(trajectory, "pos")[:, 1]).max() < 0.003 * np.abs(north).max() + 0.1


def test_specific_force_and_gravity_make_the_acceleration_of_the_truth(streams, found):
    truth = matrix(streams["reference"], "accel")
    # Vibration and noise are in the log, so only the mean is compared: it is as good as the level, 0.035 deg of 9.8.
    assert np.abs((matrix(found["trajectory"], "accel") - truth).mean(axis=0)).max() < 0.01


def test_standstills_and_the_outage_are_events(streams, found):
    start = time_ns(streams["imu"])[0]
    seen = {
        kind: [((first - start) * 1e-9, (last - start) * 1e-9) for first, last in spans(found["events"], kind)]
        for kind in ("standstill", "outage")
    }
    # The fixes of each second end before the outage and begin again with it.
    (outage,) = seen["outage"]
    assert outage == pytest.approx((OUTAGE[0] - 1.0, OUTAGE[1]), abs=0.01)
    truth = streams["reference"]
    t_s = (time_ns(truth) - start) * 1e-9
    speed = np.sqrt((matrix(truth, "vel") ** 2).sum(axis=1))
    for first, last in seen["standstill"]:
        # The limit above which no fix belongs to a standstill, see smoothing.stops.
        assert speed[(t_s > first) & (t_s < last)].max() < 0.6
    # It stands for 30 s to begin with; the first and the last second of a stop may be missed.
    assert seen["standstill"][0] == pytest.approx((0.0, 30.0), abs=2.0)


def test_every_fix_has_its_residuals_in_sigmas(streams, found):
    residuals = found["residuals"]
    # But for those at the very ends of the record, which lie in no interval between knots.
    assert 6 * (streams["gnss"].num_rows - 2) <= residuals.num_rows <= 6 * streams["gnss"].num_rows
    taken = vector(residuals, "weight") > 0.5
    size = np.sqrt(np.mean((vector(residuals, "value") / vector(residuals, "sigma"))[taken] ** 2))
    # 1500 residuals that are partly one error: within a quarter of one.
    assert 0.75 < size < 1.25


def test_residuals_of_a_short_drive_are_as_large_as_their_sigmas(streams):
    def first_two_minutes(s):
        end = time_ns(s["imu"])[0] + 120 * 10**9
        return {name: select_rows(s[name], time_ns(s[name]) < end) for name in ("imu", "gnss")}

    residuals = fused(streams, first_two_minutes)["residuals"]
    names = np.array(residuals["component"].to_pylist())
    z = vector(residuals, "value") / vector(residuals, "sigma")
    for name in ("pos_e", "pos_n", "pos_u"):
        # Two minutes hardly tell lever and delay. The limits of 99.9 % of 119 values are 0.62 and 1.48 (chi-square),
        # above that of what a drive takes of its own fixes in small ways that the sigma leaves out.
        square = np.mean(z[(names == name) & (vector(residuals, "weight") > 0.5)] ** 2)
        assert square < 1.48


def test_rows_of_latitude_and_longitude_zero_are_no_positions(streams):
    def as_before_the_first_fix(s):
        return scaled(("lat", "lon"), 0.0)(s)["gnss"].slice(0, 10)

    def edit(s):
        return {**s, "gnss": pa.concat_tables([as_before_the_first_fix(s), s["gnss"].slice(10)])}

    def hidden(s):
        return blank("gnss", "lat", slice(0, 10))(s)

    ours, expected = (matrix(fused(streams, change)["trajectory"], "pos") for change in (edit, hidden))
    np.testing.assert_array_equal(ours, expected)


def test_bursts_are_put_aside_and_good_fixes_are_not(streams, found):
    t_ns = time_ns(found["residuals"])
    bad = np.zeros(len(t_ns), dtype=bool)
    for first, last in spans(streams["events"], "multipath"):
        bad |= (t_ns >= first) & (t_ns <= last)
    assert bad.any()
    names = np.array(found["residuals"]["component"].to_pylist())
    place = np.char.startswith(names.astype(str), "pos")
    accepted = np.array(found["residuals"]["accepted"].to_pylist())
    assert accepted[place & ~bad].mean() > 0.98
    assert accepted[place & bad].mean() < 0.5


def test_metrics_tell_what_was_estimated_near_the_truth(streams, found):
    ours, true = numbers(found), numbers(streams)
    sigma = {row["name"]: row["sigma"] for row in found["metrics"].to_pylist()}
    for name in ("mount_yaw", "mount_pitch", "lever_arm_x", "lever_arm_y", "accel_bias_z", "gyro_bias_x"):
        # Four sigmas of any one value; biases wander by what the class says, 0.01 at most here.
        assert abs(ours[name] - true[f"true_{name}"]) < 4.0 * sigma[name] + 0.02 * name.startswith(("accel", "gyro")), (
            name
        )


def test_twice_the_same_is_the_same_and_arguments_are_left_alone(streams, found):
    before = {name: streams[name] for name in ("imu", "gnss")}
    again = fused(streams)
    assert again["trajectory"].equals(found["trajectory"])
    assert all(streams[name].equals(table) for name, table in before.items())


@pytest.mark.parametrize("sensors", ["study_one", "study_two", "consumer_mems"])
def test_an_ordinary_drive_raises_no_doubt(sensors):
    assert warnings_of(fused(drive("mixed", sensors, seed=33, duration=420.0))["metrics"]) == []


def rows(stream, keep):
    return lambda s: {**s, stream: select_rows(s[stream], np.arange(s[stream].num_rows)[keep])}


def moved(seconds):
    def edit(s):
        gnss = s["gnss"]
        at = gnss.column_names.index("time")
        later = times(time_ns(gnss) + int(seconds * 1e9))
        return {**s, "gnss": gnss.set_column(at, gnss.schema.field(at), later)}

    return edit


def blank(stream, column, some):
    def edit(s):
        table = s[stream]
        at = table.column_names.index(column)
        values = np.array(vector(table, column, gaps=True))
        values[some] = np.nan
        return {**s, stream: table.set_column(at, table.schema.field(at), pa.array(values))}

    return edit


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        (rows("gnss", slice(0, 0)), "not enough GNSS"),
        (rows("gnss", slice(0, 1)), "not enough GNSS"),
        (rows("imu", slice(0, 0)), "too short"),
        (rows("imu", slice(0, 2)), "too short"),
        (moved(1e5), "during the imu's record"),
        (blank("imu", "gyro_z", slice(None)), "0 of 30000 rows"),
        (scaled(("accel_x", "accel_y", "accel_z"), 1.0 / 9.81, "imu"), "is its unit g"),
        (scaled(("lat",), 3.0), "latitudes beyond 90 deg"),
    ],
)  # fmt: skip
def test_what_is_missing_is_said(streams, edit, says):
    with pytest.raises(DataError, match=says):
        fused(streams, edit)


@pytest.mark.parametrize("hide", [(), ("vel_e", "vel_n", "vel_u", "speed", "course")])
def test_a_vehicle_that_never_moves_has_no_heading(hide):
    standing = drive("rest", seed=3, duration=200.0)
    with pytest.raises(DataError, match="no motion to find the heading"):
        fused(standing, without(*hide))


def test_gnss_with_holes_is_used_where_it_is_there(streams):
    def edit(s):
        return blank("gnss", "height", slice(10, 60))(blank("gnss", "speed", slice(5, 90))(blank(
            "gnss", "lat", slice(20, 40))(s)))  # fmt: skip

    assert errors(streams, fused(streams, edit)).horizontal() < 1.6 * 2.1


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        (scaled(("speed", "vel_e", "vel_n", "vel_u"), 3.6), "km/h"),
        (scaled(("lat", "lon"), 0.0), "no GNSS positions"),
        (moved(20.0), "do not trust"),
    ],
)  # fmt: skip
def test_what_is_not_to_be_trusted_says_so(streams, edit, says):
    assert any(says in note for note in warnings_of(fused(streams, edit)["metrics"]))


def test_latitude_and_longitude_in_each_others_place_are_doubted(streams):
    def edit(s):
        names = [{"lat": "lon", "lon": "lat"}.get(name, name) for name in s["gnss"].column_names]
        return {**s, "gnss": s["gnss"].rename_columns(names)}

    notes = warnings_of(fused(streams, edit)["metrics"])
    assert any("are lat and lon right?" in note for note in notes)


@pytest.mark.parametrize(("times", "doubted"), [(20.0, False), (70.0, True), (1000.0, True)])
def test_noise_far_beyond_what_was_expected_is_a_doubt(streams, times, doubted):
    # What the drive shows is that of its sensors, give or take a third.
    told = {"gyro_noise": np.radians(0.01) / times, "accel_noise": 150e-6 * 9.80665 / times}
    notes = warnings_of(fused(streams, **told)["metrics"])
    assert any("contradict each other" in note for note in notes) == doubted


@pytest.mark.parametrize(("silence", "lost"), [((259.0, 274.0), True), ((100.0, 115.0), False)])
def test_a_heading_that_is_not_found_again_after_the_imu_was_silent_is_a_doubt(silence, lost):
    # Of the half minute after the first silence it stands for most; after the second it drives for minutes.
    def edit(s):
        t_s = seconds(s["imu"])
        return {**s, "imu": select_rows(s["imu"], (t_s < silence[0]) | (t_s > silence[1]))}

    notes = warnings_of(fused(drive("city", seed=6211, duration=300.0), edit)["metrics"])
    assert any("from 274 to 300 s the heading is hardly known" in note for note in notes) == lost
    assert lost or notes == []


@pytest.mark.parametrize("seed", [6200, 6201, 6206])
def test_a_heading_that_nothing_tells_keeps_no_drive_from_converging(seed):
    def edit(s):
        t_s = seconds(s["imu"])
        return {**s, "imu": select_rows(s["imu"], (t_s < 5.0) | (t_s > 25.0))}

    streams = drive("city", seed=seed, duration=300.0)
    result = fused(streams, edit)
    (note,) = warnings_of(result["metrics"])
    assert "from 0 to 5 s the heading is hardly known" in note
    # As in the limits of drives without a gap, in the half of the drive that is far from it.
    assert errors(streams, result).horizontal((150.0, 300.0)) < 1.6 * 2.1


@pytest.mark.parametrize("seed", [6222, 6246, 6272, 6284, 6288])
def test_seconds_of_imu_between_silences_come_out_driving_ahead(seed):
    def edit(s):
        t_s = seconds(s["imu"])
        return {**s, "imu": select_rows(s["imu"], (t_s < 60.0) | ((t_s > 80.0) & (t_s < 85.0)) | (t_s > 105.0))}

    streams = drive("city", seed=seed, duration=240.0)
    result = fused(streams, edit)
    found = errors(streams, result)
    alone = (found.t_s > 80.0) & (found.t_s < 85.0)
    yaw_std = vector(result["trajectory"], "att_std_yaw")[alone]
    assert np.degrees(yaw_std.max()) < 1.0
    assert (np.abs(found.turn[alone, 2]) < 3.0 * yaw_std).all()
    assert warnings_of(result["metrics"]) == []


@pytest.mark.parametrize("seed", [6205, 6206])
def test_an_imu_that_is_silent_every_20_s_keeps_its_heading(seed):
    def edit(s):
        return {**s, "imu": select_rows(s["imu"], seconds(s["imu"]) % 20.0 < 18.0)}

    streams = drive("mixed", seed=seed, duration=300.0)
    result = fused(streams, edit)
    truth, trajectory = streams["reference"], result["trajectory"]
    speed = np.linalg.norm(matrix(truth, "vel"), axis=1)[np.searchsorted(time_ns(truth), time_ns(trajectory))]
    heading = np.abs(errors(streams, result).turn[:, 2])
    assert (heading < 4.0 * vector(trajectory, "att_std_yaw"))[speed > 3.0].all()
    assert not any("not converged" in note for note in warnings_of(result["metrics"]))


@pytest.mark.parametrize("seed", [6306, 6307, 6308, 6317])
def test_an_imu_that_is_silent_every_10_s_converges_and_drives_ahead(seed):
    def edit(s):
        return {**s, "imu": select_rows(s["imu"], seconds(s["imu"]) % 10.0 < 8.0)}

    streams = drive("mixed", seed=seed, duration=300.0)
    result = fused(streams, edit)
    assert np.degrees(np.abs(errors(streams, result).turn[:, 2]).max()) < 30.0
    assert not any("not converged" in note for note in warnings_of(result["metrics"]))


@pytest.mark.parametrize("seed", [6331, 6335])
def test_headings_that_long_silences_lose_keep_no_drive_from_converging(seed):
    def edit(s):
        return {**s, "imu": select_rows(s["imu"], seconds(s["imu"]) % 20.0 < 12.0)}

    notes = warnings_of(fused(drive("mixed", seed=seed, duration=300.0), edit)["metrics"])
    assert not any("not converged" in note for note in notes)


def test_sigmas_beside_a_silence_of_the_imu_cover_what_is_not_known_of_it() -> None:
    """A second of every thirteen. A line between knots tells velocities 1.5 times as well as they are."""
    log = drive(seed=33, duration=240.0, multipath=0.0)
    first = np.arange(20.0, 230.0, 13.4)
    t_s = seconds(log["imu"])
    silent = ((t_s[:, None] > first) & (t_s[:, None] < first + 1.0)).any(axis=1)
    result = fused({**log, "imu": select_rows(log["imu"], ~silent)})
    off = errors(log, result)
    beside = ((off.t_s[:, None] > first - 1.0) & (off.t_s[:, None] < first + 2.0)).any(axis=1)
    assert np.sqrt(np.mean((off.vel / matrix(result["trajectory"], "vel_std"))[beside] ** 2)) < 1.0
