from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from recon.numerics.rotation import rotate
from recon.rows import warnings_of
from recon.tables import matrix, meta, replace, vector
from recon_aligners.lever_arm import LeverArmParams, declare_aligners, move
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams

LEVER = (-1.2, 0.3, -0.4)


def truth(**params: Any) -> Any:
    """The true motion of the point at LEVER from the rear axle, and that of the rear axle itself."""
    common = {"sensors": "perfect", "imu_rate": 400.0, "motion": "crash", "speed": 15.0, "spin": 1.0, "direction": 0.8}
    return simulate_drive(DriveParams(**{**common, **params}))["reference"]


def test_a_spinning_crash_at_another_point_is_that_of_a_box_there() -> None:
    # The rear axle is where the simulator's road runs: two boxes at levers of their own see one and the same car, but
    # its impact, which pushes the box. So the check is by differences of what one box sees.
    box = truth()
    moved = move(trajectory=box, params=LeverArmParams(lever_arm=LEVER))["trajectory"]
    t_s = np.arange(box.num_rows) / 400.0
    pos, vel, accel = (matrix(moved, name) for name in ("pos", "vel", "accel"))
    spin = slice(4000, -100)
    # Central differences err by h^2 / 6 times the third derivative: for a pulse of 120 m/s^2 in 0.1 s about 0.01 m/s.
    np.testing.assert_allclose(np.gradient(pos, t_s, axis=0)[spin], vel[spin], rtol=0, atol=0.02)
    q = matrix(moved, "q")
    in_n = rotate(q, accel)
    np.testing.assert_allclose(np.gradient(vel, t_s, axis=0)[spin], in_n[spin], rtol=0, atol=0.6)  # of 240 m/s^2
    swing = np.abs(accel - matrix(box, "accel"))[spin].max()
    assert swing > 3.0  # and without the move the last check would fail by that


def test_the_place_moves_with_the_position() -> None:
    box = truth(motion="circle", spin=0.0, direction=0.0, rest=3.0, turns=1.0)
    moved = move(trajectory=box, params=LeverArmParams(lever_arm=LEVER))["trajectory"]
    metre = 1.0 / 111_000.0
    shift_n = matrix(moved, "pos")[:, 1] - matrix(box, "pos")[:, 1]
    # A degree of latitude is 111.0 km within 0.5 %.
    np.testing.assert_allclose((vector(moved, "lat") - vector(box, "lat")) / metre, shift_n, rtol=0, atol=0.01)
    np.testing.assert_allclose(vector(moved, "height") - vector(box, "height"), -0.4, rtol=0, atol=0.01)


def test_a_trajectory_without_heights_is_moved_as_well() -> None:
    box = truth(rest=3.0)
    whole = move(trajectory=box, params=LeverArmParams(lever_arm=LEVER))["trajectory"]
    flat = move(trajectory=box.drop_columns(["height"]), params=LeverArmParams(lever_arm=LEVER))["trajectory"]
    assert "height" not in flat.column_names
    # A height of up to 100 m moves a lever of 1.2 m by 1e-5 of it.
    np.testing.assert_allclose(vector(flat, "lat"), vector(whole, "lat"), rtol=0, atol=1e-4 / 111_000.0)


def test_no_lever_is_no_move() -> None:
    box = truth(motion="circle", spin=0.0, direction=0.0, rest=3.0, turns=1.0)
    same = move(trajectory=box, params=LeverArmParams())["trajectory"]
    assert same.equals(box)
    assert meta(same)["lever_arm_sigma"] == [0.0, 0.0, 0.0]


def test_what_is_not_known_of_the_lever_is_in_the_sigmas_and_facts() -> None:
    box = truth(motion="circle", spin=0.0, direction=0.0, rest=3.0, turns=1.0)
    box = replace(box, pos_std=np.full((box.num_rows, 3), 0.4))
    params = LeverArmParams(lever_arm=LEVER, sigma=(0.3, 0.3, 0.3))
    moved = move(trajectory=box, params=params)["trajectory"]
    assert matrix(moved, "pos_std")[0, 2] == pytest.approx(0.5, rel=1e-6)
    assert meta(moved)["lever_arm_sigma"] == [0.3, 0.3, 0.3]
    assert meta(moved)["reference_point"] == "centre of gravity"


def test_without_turn_rates_it_says_what_it_left() -> None:
    box = truth(motion="circle", spin=0.0, direction=0.0, rest=3.0, turns=1.0).drop_columns(
        ["gyro_x", "gyro_y", "gyro_z"]
    )
    found = move(trajectory=box, params=LeverArmParams(lever_arm=LEVER))
    assert "no turn rates" in warnings_of(found["metrics"])[0]


def test_the_declaration_has_no_fault() -> None:
    assert [stage.faults() for stage in declare_aligners()] == [[]]
