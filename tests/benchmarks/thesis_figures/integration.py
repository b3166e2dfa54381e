"""Chapter 6: how far the rules of integration lead from the truth, and from each other."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import recon
from recon import ATTITUDE, GNSS, IMU, build
from recon.numerics.integration import RULES
from recon.numerics.motion import MotionTruth, Spring
from recon.numerics.rotation import conjugate, rotate
from recon.rows import spans
from recon.tables import Array, matrix, seconds, time_ns
from recon_integrators.motion import MotionParams, integrate_motion
from thesis_figures.style import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    SKY,
    VERMILLION,
    WIDTH,
    Number,
    legend_above_all,
    panels,
)

SPRING = Spring(radius=20.0, rate=0.4, climb=0.5, amplitude=1.0, oscillation=1.3)
"""A coil spring: 20 m of radius at 8 m/s, climbing 0.5 m/s."""
DURATION_S, RATE_HZ, JITTER = 60.0, 50.0, 0.2
"""Samples of the synthetic trajectory, each up to JITTER of a step early or late: no step is taken for a gap."""
DRAWS = 9
"""How often the jitter is drawn; an error is the median, for that of the parabolas depends on the draw."""
LOOKS = dict(
    zip(RULES, ((GREY, "-"), (ORANGE, "--"), (BLUE, "-"), (VERMILLION, "-.")), strict=True),
)
"""Colour and line of each rule."""
LABELS = {rule: rule.replace("_", " ") for rule in RULES} | {"parabola": "parabola (PaIS)"}


def synthetic_trajectory() -> tuple[Figure, list[Number]]:
    """Figure 6.1: the analytic path and the one that the rectangles find."""
    truth = SPRING.at(_irregular(RATE_HZ, 0))
    figure = Figure(figsize=(WIDTH, 2.7))
    axes = figure.add_axes((0.0, 0.06, 0.92, 0.88), projection="3d")
    axes.plot(*_integrated(truth, "rectangle").T, color=SKY, lw=1.0, label="integrated by rectangles")
    axes.plot(*truth.pos_n.T, color=BLACK, lw=1.0, label="analytic")
    axes.set_xlabel("east / m", labelpad=-4)
    axes.set_ylabel("north / m", labelpad=-4)
    axes.set_zlabel("up / m", labelpad=-4)
    axes.tick_params(pad=-2)
    axes.set_box_aspect((1.0, 1.0, 0.8))
    figure.legend(*axes.get_legend_handles_labels(), loc="upper center", ncols=2)
    length = float(np.linalg.norm(np.diff(truth.pos_n, axis=0), axis=1).sum())
    return figure, [Number("length of the path", length, "m"), Number("samples", len(truth.t_s))]


def integration_error() -> tuple[Figure, list[Number]]:
    """Figure 6.2: distance of each rule from the analytic path, over time and over the rate of the samples."""
    truth = SPRING.at(_irregular(RATE_HZ, 0))
    rates_hz = np.array([5.0, 10.0, 20.0, 50.0, 100.0, 200.0])
    draws = [[SPRING.at(_irregular(rate, seed)) for seed in range(DRAWS)] for rate in rates_hz]
    largest = {rule: np.array([[_distance(one, rule).max() for one in row] for row in draws]) for rule in RULES}
    at_rate = {rule: found[rates_hz == RATE_HZ][0] for rule, found in largest.items()}
    figure, (left, right) = panels(1, 2, height=2.4, sharey=True)
    numbers = []
    for rule in RULES:
        color, line = LOOKS[rule]
        left.semilogy(truth.t_s[1:], _distance(truth, rule)[1:], line, color=color, label=LABELS[rule])
        worst = np.median(largest[rule], axis=1)
        right.loglog(rates_hz, worst, line, color=color, marker="o", ms=2.5)
        order = -np.polyfit(np.log(rates_hz), np.log(worst), 1)[0]
        numbers += [
            Number(f"largest error at {RATE_HZ:g} Hz, {LABELS[rule]}", float(np.median(at_rate[rule])), "m"),
            Number(f"order of the error, {LABELS[rule]}", float(order)),
        ]
    for coarse, fine in pairwise(RULES):
        ratio = at_rate[coarse] / at_rate[fine]
        for name, of in (("lowest", np.min), ("median", np.median), ("highest", np.max)):
            numbers.append(Number(f"{LABELS[coarse]} over {LABELS[fine]}, {name} of {DRAWS} draws", float(of(ratio))))
    left.set(xlabel="time / s", ylabel="error of the position / m", xlim=(0.0, DURATION_S), ylim=(1e-9, 3e2))
    left.set_title(f"at {RATE_HZ:g} Hz")
    right.set(xlabel="rate / Hz", title=f"largest in {DURATION_S:g} s, median")
    right.set_xticks([5, 20, 100], ["5", "20", "100"])
    right.minorticks_off()
    legend_above_all(figure, left, 2)
    return figure, numbers


def parabola_and_trapezoid(log: Path) -> tuple[Figure, list[Number]]:
    """Figure 6.3: the distance between the two rules over the 40 000 steps of a real crash.

    log : physycom text
    """
    runs = {
        rule: recon.run("thesis", log, **{"integrator.motion.rule": rule, "integrator.motion.zero_at_stops": False})
        for rule in ("parabola", "trapezoid")
    }
    tables = {rule: run.trajectory.table for rule, run in runs.items()}
    t_s = seconds(tables["parabola"])
    figure, rows = panels(2, 1, height=2.7, sharex=True)
    crash = np.searchsorted(time_ns(tables["parabola"]), spans(runs["parabola"].events, "crash")[0][0])
    numbers = [Number("steps", len(t_s) - 1)]
    for axes, group, unit in zip(rows, ("vel", "pos"), ("mm/s", "mm"), strict=True):
        apart = np.linalg.norm(matrix(tables["parabola"], group) - matrix(tables["trapezoid"], group), axis=1)
        axes.plot(np.arange(len(t_s)) / 1e3, 1e3 * apart, color=BLUE, lw=0.8)
        quantity = {"vel": "velocity", "pos": "position"}[group]
        axes.set_ylabel(f"{quantity} / {unit}")
        numbers.append(Number(f"largest difference of the {quantity}", 1e3 * float(apart.max()), unit))
        axes.axvline(crash / 1e3, color=VERMILLION, ls="--", lw=0.8, zorder=1, label="crash")
    rows[0].set_title("distance between PaIS and trapezoid")
    rows[0].legend(loc="upper left")
    rows[1].set(xlabel="steps / 1000", xlim=(0.0, len(t_s) / 1e3))
    return figure, numbers


def _irregular(rate_hz: float, seed: int) -> Array:
    """Times (n,) s, whole nanoseconds, at a rate with jitter."""
    t_s = np.arange(0.0, DURATION_S, 1.0 / rate_hz)
    t_s[1:] += np.random.default_rng(seed).uniform(-JITTER, JITTER, len(t_s) - 1) / rate_hz
    return np.round(t_s * 1e9) * 1e-9


def _integrated(truth: MotionTruth, rule: str) -> Array:
    """Position (n, 3) m by integrator.motion, from the true acceleration, attitude, first position and velocity."""
    time = np.round(truth.t_s * 1e9).astype(np.int64)
    made = integrate_motion(
        imu=build(IMU, time=time, accel=rotate(conjugate(truth.q_nv), truth.acc_n), gyro=truth.gyro_v),
        attitude=build(ATTITUDE, time=time, q=truth.q_nv),
        events=None,
        gnss=build(GNSS, time=time[:1], pos=truth.pos_n[:1], vel=truth.vel_n[:1]),
        params=MotionParams(rule=rule),
    )
    return matrix(made["trajectory"], "pos")


def _distance(truth: MotionTruth, rule: str) -> Array:
    """Absolute error (n,) m."""
    return np.asarray(np.linalg.norm(_integrated(truth, rule) - truth.pos_n, axis=1))
