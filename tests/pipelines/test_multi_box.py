"""The pipeline multi_box as a user runs it: two logs of one drive in, one trajectory out."""

from __future__ import annotations

import numpy as np
import pytest
from box_drives import boxes

import recon
from recon import matrix, replace, time_ns
from recon.numerics.rotation import angle, from_euler, rotate
from recon.numerics.rotation_series import slerp
from recon.recording import Recording
from recon.rows import warnings_of
from recon.storage import write_recording
from recon_aligners.boxes import BoxesParams, align_boxes
from recon_fusers.virtual_imu import VirtualImuParams, virtual_imu


@pytest.fixture(scope="module")
def drive():
    return boxes(seed=2, duration=240.0)


@pytest.fixture(scope="module")
def result(drive, tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    logs = [{"imu": drive.imus[0], "gnss": drive.streams["gnss"]}, {"imu": drive.imus[1]}]
    paths = [folder / "front", folder / "rear"]
    for path, log in zip(paths, logs, strict=True):
        write_recording(Recording(log, {"sources": [path.name]}), path, "parquet")
    return recon.run("multi_box", paths).recording


def test_one_trajectory_comes_of_two_logs(drive, result):
    found, truth = result["trajectory"], drive.streams["reference"]
    q_nv = slerp(time_ns(found), time_ns(truth), matrix(truth, "q"))
    # tenths of a degree, most of it the mounting that the drive shows; a box that is turned wrongly errs by radians
    assert np.degrees(np.sqrt(np.nanmean(angle(q_nv, matrix(found, "q", gaps=True)) ** 2))) < 2.0
    assert time_ns(result["imu"])[0] == time_ns(drive.imus[0])[0]


def test_what_was_found_of_the_second_box_is_told(drive, result):
    told = {row["name"]: row["value"] for row in result["metrics"].to_pylist()}
    assert abs(told["imu_2_lag"] - drive.lags_s[1]) < 1e-3
    assert {"imu_gyro_share", "imu_2_accel_share"} <= set(told)
    assert not [note for note in warnings_of(result["metrics"]) if "imu_2" in note]


def test_a_box_that_comes_loose_on_the_way_is_placed_by_what_went_before_and_voted_out():
    drive = boxes(seed=1, count=3)
    first, second, third = drive.imus
    later = (np.arange(second.num_rows) > 0.6 * second.num_rows)[:, None]
    tipped = from_euler(0.1, 0.1, 0.0)
    turned = {name: rotate(tipped, matrix(second, name)) for name in ("gyro", "accel")}
    second = replace(second, **{name: np.where(later, turned[name], matrix(second, name)) for name in turned})
    streams = {"imu": first, "imu_2": second, "imu_3": third, "imu_4": None}
    aligned = align_boxes(**streams, params=BoxesParams())
    told = {row["name"]: row["value"] for row in aligned["metrics"].to_pylist()}
    euler = [np.radians(told[f"imu_2_{name}"]) for name in ("yaw", "pitch", "roll")]
    assert np.degrees(angle(from_euler(*euler), drive.q_1[1])) < 0.1
    voted = virtual_imu(**{**streams, "imu_2": aligned["imu_2"], "imu_3": aligned["imu_3"]}, params=VirtualImuParams())
    (note,) = warnings_of(voted["metrics"])
    assert note.startswith("imu_2 came loose 360 s after the start")
