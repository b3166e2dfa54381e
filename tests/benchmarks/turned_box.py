"""What fuser.map makes of a box that turns in its mount while it is driven.

    python tests/benchmarks/turned_box.py [--seeds 32] [--first 9400] [--untouched 0]

Simulated drives of ten and twenty minutes, each on a route of its own, of four kinds. In each the box turns once to
three times, by 4 to 120 deg about any axis within 0.3 to 8 s, anywhere between an eighth of the drive and seven. Next
to it the same drive of a box that stays. Root mean squares of a drive are errors of the vehicle's attitude and of the
place. Of the drives whose heading is more than three of its sigmas off those are counted that are not warned of with
"do not trust" or "take care". `--untouched`: so many drives of ten minutes whose box nobody touched, and as many with
every fifth or seventh fix in bursts of multipath of 5 to 60 s: in how many is it taken to turn?
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from map_drives import drive, errors, fused
from turned_drives import turned

from recon import Streams, matrix
from recon.numerics.rotation import Floats, from_rotvec
from recon.rows import spans, warnings_of

_KINDS = (("country", "study_one"), ("mixed", "study_two"), ("city", "consumer_mems"), ("mixed", "automotive"))
_WARNED = ("do not trust", "take care")


def with_turns(streams: Streams, duration: float, rng: np.random.Generator) -> tuple[Streams, int]:
    """The drive with its box turned, and how often."""
    count, imu = int(rng.integers(1, 4)), streams["imu"]
    for at_s in np.sort(rng.uniform(0.12, 0.88, count)) * duration:
        size = np.radians(np.exp(rng.uniform(np.log(4.0), np.log(120.0))))
        axis = rng.normal(size=3) * [0.5, 0.5, 1.0]
        lasts_s = float(np.exp(rng.uniform(np.log(0.3), np.log(8.0))))
        imu = turned({**streams, "imu": imu}, from_rotvec(size * axis / np.linalg.norm(axis)), float(at_s), lasts_s)
    return {**streams, "imu": imu}, count


def row_of(truth: Streams, found: Streams) -> tuple[Floats, bool, bool]:
    """Heading, worse of pitch and roll in deg, horizontal m; is the heading over three sigmas off, and warned of?"""
    off = errors(truth, found)
    sizes = np.sqrt((off.turn**2).mean(axis=0))
    sigma = matrix(found["trajectory"], "att_std")
    over = np.sqrt(((off.turn[:, 2] / sigma[:, 2]) ** 2).mean())
    told = any(word in note for note in warnings_of(found["metrics"]) for word in _WARNED)
    return np.array([*np.degrees([sizes[2], sizes[:2].max()]), off.horizontal()]), bool(over > 3.0), told


def taken_to_turn(first: int, count: int, multipath: bool) -> int:
    """Drives, of boxes that stay, that are told to turn."""
    taken = 0
    for seed in range(first, first + count):
        motion, sensors = _KINDS[seed % len(_KINDS)]
        share = {"multipath": 0.2 if seed % 8 < 4 else 1.0 / 7.0, "multipath_length": (5.0, 60.0)} if multipath else {}
        taken += bool(spans(fused(drive(motion, sensors, seed, **share))["events"], "box_turned"))
    return taken


def main() -> None:
    """Print a line for each drive, and what comes out of all."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--seeds", type=int, default=32)
    options.add_argument("--first", type=int, default=9400)
    options.add_argument("--untouched", type=int, default=0)
    given = options.parse_args()
    if given.untouched:
        plain, bursts = (taken_to_turn(given.first, given.untouched, multipath) for multipath in (False, True))
        print(f"of {given.untouched} boxes that stay {plain} are taken to turn, and {bursts} in multipath")
        return
    rows: dict[str, list[Floats]] = {"turned": [], "stays": []}
    over, unwarned, as_many = 0, 0, 0
    for seed in range(given.first, given.first + given.seeds):
        rng = np.random.default_rng(seed)
        motion, sensors = _KINDS[seed % len(_KINDS)]
        duration = float(rng.choice([600.0, 1200.0]))
        log = drive(motion, sensors, seed, duration=duration)
        given_turned, count = with_turns(log, duration, rng)
        found = fused(given_turned)
        row, off, told = row_of(log, found)
        rows["turned"].append(row)
        rows["stays"].append(row_of(log, fused(log))[0])
        seen = len(spans(found["events"], "box_turned"))
        over, unwarned, as_many = over + off, unwarned + (off and not told), as_many + (seen == count)
        print(
            f"{seed} {sensors}: {count} turns, {seen} told; " + ", ".join(f"{value:.2f}" for value in row), flush=True
        )
    print(f"as many turns told as there were: {as_many}; over three sigmas off: {over}, not warned of: {unwarned}")
    for name, values in rows.items():
        table = np.array(values)
        half, most = np.median(table, axis=0), np.quantile(table, 0.8, axis=0)
        print(f"{name}: heading {half[0]:.2f} ({most[0]:.2f}) deg, pitch and roll {half[1]:.2f} ({most[1]:.2f}) deg, "
              f"H {half[2]:.2f} ({most[2]:.2f}) m: half of the drives, four of five below")  # fmt: skip


if __name__ == "__main__":
    main()
