"""Are the sigmas of fuser.map true on real logs? Fixes are withheld from it, and held against what it then tells.

    python tests/benchmarks/withheld.py [LOG ...] [--logs FOLDER]

Every tenth fix, at random, is left out once; and all fixes, positions and velocities, of many spans of 10, 30 and 60 s,
as `recon outages` places them. A withheld fix less what the result says that GNSS would show there - the antenna's
motion, with the delay and the slow error as they were found - is divided by the root of the sum of the variance of that
and of the fix's own, as `fuser.map` found it. What the table shows of these ratios is their root mean square and the
share within 2, 95 % for honest sigmas, along the way, across it and up, of the velocity, and of the heading of the
vehicle against the course over ground above 5 m/s. Where a receiver tells no course, it is that of the fix before to
the one behind. Bursts of multipath are in it: a withheld fix is not judged by anything else.

IMU and GNSS alone are used, with nothing told but the mapping of the columns. FOLDER holds the logs, by default what
RECON_TEST_DATA names.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

import recon
from recon.driving import drive_of, impacts_of, measured, solve
from recon.errors import DataError, NotEnoughData
from recon.fixes import Observed, about, observe
from recon.numerics.signals import wrap_angle
from recon.numerics.smoothing import Estimate, Fixes
from recon.numerics.smoothing.epochs import locate, place_epochs
from recon.numerics.smoothing.measurements import COMMON, AtEpochs, Measured, at_epochs, position_rows, velocity_rows
from recon.numerics.smoothing.soa import mtv, mv
from recon.numerics.smoothing.state import (
    COMMON_SIZE,
    DRIFT,
    KNOT_SIZE,
    LAG,
    LEVER,
    MOUNT,
    POSITION,
    REAR,
    ROTATION,
    SLIP,
    VELOCITY,
    VELOCITY_LAG,
)
from recon.outages import placed
from recon.pipeline import Pipeline
from recon.recording import Recording
from recon.tables import Array, select_rows, time_ns
from recon.yaml_nodes import load_file
from recon_fusers.map import MapParams, model_of, noise_of, trust_of

LENGTHS_S: Final = (10.0, 30.0, 60.0)
SEEDS, MOST = 3, 10
"""Of where outages lie, and how many of them there are at most in one run."""
COLUMNS: Final = ("along", "across", "up", "velocity along", "velocity across", "heading")
_FAST: Final = 5.0
"""m/s from which a course is held against the heading."""
_MAPPINGS: Final = Path(__file__).parents[1] / "plugins" / "csv_mappings"

Ratios = dict[str, Array]
"""Errors over their sigmas, by column; NaN where a fix does not tell it."""


@dataclass(frozen=True)
class Case:
    """A log. files : in the folder of logs; mapping : of csv; told : parameters of fuser.map"""

    files: tuple[str, ...]
    mapping: str = ""
    told: Mapping[str, Any] = field(default_factory=dict)


_BOSTON, _DRESDEN = "neu_boston_car", "balzer82_dresden"
_MOTORBIKE: Final = (f"{_DRESDEN}/2016-08-09-Motorbike.csv",)
CASES: Final = {
    "sim_urban_gnssinssim": Case(("sim_urban_gnssinssim/imu.csv", "sim_urban_gnssinssim/gnss.csv"), "urban"),
    "navego_synthetic": Case(("navego_synthetic",)),
    "comma2k19_example": Case(("comma2k19_example/seg40",)),
    "neu_boston_car, town": Case(
        (f"{_BOSTON}/first_test/town_imu.csv", f"{_BOSTON}/first_test/town_gps.csv"), "boston_car"
    ),
    "neu_boston_car, circle": Case(
        (f"{_BOSTON}/circle/circle_imu.csv", f"{_BOSTON}/circle/circle_gps.csv"), "boston_car"
    ),
    "neu_boston_car2, circle": Case(
        ("neu_boston_car2/circle_data_0_imu.csv", "neu_boston_car2/circle_data_0_gps.csv"), "boston_car2"
    ),
    "balzer82_dresden, 2014-03-26": Case((f"{_DRESDEN}/2014-03-26-000-Data.csv",), "dresden_car"),
    "balzer82_dresden, 2014-02-14": Case((f"{_DRESDEN}/2014-02-14-data_from_karanchawla.csv",), "dresden_car"),
    "balzer82_dresden, motorbike": Case(_MOTORBIKE, "dresden_motorbike"),
    "the same, `wheels: false`": Case(_MOTORBIKE, "dresden_motorbike", {"wheels": False}),
    "physycom_crash": Case(("physycom_crash/crash_01.txt",)),
    "rtklibexplorer_walk, `wheels: false`": Case(
        ("rtklibexplorer_walk/imu_1730_sf.csv", "rtklibexplorer_walk/gnss_1730_sf.pos"), "walk", {"wheels": False}
    ),
}


class Log:
    """A log that fixes can be withheld from."""

    def __init__(self, streams: Mapping[str, pa.Table], told: Mapping[str, Any]) -> None:
        self.params = MapParams(**told)
        self.imu = measured(streams["imu"])
        self.start_ns = int(time_ns(self.imu)[0])
        crashes = recon.run(Pipeline.of("crashes", "detector.crash"), Recording(streams)).recording.get("events")
        self.impacts = impacts_of(self.imu, crashes, self.params.impact_error, self.params.slip_time)
        self.observed = self._observed(streams["gnss"])
        self.gnss = about(streams["gnss"], self.observed.anchor)

    def _observed(self, gnss: pa.Table) -> Observed:
        return observe(gnss, self.start_ns, trust_of(self.params), self.params.reported_sigmas)

    def without(self, lost: NDArray[np.bool_]) -> Ratios:
        """What the fixes in some rows of gnss err by, withheld. Raises DataError where a drive without is refused."""
        kept = self._observed(select_rows(self.gnss, ~lost))
        drive = drive_of(self.imu, None, kept, self.start_ns, self.impacts)
        found = solve(drive, model_of(self.params, None), noise_of(self.params, kept), learn_noise=True)
        return ratios(found, self.observed, lost[self.observed.row])

    def outages(self, length_s: float) -> Iterator[tuple[int, NDArray[np.bool_]]]:
        """How many there are, and which rows lie in them: for each seed. Raises NotEnoughData where none finds room."""
        t_ns = time_ns(self.gnss)
        for seed in range(SEEDS):
            rng = np.random.default_rng([seed, round(1000.0 * length_s)])
            chosen = placed(self.gnss, length_s, MOST, rng)
            yield len(chosen), np.any([(t_ns >= start) & (t_ns < end) for start, end in chosen], axis=0)

    def tenths(self) -> Iterator[tuple[int, NDArray[np.bool_]]]:
        """The same of every tenth fix, at random, until each was left out once."""
        which = np.random.default_rng(1).integers(0, 10, self.gnss.num_rows)
        for tenth in range(10):
            yield int((which[self.observed.row] == tenth).sum()), which == tenth


def read(case: Case, logs: Path) -> Log:
    """A log in the folder of logs."""
    mapping = {"reader.csv.columns": load_file(_MAPPINGS / f"{case.mapping}.yaml").plain()} if case.mapping else {}
    return Log(recon.read([logs / file for file in case.files], **mapping), case.told)


def ratios(found: Estimate, observed: Observed, lost: NDArray[np.bool_]) -> Ratios:
    """Errors of the `lost` of the fixes over the root of the variance of prediction and fix."""
    smoother, solved = found.smoother, found.solved
    fixes = replace(observed.fixes, share=np.ones(len(observed.fixes.t_s)))
    epochs = place_epochs(smoother.drive.samples, smoother.blocks, fixes.t_s + solved.moved_lag)
    inside = locate(epochs, smoother.drive.samples, solved.increments)
    here = at_epochs(solved.state, solved.ends, epochs, inside)
    position = position_rows(here, solved.state, fixes, epochs, np.zeros((3, 1)))
    velocity = velocity_rows(here, solved.state, fixes, epochs)
    at = np.flatnonzero((epochs.fix >= 0) & lost[epochs.fix])
    known = _between(found, epochs.interval[at], inside.u[at])
    fix, axes = epochs.fix[at], _along(here, solved.state.rot_vs, at)
    turned = axes if observed.kind == "vector" else np.broadcast_to(np.eye(3), axes.shape)
    out: Ratios = {}
    for names, rows, parts, noise, sigma, frame in (
        (COLUMNS[:3], position, (DRIFT, POSITION), solved.noise.position, fixes.pos_sigma[:, fix], axes),
        (COLUMNS[3:5], velocity, (VELOCITY,), solved.noise.velocity, _told(fixes)[:, fix], turned),
    ):
        error = np.einsum("nij,jn->in", frame, rows.residual[:, at])
        jacobian = frame @ _jacobian(rows, parts, at)
        spread = np.einsum("nij,njk,nik->in", jacobian, known, jacobian) + (noise**2)[:, None]
        for name, value, sure in zip(names, error / np.sqrt(spread), np.isfinite(sigma), strict=False):
            out[name] = np.where(sure, value, np.nan)
    out["heading"] = _against_course(found, observed, here, at, fix, known)
    return out


def _told(fixes: Fixes) -> Array:
    """Sigmas of velocities, none of those that are only said to be small."""
    return np.where(fixes.small_only, np.inf, fixes.vel_sigma)


def _between(found: Estimate, interval: NDArray[np.intp], u: Array) -> Array:
    """Covariances of the knot's unknowns and what is common, linear between knots: (n, 46, 46)."""
    both = np.zeros((len(found.covariance), KNOT_SIZE + COMMON_SIZE, KNOT_SIZE + COMMON_SIZE))
    both[:, :KNOT_SIZE, :KNOT_SIZE], both[:, :KNOT_SIZE, KNOT_SIZE:] = found.covariance, found.cross
    both[:, KNOT_SIZE:, :KNOT_SIZE] = found.cross.swapaxes(1, 2)
    both[:, KNOT_SIZE:, KNOT_SIZE:] = found.covariance_common
    share = u[:, None, None]
    return np.asarray((1.0 - share) * both[interval] + share * both[interval + 1])


