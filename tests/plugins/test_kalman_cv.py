from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

import recon
import recon.knots
from recon import ATTITUDE, GNSS, IMU, build, has, matrix, meta, replace, spans, time_ns, vector
from recon.errors import DataError, NotEnoughData
from recon.numerics.constant_velocity import Fusion
from recon.numerics.geodesy import enu_to_geodetic
from recon.numerics.rotation import from_euler, to_euler
from recon.rows import warnings_of
from recon.schema import Change
from recon.tables import conform
from recon.testing.drives import ANCHOR, Conditions, drive
from recon.testing.serving import serve
from recon_fusers.kalman_cv import KalmanParams, declare_fusers, kalman_cv

READS = {"imu": IMU.need("accel", frame="local", quantity={"accel": "acceleration"}), "gnss": GNSS.need("pos")}


def inputs(seed=1, noise=1.0):
    return serve(drive(Conditions(seed=seed, noise=noise)), {**READS, "attitude": ATTITUDE.need("q")})


def run(streams, **params):
    return kalman_cv(**{"attitude": None, **streams}, params=KalmanParams(**params))


def fuse(seed=1, noise=1.0, **params):
    return run(inputs(seed, noise), **params)


def metric(result, name):
    (row,) = (row for row in result["metrics"].to_pylist() if row["name"] == name)
    return row["value"], row["method"]


def horizontal(table, truth):
    rows = np.searchsorted(time_ns(truth), time_ns(table))
    error = matrix(table, "pos") - matrix(truth, "pos")[rows]
    return float(np.sqrt((error[:, :2] ** 2).sum(axis=1).mean()))


def test_it_is_the_filter_of_the_numerics_with_the_sigmas_that_the_receiver_tells():
    streams = inputs()
    found = run(streams, smooth=True, accel_noise=0.3, slow_share=0.0)["trajectory"]
    imu, gnss = streams["imu"], streams["gnss"]
    start = time_ns(imu)[0]
    fusion = Fusion.of(
        (time_ns(imu) - start) * 1e-9, matrix(imu, "accel"), np.zeros(imu.num_rows - 1, dtype=bool),
        (time_ns(gnss) - start) * 1e-9, matrix(gnss, "pos"), matrix(gnss, "pos_std") ** 2,
        held_density=2.0, gate=5.0, patience=10.0,
    )  # fmt: skip
    wanted, _ = fusion.estimate(np.full(3, 0.3), smooth=True)
    np.testing.assert_array_equal(matrix(found, "pos"), wanted.pos)
    np.testing.assert_array_equal(matrix(found, "vel_std"), np.sqrt(wanted.vel_var))
    np.testing.assert_array_equal(matrix(found, "pos_std"), np.sqrt(wanted.pos_var))


@pytest.mark.parametrize("seed", range(20))
def test_filtered_and_smoothed_it_beats_the_fixes(seed):
    truth = drive(Conditions(seed=seed))["reference"]
    streams = inputs(seed)
    raw = horizontal(streams["gnss"], truth)
    filtered, smoothed = (horizontal(run(streams, smooth=smooth)["trajectory"], truth) for smooth in (False, True))
    assert smoothed < filtered < raw


def test_what_lasts_for_minutes_is_not_averaged_away_but_claimed():
    plain, shared = (fuse(slow_share=share)["trajectory"] for share in (0.0, 0.75))
    assert (matrix(plain, "pos_std")[1000:] < 0.6).all()
    assert (matrix(shared, "pos_std") > np.sqrt(0.75)).all()


def test_the_parameters_take_the_place_of_what_the_receiver_tells():
    assert metric(fuse(), "sigma_horizontal") == (1.0, "told by the receiver")
    assert metric(fuse(horizontal=4.0), "sigma_horizontal") == (4.0, "given")
    streams = inputs()
    streams["gnss"] = streams["gnss"].drop_columns(["pos_std_e", "pos_std_n", "pos_std_u"])
    assert metric(run(streams), "sigma_vertical") == (5.0, "typical")
    zero = replace(inputs()["gnss"], pos_std=np.zeros((streams["gnss"].num_rows, 3)))
    assert metric(run({**streams, "gnss": zero}), "sigma_horizontal") == (3.0, "typical")


