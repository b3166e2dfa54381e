"""Damaged files must give rows or an error of recon: never another exception, a crash, a hang or gigabytes.

    python tests/fuzz/run.py --cases 10000 [--target NAME] [--first SEED]

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
from typing import Final

from targets import TARGETS

WORKER: Final = Path(__file__).with_name("worker.py")
CASES_OF_A_WORKER: Final = 1250


def campaign(target: str, first: int, cases: int, worker: Path) -> tuple[Counter[str], dict[int, str]]:
    """Run the cases in processes beside each other: how many came out how, and by seed what failed."""
    last = first + cases - 1
    parts = [(start, min(start + CASES_OF_A_WORKER - 1, last)) for start in range(first, last + 1, CASES_OF_A_WORKER)]
    counts: Counter[str] = Counter()
    failed: dict[int, str] = {}
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for outcomes in pool.map(lambda part: stretch(target, *part, worker), parts):
            counts.update(line.partition(" ")[0] for line in outcomes.values())
            failed |= {seed: line for seed, line in outcomes.items() if line.startswith("failed")}
    return counts, failed


def stretch(target: str, first: int, last: int, worker: Path) -> dict[int, str]:
    """What came of each seed; where a case took its process along, the next one begins in a new process."""
    outcomes: dict[int, str] = {}
    while first <= last:
        command = [sys.executable, str(worker), target, str(first), str(last)]
        ended = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", errors="replace")
        lines = ended.stdout.splitlines()
        if not lines:
            raise SystemExit(f"the worker did not start:\n{ended.stderr}")
        outcomes |= {int(case.split()[1]): came for case, came in zip(lines[::2], lines[1::2], strict=False)}
        if len(lines) % 2:
            died = int(lines[-1].split()[1])
            outcomes[died] = f"failed its process ended with {ended.returncode}: {ended.stderr[-2000:]}"
        elif ended.returncode:
            raise SystemExit(f"the worker failed:\n{ended.stderr}")
        first = max(outcomes) + 1
    return outcomes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=10_000, help="of each target")
    parser.add_argument("--target", choices=TARGETS, action="append", help="may be repeated; by default all")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    chosen = parser.parse_args()
    any_failed = False
    for target in chosen.target or TARGETS:
        start = time.perf_counter()
        counts, failed = campaign(target, chosen.first, chosen.cases, WORKER)
        took = time.perf_counter() - start
        told = f"{counts['ok']} gave rows, {counts['refused']} were refused, {len(failed)} failed"
        print(f"{target}: {told}; {took:.0f} s", flush=True)
        for seed, line in sorted(failed.items()):
            print(f"  {target} {seed} {line}")
        any_failed = any_failed or bool(failed)
    raise SystemExit(any_failed)


if __name__ == "__main__":
    main()