def _jacobian(rows: Measured, parts: tuple[slice, ...], at: NDArray[np.intp]) -> Array:
    """(n, 3, 46) of rows to the unknowns, of which `parts` move what is measured one to one."""
    out = np.zeros((len(at), 3, KNOT_SIZE + COMMON_SIZE))
    for part in parts:
        out[:, :, part] = rows.along[..., at].transpose(2, 0, 1)
    out[:, :, ROTATION] = rows.turn[..., at].transpose(2, 0, 1)
    out[:, :, KNOT_SIZE + COMMON.start : KNOT_SIZE + COMMON.stop] = rows.common[:, COMMON, at].transpose(2, 0, 1)
    return out


def _along(here: AtEpochs, rot_vs: Array, at: NDArray[np.intp]) -> Array:
    """Axes along the way, across it and up: (n, 3, 3); where it hardly moves, those of the vehicle."""
    ahead = mv(here.rot[..., at], np.tile(rot_vs[0][:, None], len(at)))
    moves = np.hypot(*here.vel[:2, at]) > 1.0
    east, north = np.where(moves, here.vel[:2, at], ahead[:2])
    east, north = np.array([east, north]) / np.hypot(east, north)
    none, one = np.zeros_like(east), np.ones_like(east)
    axes = np.array([[east, north, none], [-north, east, none], [none, none, one]])
    return np.asarray(axes.transpose(2, 0, 1))


