"""What a barometer, a map of heights and the wheels add to `fuser.map`, on simulated drives whose truth is known.

    python tests/benchmarks/aids.py [--drives 10] [--only barometer map outages end poor]

    barometer   country roads, 15 minutes, GNSS tells no vertical velocity; windows and tunnels move the pressure six
                times an hour; RMS error of the height, and the same but for its mean (barometer, climbs): the mean is
                that of GNSS, of which no barometer knows; and that of what is not told to roll on wheels, whose
                pitch tells climbs (no wheels)
    map         the same, the heights of a map wrong by 1 m each (white), and by 12 m on a bridge of 20 s; the level of
                the map is that of GNSS, or is known (map, level)
    outages     town and country, an outage of 60 s each five minutes: the speed of the wheels, and beside it the angle
                of the steering wheel. Horizontal RMS error in the outages: all of it, most of which is the slow error
                of GNSS before and after; and what the outage added to that
    end         the same, one outage, the last four minutes, after which no fix comes
    poor        as outages, with a gyroscope of ten to twenty times the noise and the walk of `consumer_mems`

A row is a drive: error of GNSS itself, without the aid, with it.
"""

from __future__ import annotations

import argparse
from functools import partial

import numpy as np
import pyarrow as pa

from recon.numerics.geodesy import Anchor, geodetic_to_enu
from recon.numerics.signals import interpolate
from recon.schema import GROUND
from recon.tables import build, time_ns, vector
from recon_fusers.map import MapParams, fuse_map
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams

Row = tuple[float, float, float]


def rms(values: np.ndarray) -> float:
    """Root mean square, NaN left out."""
    return float(np.sqrt(np.nanmean(np.square(values))))


def fused(
    drive: dict[str, pa.Table], level: float | None = None, wheels: bool = True, **aids: pa.Table | None
) -> pa.Table:
    """The trajectory."""
    params = MapParams(ground_level=level, wheels=wheels)
    given = {"wheel": None, "baro": None, "ground": None, **aids}
    found = fuse_map(imu=drive["imu"], gnss=drive["gnss"], attitude=None, events=None, params=params, **given)
    return found["trajectory"]


def height_error(table: pa.Table, reference: pa.Table) -> np.ndarray:
    """Height less the true one, (n,) m."""
    return vector(table, "height") - interpolate(time_ns(table), time_ns(reference), vector(reference, "height"))


def hills(seed: int) -> dict[str, pa.Table]:
    """A drive on country roads with a barometer."""
    return simulate_drive(
        DriveParams(
            motion="country", duration=900.0, imu_rate=50.0, seed=seed, route=seed, gnss_vector=False, baro_rate=10.0,
            baro_jump_rate=6.0 / 3600.0,
        )
    )  # fmt: skip


def barometer(seed: int) -> np.ndarray:
    """Heights with a barometer, how they change, and heights of what is not told to roll on wheels: (3, 3) m."""
    drive = hills(seed)
    gnss, rolls, loose = (
        [height_error(table, drive["reference"]) for table in tables]
        for tables in (
            [drive["gnss"]],
            [fused(drive, baro=baro) for baro in (None, drive["baro"])],
            [fused(drive, wheels=False, baro=baro) for baro in (None, drive["baro"])],
        )
    )
    rows = ((rms, rolls), (spread, rolls), (rms, loose))
    return np.array([[each(error) for error in gnss + errors] for each, errors in rows])


def spread(values: np.ndarray) -> float:
    """Root mean square but for the mean."""
    return rms(values - np.nanmean(values))


def ground_of(drive: dict[str, pa.Table], seed: int) -> pa.Table:
    """What a map would say of the ground below the fixes: the truth, 1 m wrong, and a bridge."""
    gnss, reference = drive["gnss"], drive["reference"]
    at = time_ns(gnss)
    lat, lon, height = (
        interpolate(at, time_ns(reference), vector(reference, name)) for name in ("lat", "lon", "height")
    )
    known = np.isfinite(height)
    noise = np.random.default_rng(seed).standard_normal(len(at))
    since = (at - time_ns(reference)[0]) * 1e-9
    height = height + noise - 12.0 * ((since > 300.0) & (since < 320.0))
    flat = np.zeros(int(known.sum()))
    return build(
        GROUND, time=at[known], lat=lat[known], lon=lon[known], height=height[known], slope_e=flat, slope_n=flat,
        height_std=flat + 1.0,
    )  # fmt: skip


