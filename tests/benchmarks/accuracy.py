"""How near fuser.map comes to the truth, how honest its sigmas are, and how it stands next to the peers.

    python tests/benchmarks/accuracy.py [--quick] [--only SECTION ...] [--json FILE] [--logs FOLDER]

Drives are simulated by numbers that nothing was tuned on, each in a process of its own; times are taken on one thread
with nothing beside. The command prints Markdown; FILE gets every number of every drive, angles of the section peers in
rad. FOLDER holds the real logs, by default what RECON_TEST_DATA names. gtsam is left out where it is not installed.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from math import isfinite
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

from accuracy_rows import cases, real, rivals, scoring, tables
from peers import scores

Given = TypeVar("Given")
Found = TypeVar("Found")

QUICK = cases.Size(drives=3, longest_s=600.0)
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Bench:
    """What a section needs. size : how much is measured; workers : processes; logs : folder of the real logs."""

    size: cases.Size
    workers: int
    logs: Path | None

    def over(self, work: Callable[[Given], Found], jobs: Iterable[Given], workers: int | None = None) -> list[Found]:
        """`work` done on every job, in processes that start afresh and keep to one thread."""
        with ProcessPoolExecutor(workers or self.workers, get_context("spawn")) as pool:
            return list(pool.map(work, jobs))

    def cases(self, wanted: Iterable[cases.Case]) -> dict[str, list[scoring.Row]]:
        """The scored drives of each case."""
        chosen = list(wanted)
        rows = iter(self.over(scoring.scored, [job for case in chosen for job in case.jobs]))
        return {case.name: [next(rows) for _ in case.jobs] for case in chosen}


Section = tuple[str, Any]
"""What a section prints, and its numbers."""


def accuracy(bench: Bench) -> Section:
    """Errors and honesty of fuser.map: in short, then every statistic."""
    wanted = cases.accuracy_cases(bench.size)
    found = bench.cases(wanted)
    parts = (tables.summary_table(found), tables.honesty_table(found), tables.errors_table(found, wanted))
    return "\n\n".join(parts), found


def insurance(bench: Bench) -> Section:
    """The same drives, with sigmas told or given wrong."""
    found = bench.cases(cases.insurance_cases(bench.size))
    return tables.insurance_table(found), found


def peers(bench: Bench) -> Section:
    """fuser.map and the peers on the same drives."""
    parts, numbers = [], {}
    for name, jobs in rivals.rival_jobs(bench.size).items():
        rows = bench.over(rivals.compared, jobs)
        found = {solver: [row[solver] for row in rows] for solver in rows[0]}
        parts.append(f"{name}\n\n{scores.table(found)}\n\n{rivals.ratios(found)}")
        numbers[name] = {solver: [asdict(one) for one in of] for solver, of in found.items()}
    return "\n\n".join(parts), numbers


def times(bench: Bench) -> Section:
    """Wall time, one after the other."""
    found = bench.over(rivals.timed, rivals.timing_jobs(bench.size), workers=1)
    return rivals.timing_table(found), found


def comma2k19(bench: Bench) -> Section:
    """The real segment; left out without the logs."""
    if bench.logs is None:
        return "Left out: neither --logs nor RECON_TEST_DATA names the folder of the real logs.", None
    found = bench.over(partial(real.bridged, bench.logs), real.variants(bench.size))
    return real.real_table(found), found


SECTIONS: dict[str, Callable[[Bench], Section]] = {
    "accuracy": accuracy, "insurance": insurance, "peers": peers, "times": times, "comma2k19": comma2k19,
}  # fmt: skip


def without_nan(found: Any) -> Any:
    """Nested numbers as JSON holds them: None where there is none."""
    if isinstance(found, dict):
        return {name: without_nan(value) for name, value in found.items()}
    if isinstance(found, list):
        return [without_nan(value) for value in found]
    return None if isinstance(found, float) and not isfinite(found) else found


def options() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="three drives of each kind, none longer than 10 minutes")
    parser.add_argument("--drives", type=int, help="drives of each kind")
    parser.add_argument("--minutes", type=float, help="no drive is longer")
    parser.add_argument("--only", nargs="+", choices=SECTIONS, default=list(SECTIONS), help="some sections alone")
    parser.add_argument("--json", type=Path, help="file for every number")
    parser.add_argument("--logs", type=Path, default=os.environ.get("RECON_TEST_DATA"), help="folder of the real logs")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes side by side")
    return parser.parse_args()


def main() -> None:
    """Measure and print."""
    given = options()
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    usual = QUICK if given.quick else cases.Size()
    longest_s = 60.0 * given.minutes if given.minutes else usual.longest_s
    bench = Bench(cases.Size(given.drives or usual.drives, longest_s), given.workers, given.logs)
    if longest_s < cases.HOUR:
        print(f"No drive is longer than {longest_s / 60.0:g} min, whatever its name says.\n")
    numbers = {}
    for name in given.only:
        text, numbers[name] = SECTIONS[name](bench)
        print(f"## {name}\n\n{text}\n", flush=True)
    if given.json:
        given.json.write_text(json.dumps(without_nan(numbers), indent=1, allow_nan=False), encoding="utf-8")


if __name__ == "__main__":
    main()