def _against_course(
    found: Estimate, observed: Observed, here: AtEpochs, at: NDArray[np.intp], fix: NDArray[np.intp], known: Array
) -> Array:
    """Course less the heading and what the antenna slips, over its sigma: (n,)."""
    state, noise = found.solved.state, found.solved.noise
    rot, speed = here.rot[..., at], np.hypot(*here.vel[:2, at])
    rate = state.rot_vs @ here.rate[:, at]
    push = state.rot_vs @ mtv(rot, here.force_n[:, at])
    ahead = mv(rot, np.tile(state.rot_vs[0][:, None], len(at)))
    arm = (state.rot_vs @ (state.common[LEVER] - state.common[REAR]))[0]
    left = rate[2] * arm / np.maximum(speed, 1.0) + state.common[SLIP] * push[1]
    if observed.kind in ("vector", "course"):
        seen = np.einsum("jin,jn->in", observed.fixes.vel_rows[..., fix], observed.fixes.vel[:, fix])
        doubt = noise.velocity[1] * _told(observed.fixes)[1, fix] / np.maximum(speed, 1.0)
        left = left + rate[2] * (state.common[LAG] + state.common[VELOCITY_LAG])
    else:
        near = np.clip(fix, 1, len(observed.fixes.t_s) - 2)
        seen, apart_s = (
            part[..., near + 1] - part[..., near - 1] for part in (observed.fixes.pos_n, observed.fixes.t_s)
        )
        slow = noise.drift[0] ** 2 * (1.0 - np.exp(-apart_s / noise.drift_tau))
        white = (noise.position[0] * observed.fixes.pos_sigma[0, fix]) ** 2
        doubt = np.sqrt(2.0 * (slow + white)) / np.maximum(np.hypot(*seen[:2]), 0.1)
    error = wrap_angle(np.arctan2(seen[0], seen[1]) - np.arctan2(ahead[0], ahead[1]) + left)
    about = np.zeros(KNOT_SIZE + COMMON_SIZE)
    about[ROTATION], about[KNOT_SIZE + MOUNT.start : KNOT_SIZE + MOUNT.stop] = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
    told = np.isfinite(doubt) & (speed > _FAST)
    return np.where(told, error / np.sqrt(np.where(told, doubt, 1.0) ** 2 + about @ known @ about), np.nan)


