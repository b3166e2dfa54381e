from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from recon.errors import DataError, NotEnoughData
from recon.numerics.rotation import angle, conjugate, rotate
from recon.rows import warnings_of
from recon.schema import ATTITUDE, GNSS, IMU
from recon.tables import Array, build, matrix
from recon.testing.motions import RollingCircle
from recon_integrators.symplectic import SymplecticParams, declare_integrators, integrate_symplectic

T_S = np.arange(0.0, 10.0, 0.01)
TRUTH = RollingCircle().at(T_S)


def inputs(t_s: Array = T_S) -> dict[str, Any]:
    truth, time = RollingCircle().at(t_s), np.rint(t_s * 1e9).astype(np.int64)
    return {
        "imu": build(IMU, time=time, accel=rotate(conjugate(truth.q_nv), truth.acc_n), gyro=truth.gyro_v),
        "attitude": build(ATTITUDE, time=time[:1], q=truth.q_nv[:1]),
        "gnss": build(GNSS, time=time[:1], pos=truth.pos_n[:1], vel=truth.vel_n[:1]),
        "params": SymplecticParams(),
    }


def test_a_swaying_circle_is_followed() -> None:
    made = integrate_symplectic(**inputs())
    assert np.max(angle(matrix(made["attitude"], "q"), TRUTH.q_nv)) < 1e-7
    # Order 2: h^2 / 12 of the change of the acceleration, 5 m/s^2 turning with 0.5 rad/s, over 10 s.
    assert matrix(made["trajectory"], "vel") == pytest.approx(TRUTH.vel_n, abs=1e-4 / 12 * 5 * 0.5 * 10)
    assert matrix(made["trajectory"], "pos") == pytest.approx(TRUTH.pos_n, abs=1e-4 / 12 * 5 * 0.5 * 100)


def test_over_a_gap_attitude_and_velocity_are_held_and_it_is_said() -> None:
    kept = (T_S < 4.0) | (T_S >= 5.0)
    made = integrate_symplectic(**inputs(T_S[kept]))
    row = int((T_S < 4.0).sum())
    for table, group in (("attitude", "q"), ("trajectory", "vel")):
        values = matrix(made[table], group)
        assert values[row] == pytest.approx(values[row - 1], abs=1e-15)
    assert any("attitude and velocity are held" in note for note in warnings_of(made["metrics"]))


def test_an_attitude_of_another_time_and_no_rows_are_refused() -> None:
    given = inputs()
    late = build(ATTITUDE, time=np.array([1]), q=TRUTH.q_nv[:1])
    with pytest.raises(DataError, match="not that of the first row"):
        integrate_symplectic(**{**given, "attitude": late})
    with pytest.raises(NotEnoughData):
        integrate_symplectic(**{**given, "imu": given["imu"].slice(0, 0)})


def test_the_declaration_has_no_fault() -> None:
    assert [stage.faults() for stage in declare_integrators()] == [[]]
