"""Damaged files must give rows or an error of recon: never another exception, a crash, a hang or gigabytes.

    python tests/fuzz/run.py --cases 10000 [--target NAME] [--first SEED] [--workers N]

Each case is known by its target and its seed. A failed one is seen again with
    python tests/fuzz/worker.py TARGET SEED SEED
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final, NamedTuple

from targets import TARGETS

WORKER: Final = Path(__file__).with_name("worker.py")
CASES_OF_A_WORKER: Final = 1250


class Outcome(NamedTuple):
    """What came of a case.

    told : ok, refused or failed WHY; seconds : that it took; peak_mb : most that its process had held by then beyond
    what it began with
    """

    told: str
    seconds: float = 0.0
    peak_mb: float = 0.0

    @classmethod
    def of(cls, line: str) -> Outcome:
        """From the line of a worker."""
        seconds, peak, told = line.split(" ", 2)
        return cls(told, float(seconds), float(peak))


def campaign(target: str, first: int, cases: int, worker: Path, workers: int | None) -> dict[int, Outcome]:
    """Run the cases in processes beside each other: what came of each seed."""
    last = first + cases - 1
    parts = [(start, min(start + CASES_OF_A_WORKER - 1, last)) for start in range(first, last + 1, CASES_OF_A_WORKER)]
    with ThreadPoolExecutor(workers or os.cpu_count()) as pool:
        found = list(pool.map(lambda part: stretch(target, *part, worker), parts))
    return {seed: outcome for part in found for seed, outcome in part.items()}


def stretch(target: str, first: int, last: int, worker: Path) -> dict[int, Outcome]:
    """What came of each seed; where a case took its process along, the next one begins in a new process."""
    outcomes: dict[int, Outcome] = {}
    while first <= last:
        command = [sys.executable, str(worker), target, str(first), str(last)]
        ended = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", errors="replace")
        lines = ended.stdout.splitlines()
        if not lines:
            raise SystemExit(f"the worker did not start:\n{ended.stderr}")
        outcomes |= {
            int(case.split()[1]): Outcome.of(came) for case, came in zip(lines[::2], lines[1::2], strict=False)
        }
        if len(lines) % 2:
            died = int(lines[-1].split()[1])
            outcomes[died] = Outcome(f"failed its process ended with {ended.returncode}: {ended.stderr[-2000:]}")
        elif ended.returncode:
            raise SystemExit(f"the worker failed:\n{ended.stderr}")
        first = max(outcomes) + 1
    return outcomes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=10_000, help="of each target")
    parser.add_argument("--target", choices=TARGETS, action="append", help="may be repeated; by default all")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--workers", type=int, help="processes beside each other; by default one for each core")
    chosen = parser.parse_args()
    any_failed = False
    for target in chosen.target or TARGETS:
        start = time.perf_counter()
        found = campaign(target, chosen.first, chosen.cases, WORKER, chosen.workers)
        print(f"{target}: {summary(found)}; {time.perf_counter() - start:.0f} s", flush=True)
        failed = {seed: outcome.told for seed, outcome in found.items() if outcome.told.startswith("failed")}
        for seed, told in sorted(failed.items()):
            print(f"  {target} {seed} {told}")
        any_failed = any_failed or bool(failed)
    raise SystemExit(any_failed)


def summary(found: dict[int, Outcome]) -> str:
    """How many came out how, what took longest, and the most memory of a process."""
    counts = Counter(outcome.told.partition(" ")[0] for outcome in found.values())
    told = f"{counts['ok']} gave rows, {counts['refused']} were refused, {counts['failed']} failed"
    slowest = max(found, key=lambda seed: found[seed].seconds)
    peak = max(outcome.peak_mb for outcome in found.values())
    return f"{told}; slowest {found[slowest].seconds:.2f} s (seed {slowest}); peak {peak:.0f} MB"


if __name__ == "__main__":
    main()
