"""recon's pipelines and the alternatives on the same drives: errors, honesty, time, memory; a table and a figure.

    python tests/benchmarks/quality.py [--seeds 5] [--minutes 10] [--logs FOLDER] [--figure quality.png] [--json FILE]

Every program gets the same samples and fixes, in a process of its own on one thread, after a minute of a drive to warm
up, which is neither timed nor counted. What it is told besides stands in TOLD. The table shows medians over the drives
and from best to worst; memory is what the process grows by, libraries included. Sigmas of positions are what a program
tells of them itself, in the same time: of GTSAM the marginals of its graph, of the filters their covariance. With
--resume only what is not in the file of --json, or failed, is measured. gtsam and ahrs are left out where they are not
installed (`pip install recon-dynamics[bench]`), the real drive where no folder of logs is named (RECON_TEST_DATA).
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
from accuracy_rows import real
from accuracy_rows.cases import FIRST, drive_of
from accuracy_rows.scoring import estimate_of
from peers.drives import Drive, Estimate
from peers.scores import in_outage
from peers.simulated import simulated

from recon import api
from recon.errors import ConfigError
from recon.numerics.consistency import consistency
from recon.numerics.geodesy import Anchor
from recon.numerics.rotation import Floats, conjugate, multiply, to_euler
from recon.numerics.rotation_series import slerp
from recon.numerics.signals import interpolate, wrap_angle
from recon.parameters import NoParams
from recon.pipeline import Pipeline
from recon.recording import Recording
from recon.registry import Registry
from recon.tables import Streams, matrix, time_ns, vector
from recon_readers.comma2k19 import read
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams

PIPELINES: Final = ("best_accuracy", "smartphone", "thesis")
PEERS: Final = {"gtsam_batch": "gtsam", "ekf_rts": None, "ahrs_kalman": "ahrs"}
"""By name, the package that each needs."""
TOLD: Final = {
    "best_accuracy": "nothing",
    "smartphone": "nothing",
    "thesis": "nothing",
    "gtsam_batch": "first attitude, size of every noise, lever of the antenna",
    "ekf_rts": "first attitude, size of every noise, lever, rear axle, mounting",
    "ahrs_kalman": "first attitude, size of every noise, lever",
}
KINDS: Final[Mapping[str, Mapping[str, Any]]] = {
    "consumer, town": {"sensors": "consumer_mems", "motion": "city"},
    "study_two, mixed": {"sensors": "study_two", "motion": "mixed"},
    "automotive, country": {"sensors": "automotive", "motion": "country"},
}
REAL: Final = "comma2k19, 60 s"
_OUTAGE_S: Final = 30.0
_HONEST: Final = (0.12, 2.79)
"""NEES of an honest program on 19 of 20 drives: chi-square over its four degrees, which slow errors of GNSS leave."""
_COLORS: Final = dict(zip(TOLD, ("#0072B2", "#56B4E9", "#CC79A7", "#009E73", "#E69F00", "#D55E00"), strict=True))


@dataclass(frozen=True)
class Case:
    """A drive as recon and the peers take it, and the truth. vehicle : is its attitude that of the vehicle?"""

    streams: Streams
    drive: Drive
    truth: Estimate
    anchor: Anchor
    start_ns: int


@dataclass(frozen=True)
class Job:
    """One program on one drive. number : seed, or variant of the real drive."""

    program: str
    kind: str
    number: int
    seconds: float
    logs: str = ""


_WARM_UP: Final = Job("", "consumer, town", 0, 60.0)


@dataclass(frozen=True)
class Result:
    """horizontal, worst : m, over the drive (rms) and the largest in outages; velocity : m/s; heading : deg

    within : share of horizontal components within two told sigmas; nees : mean square of them over their sigmas, 1 if
        honest; NaN where no sigmas are told
    wall_s : s; memory : MB; failed : why there is none
    """

    horizontal: float = np.nan
    worst: float = np.nan
    velocity: float = np.nan
    heading: float = np.nan
    within: float = np.nan
    nees: float = np.nan
    wall_s: float = np.nan
    memory: float = np.nan
    failed: str = ""


def case_of(job: Job) -> Case:
    """The drive of a job, with what peers are told of it."""
    return _real_case(job) if job.kind == REAL else _simulated_case(job)


def _simulated_case(job: Job) -> Case:
    shape = dict(KINDS[job.kind])
    outages = tuple((share * job.seconds, share * job.seconds + _OUTAGE_S) for share in (0.35, 0.7))
    given = outages if job.seconds > 4.0 * _OUTAGE_S else ()
    params: DriveParams = drive_of(FIRST + job.number, job.seconds, gnss_vector=True, outages=given, **shape)
    streams = simulate_drive(params)
    drive, truth = simulated(params)
    anchor = Anchor(float(np.degrees(params.lat)), float(np.degrees(params.lon)), params.height)
    vehicle = replace(truth, q_ns=multiply(truth.q_ns, conjugate(drive.mount_q_vs)))
    return Case(streams, drive, vehicle, anchor, int(time_ns(streams["imu"])[0]))


def _real_case(job: Job) -> Case:
    """A minute of comma2k19 at one fix a second, twenty seconds of it without."""
    streams = read(Path(job.logs) / real.SEGMENT, NoParams())
    imu = streams["imu"]
    start_ns = int(time_ns(imu)[0])
    starts, phases = (12.0, 18.0, 24.0, 30.0), (0.0, 0.3, 0.6)
    begin, phase = [(start, phase) for start in starts for phase in phases][job.number % 12]
    gnss = real._cut(streams["gnss"], start_ns, begin, phase)
    anchor = Anchor(*(float(vector(gnss, name)[0]) for name in ("lat", "lon", "height")))
    truth = estimate_of(streams["reference"], anchor, start_ns)
    return Case({"imu": imu, "gnss": gnss}, real._told(imu, gnss, anchor, truth), truth, anchor, start_ns)


def solved(program: str, case: Case) -> tuple[Estimate, Floats | None]:
    """The trajectory, its attitude that of the vehicle, and told sigmas of the position (n, 3)."""
    if program in PEERS:
        module = __import__(f"peers.{program}", fromlist=["solve"])
        found = module.solve(case.drive)
        return replace(found, q_ns=multiply(found.q_ns, conjugate(case.drive.mount_q_vs))), found.pos_std_n
    given = Recording({name: case.streams[name] for name in ("imu", "gnss")})
    pipeline = Pipeline.from_file(program)
    run = api.execute(pipeline, given, None, [], registry=Registry.installed())
    table = run.trajectory.table
    known = "pos_std_e" in table.column_names and table["pos_std_e"].null_count < table.num_rows
    sigma = matrix(table, "pos_std", gaps=True) if known else None
    found = estimate_of(table, case.anchor, case.start_ns)
    if program == "smartphone":  # its attitude is that of the phone
        found = replace(found, q_ns=multiply(found.q_ns, conjugate(case.drive.mount_q_vs)))
    return found, sigma


def scored(case: Case, found: Estimate, sigma: Floats | None) -> Result:
    """Errors at the rows that the truth spans."""
    use = (found.t_s >= case.truth.t_s[0]) & (found.t_s <= case.truth.t_s[-1]) & np.isfinite(found.pos_n).all(axis=1)
    t_s = found.t_s[use]
    apart = found.pos_n[use] - interpolate(t_s, case.truth.t_s, case.truth.pos_n)
    speed = found.vel_n[use] - interpolate(t_s, case.truth.t_s, case.truth.vel_n)
    yaw = to_euler(found.q_ns[use])[0] - to_euler(slerp(t_s, case.truth.t_s, case.truth.q_ns))[0]
    yaw = wrap_angle(yaw)
    horizontal = np.hypot(apart[:, 0], apart[:, 1])
    lost = in_outage(t_s, case.drive.fix_t_s)
    honest = None if sigma is None else consistency(apart[:, :2], sigma[use, :2])
    return Result(
        horizontal=float(np.sqrt((horizontal**2).mean())),
        worst=float(horizontal[lost].max()) if lost.any() else np.nan,
        velocity=float(np.sqrt((speed**2).sum(axis=1).mean())),
        heading=float(np.degrees(np.sqrt(np.nanmean(yaw**2)))),
        within=np.nan if honest is None else honest.coverage[1],
        nees=np.nan if honest is None else honest.nees,
    )


def measured(job: Job, answer: Any) -> None:
    """Solve and score in this process; what came out goes into the pipe `answer`."""
    import psutil

    try:
        case, process = case_of(job), psutil.Process()
        before = process.memory_info().rss
        with _Peak(process) as peak:
            solved(job.program, case if job.kind == REAL else case_of(_WARM_UP))
            begin = time.perf_counter()
            found, sigma = solved(job.program, case)
            wall_s = time.perf_counter() - begin
        answer.send(replace(scored(case, found, sigma), wall_s=wall_s, memory=(peak.bytes - before) / 1e6))
    except Exception as error:  # a program that fails is a result
        answer.send(Result(failed=f"{type(error).__name__}: {error}"))


class _Peak:
    """The largest memory of a process while the block runs, looked at every few milliseconds."""

    def __init__(self, process: Any) -> None:
        self.process, self.bytes, self.running = process, 0, True

    def __enter__(self) -> _Peak:
        from threading import Thread

        self.thread = Thread(target=self._watch, daemon=True)
        self.thread.start()
        return self

    def _watch(self) -> None:
        while self.running:
            self.bytes = max(self.bytes, self.process.memory_info().rss)
            time.sleep(0.005)

    def __exit__(self, *_: object) -> None:
        self.running = False
        self.thread.join()
        self.bytes = max(self.bytes, self.process.memory_info().rss)


def run(job: Job) -> Result:
    """A job in a process of its own."""
    ours, theirs = multiprocessing.get_context("spawn").Pipe()
    process = multiprocessing.get_context("spawn").Process(target=measured, args=(job, theirs))
    process.start()
    theirs.close()
    try:
        found: Result = ours.recv()
    except EOFError:
        found = Result(failed="the process died")
    process.join()
    return found


def programs() -> list[str]:
    """Those that are there: pipelines that are shipped, peers that are installed."""
    found = []
    for name in PIPELINES:
        try:
            Pipeline.from_file(name)
        except ConfigError:
            continue
        found.append(name)
    return found + [name for name, package in PEERS.items() if package is None or find_spec(package)]


_COLUMNS: Final[Mapping[str, tuple[str, float, int]]] = {
    "horizontal": ("position m", 1.0, 2),
    "worst": ("worst in outages m", 1.0, 2),
    "velocity": ("velocity m/s", 1.0, 3),
    "heading": ("heading deg", 1.0, 2),
    "within": ("within 2 sigma %", 100.0, 0),
    "nees": ("NEES", 1.0, 2),
    "wall_s": ("time s", 1.0, 2),
    "memory": ("memory MB", 1.0, 0),
}


def table(found: Mapping[str, Mapping[str, Sequence[Result]]]) -> str:
    """Markdown: medians, and the best and the worst drive."""
    heads = ["drives", "program", *(head for head, _, _ in _COLUMNS.values()), "was told"]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for kind, by_program in found.items():
        for index, (name, results) in enumerate(by_program.items()):
            good = [one for one in results if not one.failed]
            cells = [_cell([getattr(one, key) for one in good], *how[1:]) for key, how in _COLUMNS.items()]
            label = f"{kind} ({len(results)})" if index == 0 else ""
            failed = f", fails on {len(results) - len(good)}" if len(good) < len(results) else ""
            bold = f"**{name}**" if name in PIPELINES else name
            lines.append("| " + " | ".join([label, bold + failed, *cells, TOLD[name]]) + " |")
    return "\n".join(lines)


def _cell(values: Sequence[float], size: float, digits: int) -> str:
    known = size * np.array([value for value in values if np.isfinite(value)])
    if not len(known):
        return "-"
    middle, low, high = (f"{value:.{digits}f}" for value in (np.median(known), known.min(), known.max()))
    return middle if low == high else f"{middle} ({low} to {high})"


def draw(path: Path, found: Mapping[str, Mapping[str, Sequence[Result]]]) -> None:
    """The errors of the table: a dot for each drive, a bar at the median."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    shown = {
        "worst": "worst position in outages [m]",
        "heading": "heading, rms [deg]",
        "nees": "NEES (grey: honest)",
        "wall_s": "time [s]",
    }
    names = list(next(iter(found.values())))
    figure = Figure(figsize=(11.0, 3.9), layout="constrained")
    for axes, (key, title) in zip(figure.subplots(1, len(shown)), shown.items(), strict=True):
        for k, name in enumerate(names):
            for row, by_program in enumerate(found.values()):
                values = np.array([getattr(one, key) for one in by_program[name] if not one.failed])
                values = values[np.isfinite(values)]
                if not len(values):
                    continue
                y = row + 0.8 * ((k + 0.5) / len(names) - 0.5)
                label = name if row == 0 else None
                axes.plot(values, np.full(len(values), y), "o", color=_COLORS[name], markersize=3.2, alpha=0.55)
                axes.plot(
                    [np.median(values)],
                    [y],
                    "|",
                    color=_COLORS[name],
                    markersize=11.0,
                    markeredgewidth=2.4,
                    label=label,
                )
        axes.set_xscale("log")
        if key == "nees":
            axes.axvspan(*_HONEST, color="#eef0f2", linewidth=0.0, zorder=0)
            axes.axvline(1.0, color="#5f6368", linewidth=1.0, zorder=0)
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xlabel(title)
        axes.set_yticks(range(len(found)), list(found) if key == "worst" else [""] * len(found))
        axes.set_ylim(len(found) - 0.5, -0.5)
        axes.grid(color="#e4e6e8", which="both", axis="x", linewidth=0.6)
        for row in range(1, len(found)):
            axes.axhline(row - 0.5, color="#9aa0a6", linewidth=0.6)
    handles = figure.axes[0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside upper center", ncols=len(names), frameon=False)
    figure.savefig(path, dpi=150)


def _plain(found: Mapping[str, Mapping[str, Sequence[Result]]]) -> dict[str, Any]:
    """JSON data; null for what is not known."""
    return {
        kind: {
            name: [{k: None if v != v else v for k, v in vars(one).items()} for one in of] for name, of in by.items()
        }
        for kind, by in found.items()
    }


def _read_back(one: Mapping[str, Any]) -> Result:
    return Result(**{key: np.nan if value is None else value for key, value in one.items()})


def main() -> None:
    """Measure, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5, help="drives of each kind")
    parser.add_argument("--minutes", type=float, default=10.0, help="of the simulated drives")
    parser.add_argument("--logs", default=os.environ.get("RECON_TEST_DATA", ""), help="folder of the real logs")
    parser.add_argument("--only", nargs="+", default=[], help="some programs alone")
    parser.add_argument("--figure", type=Path, help="file for the figure")
    parser.add_argument("--json", type=Path, help="file for every number")
    parser.add_argument("--resume", action="store_true", help="keep the results that are in it already")
    given = parser.parse_args()
    os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
    kinds = [*KINDS, *([REAL] if given.logs else [])]
    chosen = [name for name in programs() if not given.only or name in given.only]
    kept: dict[str, Any] = json.loads(given.json.read_text(encoding="utf-8")) if given.resume else {}
    found: dict[str, dict[str, list[Result]]] = {}
    for kind in kinds:
        found[kind] = {}
        for name in chosen:
            before = [_read_back(one) for one in kept.get(kind, {}).get(name, [])][: given.seeds]
            good = {number: one for number, one in enumerate(before) if not one.failed}
            jobs = [Job(name, kind, number, 60.0 * given.minutes, given.logs) for number in range(given.seeds)]
            results = found[kind][name] = [good.get(job.number) or run(job) for job in jobs]
            for number, one in enumerate(results):
                if one.failed:
                    print(f"{name} fails on {kind}, drive {number}: {one.failed}")
            if given.json:
                merged = {kind: {**kept.get(kind, {}), **of} for kind, of in {**kept, **_plain(found)}.items()}
                given.json.write_text(json.dumps(merged, indent=1), encoding="utf-8")
    print(table(found))
    if given.figure:
        draw(given.figure, found)


if __name__ == "__main__":
    main()
