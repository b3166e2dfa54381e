"""Runs the cases of one target in this process, which may die of one: `worker.py TARGET FIRST LAST`.

Before a case it prints `case SEED`, behind it `SECONDS MB ok`, `... refused` or `... failed WHY`: how long
the case took, and the most that the process has held so far beyond what it held before the first. A traceback goes to
standard error.
A case that takes longer than LONGEST_S ends the process with a traceback of where it was.
"""

from __future__ import annotations

import faulthandler
import sys
import tempfile
import time
import traceback
from pathlib import Path
from random import Random
from typing import Final

from mutations import mutate
from targets import TARGETS, Sample, Target

from recon.errors import ReconError, StageError

try:
    import resource
except ImportError:  # not POSIX: memory is not watched there
    resource = None

LONGEST_S: Final = 20.0
MOST_BYTES: Final = 2**30
"""Of memory for one case: samples are of a few ten kB."""
_MAXRSS_UNIT: Final = 1 if sys.platform == "darwin" else 1024


def main() -> None:
    name, first, last = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    target = TARGETS[name]
    samples = target.samples()
    if resource is not None:
        _limit_memory()
    before = _peak()
    for seed in range(first, last + 1):
        print(f"case {seed}", flush=True)
        with tempfile.TemporaryDirectory() as scratch:
            place = damaged(samples, Random(f"{name} {seed}"), Path(scratch))
            faulthandler.dump_traceback_later(LONGEST_S, exit=True)
            start = time.perf_counter()
            came = outcome(target, place)
            faulthandler.cancel_dump_traceback_later()
            print(f"{time.perf_counter() - start:.3f} {(_peak() - before) / 1e6:.0f} {came}", flush=True)


def damaged(samples: list[Sample], rng: Random, folder: Path) -> Path:
    """One of the samples with a file of it damaged, or lost, written into the folder: the file or folder to read."""
    sample = rng.choice(samples)
    others = [content for each in samples for content in each.values()]
    files = dict(sample)
    chosen = rng.choice(sorted(files))
    if len(files) > 1 and rng.random() < 0.05:
        del files[chosen]
    else:
        files[chosen] = mutate(files[chosen], [files[chosen], *others], rng)
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return folder if len(sample) > 1 else folder / chosen


def outcome(target: Target, place: Path) -> str:
    """What came of an attempt, as one line."""
    before = _peak()
    try:
        target.attempt(place)
        found = "ok"
    except BaseException as error:
        found = "refused"
        if fault := _fault(error):
            traceback.print_exc()
            found = f"failed {fault}"
    grown = _peak() - before
    return found if grown <= MOST_BYTES else f"failed it took {grown / 2**30:.1f} GiB of memory"


def _fault(error: BaseException) -> str:
    """Why an error is none that a user should see; "" where it is. What stages raise is wrapped by the runner."""
    link: BaseException | None = error
    while link is not None:
        if isinstance(link, MemoryError):
            return f"it asked for too much memory: {link}".replace("\n", " ")
        link = link.__cause__ or link.__context__
    if isinstance(error, ReconError) and not isinstance(error, StageError):
        return "" if str(error).strip() else "an error without a message"
    return f"{type(error).__name__}: {error}".replace("\n", " ")


def _peak() -> int:
    """Largest resident memory so far, bytes; 0 where that is not told."""
    return 0 if resource is None else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _MAXRSS_UNIT


def _limit_memory() -> None:
    """Let what is asked for beyond MOST_BYTES fail, before it harms the machine. Threads reserve some more."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() if _has_proc() else 2**32
    resource.setrlimit(resource.RLIMIT_AS, (used + 2 * MOST_BYTES, resource.RLIM_INFINITY))


def _has_proc() -> bool:
    return Path("/proc/self/statm").exists()


if __name__ == "__main__":
    faulthandler.enable()
    main()