def test_the_trajectory_knows_its_place_and_whose_attitude_it_has():
    streams = inputs(noise=0.0)
    q = from_euler(0.3, np.full(streams["imu"].num_rows, 0.1), 0.0)
    sensor = Change(frames={"q": "sensor"}).apply(ATTITUDE)
    streams["attitude"] = conform(
        build(ATTITUDE, time=time_ns(streams["imu"]), q=q), sensor, stream="attitude", step="test"
    )
    found = run(streams)["trajectory"]
    assert meta(found)["body"] == "sensor"
    assert to_euler(matrix(found, "q"))[1] == pytest.approx(0.1)
    lat, lon, height = enu_to_geodetic(matrix(found, "pos"), ANCHOR)
    for name, values in (("lat", lat), ("lon", lon), ("height", height)):
        np.testing.assert_array_equal(vector(found, name), values)
    (stage,) = declare_fusers()
    schemas = recon.Recording(streams).schemas()
    assert stage.outputs(schemas, KalmanParams())["trajectory"]["qw"].frame == "sensor"
    assert not has(run(inputs() | {"attitude": None})["trajectory"], "q")


def test_an_outage_is_told_and_the_sigma_grows_in_it():
    streams = inputs()
    gnss = streams["gnss"]
    since = (time_ns(gnss) - time_ns(gnss)[0]) * 1e-9
    streams["gnss"] = gnss.filter(pa.array((since < 10.0) | (since > 20.0)))
    found = run(streams, accel_noise=0.3)
    ((start, stop),) = spans(found["events"], "outage")
    assert (stop - start) * 1e-9 == pytest.approx(10.0, abs=0.5)
    since = (time_ns(found["trajectory"]) - time_ns(gnss)[0]) * 1e-9
    sigma = vector(found["trajectory"], "pos_std_e")
    assert sigma[np.searchsorted(since, 19.9)] > 5.0 * sigma[np.searchsorted(since, 9.9)]


def test_residuals_are_the_innovations_and_an_outlier_is_not_accepted():
    streams = inputs()
    pos = matrix(streams["gnss"], "pos").copy()
    pos[40] += [80.0, 0.0, 0.0]
    found = run({**streams, "gnss": replace(streams["gnss"], pos=pos)})
    rows = [row for row in found["residuals"].to_pylist() if not row["accepted"]]
    assert [row["component"] for row in rows] == ["pos_e"]
    assert rows[0]["value"] == pytest.approx(80.0, abs=5.0)
    assert rows[0]["weight"] < 0.05
    assert metric(found, "fixes_doubted")[0] == 1.0


def test_the_noise_of_the_acceleration_is_found_where_it_is_not_given():
    streams = inputs()
    scatter = np.random.default_rng(3).normal(0.0, 10.0, (streams["imu"].num_rows, 3)) * [1.0, 1.0, 0.1]
    found = run({**streams, "imu": replace(streams["imu"], accel=matrix(streams["imu"], "accel") + scatter)})
    # 10 m/s^2 of white noise at 100 Hz are 1 m/s^1.5; the height has a tenth of it, and the bias of the drive.
    level, method = metric(found, "accel_noise_horizontal")
    assert 0.7 <= level <= 1.4
    assert 0.05 <= metric(found, "accel_noise_vertical")[0] <= 0.3
    assert method == "likeliest, by the innovations"
    assert metric(fuse(accel_noise=0.3), "accel_noise_vertical") == (0.3, "given")


def test_an_attitude_that_is_wrong_shows_in_the_innovations():
    streams = inputs()
    tilted = matrix(streams["imu"], "accel") + np.array([8.0, 0.0, 0.0])
    found = run({**streams, "imu": replace(streams["imu"], accel=tilted)}, accel_noise=0.05)
    assert "is the attitude right?" in warnings_of(found["metrics"])[0]


def test_gaps_of_the_imu_are_warned_of():
    streams = inputs()
    imu = streams["imu"]
    since = (time_ns(imu) - time_ns(imu)[0]) * 1e-9
    streams["imu"] = imu.filter(pa.array((since < 10.0) | (since > 12.0)))
    found = run(streams)
    assert "the acceleration is taken as zero" in warnings_of(found["metrics"])[0]
    since = (time_ns(found["trajectory"]) - time_ns(imu)[0]) * 1e-9
    sigma = vector(found["trajectory"], "vel_std_e")
    assert sigma[np.searchsorted(since, 12.0)] > 1.5 * sigma[np.searchsorted(since, 9.9)]


