"""fuser.map and the peers on the same drives: errors, and the wall time of each on one thread.

All are scored alike, at the times of their own choice. The peers are told more, see peers. Imports are not timed, and
neither is the drive that each solves first to warm up.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from typing import Final

import numpy as np
from peers import ekf_rts
from peers.drives import Drive, Noise, Solve
from peers.scores import Score, run
from peers.simulated import simulated

from recon.sensor_classes import typical
from recon_fusers.map import MapParams
from recon_simulators.drive import simulate_drive

from .cases import FIRST, HOUR, TEN_MINUTES, Job, Size, kind
from .scoring import fused, smoothed
from .tables import change, plain_table

OURS: Final = "fuser.map"
_KINDS: Final = (("study_one", "country"), ("study_two", "mixed"))


def peers() -> Mapping[str, Solve]:
    """The peers that are installed; GTSAM may be absent."""
    found: dict[str, Solve] = {"ekf_rts": ekf_rts.solve}
    if find_spec("gtsam"):
        from peers import gtsam_batch

        found["gtsam_batch"] = gtsam_batch.solve
        found["gtsam_scatter"] = gtsam_batch.solve_scatter
        found["gtsam_untold"] = lambda drive: gtsam_batch.solve_scatter(_untold(drive))
    return found


def _untold(drive: Drive) -> Drive:
    """Told no more than fuser.map, but for the first attitude."""
    usual = MapParams()
    return replace(drive, noise=usual_noise(usual, usual.gnss_velocity_vertical), lever_s=np.zeros(3))


def usual_noise(usual: MapParams, velocity_vertical: float) -> Noise:
    """What fuser.map begins with. velocity_vertical : sigma, m/s"""
    names = {
        "gyro": "gyro_noise", "accel": "accel_noise", "gyro_walk": "gyro_bias_walk", "accel_walk": "accel_bias_walk",
        "gyro_bias": "gyro_bias", "accel_bias": "accel_bias", "gyro_scale": "gyro_scale",
    }  # fmt: skip
    level = np.array([1.0, 1.0, 0.0])
    up = 1.0 - level
    return Noise(
        **{name: typical(usual.sensor_class, row) for name, row in names.items()},
        drift_n=usual.gnss_horizontal * level + usual.gnss_vertical * up,
        drift_s=usual.gnss_correlation,
        white_n=usual.gnss_white_horizontal * level + usual.gnss_white_vertical * up,
        velocity_n=usual.gnss_velocity * level + velocity_vertical * up,
    )


def rival_jobs(size: Size) -> dict[str, tuple[Job, ...]]:
    """Drives on which all are compared, by kind."""
    return {
        f"{sensors}, {motion}, 10 min": size.jobs(20, TEN_MINUTES, kind(sensors, motion)) for sensors, motion in _KINDS
    }


def compared(job: Job) -> dict[str, Score]:
    """The scores of fuser.map and of the peers on one drive."""
    streams = simulate_drive(job.drive)
    drive, truth = simulated(job.drive)
    ours = smoothed(job, streams, drive, truth)[2]
    return {OURS: ours, **{name: run(solve, drive, truth) for name, solve in peers().items()}}


def ratios(scores: Mapping[str, Sequence[Score]]) -> str:
    """How much smaller the errors of fuser.map are than those of each peer, in %: over all drives, and as a rule."""
    rows = []
    for name in scores:
        if name == OURS:
            continue
        cells = [name]
        for column in ("horizontal", "heading"):
            ours, theirs = (np.array([getattr(one.drive, column) for one in scores[who]]) for who in (OURS, name))
            cells += [change(np.sqrt((ours**2).mean()), np.sqrt((theirs**2).mean()))]
            cells += [change(float(np.median(ours / theirs)), 1.0)]
        rows.append(cells)
    return plain_table(["fuser.map against", "H %: rms", "median drive", "heading %: rms", "median drive"], rows)


def timing_jobs(size: Size) -> list[Job]:
    """Drives of ten minutes and of an hour."""
    lengths = dict.fromkeys(min(seconds, size.longest_s) for seconds in (TEN_MINUTES, HOUR))
    return [kind("study_two", "mixed")(FIRST, seconds) for seconds in lengths]


def timed(job: Job) -> dict[str, float]:
    """Wall time in s of each on one drive: the shortest of three, or of as many as fit into ten seconds."""
    streams = simulate_drive(job.drive)
    drive, _ = simulated(job.drive)
    known = job.fuser.model_copy(update={"estimate_noise": False})
    solvers: dict[str, Callable[[], object]] = {
        f"{OURS}, noise as given": lambda: fused(streams, known),
        f"{OURS}, noise estimated": lambda: fused(streams, job.fuser),
        **{name: lambda solve=solve: solve(drive) for name, solve in peers().items()},  # type: ignore[misc]
    }
    return {"samples": float(len(drive.t_s)), **{name: _shortest(solve) for name, solve in solvers.items()}}


def _shortest(solve: Callable[[], object]) -> float:
    times: list[float] = []
    while len(times) < 3 and sum(times) < 10.0:
        begin = time.perf_counter()
        solve()
        times.append(time.perf_counter() - begin)
    return min(times)


def timing_table(rows: Sequence[Mapping[str, float]]) -> str:
    """Seconds of each, and how many times those of fuser.map without and with estimation of the noise."""
    names = [name for name in rows[0] if name != "samples"]
    lines = []
    for name in names:
        cells = [name]
        for row in rows:
            known, learnt_noise = (row[f"{OURS}, noise {how}"] for how in ("as given", "estimated"))
            cells += [f"{row[name]:.2f}", f"{row[name] / known:.1f}", f"{row[name] / learnt_noise:.1f}"]
        lines.append(cells)
    heads = [head for row in rows for head in (f"{row['samples']:.0f} samples: s", "x as given", "x estimated")]
    return plain_table(["", *heads], lines)
