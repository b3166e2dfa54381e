"""What a tunnel would cost: GNSS taken away from a log for a while, and how far the result then is from the other.

Outages of one length are placed at random, by a seed, apart from each other and from the ends of GNSS, as many as find
room; the pipeline runs over the log without their fixes. At the end of each the trajectory is compared with the log's
own `reference`, or where it holds none with what the same pipeline makes of all fixes, whose errors then both share.

Reference: Groves (2013), "Principles of GNSS, inertial, and multisensor integrated navigation systems", 2nd ed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import api
from recon.errors import DataError, NotEnoughData
from recon.evaluation import match
from recon.numerics.evaluation import errors
from recon.overrides import Override
from recon.pipeline import Pipeline
from recon.recording import Recording
from recon.registry import Registry
from recon.runner import Progress, silent
from recon.schema import unnumbered
from recon.stages import Exporter, Reader, role_of
from recon.tables import select_rows, time_ns

APART_S: Final = 30.0
"""s with fixes before, between and behind outages, in which a filter finds its biases again; in short logs"""
_SHARE: Final = 0.2
"""of them."""
_ALL: Final = "all fixes"
"""What the pipeline ran over for comparison."""
_LATE_S: Final = 2.0
"""The row that is compared must not lie further before the end of the outage."""


@dataclass(frozen=True)
class Outage:
    """Errors at the end of an outage. start_ns, end_ns : ns since 1970; way : m driven in it

    horizontal, vertical : m; velocity : m/s, of the vector; heading : deg; NaN where not known
    worst : m, the largest horizontal error inside: a smoother also knows the fixes behind the outage
    sigma : m, that the trajectory tells of its horizontal position there, root sum square of east and north
    t_s, growth : (n,) s since the start, and the horizontal error over it, m
    """

    start_ns: int
    end_ns: int
    way: float
    horizontal: float
    worst: float
    vertical: float
    velocity: float
    heading: float
    sigma: float
    t_s: NDArray[np.float64]
    growth: NDArray[np.float64]

    @property
    def length_s(self) -> float:
        """Of the outage."""
        return (self.end_ns - self.start_ns) * 1e-9


def placed(gnss: pa.Table, length_s: float, most: int, rng: np.random.Generator) -> list[tuple[int, int]]:
    """Spans without fixes, (start, end) in ns since 1970, rising.

    most : so many at most. Raises NotEnoughData where not even one finds room.
    """
    t_ns = time_ns(gnss)
    whole_s = float(t_ns[-1] - t_ns[0]) * 1e-9 if len(t_ns) else 0.0
    apart_s = min(APART_S, _SHARE * whole_s)
    free_s = whole_s - apart_s
    count = min(most, int(free_s // (length_s + apart_s)))
    if count < 1:
        needed = f"{min(length_s / (1.0 - 2.0 * _SHARE), length_s + 2.0 * APART_S):g} s of GNSS"
        raise NotEnoughData(f"GNSS for an outage of {length_s:g} s", needed=needed, found=f"{whole_s:.0f} s")
    slack = np.sort(rng.uniform(0.0, free_s - count * (length_s + apart_s), count))
    starts = t_ns[0] + np.rint(1e9 * (apart_s + slack + np.arange(count) * (length_s + apart_s))).astype(np.int64)
    return [(int(start), int(start) + round(1e9 * length_s)) for start in starts]


def without_fixes(recording: Recording, spans: Iterable[tuple[int, int]]) -> Recording:
    """The recording without the rows of every receiver inside the spans."""
    chosen = list(spans)
    cut = {}
    for name, table in recording.items():
        if unnumbered(name) == "gnss":
            t_ns = time_ns(table)
            lost = np.zeros(len(t_ns), dtype=bool)
            for start, end in chosen:
                lost |= (t_ns >= start) & (t_ns < end)
            cut[name] = select_rows(table, ~lost)
    return recording.updated(cut)


def measured(trajectory: pa.Table, truth: pa.Table, spans: Iterable[tuple[int, int]]) -> list[Outage]:
    """The errors of a trajectory that knows no fix in the spans. Raises DataError where the two have no time in common.

    truth : trajectory or reference
    """
    found = match(trajectory, truth)
    wrong, t_ns = errors(found.run, found.reference), found.run.t_ns
    apart = np.hypot(wrong.pos_n[:, 0], wrong.pos_n[:, 1])
    steps = np.linalg.norm(np.diff(found.reference.pos_n[:, :2], axis=0, prepend=found.reference.pos_n[:1, :2]), axis=1)
    outages = []
    for start, end in spans:
        first, stop = np.searchsorted(t_ns, (start, end))
        if stop == first or (end - t_ns[stop - 1]) * 1e-9 > _LATE_S:
            continue
        last, rows = stop - 1, slice(first, stop)
        outages.append(
            Outage(
                start_ns=start,
                end_ns=end,
                way=float(steps[rows].sum()),
                horizontal=float(apart[last]),
                worst=float(apart[rows].max()),
                vertical=float(abs(wrong.pos_n[last, 2])),
                velocity=float(np.linalg.norm(wrong.vel_n[last])),
                heading=float(abs(np.degrees(wrong.att[last, 2]))) if found.same_body else float("nan"),
                sigma=float(np.hypot(*found.run.pos_std[last, :2])),
                t_s=np.asarray((t_ns[rows] - start) * 1e-9),
                growth=apart[rows],
            )
        )
    return outages


@dataclass(frozen=True)
class Study:
    """Outages by their length in s; against : what they are compared with, "reference" or "all fixes"

    warnings : of the pipeline, by what it ran over: "all fixes", where that was needed, and "outages of 10 s"
    lost : why there is no result with outages of a length, by the length; of that length there are none then
    """

    outages: Mapping[float, Sequence[Outage]]
    against: str
    warnings: Mapping[str, Sequence[str]]
    lost: Mapping[float, str]

    def as_data(self) -> dict[str, Any]:
        """As JSON holds it: statistics of each length, every outage, null for what is not known."""
        return {
            "against": self.against,
            "warnings": {over: list(texts) for over, texts in self.warnings.items()},
            "lengths": [
                {"length_s": s, **statistics(some, self.against), "lost": self.lost.get(s)}
                for s, some in self.outages.items()
            ],
            "outages": [_plain(one) for some in self.outages.values() for one in some],
        }


def study(
    paths: Sequence[Path],
    pipeline: Pipeline,
    lengths: Sequence[float],
    *,
    most: int = 10,
    seed: int = 0,
    overrides: Sequence[Override] = (),
    registry: Registry | None = None,
    progress: Progress = silent,
) -> Study:
    """Outages of each length in s on a log, by a pipeline that begins with a reader; its exporters are left out.

    most : outages of each length; overrides : parameters of the pipeline; progress : told what the pipeline runs over
    A length that leaves the pipeline too little is told, the others go on. Raises as `recon.run`, NotEnoughData, also
    where every length fails.
    """
    registry = registry or Registry.installed()
    left_out = {step.id for step in pipeline.steps if role_of(step.use) == Exporter.role}
    pipeline = replace(pipeline, steps=tuple(step for step in pipeline.steps if step.id not in left_out))
    first = pipeline.steps[:1]
    names = {step.id for step in first}
    of_reader = [one for one in overrides if one.step in names or role_of(one.step) == Reader.role]
    others = [one for one in overrides if one not in of_reader and one.step not in left_out]
    reading = replace(pipeline, name="outages", steps=first)
    log = api.execute(reading, paths, None, of_reader, registry=registry).recording
    over = [*([] if "reference" in log else [_ALL]), *(_named(length) for length in lengths)]
    warnings: dict[str, list[str]] = {}

    def solve(recording: Recording, name: str) -> pa.Table:
        progress(over.index(name), len(over), name)
        run = api.execute(pipeline, recording, None, others, registry=registry)
        warnings[name] = run.warnings
        return run.trajectory.table

    outages, against, lost = simulate(log, solve, lengths, most, seed)
    return Study(outages, against, warnings, lost)


def _named(length: float) -> str:
    return f"outages of {length:g} s"


def simulate(
    recording: Recording,
    solve: Callable[[Recording, str], pa.Table],
    lengths: Sequence[float],
    most: int,
    seed: int,
) -> tuple[dict[float, list[Outage]], str, dict[float, str]]:
    """Outages of each length in s; what they are compared with, "reference" or "all fixes"; why some lengths failed.

    solve : (recording, its name) -> trajectory; most : outages of each length
    Raises NotEnoughData where there is no GNSS, DataError where all fixes or every length of outages are too little.
    """
    if "gnss" not in recording or not recording["gnss"].num_rows:
        raise NotEnoughData("GNSS to take away", needed="a stream gnss", found="none")
    known = recording.get("reference")
    truth = solve(recording, _ALL) if known is None else known
    found: dict[float, list[Outage]] = {}
    failed: dict[float, DataError] = {}
    for length in lengths:
        try:
            spans = placed(recording["gnss"], length, most, np.random.default_rng([seed, round(1000.0 * length)]))
            found[length] = measured(solve(without_fixes(recording, spans), _named(length)), truth, spans)
        except DataError as error:
            found[length], failed[length] = [], error
    if failed and len(failed) == len(found):
        raise next(iter(failed.values()))
    return found, _ALL if known is None else "reference", {length: error.message for length, error in failed.items()}


FIGURES: Final = ("horizontal", "worst", "vertical", "velocity", "heading")


def statistics(outages: Sequence[Outage], against: str) -> dict[str, Any]:
    """Median and largest of each error; how much that is of the way; the told sigma, and how many are within two.

    against : as `simulate` tells it; errors that both share are no test of a sigma
    """
    told: dict[str, Any] = {"count": len(outages), "way_m": _middle([one.way for one in outages])}
    for name in FIGURES:
        values = [getattr(one, name) for one in outages]
        told[name] = {"median": _middle(values), "max": float(np.nanmax(values)) if np.isfinite(values).any() else None}
    far = [100.0 * one.horizontal / one.way for one in outages if one.way > 1.0]
    told["drift_percent"] = _middle(far)
    ratio = np.array([one.horizontal / one.sigma for one in outages if np.isfinite(one.sigma) and one.sigma > 0.0])
    told["sigma"] = _middle([one.sigma for one in outages])
    told["within_2_sigma"] = float((ratio < 2.0).mean()) if len(ratio) and against == "reference" else None
    return told


def _plain(one: Outage) -> dict[str, Any]:
    numbers = {name: getattr(one, name) for name in (*FIGURES, "sigma", "way")}
    known = {name: value if np.isfinite(value) else None for name, value in numbers.items()}
    return {"start": f"{np.datetime64(one.start_ns, 'ns')}Z", "length_s": one.length_s, **known}


def _middle(values: Sequence[float]) -> float | None:
    known = np.array([value for value in values if np.isfinite(value)])
    return float(np.median(known)) if len(known) else None