def simulated(seed, slow=1.5, white=1.5, density=0.3, tau_s=100.0):
    """Five minutes that the model itself drives, with fixes that err as it says: streams, and the true positions."""
    rng = np.random.default_rng(seed)
    t_ns, h = np.arange(3001) * 100_000_000, 0.1
    acc = np.sin(np.arange(3001)[:, None] * h / np.array([5.0, 7.0, 11.0]))
    pushed = 0.5 * (acc[:-1] + acc[1:]) + density / np.sqrt(h) * rng.standard_normal((3000, 3))
    vel = np.vstack([np.zeros(3), np.cumsum(h * pushed, axis=0)])
    pos = np.vstack([np.zeros(3), np.cumsum(h * vel[:-1] + h**2 * pushed / 2.0, axis=0)])
    kept, last = np.exp(-1.0 / tau_s), [slow * rng.standard_normal(3)]
    for _ in range(300):
        last.append(kept * last[-1] + slow * np.sqrt(1.0 - kept**2) * rng.standard_normal(3))
    fix = pos[::10] + np.array(last) + white * rng.standard_normal((301, 3))
    std = np.full(fix.shape, np.hypot(slow, white))
    gnss = build(GNSS, time=t_ns[::10], pos=fix, pos_std=std)
    shape = Change(frames={"accel": "local"}, quantities={"accel": "acceleration"}).apply(IMU)
    imu = conform(build(IMU, time=t_ns, accel=acc, gyro=np.zeros_like(acc)), shape, stream="imu", step="test")
    return {"imu": imu, "gnss": gnss}, pos


def test_sigmas_of_changes_are_of_the_size_of_their_errors():
    squares = {1.0: [], 10.0: [], 60.0: [], 200.0: []}
    for seed in range(40):
        streams, pos = simulated(seed)
        found = run(streams, smooth=True, accel_noise=0.3, slow_share=0.5)
        trajectory = recon.Trajectory(found["trajectory"], found["knots"])
        for span, each in squares.items():
            start = np.random.default_rng(seed).integers(5, 2950 - int(10 * span), 8)
            moved = trajectory.between(start / 10.0, start / 10.0 + span)
            error = moved.displacement - (pos[start + round(10 * span)] - pos[start])
            each.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(moved.displacement_covariance), error).mean())
    for span, each in squares.items():
        # Chi square of 3: 40 drives of 8 spans, which share much in a drive: at least 40 x 3 count, sigma 0.13.
        # Of what slow errors change by in a second, 0.2 m, the smoother lets a part through alone: there it says more.
        assert (0.5 if span == 1.0 else 0.7) < np.mean(each) / 3.0 < 1.3, span


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("tau_s", [30.0, 100.0])
def test_sigmas_of_velocities_hold_what_slow_errors_change_by(smooth, tau_s):
    squares = []
    for seed in range(20):
        streams, pos = simulated(seed, density=0.05, tau_s=tau_s)
        found = run(streams, smooth=smooth, accel_noise=0.05, slow_share=0.5, slow_time=tau_s)["trajectory"]
        error = matrix(found, "vel")[1:-1] - (pos[2:] - pos[:-2]) / 0.2
        squares.append(((error / matrix(found, "vel_std")[1:-1]) ** 2)[300:].mean())
    # Of 20 drives, 3 axes and 27 times that are 10 s apart: sigma 0.035, and means of 0.2 s instead of velocities.
    assert np.mean(squares) == pytest.approx(1.0, abs=0.2)


def test_sigmas_at_the_knots_are_those_of_the_trajectory():
    found = fuse(smooth=True)
    known, table = recon.knots.Knots.of(found["knots"]), found["trajectory"]
    _, knot, row = np.intersect1d(known.t_ns, time_ns(table), return_indices=True)
    assert len(knot) == len(known.t_ns)
    variance = np.diagonal(known.covariance(knot, knot), axis1=1, axis2=2)
    wanted = np.column_stack([matrix(table, "pos_std")[row], matrix(table, "vel_std")[row]])
    np.testing.assert_allclose(np.sqrt(variance[:, :6]), wanted, rtol=1e-5)  # single precision
    np.testing.assert_array_equal(matrix(found["knots"], "pos"), matrix(table, "pos")[row])
    movement = recon.Trajectory(table, found["knots"]).between(3.0, 20.0)
    assert movement.distance_sigma > 0.0
    assert np.isnan(movement.heading_sigma)


def test_a_filter_tells_no_sigmas_of_changes():
    assert "knots" not in fuse()


def test_without_a_fix_in_its_time_there_is_nothing():
    streams = inputs()
    late = replace(streams["gnss"], time=recon.times(time_ns(streams["gnss"]) + 10**15))
    with pytest.raises(NotEnoughData, match="gnss positions in the time of imu"):
        run({**streams, "gnss": late})
    with pytest.raises(DataError, match="rows in imu"):
        run({**streams, "imu": streams["imu"].slice(0, 1)})


def test_the_declaration_has_no_fault():
    assert [stage.faults() for stage in declare_fusers()] == [[]]
