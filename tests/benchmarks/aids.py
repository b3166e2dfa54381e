"""What a barometer, a map of heights and the wheels add to `fuser.map`, on simulated drives whose truth is known.

    python tests/benchmarks/aids.py [--drives 10] [--only wheels steering]

    barometer   country roads, 15 minutes, GNSS tells no vertical velocity; windows and tunnels move the pressure six
                times an hour; RMS error of the height
    map         the same, the heights of a map wrong by 1 m each (white), and by 12 m on a bridge of 20 s; the level of
                the map is that of GNSS, or is known (map, level)
    wheels      town and country, an outage of 60 s each five minutes; horizontal RMS error in the outages; "end": one
                outage, the last four minutes, after which no fix comes
    steering    the same, the speed of the wheels without and with the angle of the steering wheel; "poor gyro": its
                bias walks by 0.01 deg/s in a second

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


def fused(drive: dict[str, pa.Table], level: float | None = None, **aids: pa.Table | None) -> pa.Table:
    """The trajectory."""
    params = MapParams(ground_level=level)
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


def barometer(seed: int) -> Row:
    """Heights with a barometer."""
    drive = hills(seed)
    reference = drive["reference"]
    errors = (height_error(fused(drive, baro=baro), reference) for baro in (None, drive["baro"]))
    return (rms(height_error(drive["gnss"], reference)), *map(rms, errors))


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


def silent(seed: int, spans: tuple[tuple[float, float], ...], **car: object) -> tuple[dict[str, pa.Table], np.ndarray]:
    """A drive with the wheels' speed and the steering, and the rows of its reference in the outages."""
    drive = simulate_drive(
        DriveParams(
            motion="mixed", duration=960.0, imu_rate=50.0, seed=seed, route=seed, outages=spans, wheel_rate=20.0,
            steering=True, **car,
        )
    )  # fmt: skip
    seconds = (time_ns(drive["reference"]) - time_ns(drive["reference"])[0]) * 1e-9
    return drive, np.any([(seconds > start) & (seconds < stop) for start, stop in spans], axis=0)


def place_error(found: pa.Table, reference: pa.Table, rows: np.ndarray) -> float:
    """Horizontal, RMS over some rows, m."""
    place = Anchor(*(float(vector(reference, name)[0]) for name in ("lat", "lon", "height")))
    true, here = (
        geodetic_to_enu(*(vector(table, name) for name in ("lat", "lon", "height")), place)
        for table in (reference, found)
    )
    return rms(np.linalg.norm((here - true)[rows, :2], axis=1))


WITHIN = ((240.0, 300.0), (540.0, 600.0), (840.0, 900.0))
LAST = ((720.0, 960.0),)
POOR = {"gyro_bias_walk": np.radians(0.01), "accel_bias_walk": 2e-3}


def wheels(seed: int, spans: tuple[tuple[float, float], ...] = WITHIN, **car: object) -> Row:
    """Places in outages with the speed of the wheels."""
    drive, rows = silent(seed, spans, **car)
    speed = drive["wheel"].select(["time", "speed"])
    return (float("nan"), *(place_error(fused(drive, wheel=w), drive["reference"], rows) for w in (None, speed)))


def steering(seed: int, spans: tuple[tuple[float, float], ...] = WITHIN, **car: object) -> Row:
    """Places in outages with the angle of the steering wheel beside the speed of the wheels."""
    drive, rows = silent(seed, spans, **car)
    speed = drive["wheel"].select(["time", "speed"])
    given = (speed, drive["wheel"])
    return (float("nan"), *(place_error(fused(drive, wheel=w), drive["reference"], rows) for w in given))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drives", type=int, default=10)
    parser.add_argument("--only", nargs="*", help="names of cases")
    options = parser.parse_args()
    level = partial(map_of_heights, level=0.0)
    cases = {
        "barometer": barometer,
        "map": map_of_heights,
        "map, level": level,
        "wheels": wheels,
        "wheels, end": partial(wheels, spans=LAST),
        "steering": steering,
        "steering, end": partial(steering, spans=LAST),
        "steering, poor gyro": partial(steering, spans=LAST, **POOR),
    }
    for name, case in cases.items():
        if options.only and name not in options.only:
            continue
        rows = np.array([case(seed) for seed in range(1, options.drives + 1)])
        better = int((rows[:, 2] < rows[:, 1]).sum())
        gnss, without, with_it = np.median(rows, axis=0)
        print(
            f"{name:20s} gnss {gnss:.2f}  without {without:.2f}  with {with_it:.2f} m  better in {better}", flush=True
        )


if __name__ == "__main__":
    main()
