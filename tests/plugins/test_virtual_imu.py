from __future__ import annotations

import numpy as np
import pytest

from recon import IMU, Streams, build, matrix, select_rows, spans, time_ns
from recon.numerics.rotation import from_euler, rotate
from recon.rows import warnings_of
from recon.tables import replace
from recon.testing.drives import drive
from recon_fusers.virtual_imu import VirtualImuParams, virtual_imu

NOISE = (0.001, 0.02)
"""rad/s and m/s^2 of each sample."""


@pytest.fixture(scope="module")
def truth():
    """What a box without noise logs."""
    return drive()["imu"]


def box(truth, seed, noisier=1.0, bias=0.0):
    rng = np.random.default_rng(seed)
    return replace(
        truth,
        gyro=matrix(truth, "gyro") + bias / 10 + noisier * NOISE[0] * rng.standard_normal((truth.num_rows, 3)),
        accel=matrix(truth, "accel") + bias + noisier * NOISE[1] * rng.standard_normal((truth.num_rows, 3)),
    )


def fused(*imus) -> Streams:
    named = dict(zip(("imu", "imu_2", "imu_3", "imu_4"), [*imus, None, None, None], strict=False))
    return virtual_imu(**named, params=VirtualImuParams())


def shares(result, sensor):
    found = {row["name"]: row["value"] for row in result["metrics"].to_pylist()}
    return [value for name, value in found.items() if name.endswith(f"{sensor}_share")]


def error(result, truth, group):
    return np.std(matrix(result["imu"], group) - matrix(truth, group))


def test_noise_of_three_alike_shrinks_by_the_root_of_three(truth):
    result = fused(*(box(truth, seed) for seed in range(3)))
    for group, noise in zip(("gyro", "accel"), NOISE, strict=True):
        # a standard deviation of 3 n numbers is known to 1 / sqrt(6 n), far below 2 %; shares err by some percent
        assert error(result, truth, group) == pytest.approx(noise / np.sqrt(3.0), rel=0.03)
    assert not warnings_of(result["metrics"])


def test_a_noisy_box_counts_less(truth):
    # the drive's own noise, .02 m/s^2, is in every box: densities are as sqrt(1 + 1) to sqrt(1 + 16)
    result = fused(box(truth, 1), box(truth, 2, noisier=4.0))
    expected = (1 / 2) / (1 / 2 + 1 / 17)
    assert shares(result, "accel")[0] == pytest.approx(expected, abs=0.05)
    assert sum(shares(result, "gyro")) == pytest.approx(1.0)


def test_a_box_that_came_loose_is_voted_out_and_named(truth):
    loose = box(truth, 2)
    later = (np.arange(loose.num_rows) > 0.7 * loose.num_rows)[:, None]
    tilted = rotate(from_euler(0.0, 0.15, 0.0), matrix(loose, "accel"))
    loose = replace(loose, accel=np.where(later, tilted, matrix(loose, "accel")))
    result = fused(box(truth, 1), loose, box(truth, 3))
    (note,) = warnings_of(result["metrics"])
    assert note.startswith("imu_2 came loose")
    ((start, _),) = spans(result["events"], "box_disagrees")
    begin = time_ns(truth)[int(0.7 * truth.num_rows)]
    assert abs(start - begin) <= 2_000_000_000  # votes are taken each second
    assert error(result, truth, "accel") < NOISE[1] / np.sqrt(1.9)


def test_the_first_box_can_lose_the_vote_as_any_other(truth):
    wild = matrix(box(truth, 1), "gyro")
    wild[2000:2600] += 0.5
    result = fused(replace(truth, gyro=wild), box(truth, 2), box(truth, 3))
    (note,) = warnings_of(result["metrics"])
    assert note.startswith("imu disagrees with the other boxes")
    assert error(result, truth, "gyro") < NOISE[0]


def test_of_two_that_disagree_the_first_is_believed(truth):
    wild = matrix(box(truth, 2), "gyro")
    wild[2000:2600] += 0.5
    result = fused(box(truth, 1), replace(truth, gyro=wild))
    assert "which is wrong two cannot tell" in warnings_of(result["metrics"])[0]
    assert error(result, truth, "gyro") < NOISE[0]


def test_nothing_jumps_where_a_biased_box_ends(truth):
    short = box(truth, 2, bias=0.2)
    short = select_rows(short, np.arange(short.num_rows) < 3000)
    result = fused(box(truth, 1), short)
    off = matrix(result["imu"], "accel") - matrix(truth, "accel")
    # before and after: half the bias, .1 m/s^2; means of 3000 rows of noise .02 err by .0004
    assert np.allclose(off[:3000].mean(axis=0), off[3000:].mean(axis=0), atol=0.003)


def test_one_box_is_the_virtual_imu(truth):
    result = fused(truth)
    assert result["imu"].equals(truth)
    none = build(IMU, time=np.zeros(0, dtype=np.int64), accel=np.zeros((0, 3)), gyro=np.zeros((0, 3)))
    assert fused(none, none)["imu"].num_rows == 0
