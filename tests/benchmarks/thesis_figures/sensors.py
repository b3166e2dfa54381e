"""Chapter 4: GNSS at rest, and the box before and after its alignment."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from matplotlib.figure import Figure

import recon
from recon.numerics.geodesy import Anchor, geodetic_to_enu
from recon.numerics.moving_window import moving_average
from recon.pipeline import Pipeline
from recon.placing import rows_during
from recon.tables import Array, matrix, meta, seconds, vector
from thesis_figures.style import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILLION, Number, legend_above_all, panels

STRAIGHT = np.radians(2.0)
"""rad/s: the road is straight below this yaw rate, as for aligner.forward."""
SHOWN_S = 60.0
"""Figure 4.3 shows the first minute."""
RADIUS_95 = float(np.sqrt(-2.0 * np.log(0.05)))
"""Radius in sigma of the circle that holds 95 % of a two-dimensional normal distribution."""


def gnss_at_rest(duration_s: float) -> tuple[Figure, list[Number]]:
    """Figure 4.1: where GNSS says that a vehicle at rest is, and how fast it seems to move.

    duration_s : s at rest
    """
    made = recon.run(
        "simulated_drive", **{"simulator.drive.motion": "rest", "simulator.drive.duration": f"{duration_s} s"}
    ).recording
    anchor = Anchor(**meta(made["reference"])["anchor"])
    gnss = recon.run(_until("filter.gnss_kinematics"), made).recording["gnss"]
    pos_n = geodetic_to_enu(vector(gnss, "lat"), vector(gnss, "lon"), vector(gnss, "height"), anchor)
    sigma = float(vector(gnss, "pos_std_e")[0])
    derived = np.hypot(vector(gnss, "vel_e"), vector(gnss, "vel_n"))
    figure, (left, right) = panels(1, 2, height=2.15, width_ratios=[1.15, 1.0])
    left.scatter(pos_n[:, 0], pos_n[:, 1], s=4, color=GREEN, linewidths=0, label="GNSS")
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    for radius, line, name in ((1.0, "-", "1 σ"), (RADIUS_95, "--", "95 %")):
        left.plot(sigma * radius * np.cos(turn), sigma * radius * np.sin(turn), line, color=BLACK, lw=0.8, label=name)
    left.plot(0.0, 0.0, "+", color=VERMILLION, ms=8, mew=1.5, label="truth")
    left.set(xlabel="east / m", ylabel="north / m", aspect="equal")
    bins = np.linspace(0.0, max(derived.max(), vector(gnss, "speed").max()), 30)
    right.hist(vector(gnss, "speed"), bins, color=BLUE, alpha=0.8, label="speed, reported")
    right.hist(derived, bins, color=ORANGE, alpha=0.8, label="speed, of positions")
    right.set(xlabel="speed at rest / (m/s)", ylabel="fixes", xlim=(0.0, bins[-1]))
    handles = [axes.get_legend_handles_labels() for axes in (left, right)]
    figure.legend(*(a + b for a, b in zip(*handles, strict=True)), loc="outside upper center", ncols=3)
    distance = np.hypot(pos_n[:, 0], pos_n[:, 1])
    return figure, [
        Number("reported sigma of each axis", sigma, "m"),
        Number("scatter of each axis, rms", float(np.sqrt(np.mean(distance**2) / 2.0)), "m"),
        Number("fixes inside the 95 % circle", 100.0 * float(np.mean(distance <= RADIUS_95 * sigma)), "%"),
        Number("largest distance from the truth", float(distance.max()), "m"),
        Number("speed at rest, reported, rms", float(np.sqrt(np.mean(vector(gnss, "speed") ** 2))), "m/s"),
        Number("speed at rest, of positions, rms", float(np.sqrt(np.mean(derived**2))), "m/s"),
    ]


@dataclass(frozen=True)
class Tilted:
    """A city drive of `duration_s` with a box that is mounted askew, at each stage of its alignment."""

    duration_s: float

    @cached_property
    def made(self) -> recon.Recording:
        """The log and its truth."""
        mount = {"mount_roll": "6 deg", "mount_pitch": "-9 deg", "mount_yaw": "25 deg"}
        given = {"duration": f"{self.duration_s} s", **mount}
        return recon.run("simulated_drive", **{f"simulator.drive.{key}": text for key, text in given.items()}).recording

    @cached_property
    def raw(self) -> recon.Run:
        """As the box feels it, without the offset of the gyroscope."""
        return recon.run(_until("filter.moving_average"), self.made)

    @cached_property
    def level(self) -> recon.Run:
        """After aligner.level_at_stops."""
        return recon.run(_until("aligner.level_at_stops"), self.made)

    @cached_property
    def forward(self) -> recon.Run:
        """After aligner.forward."""
        return recon.run(_until("aligner.forward"), self.made)


def vertical_alignment(drive: Tilted) -> tuple[Figure, list[Number]]:
    """Figure 4.3: the specific force of a tilted box before and after it is turned upright."""
    figure, rows = panels(2, 1, height=3.0, sharex=True, sharey=True)
    numbers = []
    for axes, run, title in zip(rows, (drive.raw, drive.level), ("as mounted", "levelled at stops"), strict=True):
        imu = run.recording["imu"]
        t_s, accel = seconds(imu), matrix(imu, "accel")
        shown = t_s <= SHOWN_S
        stops = rows_during(imu, run.events, "standstill")
        for start, stop in stops:
            axes.axvspan(t_s[start], t_s[stop - 1], color="#EEEEEE", lw=0, zorder=0)
        for column, (color, name) in enumerate(zip((VERMILLION, GREEN, BLUE), "xyz", strict=True)):
            axes.plot(t_s[shown], accel[shown, column], color=color, lw=0.9, label=f"${name}$")
        axes.set(title=title, xlim=(0.0, SHOWN_S))
        first = accel[slice(*stops[0])].mean(axis=0)
        tilt = np.degrees(np.arctan2(np.hypot(first[0], first[1]), first[2]))
        numbers.append(Number(f"tilt of gravity at the first stop, {title}", float(tilt), "deg"))
    rows[1].set_xlabel("time / s (grey: stops found)")
    figure.supylabel("specific force / (m/s²)", fontsize=8)
    legend_above_all(figure, rows[0], 3)
    for name, true in (("mount_roll", 6.0), ("mount_pitch", -9.0)):
        numbers.append(Number(f"{name} found ({true:g} is true, bias 20 mg)", _metric(drive.level, name), "deg"))
    return figure, numbers


def horizontal_alignment(drive: Tilted) -> tuple[Figure, list[Number]]:
    """Figure 4.5: horizontal accelerations on straight road before and after x is turned forward."""
    figure, columns = panels(1, 2, height=1.65, sharex=True, sharey=True)
    found = _metric(drive.forward, "mount_yaw")
    numbers = []
    for axes, run, title, yaw in zip(
        columns, (drive.level, drive.forward), ("levelled", "turned forward"), (found, 0.0), strict=True
    ):
        accel = _on_straight_road(run)
        axes.scatter(accel[:, 0], accel[:, 1], s=3, color=BLUE, linewidths=0, label="mean of 1 s, straight road")
        along = np.radians(-yaw)
        axes.axline((0.0, 0.0), (np.cos(along), np.sin(along)), color=VERMILLION, ls="--", lw=1.0, label="forward")
        axes.set(title=title, xlabel="$a_x$ / (m/s²)", aspect="equal", xlim=(-3.6, 3.6), ylim=(-2.0, 2.0))
        axes.set(xticks=[-3, 0, 3], yticks=[-1, 0, 1])
        axes.axhline(0.0, color=GREY, lw=0.5, zorder=0)
        numbers.append(Number(f"rms of a_y on straight road, {title}", float(accel[:, 1].std()), "m/s^2"))
    columns[0].set_ylabel("$a_y$ / (m/s²)")
    legend_above_all(figure, columns[0], 2)
    return figure, [*numbers, Number("mount_yaw found (25 is true)", found, "deg")]


def _on_straight_road(run: recon.Run) -> Array:
    """Horizontal acceleration (m, 2) m/s^2, averaged over 1 s, every 0.2 s of straight road."""
    imu = run.recording["imu"]
    window, step = 101, 20
    accel = moving_average(matrix(imu, "accel")[:, :2], window)[::step]
    yaw_rate = moving_average(vector(imu, "gyro_z"), window)[::step]
    return accel[np.abs(yaw_rate) < STRAIGHT]


def _until(use: str) -> Pipeline:
    """The thesis' pipeline up to a stage."""
    pipeline = Pipeline.from_file("thesis")
    last = [step.use for step in pipeline.steps].index(use)
    return replace(pipeline, steps=pipeline.steps[: last + 1])


def _metric(run: recon.Run, name: str) -> float:
    (value,) = (row["value"] for row in run.metrics.to_pylist() if row["name"] == name)
    return float(value)