def rows_of(name: str, case: Case, logs: Path) -> list[list[str]]:
    """The rows of one log: every tenth fix, and outages of each length that finds room; runs that are refused not."""
    log, rows = read(case, logs), []
    for what, cuts in (("tenth", log.tenths()), *((f"{s:g} s", log.outages(s)) for s in LENGTHS_S)):
        count, found = 0, []
        with suppress(NotEnoughData):
            for number, lost in cuts:
                with suppress(DataError):
                    found.append(log.without(lost))
                    count += number
        if found:
            cells = [_cell(np.concatenate([one[column] for one in found])) for column in COLUMNS]
            rows.append([name if not rows else "", f"{what} ({count})", *cells])
    return rows


def _cell(ratio: Array) -> str:
    """Root mean square, and the share within 2."""
    known = ratio[np.isfinite(ratio)]
    return f"{np.sqrt((known**2).mean()):.2f}, {100.0 * (np.abs(known) < 2.0).mean():.0f} %" if len(known) else "-"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("names", nargs="*", metavar="LOG", help=f"of {', '.join(CASES)}; all by default")
    parser.add_argument("--logs", type=Path, default=os.environ.get("RECON_TEST_DATA"), metavar="FOLDER")
    given = parser.parse_args()
    unknown = [name for name in given.names if name not in CASES]
    if unknown or given.logs is None:
        parser.error(f"no log {unknown[0]!r}" if unknown else "give the folder of the logs: --logs FOLDER")
    head = ["log", "withheld", *COLUMNS]
    for row in (head, ["---"] * len(head)):
        print(f"| {' | '.join(row)} |")
    for name in given.names or CASES:
        for row in rows_of(name, CASES[name], given.logs):
            print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
