"""What the pipeline smartphone makes of a phone's fixes on simulated drives, next to best_accuracy.

    python tests/benchmarks/smartphone.py [SEEDS [PHONE ...]]

Two minutes of town, another route, sensors and fixes for each seed; the phone stands in landscape on the dashboard.

    plain      IMU `consumer_mems`, no magnetometer; fixes err by 2 m for minutes and by 1 m from fix to fix
    nine_axes  sensors `phone`: a magnetometer with hard and soft iron beside it, disturbed by what the car passes;
               fixes err by 2 m for minutes alone, of which no filter can take much

Root mean squares over east and north against the truth, at the times of the fixes; in how many drives it beats the
fixes; error of the heading.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

import recon
from recon.numerics.geodesy import Anchor, geodetic_to_enu
from recon.numerics.rotation import conjugate, from_euler, multiply, to_rotvec
from recon.numerics.rotation_series import slerp
from recon.numerics.signals import interpolate
from recon.tables import matrix, meta, time_ns, vector

SEEDS: Final = 40
TOWN: Final = {"motion": "city", "duration": "120 s", "imu_rate": "50 Hz"}
PHONES: Final[Mapping[str, Mapping[str, str]]] = {
    "plain": {
        "gnss_white_horizontal": "1 m",
        # upright on the dashboard, its long side level, turned to the driver
        "mount_roll": "90 deg",
        "mount_pitch": "5 deg",
        "mount_yaw": "-70 deg",
    },
    "nine_axes": {"sensors": "phone"},
}


class Case(NamedTuple):
    """Errors of one drive: of the fixes and of both pipelines, m; of the heading, deg; what told the heading."""

    fixes: float
    smartphone: float
    best_accuracy: float
    heading: float
    told_by: str


def drive(phone: str, seed: int, **others: str) -> recon.Run:
    """A drive as this phone sees it."""
    settings = {**TOWN, **PHONES[phone], "route": seed, "seed": seed, **others}
    return recon.run("simulated_drive", **{f"simulator.drive.{name}": value for name, value in settings.items()})


def horizontal(streams: recon.Recording, truth: recon.Run) -> float:
    """Root mean square m of what `trajectory`, else gnss, errs by in east and north at the times of the fixes."""
    reference, gnss = truth.recording["reference"], truth.recording["gnss"]
    anchor = Anchor(**meta(reference)["anchor"])
    table = streams.get("trajectory", gnss)
    pos = geodetic_to_enu(*(vector(table, name) for name in ("lat", "lon", "height")), anchor)
    here = interpolate(time_ns(gnss), time_ns(table), pos)
    error = here - interpolate(time_ns(gnss), time_ns(reference), matrix(reference, "pos"))
    return float(np.sqrt(np.nanmean((error[:, :2] ** 2).sum(axis=1))))


def raw(truth: recon.Run) -> float:
    """The same of the fixes."""
    return horizontal(recon.Recording({"gnss": truth.recording["gnss"]}), truth)


def heading_error(run: recon.Run, truth: recon.Run) -> float:
    """Root mean square deg about up of the attitude of the phone."""
    told = {row["name"]: row["value"] for row in truth.metrics.to_pylist()}
    q_vs = from_euler(*(np.radians(told[f"true_mount_{angle}"]) for angle in ("yaw", "pitch", "roll")))
    reference, attitude = truth.recording["reference"], run.recording["attitude"]
    q_ns = multiply(slerp(time_ns(attitude), time_ns(reference), matrix(reference, "q")), q_vs)
    off = to_rotvec(multiply(matrix(attitude, "q"), conjugate(q_ns)))[:, 2]
    return float(np.degrees(np.sqrt(np.nanmean(off**2))))


def case(phone: str, seed: int) -> Case:
    """One drive through both pipelines."""
    made = drive(phone, seed)
    plain, best = (recon.run(pipeline, made.recording) for pipeline in ("smartphone", "best_accuracy"))
    (method,) = (row["method"] for row in plain.metrics.to_pylist() if row["name"] == "heading")
    errors = (horizontal(run.recording, made) for run in (plain, best))
    return Case(raw(made), *errors, heading_error(plain, made), method)


def main() -> None:
    """Print a line for each phone."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("seeds", type=int, nargs="?", default=SEEDS)
    parser.add_argument("phones", nargs="*", default=list(PHONES))
    options = parser.parse_args()
    print("phone       fixes, m  smartphone, m  better in  best_accuracy, m  heading, deg  by the magnetometer, too")
    for phone in options.phones:
        cases = [case(phone, seed) for seed in range(options.seeds)]
        fixes, plain, best, heading = (
            float(np.sqrt(np.mean(np.square([one[column] for one in cases])))) for column in range(4)
        )
        better = sum(one.smartphone < one.fixes for one in cases)
        told = sum("magnetometer" in one.told_by for one in cases)
        print(
            f"{phone:10s}  {fixes:8.2f}  {plain:13.2f}  {better:3d} of {len(cases)}  {best:16.2f}  {heading:12.1f}  "
            f"{told} of {len(cases)}"
        )


if __name__ == "__main__":
    main()