def map_of_heights(seed: int, level: float | None = None) -> Row:
    """Heights with a map."""
    drive = hills(seed)
    reference = drive["reference"]
    errors = (height_error(fused(drive, level, ground=ground), reference) for ground in (None, ground_of(drive, seed)))
    return (rms(height_error(drive["gnss"], reference)), *map(rms, errors))


WITHIN = ((240.0, 300.0), (540.0, 600.0), (840.0, 900.0))
LAST = ((720.0, 960.0),)


def place_errors(found: pa.Table, reference: pa.Table, spans: tuple[tuple[float, float], ...]) -> tuple[float, float]:
    """Horizontal, RMS over the spans, m: all of it, and what came since the last fix, in a line to the next if any."""
    place = Anchor(*(float(vector(reference, name)[0]) for name in ("lat", "lon", "height")))
    true, here = (
        geodetic_to_enu(*(vector(table, name) for name in ("lat", "lon", "height")), place)[:, :2]
        for table in (reference, found)
    )
    apart, t_s = here - true, (time_ns(reference) - time_ns(reference)[0]) * 1e-9
    whole, added = [], []
    for start, stop in spans:
        part = apart[(t_s > start) & (t_s < stop)]
        share = np.linspace(0.0, 1.0, len(part))[:, None] if stop < t_s[-1] else 0.0
        whole.append(part)
        added.append(part - (1.0 - share) * part[0] - share * part[-1])
    return rms(np.linalg.norm(np.vstack(whole), axis=1)), rms(np.linalg.norm(np.vstack(added), axis=1))


POOR = {"gyro_noise": np.radians(0.14), "gyro_bias_walk": np.radians(0.004)}
"""rad/s/sqrt(Hz) and rad/s/sqrt(s); consumer_mems has 0.007 deg and 0.0004 deg."""


def silent(seed: int, spans: tuple[tuple[float, float], ...], **sensors: float) -> np.ndarray:
    """Errors of places in outages without wheels, with their speed, and with the steering beside it: (3, 2) m."""
    drive = simulate_drive(
        DriveParams(
            motion="mixed", duration=960.0, imu_rate=50.0, seed=seed, route=seed, outages=spans, wheel_rate=20.0,
            steering=True, **sensors,
        )
    )  # fmt: skip
    speed = drive["wheel"].select(["time", "speed"])
    tables = (fused(drive, wheel=wheel) for wheel in (None, speed, drive["wheel"]))
    return np.array([place_errors(table, drive["reference"], spans) for table in tables])


OUTAGES = {
    "outages": partial(silent, spans=WITHIN), "end": partial(silent, spans=LAST),
    "poor": partial(silent, spans=WITHIN, **POOR),
}  # fmt: skip


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drives", type=int, default=10)
    parser.add_argument("--only", nargs="*", help="names of cases")
    options = parser.parse_args()
    level = partial(map_of_heights, level=0.0)
    cases = {"map": map_of_heights, "map, level": level}
    seeds = range(1, options.drives + 1)
    if not options.only or "barometer" in options.only:
        both = np.array([barometer(seed) for seed in seeds])
        for index, name in enumerate(("barometer", "barometer, climbs", "barometer, no wheels")):
            show(name, both[:, index])
    for name, case in cases.items():
        if not options.only or name in options.only:
            show(name, np.array([case(seed) for seed in seeds]))
    for name, without_fixes in OUTAGES.items():
        if not options.only or name in options.only:
            found = np.array([without_fixes(seed) for seed in seeds])
            for kind, errors in zip(("all", "added"), np.moveaxis(found, 2, 0), strict=True):
                nothing = np.full(len(errors), np.nan)
                show(f"{name}, wheels, {kind}", np.column_stack([nothing, errors[:, :2]]))
                show(f"{name}, steering, {kind}", np.column_stack([nothing, errors[:, 1:]]))


def show(name: str, rows: np.ndarray) -> None:
    """A line: medians of GNSS, without and with, and how many drives are better."""
    better = int((rows[:, 2] < rows[:, 1]).sum())
    gnss, without, with_it = np.median(rows, axis=0)
    print(f"{name:32s} gnss {gnss:.2f}  without {without:.2f}  with {with_it:.2f} m  better in {better}", flush=True)


if __name__ == "__main__":
    main()
