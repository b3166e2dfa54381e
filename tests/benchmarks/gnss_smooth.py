"""What filter.gnss_smooth gains on simulated city drives: the wander at stops, and the error in the drive.

    python tests/benchmarks/gnss_smooth.py [SEEDS [SENSORS]]

Each seed has a route of its own of 600 s; SENSORS is a preset of simulator.drive, by default `consumer_mems`. The
wander of a stop is the way that the fixes go in it, horizontally, where the truth stands; the errors are horizontal, at
the antenna of a receiver without lever arm.
"""

from __future__ import annotations

import sys
from typing import Any, NamedTuple

import numpy as np

from recon.numerics.geodesy import Anchor, geodetic_to_enu
from recon.tables import Array, matrix, meta, time_ns, vector
from recon_detectors.standstill_speed import StandstillSpeedParams, standstill_speed
from recon_filters.gnss_kinematics import GnssKinematicsParams, gnss_kinematics
from recon_filters.gnss_smooth import GnssSmoothParams, gnss_smooth
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams

SEEDS = 12


class Errors(NamedTuple):
    """m: way that fixes at stops go, in an hour of standing; horizontal error at stops and in motion, rms."""

    wander: float
    stops: float
    motion: float


def case(seed: int, duration_s: float = 600.0, sensors: str = "consumer_mems") -> tuple[Errors, Errors]:
    """Errors of the fixes without the filter and with it."""
    log = simulate_drive(
        DriveParams(
            motion="city",
            sensors=sensors,
            duration=duration_s,
            route=seed,
            seed=seed,
            lever_arm=(0.0, 0.0, 0.0),
        )
    )
    gnss = gnss_kinematics(gnss=log["gnss"], params=GnssKinematicsParams())["gnss"]
    events = standstill_speed(gnss=gnss, imu=None, params=StandstillSpeedParams())["events"]
    smooth = gnss_smooth(gnss=gnss, events=events, params=GnssSmoothParams())["gnss"]
    return errors(gnss, log["reference"]), errors(smooth, log["reference"])


def errors(gnss: Any, reference: Any) -> Errors:
    """Of the places of gnss against the truth."""
    anchor = Anchor(**meta(reference)["anchor"])
    found = geodetic_to_enu(vector(gnss, "lat"), vector(gnss, "lon"), vector(gnss, "height"), anchor)[:, :2]
    since = int(time_ns(reference)[0])
    at_s, t_s = ((time_ns(table) - since) * 1e-9 for table in (gnss, reference))
    true = np.column_stack([np.interp(at_s, t_s, column) for column in matrix(reference, "pos")[:, :2].T])
    still = np.interp(at_s, t_s, np.linalg.norm(matrix(reference, "vel"), axis=1)) < 1e-3
    both = still[1:] & still[:-1]
    way = np.linalg.norm(np.diff(found, axis=0), axis=1)[both].sum()
    hours = np.diff(at_s)[both].sum() / 3600.0
    return Errors(way / hours, _rms(found[still] - true[still]), _rms(found[~still] - true[~still]))


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def main() -> None:
    """Print a line for each seed and the medians."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else SEEDS
    cases = [case(seed, sensors=sys.argv[2] if len(sys.argv) > 2 else "consumer_mems") for seed in range(count)]
    print("seed   wander at stops, m/h     error at stops, m    error in motion, m     (without, with)")
    for seed, (raw, smooth) in enumerate(cases):
        print(f"{seed:4d} " + " ".join(f"{a:10.2f} {b:10.2f}" for a, b in zip(raw, smooth, strict=True)))
    medians = np.median(np.array(cases), axis=0)
    print("all  " + " ".join(f"{a:10.2f} {b:10.2f}" for a, b in medians.T))
    better = (np.array(cases)[:, 1] < np.array(cases)[:, 0]).sum(axis=0)
    print(f"better: wander {better[0]}, stops {better[1]}, motion {better[2]} of {len(cases)}")


if __name__ == "__main__":
    main()
