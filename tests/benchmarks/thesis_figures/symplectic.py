"""Chapter 9.1: geometric integrators against the rules of quadrature, over 40 000 steps of motions in closed form."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from recon import ATTITUDE, GNSS, IMU, build
from recon.numerics.motion import MotionTruth, Spring
from recon.numerics.rotation import angle, conjugate, rotate
from recon.tables import Array, matrix
from recon.testing.motions import RollingCircle
from recon_integrators.attitude import AttitudeParams, integrate_attitude
from recon_integrators.motion import MotionParams, integrate_motion
from recon_integrators.symplectic import SymplecticParams, integrate_symplectic
from thesis_figures.style import BLUE, GREEN, ORANGE, VERMILLION, Number, legend_above_all, panels

RATE_HZ = 100.0
ROUNDING = 1e-13
"""rad: the spring does not sway, so that any rule turns it to rounding."""
MOTIONS: Mapping[str, Callable[[Array], MotionTruth]] = {
    "swaying circle": RollingCircle().at,
    "spring": Spring(radius=20.0, rate=0.4, climb=0.5, amplitude=1.0, oscillation=1.3).at,
}
RULES = ("trapezoid", "parabola", "mean_parabola")
LOOKS = {
    "trapezoid": (ORANGE, "--"),
    "parabola": (BLUE, "-"),
    "mean_parabola": (VERMILLION, "-."),
    "symplectic": (GREEN, "-"),
}


@dataclass(frozen=True)
class Drift:
    """Errors at each step: attitude (n,) rad, position (n,) m, kinetic energy (n,) of its own mean."""

    attitude: Array
    position: Array
    energy: Array


def symplectic(steps: int) -> tuple[Figure, list[Number]]:
    """Error of attitude, position and energy of each rule and of integrator.symplectic over so many steps."""
    t_s = np.arange(steps + 1) / RATE_HZ
    figure, rows = panels(3, 2, height=4.6, sharex=True, sharey="row")
    numbers = []
    for column, (name, motion) in enumerate(MOTIONS.items()):
        truth = motion(t_s)
        for method, (color, line) in LOOKS.items():
            found = drift(truth, method)
            for axes, (what, error) in zip(rows[:, column], vars(found).items(), strict=True):
                if error.max() > ROUNDING:
                    largest = np.maximum.accumulate(error[1:])
                    label, above = method.replace("_", " "), 2.0 if line == "-" else 3.0  # broken lines show both
                    axes.loglog(np.arange(1, steps + 1), largest, line, color=color, lw=0.9, label=label, zorder=above)
                unit = {"attitude": "rad", "position": "m", "energy": ""}[what]
                numbers.append(Number(f"{name}, {method.replace('_', ' ')}: {what}", float(error.max()), unit))
        rows[0, column].set_title(name)
        rows[2, column].set_xlabel("steps")
    for axes, label in zip(rows[:, 0], ("attitude / rad", "position / m", "energy, relative"), strict=True):
        axes.set_ylabel(label)
    rows[0, 1].text(0.5, 0.5, "exact to rounding", transform=rows[0, 1].transAxes, ha="center", fontsize=7)
    legend_above_all(figure, rows[1, 0], 2)
    return figure, numbers


def drift(truth: MotionTruth, method: str) -> Drift:
    """Errors of a rule of integrator.attitude and integrator.motion, or of integrator.symplectic."""
    time = np.round(truth.t_s * 1e9).astype(np.int64)
    imu = build(IMU, time=time, accel=rotate(conjugate(truth.q_nv), truth.acc_n), gyro=truth.gyro_v)
    start = build(ATTITUDE, time=time[:1], q=truth.q_nv[:1])
    gnss = build(GNSS, time=time[:1], pos=truth.pos_n[:1], vel=truth.vel_n[:1])
    if method == "symplectic":
        made = integrate_symplectic(imu=imu, attitude=start, gnss=gnss, params=SymplecticParams())
    else:
        turned = integrate_attitude(imu=imu, attitude=start, params=AttitudeParams(rule=method))["attitude"]
        made = integrate_motion(imu=imu, attitude=turned, events=None, gnss=gnss, params=MotionParams(rule=method))
    trajectory = made["trajectory"]
    energy, true = (np.sum(vel**2, axis=1) for vel in (matrix(trajectory, "vel"), truth.vel_n))
    return Drift(
        np.asarray(angle(matrix(trajectory, "q"), truth.q_nv)),
        np.asarray(np.linalg.norm(matrix(trajectory, "pos") - truth.pos_n, axis=1)),
        np.asarray(np.abs(energy - true) / true.mean()),
    )
