"""From what length on several cores beat one at what cannot be taken sample by sample: running sums and products.

    python tests/benchmarks/parallel_scan.py [--longest 7] [--workers 4]

    sum        cumulative trapezoids of accelerations (n, 3), as integrator.motion takes them
    product    running product of quaternions (n, 4), recon.numerics.rotation_series.compose
    strapdown  quaternions from turn rates, forces turned to the local frame and summed twice

Each is done whole on one core, and as a scan over chunks: every worker scans a chunk, the last values are scanned, and
every worker joins what came before to its chunk. The workers are threads, for NumPy lets go of the interpreter's lock
in its loops. Least times of seven, of two for ten million samples: ms by the clock of one and of many, how many times
faster that is, and how many times faster it can be at most on as many free cores, by the time of all processors.

Reference: Blelloch (1990), "Prefix sums and their applications", CMU-CS-90-190, section 1.3.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np

from recon.numerics.integration import cumulative
from recon.numerics.rotation import from_rotvec, multiply, rotate
from recon.numerics.rotation_series import compose

STEP_S = 0.01
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
Scan = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, ...]]


def sums(gyro: np.ndarray, accel: np.ndarray) -> tuple[np.ndarray, ...]:
    """Running integral."""
    return (cumulative(np.arange(len(accel)) * STEP_S, accel, "trapezoid"),)


def product(gyro: np.ndarray, accel: np.ndarray) -> tuple[np.ndarray, ...]:
    """Running attitude."""
    return (compose(from_rotvec(gyro[:-1] * STEP_S), IDENTITY),)


def strapdown(gyro: np.ndarray, accel: np.ndarray) -> tuple[np.ndarray, ...]:
    """Attitude, velocity, position."""
    (q,) = product(gyro, accel)
    t_s = np.arange(len(accel)) * STEP_S
    vel = cumulative(t_s, rotate(q, accel), "trapezoid")
    return q, vel, cumulative(t_s, vel, "trapezoid")


def join_sums(before: tuple[np.ndarray, ...], part: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """A chunk behind another's end."""
    return (before[0] + part[0],)


def join_product(before: tuple[np.ndarray, ...], part: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """A chunk behind another's end."""
    return (multiply(before[0], part[0]),)


def join_strapdown(before: tuple[np.ndarray, ...], part: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """A chunk behind another's end."""
    (q0, v0, p0), (q, v, p) = before, part
    t_s = np.arange(len(q))[:, None] * STEP_S
    return multiply(q0, q), v0 + rotate(q0, v), p0 + v0 * t_s + rotate(q0, p)


def chunked(whole: Scan, join: Callable[..., tuple[np.ndarray, ...]], pool: ThreadPoolExecutor, workers: int) -> Scan:
    """The same over chunks; neighbours share a sample, as intervals do."""

    def scan(gyro: np.ndarray, accel: np.ndarray) -> tuple[np.ndarray, ...]:
        edge = np.linspace(0, len(gyro) - 1, workers + 1).astype(int)
        cuts = [slice(a, b + 1) for a, b in pairwise(edge)]
        parts = list(pool.map(lambda cut: whole(gyro[cut], accel[cut]), cuts))
        before = [tuple(rows[0] for rows in parts[0])]
        for part in parts[:-1]:
            before.append(tuple(rows[-1] for rows in join(before[-1], part)))
        joined = list(pool.map(join, before, parts))
        return tuple(
            np.concatenate([joined[0][i], *(part[i][1:] for part in joined[1:])]) for i in range(len(joined[0]))
        )

    return scan


CASES = {"sum": (sums, join_sums), "product": (product, join_product), "strapdown": (strapdown, join_strapdown)}


def least_ms(scan: Scan, gyro: np.ndarray, accel: np.ndarray, rounds: int) -> tuple[float, float]:
    """Least times of some rounds, by the clock and of all processors."""
    taken = []
    for _ in range(rounds):
        begun = time.perf_counter(), time.process_time()
        scan(gyro, accel)
        taken.append((time.perf_counter() - begun[0], time.process_time() - begun[1]))
    wall, processors = np.min(taken, axis=0)
    return 1e3 * float(wall), 1e3 * float(processors)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--longest", type=int, default=7, help="power of ten")
    parser.add_argument("--workers", type=int, default=4)
    options = parser.parse_args()
    rng = np.random.default_rng(1)
    print("samples     " + "".join(f"{name:>12s} one   many  ratio  most" for name in CASES))
    with ThreadPoolExecutor(options.workers) as pool:
        for power in range(4, options.longest + 1):
            gyro, accel = 0.3 * rng.standard_normal((2, 10**power, 3))
            shown = []
            for whole, join in CASES.values():
                many = chunked(whole, join, pool, options.workers)
                if power == 4:
                    for a, b in zip(whole(gyro, accel), many(gyro, accel), strict=True):
                        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)
                rounds = 7 if power < 7 else 2
                (one, alone), (more, together) = (least_ms(scan, gyro, accel, rounds) for scan in (whole, many))
                most = options.workers * alone / together
                shown.append(f"{one:12.2f} {more:9.2f}  {one / more:4.2f}  {most:4.2f}")
            print(f"{10**power:10d}  " + "".join(shown), flush=True)


if __name__ == "__main__":
    main()
