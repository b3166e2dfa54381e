"""Chapter 6: the path of a city drive, its smoothness and its height, by the thesis' pipeline, by GNSS and in truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import recon
from recon.numerics.geodesy import Anchor, geodetic_to_enu
from recon.numerics.signals import interpolate
from recon.tables import Array, meta, seconds, time_ns, vector
from thesis_figures.style import BLACK, BLUE, ORANGE, VERMILLION, Number, legend_above, legend_above_all, panels

ROUTE = 4
"""A route with a hill and six stops, wider than high."""
AROUND_S = 6.0
"""The detail of the path shows this long before and after its sharpest bend."""


@dataclass(frozen=True)
class City:
    """A simulated city drive of `duration_s` with consumer sensors, and what the thesis' pipeline makes of it.

    Positions are (n, 3) m, local, from the true start.
    """

    duration_s: float

    @cached_property
    def made(self) -> recon.Recording:
        """The log and its truth."""
        given = {"simulator.drive.duration": f"{self.duration_s} s", "simulator.drive.route": ROUTE}
        return recon.run("simulated_drive", **given).recording

    @cached_property
    def trajectory(self) -> pa.Table:
        """By the thesis' pipeline: height from inertia alone."""
        return recon.run("thesis", self.made).trajectory.table

    @cached_property
    def with_gnss_height(self) -> pa.Table:
        """The same with the height averaged as the horizontal position is."""
        return recon.run("thesis", self.made, **{"fuser.weighted_average.vertical": "gnss"}).trajectory.table

    def positions(self, table: pa.Table) -> Array:
        """Of any table with lat, lon and height."""
        anchor = Anchor(**meta(self.made["reference"])["anchor"])
        return geodetic_to_enu(vector(table, "lat"), vector(table, "lon"), vector(table, "height"), anchor)

    def seconds(self, table: pa.Table) -> Array:
        """Times (n,) s since the first record."""
        return seconds(table, since=int(time_ns(self.made["imu"])[0]))

    def at_fixes(self, table: pa.Table) -> Array:
        """Positions at the times of GNSS: (fixes, 3), NaN where the table does not reach."""
        fix_ns, t_ns = time_ns(self.made["gnss"]), time_ns(table)
        return np.column_stack([interpolate(fix_ns, t_ns, column) for column in self.positions(table).T])


def path(drive: City) -> tuple[Figure, list[Number]]:
    """Figures 6.4 and 6.5: the whole path from above."""
    figure, axes = panels(height=2.0)
    _draw_path(axes, drive, (-np.inf, np.inf))
    legend_above(axes, 3)
    truth = drive.at_fixes(drive.made["reference"])
    return figure, [
        Number(f"horizontal error, rms, {name}", _rms((drive.at_fixes(table) - truth)[:, :2]), "m")
        for name, table in (("GNSS", drive.made["gnss"]), ("thesis pipeline", drive.trajectory))
    ]


def smoothness(drive: City) -> tuple[Figure, list[Number]]:
    """Figure 6.6: a bend in detail, and the acceleration that positions a second apart imply."""
    reference, gnss = drive.made["reference"], drive.made["gnss"]
    moving = np.hypot(vector(reference, "vel_e"), vector(reference, "vel_n")) > 5.0
    middle = float(drive.seconds(reference)[np.argmax(np.abs(vector(reference, "gyro_z")) * moving)])
    figure, (above, below) = panels(2, 1, height=3.6, height_ratios=[1.4, 1.0])
    _draw_path(above, drive, (middle - AROUND_S, middle + AROUND_S))
    truth = _implied(drive.at_fixes(reference))
    fix_s, numbers = drive.seconds(gnss), []
    for table, name, color in ((gnss, "GNSS", ORANGE), (drive.trajectory, "thesis pipeline", BLUE)):
        error = _implied(drive.at_fixes(table)) - truth
        below.plot(fix_s[1:-1], np.linalg.norm(error, axis=1), color=color, lw=0.9)
        numbers.append(Number(f"error of the implied acceleration, rms, {name}", _rms(error), "m/s^2"))
    below.set(xlabel="time / s", xlim=(0.0, drive.duration_s))
    below.set(ylabel="error of the implied\nacceleration / (m/s²)", ylim=(0.0, None))
    legend_above_all(figure, above, 3)
    return figure, numbers


def height(drive: City) -> tuple[Figure, list[Number]]:
    """Figure 6.7: the height over time, which the thesis leaves to inertia alone."""
    figure, axes = panels(height=2.4)
    gnss = drive.made["gnss"]
    lines = (
        (drive.made["reference"], "truth", BLACK, "-"),
        (drive.trajectory, "thesis pipeline (inertial)", BLUE, "-"),
        (drive.with_gnss_height, "the same, vertical: gnss", VERMILLION, "-"),
    )
    axes.plot(drive.seconds(gnss), drive.positions(gnss)[:, 2], ".", color=ORANGE, ms=4, label="GNSS")
    for table, name, color, line in lines:
        axes.plot(drive.seconds(table), drive.positions(table)[:, 2], line, color=color, lw=1.0, label=name)
    axes.set(xlabel="time / s", ylabel="up / m", xlim=(0.0, drive.duration_s))
    legend_above(axes, 2)
    truth = drive.at_fixes(drive.made["reference"])[:, 2]
    tables = [(gnss, "GNSS"), *((table, name) for table, name, *_ in lines[1:])]
    return figure, [
        Number(f"error of the height, rms, {name}", _rms((drive.at_fixes(table)[:, 2] - truth)[:, None]), "m")
        for table, name in tables
    ]


def _draw_path(axes: Axes, drive: City, span_s: tuple[float, float]) -> None:
    """East and north of truth, GNSS and trajectory between two times in s."""
    for table, name, color, style, size in (
        (drive.made["reference"], "truth", BLACK, "-", 1.2),
        (drive.made["gnss"], "GNSS", ORANGE, ".-", 0.8),
        (drive.trajectory, "thesis pipeline", BLUE, "-", 1.0),
    ):
        t_s = drive.seconds(table)
        shown = (t_s >= span_s[0]) & (t_s <= span_s[1])
        pos_n = drive.positions(table)[shown]
        axes.plot(pos_n[:, 0], pos_n[:, 1], style, color=color, lw=size, ms=3, label=name)
    axes.set(xlabel="east / m", ylabel="north / m")
    axes.set_aspect("equal", adjustable="datalim")


def _implied(pos_n: Array) -> Array:
    """Horizontal acceleration (n - 2, 2) m/s^2 of positions (n, 3) a second apart."""
    return np.diff(pos_n[:, :2], n=2, axis=0)


def _rms(error: Array) -> float:
    """Of the length of errors (n, k), where they are known."""
    return float(np.sqrt(np.nanmean(np.sum(error**2, axis=1))))
