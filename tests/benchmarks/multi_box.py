"""What several boxes in one vehicle gain: places found, and attitude from three boxes in place of one.

    python tests/benchmarks/multi_box.py [--seeds 10] [--sensors consumer_mems]

Simulated drives of ten minutes, each on a route of its own, with boxes of one kind 1.5 m apart in mountings and clocks
that aligner.boxes does not know. "Minute" is how far attitude has gone from the truth after a minute of the gyroscopes
alone, their bias taken from the quietest seconds: root mean square of the ten minutes. "Map" is that of fuser.map with
GNSS, but for its mean in the vehicle, which is the error of the mounting that it found and the same for any number of
boxes of one kind. Alone is the first box.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa

sys.path.insert(0, str(Path(__file__).parents[1]))

from box_drives import Boxes, boxes

from recon import matrix, seconds, time_ns
from recon.numerics.box_clocks import Inertial
from recon.numerics.boxes import quiet_rate
from recon.numerics.rotation import (
    Floats,
    angle,
    compose,
    conjugate,
    from_euler,
    from_rotvec,
    multiply,
    slerp,
    to_rotvec,
)
from recon_aligners.boxes import BoxesParams, align_boxes
from recon_fusers.map import declare_fusers
from recon_fusers.virtual_imu import VirtualImuParams, virtual_imu

_MINUTE_S = 60.0


def merged(drive: Boxes) -> tuple[pa.Table, dict[str, float]]:
    """The virtual IMU of three boxes, and how far the places found are from the truth: deg, ms, cm, the worst."""
    first, second, third = drive.imus
    aligned = align_boxes(imu=first, imu_2=second, imu_3=third, imu_4=None, params=BoxesParams())
    told = {row["name"]: row["value"] for row in aligned["metrics"].to_pylist()}
    worst = {"deg": 0.0, "ms": 0.0, "cm": 0.0}
    for number in (2, 3):
        lever = np.array([told[f"imu_{number}_lever_arm_{axis}"] for axis in "xyz"])
        found = {
            "deg": float(np.degrees(angle(_turn(told, number), drive.q_1[number - 1]))),
            "ms": 1e3 * abs(told[f"imu_{number}_lag"] - drive.lags_s[number - 1]),
            "cm": 100.0 * float(np.abs(lever - drive.levers[number - 1]).max()),
        }
        worst = {unit: max(value, found[unit]) for unit, value in worst.items()}
    boxes_2_and_3 = {name: aligned[name] for name in ("imu_2", "imu_3")}
    return virtual_imu(imu=first, **boxes_2_and_3, imu_4=None, params=VirtualImuParams())["imu"], worst


def _turn(told: dict[str, float], number: int) -> Floats:
    return from_euler(*(np.radians(told[f"imu_{number}_{name}"]) for name in ("yaw", "pitch", "roll")))


def minute_error(imu: pa.Table, ideal: pa.Table) -> float:
    """How far the gyroscopes' attitude goes in a minute from that of a box without error: deg."""
    attitudes = []
    for table in (imu, ideal):
        box = Inertial(time_ns(table), matrix(table, "gyro"), matrix(table, "accel"))
        rate = box.gyro - quiet_rate(box)
        turns = 0.5 * (rate[1:] + rate[:-1]) * np.diff(seconds(table))[:, None]
        attitudes.append(compose(from_rotvec(turns), np.array([1.0, 0.0, 0.0, 0.0])))
    step = int(np.searchsorted(seconds(imu), _MINUTE_S))
    apart = [multiply(conjugate(q[:-step]), q[step:]) for q in attitudes]
    return float(np.degrees(np.sqrt(np.mean(angle(*apart) ** 2))))


def map_error(imu: pa.Table, drive: Boxes) -> float:
    """Root mean square of the attitude's error of fuser.map, but for its mean in the vehicle: deg."""
    (stage,) = declare_fusers()
    streams = dict.fromkeys(stage.reads) | {"imu": imu, "gnss": drive.streams["gnss"]}
    found = stage.run(**streams, params=stage.params())["trajectory"]
    truth = drive.streams["reference"]
    q_nv = slerp(time_ns(found), time_ns(truth), matrix(truth, "q"))
    error_v = to_rotvec(multiply(conjugate(q_nv), matrix(found, "q", gaps=True)))
    return float(np.degrees(np.sqrt(np.nansum(np.nanvar(error_v, axis=0)))))


def main() -> None:
    """Print a row for each seed, and medians."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--sensors", default="consumer_mems")
    given = parser.parse_args()
    heads = ("deg", "ms", "cm", "minute alone", "minute three", "map alone", "map three")
    print("seed", *heads, sep="  ")
    rows = []
    for seed in range(given.seeds):
        drive = boxes(seed, 3, sensors=given.sensors)
        ideal = boxes(seed, 1, sensors="perfect").imus[0]
        three, worst = merged(drive)
        pair = drive.imus[0], three
        rows.append(
            [*worst.values(), *(minute_error(one, ideal) for one in pair), *(map_error(one, drive) for one in pair)]
        )
        print(
            f"{seed:4d}", *(f"{value:{len(head)}.3f}" for value, head in zip(rows[-1], heads, strict=True)), flush=True
        )
    found = np.array(rows)
    print("median", *(f"{value:.3f}" for value in np.median(found, axis=0)))
    for name, alone, three in (("minute", 3, 4), ("map", 5, 6)):
        ratio = found[:, three] / found[:, alone]
        print(f"{name}: three over alone {np.median(ratio):.2f}, lower in {(ratio < 1).sum()} of {len(ratio)}")


if __name__ == "__main__":
    main()
