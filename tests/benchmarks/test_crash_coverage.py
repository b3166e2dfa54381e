"""The intervals of analyzer.crash hold the truth as often as they promise, on a few cases; the script has many."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from crash_coverage import a_pulse, tally

CASES = 80


def test_the_truth_lies_in_the_intervals_of_random_pulses() -> None:
    found = tally([a_pulse(seed) for seed in range(CASES)])
    for name, (count, inside, error, sigma) in found.items():
        # Of 80 with a chance of 0.95 fewer than 68 are inside once in two thousand times.
        assert count > 0.8 * CASES, name
        assert inside >= 68 / CASES * count, name
        # Sigmas that were twice too large would hide nothing but help nobody.
        if name not in ("time_of_max", "phd", "ridedown"):  # heavy tails: where a pulse is over decides
            assert error > 0.5 * sigma, name
