"""fuser.map with further receivers: they are found, told and used; what is none of the vehicle's is left out."""

from __future__ import annotations

import numpy as np
import pytest
from box_drives import APART, LAG_S, SHARED, boxes
from map_drives import drive, fused

from recon import select_rows
from recon.rows import warnings_of


@pytest.fixture(scope="module")
def two():
    return boxes(seed=4, count=2, duration=240.0, receivers=True)


@pytest.fixture(scope="module")
def found(two):
    return fused({"imu": two.imus[0], "gnss": two.gnss[0], "gnss_2": two.gnss[1]})


def test_antenna_clock_and_what_receivers_share_are_told(two, found):
    told = {row["name"]: row for row in found["metrics"].to_pylist()}
    away = [told[f"gnss_2_antenna_{axis}"]["value"] for axis in "xy"]
    assert np.hypot(*away) < APART + 0.5
    assert abs(told["gnss_2_lag"]["value"] - LAG_S) < 0.02
    # four minutes tell a correlation to 0.05; the error of the trajectory passes for a common one
    assert abs(told["gnss_2_velocity_shared"]["value"] - SHARED["velocity"]) < 0.2


def test_residuals_name_the_receiver_and_have_its_stamps(two, found):
    table = found["residuals"]
    sensors = np.array(table["sensor"].to_pylist())
    assert set(sensors) == {"gnss", "gnss_2"}
    stamps = set(table["time"].to_numpy()[sensors == "gnss_2"].tolist())
    assert stamps <= set(two.gnss[1]["time"].to_numpy().tolist())


def test_an_empty_stream_changes_nothing(two):
    alone = {"imu": two.imus[0], "gnss": two.gnss[0]}
    empty = select_rows(two.gnss[1], np.zeros(two.gnss[1].num_rows, dtype=bool))
    assert fused({**alone, "gnss_2": empty})["trajectory"].equals(fused(alone)["trajectory"])


def test_a_receiver_of_another_vehicle_is_left_out_and_named(two):
    other = drive("mixed", seed=77, duration=240.0)["gnss"]
    alone = {"imu": two.imus[0], "gnss": two.gnss[0]}
    made = fused({**alone, "gnss_2": other})
    assert any(note.startswith("gnss_2 is left out") for note in warnings_of(made["metrics"]))
    assert made["trajectory"].equals(fused(alone)["trajectory"])


def test_a_receiver_of_one_fix_is_left_out_with_a_reason_about_itself(two):
    (told,) = warnings_of(
        fused({"imu": two.imus[0], "gnss": two.gnss[0], "gnss_2": two.gnss[1].slice(0, 1)})["metrics"]
    )
    assert told == "gnss_2 is left out: not enough GNSS: needs two rows with a position or a speed, found 1 of 1"
