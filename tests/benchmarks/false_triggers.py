"""How often detector.crash finds a crash where there is none: on real drives, and on simulated rough ones.

    python tests/benchmarks/false_triggers.py [--drives 40] [--logs FOLDER] [--workers 2]

Real drives are those of the folder of test logs (RECON_TEST_DATA) in which nobody crashed. Simulated ones are drives in
town and country of a quarter of an hour, box at any angle, 100 to 400 Hz, with a shaking vehicle and, every hundred
metres on average, a pothole, kerb, slammed door, hard braking, speed bump, railway crossing, stretch of gravel or
dropped phone, all of random strength but braking and falls.
Prints kilometres, triggers, and the rate per 1000 km that is not exceeded with 95 % (Poisson; without a trigger that is
the rule of three).
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from sys import path as places
from typing import Any, Final

import numpy as np
import pyarrow as pa
import yaml

places.insert(0, str(Path(__file__).parents[1]))

import crash_pulses as pulses

import recon
from recon.numerics.geodesy import STANDARD_GRAVITY as G
from recon.numerics.geodesy import geodesic
from recon.numerics.rotation import normalize, rotate
from recon.schema import IMU
from recon.tables import Array, build, has, matrix, time_ns, vector
from recon_detectors.crash import CrashParams, crash
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams

MAPPINGS: Final = Path(__file__).parents[1] / "plugins" / "csv_mappings"
REAL: Final[tuple[tuple[str, tuple[str, ...], str], ...]] = (
    ("comma2k19_example", ("seg40",), ""),
    ("balzer82_dresden", ("2014-03-26-000-Data.csv",), "dresden_car"),
    ("balzer82_dresden", ("2014-02-14-data_from_karanchawla.csv",), "dresden_car"),
    ("balzer82_dresden", ("2016-08-09-Motorbike.csv",), "dresden_motorbike"),
    ("neu_boston_car/first_test", ("town_imu.csv", "town_gps.csv"), "boston_car"),
    ("neu_boston_car/circle", ("circle_imu.csv", "circle_gps.csv"), "boston_car"),
    ("neu_boston_car2", ("circle_data_0_imu.csv", "circle_data_0_gps.csv"), "boston_car2"),
    ("navego_canada", ("data",), ""),
    ("formats/rosbag1", ("test1.bag",), ""),
    ("driver_behavior_br/17", ("acelerometro_terra.csv", "giroscopio_terra.csv"), "driver_behavior"),
    ("driver_behavior_br/21", ("acelerometro_terra.csv", "giroscopio_terra.csv"), "driver_behavior"),
    ("formats/gpmf", ("max-heromode.mp4",), ""),
    ("accidetec_scooter", ("Normaldrive.tsv",), "scooter"),
)
"""Folder, files, and the mapping of their columns where they have no format of their own."""
MADE: Final = (
    ("navego_synthetic", (".",), ""),
    ("sim_urban_gnssinssim", ("imu.csv", "gnss.csv"), "urban"),
)
"""The same, of drives that others simulated."""
EVERY_M: Final = 100.0
LEAST_STEP_M: Final = 1.0
INSULTS: Final[Mapping[str, Callable[[Array], Array]]] = {
    "pothole": pulses.pothole,
    "kerb": pulses.kerb,
    "door slam": pulses.door_slam,
    "hard braking": pulses.hard_braking,
    "speed bump": pulses.speed_bump,
    "railway crossing": pulses.railway_crossing,
    "gravel": pulses.gravel,
    "phone drop": pulses.phone_drop,
}
SHAKING: Final = (0.8, 0.8, 2.0)
"""m/s^2, sigma of what the road does to the body of a vehicle on a bad road: forward, left, up."""


@dataclass(frozen=True)
class Found:
    """A drive: way, None where the log does not tell it; number of insults, of those told as a fall, of crashes."""

    name: str
    km: float | None
    minutes: float
    insults: int
    falls: int
    crashes: int


def logged(logs: Path, folder: str, files: tuple[str, ...], mapping: str) -> Found:
    """A drive of the folder of logs."""
    columns = yaml.safe_load((MAPPINGS / f"{mapping}.yaml").read_text(encoding="utf-8")) if mapping else None
    given = {} if columns is None else {"reader.csv.columns": columns}
    streams = recon.read([logs / folder / file for file in files], **given)
    t_ns = time_ns(streams["imu"])
    name = folder if len(files) > 1 else f"{folder}/{files[0]}"
    return _found(name, streams["imu"], way_km(streams.get("gnss")), float(t_ns[-1] - t_ns[0]) * 1e-9 / 60.0, 0)


def way_km(gnss: pa.Table | None) -> float | None:
    """The integral of the speed that GNSS tells, or positions once a second, jumps of noise at rest left out."""
    if gnss is None:
        return None
    t_s = (time_ns(gnss) - time_ns(gnss)[0]) * 1e-9
    if has(gnss, "speed") or has(gnss, "vel"):
        speed = vector(gnss, "speed", gaps=True) if has(gnss, "speed") else _size(matrix(gnss, "vel", gaps=True))
        known = np.isfinite(speed)
        return float(np.trapezoid(speed[known], t_s[known])) / 1e3
    if not has(gnss, "lat"):
        return None
    place = np.stack([vector(gnss, "lat", gaps=True), vector(gnss, "lon", gaps=True)], axis=1)
    known = np.isfinite(place).all(axis=1)
    rows = np.flatnonzero(known)[np.unique(np.floor(t_s[known]), return_index=True)[1]]
    step = geodesic(place[rows[:-1], 0], place[rows[:-1], 1], place[rows[1:], 0], place[rows[1:], 1])[0]
    return float(step[step > LEAST_STEP_M].sum()) / 1e3


def _size(vel: Array) -> Array:
    return np.asarray(np.hypot(vel[:, 0], vel[:, 1]))


def rough(seed: int) -> Found:
    """A simulated drive on a bad road."""
    rng = np.random.default_rng([seed, 7])
    rate = float(rng.choice([100.0, 200.0, 400.0]))
    motion = ("city", "mixed", "country")[seed % 3]
    params = DriveParams(motion=motion, route=seed, duration=900.0, sensors="consumer_mems", imu_rate=rate, seed=seed)
    log = simulate_drive(params.model_copy(update={"mount_yaw": 0.0, "mount_pitch": 0.0, "mount_roll": 0.0}))
    t_ns, accel = time_ns(log["imu"]), matrix(log["imu"], "accel").copy()
    reference = log["reference"]
    speed = np.interp(t_ns, time_ns(reference), np.linalg.norm(matrix(reference, "vel"), axis=1))
    km = float(np.trapezoid(speed, t_ns * 1e-9)) / 1e3
    accel += rng.normal(0.0, SHAKING, accel.shape) * np.minimum(speed / 15.0, 1.5)[:, None]
    insults = 0
    for at in _places(rng, speed, t_ns):
        insults += _struck(rng, accel, at, rate)
    box = rotate(normalize(rng.standard_normal(4)), accel)
    imu = build(IMU, time=t_ns, accel=np.clip(box, -16.0 * G, 16.0 * G), gyro=matrix(log["imu"], "gyro"))
    return _found(motion, imu, km, float(t_ns[-1] - t_ns[0]) * 1e-9 / 60.0, insults)


def _places(rng: np.random.Generator, speed: Array, t_ns: Array) -> Iterator[int]:
    """Rows at which something happens, some ten seconds from each other at the least."""
    way = np.concatenate([[0.0], np.cumsum(speed[1:] * np.diff(t_ns) * 1e-9)])
    last = -np.inf
    for there in np.cumsum(rng.exponential(EVERY_M, int(2 * way[-1] / EVERY_M) + 10)):
        row = int(np.searchsorted(way, there))
        if row < len(t_ns) and (t_ns[row] - last) * 1e-9 > 3.0:
            last = float(t_ns[row])
            yield row


def _struck(rng: np.random.Generator, accel: Array, at: int, rate: float) -> bool:
    """Add an insult at a row, in place; phones drop seldom. False where it does not fit into the log."""
    name = str(rng.choice(list(INSULTS), p=[0.25, 0.1, 0.15, 0.15, 0.15, 0.1, 0.07, 0.03]))
    t_s = pulses.times(rate)
    first = at - int(pulses.ZERO_S * rate)
    if first < 0 or first + len(t_s) > len(accel):
        return False
    here = slice(first, first + len(t_s))
    change = INSULTS[name](t_s) - pulses.at_rest(t_s)
    if name == "phone drop":  # in the air it feels nothing of the vehicle
        flying = np.abs(change).any(axis=1)
        accel[here][flying] = INSULTS[name](t_s)[flying]
        return True
    accel[here] += change * (1.0 if name == "hard braking" else rng.uniform(0.5, 1.3))
    return True


def _found(name: str, imu: pa.Table, km: float | None, minutes: float, insults: int) -> Found:
    kinds = [row["kind"] for row in crash(imu=imu, params=CrashParams())["events"].to_pylist()]
    return Found(name, km, minutes, insults, kinds.count("fall"), kinds.count("crash"))


def bound(triggers: int, km: float) -> float:
    """Per 1000 km, what the rate does not exceed with 95 %."""
    from scipy.special import gammaincinv

    return float(gammaincinv(triggers + 1, 0.95)) / km * 1000.0


def table(drives: list[Found]) -> Iterator[str]:
    """Markdown, a row each, and the sum of those whose way is known."""
    yield "| drive | km | minutes | potholes, kerbs, doors, braking | falls | triggers |"
    yield "|---|---|---|---|---|---|"
    for drive in drives:
        km = "not told" if drive.km is None else f"{drive.km:.2f}"
        yield f"| {drive.name} | {km} | {drive.minutes:.1f} | {drive.insults} | {drive.falls} | {drive.crashes} |"


def total(name: str, drives: list[Found]) -> str:
    """The sum in a sentence."""
    known = [drive for drive in drives if drive.km is not None]
    km, triggers = sum(drive.km or 0.0 for drive in known), sum(drive.crashes for drive in known)
    minutes = sum(drive.minutes for drive in drives)
    return (
        f"{name}: {triggers} triggers in {km:.1f} km and {minutes:.0f} minutes: below {bound(triggers, km):.0f} "
        f"in 1000 km with 95 %"
    )


def main() -> None:
    """Run what the command line asks for and print it."""
    options: Any = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--drives", type=int, default=40)
    options.add_argument("--workers", type=int, default=1)
    options.add_argument("--logs", type=Path, default=os.environ.get("RECON_TEST_DATA"))
    asked = options.parse_args()
    if asked.logs is not None:
        drives, made = ([logged(Path(asked.logs), *log) for log in some] for some in (REAL, MADE))
        print("\n".join(table([*drives, *made])))
        print(total("real drives", drives))
        print(total("drives that others simulated", made))
    with ProcessPoolExecutor(asked.workers, mp_context=get_context("spawn")) as pool:
        bad = list(pool.map(rough, range(asked.drives)))
    counted = sum(drive.insults for drive in bad)
    print(total(f"simulated bad roads with {counted} potholes, kerbs, doors, braking and dropped phones", bad))
    print(f"of these {sum(drive.falls for drive in bad)} were told as falls")


if __name__ == "__main__":
    main()
