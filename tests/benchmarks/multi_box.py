"""What several boxes in one vehicle gain: places found, and attitude from three boxes in place of one.

    python tests/benchmarks/multi_box.py [--seeds 20] [--first 0] [--sensors consumer_mems]

Simulated drives of ten minutes, each on a route of its own, with boxes of one kind 1.5 m apart in mountings and clocks
that aligner.boxes does not know, each with an IMU and a GNSS receiver. Of the variance of errors of GNSS 70 % of
positions and 20 % of velocities is common to the receivers (see box_drives). "Minute" is how far attitude has gone from
the truth after a minute of the gyroscopes alone, their bias taken from the quietest seconds: root mean square of the
ten minutes. "Roll", "pitch" and "heading" are errors of fuser.map, "attitude" all three, but for their mean in the
vehicle, which is the error of the mounting that it found and the same for any number of boxes of one kind; "IMUs"
likewise, of three IMUs with the first receiver. "Outage" is what four minutes without GNSS, a minute apart, add to the
horizontal error: how far the way goes from that of the drive with all fixes, root mean square in these minutes. Alone
is the root mean square over the three boxes, each alone in the axes of the first with the first receiver: which of
three is the first is luck.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))

from box_drives import Boxes, boxes

from recon import matrix, seconds, select_rows, time_ns
from recon.numerics.box_clocks import Inertial
from recon.numerics.boxes import quiet_rate
from recon.numerics.rotation import Floats, angle, conjugate, from_euler, from_rotvec, multiply, to_rotvec
from recon.numerics.rotation_series import compose, slerp
from recon.schema import FURTHER_GNSS
from recon_aligners.boxes import BoxesParams, align_boxes
from recon_fusers.map import declare_fusers
from recon_fusers.virtual_imu import VirtualImuParams, virtual_imu

_MINUTE_S = 60.0
_OUTAGES_S = (120.0, 240.0, 360.0, 480.0)
"""Beginnings of minutes without GNSS."""


def placed(drive: Boxes) -> tuple[list[pa.Table], dict[str, float], list[float]]:
    """The boxes in the axes of the first, the worst of the places found (deg, ms, cm), and errors over their sigmas."""
    first, second, third = drive.imus
    aligned = align_boxes(imu=first, imu_2=second, imu_3=third, imu_4=None, params=BoxesParams())
    told = {row["name"]: row for row in aligned["metrics"].to_pylist()}
    worst, over = {"deg": 0.0, "ms": 0.0, "cm": 0.0}, []
    for number in (2, 3):
        lever = np.array([told[f"imu_{number}_lever_arm_{axis}"]["value"] for axis in "xyz"])
        apart = np.degrees(to_rotvec(multiply(_turn(told, number), conjugate(drive.q_1[number - 1]))))
        late = told[f"imu_{number}_lag"]["value"] - drive.lags_s[number - 1]
        away = lever - drive.levers[number - 1]
        found = {
            "deg": float(np.linalg.norm(apart)),
            "ms": 1e3 * abs(late),
            "cm": 100.0 * float(np.abs(away).max()),
        }
        worst = {unit: max(value, found[unit]) for unit, value in worst.items()}
        names = ("yaw", "lag", *(f"lever_arm_{axis}" for axis in "xyz"))
        sigma = [told[f"imu_{number}_{name}"]["sigma"] for name in names]
        over += [*(apart / sigma[0]), late / sigma[1], *(away / sigma[2:])]
    return [first, aligned["imu_2"], aligned["imu_3"]], worst, over


def merged(boxes_of_first: list[pa.Table]) -> pa.Table:
    """The virtual IMU of three boxes."""
    first, second, third = boxes_of_first
    return virtual_imu(imu=first, imu_2=second, imu_3=third, imu_4=None, params=VirtualImuParams())["imu"]


def _turn(told: dict[str, dict[str, float]], number: int) -> Floats:
    return from_euler(*(np.radians(told[f"imu_{number}_{name}"]["value"]) for name in ("yaw", "pitch", "roll")))


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


def fused(imu: pa.Table, receivers: list[pa.Table]) -> pa.Table:
    """The trajectory of fuser.map."""
    (stage,) = declare_fusers()
    fixes = dict(zip(("gnss", *FURTHER_GNSS), receivers, strict=False))
    streams = dict.fromkeys(stage.reads) | {"imu": imu} | fixes
    return stage.run(**streams, params=stage.params())["trajectory"]


def map_errors(found: pa.Table, drive: Boxes) -> list[float]:
    """Root mean squares of roll, pitch, heading and all of attitude of a trajectory, but for their means: deg."""
    truth = drive.streams["reference"]
    q_nv = slerp(time_ns(found), time_ns(truth), matrix(truth, "q"))
    error_v = to_rotvec(multiply(conjugate(q_nv), matrix(found, "q", gaps=True)))
    squares = np.nanvar(np.degrees(error_v), axis=0)
    return np.sqrt([*squares, squares.sum()]).tolist()


def outage_error(imu: pa.Table, receivers: list[pa.Table], whole: pa.Table, drive: Boxes) -> float:
    """Root mean square of the horizontal way from the trajectory of the whole drive, in minutes without GNSS: m."""
    cut = fused(imu, [select_rows(gnss, ~_silent(gnss, gnss)) for gnss in receivers])
    inside = _silent(cut, drive.streams["gnss"])
    apart = (matrix(cut, "pos", gaps=True) - matrix(whole, "pos", gaps=True))[inside, :2]
    return float(np.sqrt(np.nanmean((apart**2).sum(axis=1))))


def _silent(table: pa.Table, since: pa.Table) -> NDArray[np.bool_]:
    """The rows in the minutes without GNSS."""
    at_s = (time_ns(table) - time_ns(since)[0]) * 1e-9
    return np.any([(at_s > begin_s) & (at_s < begin_s + _MINUTE_S) for begin_s in _OUTAGES_S], axis=0)


KINDS = ("minute", "roll", "pitch", "heading", "attitude", "outage", "IMUs")


def gains(drive: Boxes, ideal: pa.Table, three_boxes: list[pa.Table]) -> tuple[list[float], list[float]]:
    """Errors of one box and of three, by kind."""
    errors = []
    three = merged(three_boxes)
    for imu, receivers in (*((imu, drive.gnss[:1]) for imu in three_boxes), (three, drive.gnss)):
        whole = fused(imu, receivers)
        found = [*map_errors(whole, drive), outage_error(imu, receivers, whole, drive)]
        errors.append([minute_error(imu, ideal), *found])
    alone = np.sqrt(np.mean(np.square(errors[:3]), axis=0)).tolist()
    return [*alone, alone[4]], [*errors[3], map_errors(fused(three, drive.gnss[:1]), drive)[3]]


def main() -> None:
    """Print a row for each seed, and medians."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="number of the first drive")
    parser.add_argument("--sensors", default="consumer_mems")
    given = parser.parse_args()
    heads = ("deg", "ms", "cm", *(f"{kind} {boxes}" for kind in KINDS for boxes in ("alone", "three")))
    print("seed", *heads, sep="  ")
    rows, over = [], []
    for seed in range(given.first, given.first + given.seeds):
        drive = boxes(seed, 3, sensors=given.sensors, receivers=True)
        ideal = boxes(seed, 1, sensors="perfect").imus[0]
        three_boxes, worst, ratios = placed(drive)
        rows.append([*worst.values(), *np.ravel(np.column_stack(gains(drive, ideal, three_boxes)))])
        over.append(ratios)
        print(
            f"{seed:4d}", *(f"{value:{len(head)}.3f}" for value, head in zip(rows[-1], heads, strict=True)), flush=True
        )
    found = np.array(rows)
    print("median", *(f"{value:.3f}" for value in np.median(found, axis=0)))
    print("worst ", *(f"{value:.3f}" for value in found[:, :3].max(axis=0)))
    by_kind = np.sqrt(np.mean(np.reshape(over, (-1, 7)) ** 2, axis=0))
    print("errors of places over their sigmas, rms: rotation, lag, lever arm", *(f"{value:.1f}" for value in by_kind))
    for index, kind in enumerate(KINDS):
        alone, three = found[:, 3 + 2 * index], found[:, 4 + 2 * index]
        ratio, pooled = three / alone, np.sqrt(np.mean(three**2) / np.mean(alone**2))
        print(
            f"{kind}: three over alone {np.median(ratio):.2f}, of all seeds together {pooled:.2f}, "
            f"lower in {(ratio < 1).sum()} of {len(ratio)}"
        )


if __name__ == "__main__":
    main()
