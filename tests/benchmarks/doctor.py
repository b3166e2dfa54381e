"""How often the doctor is right: silent on clean drives, and naming each simulated fault with its value.

    python tests/benchmarks/doctor.py [--clean 200] [--seeds 50] [--workers 2]

Clean drives have every preset of sensors but the phone's and every kind of road, boxes mounted at any angle or lined up
to a few degrees. A box at any angle is drawn so that none of its axes happens to point up: that would be a finding, and
true. A fault counts as found if its code is contradicted with the value that was put in, within the tolerance that
stands beside it. Prints two tables in Markdown.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
import pyarrow as pa

from recon.findings import findings_in
from recon.numerics.rotation import from_rotvec, normalize, rotate, to_euler, to_matrix
from recon.rows import Metric, metrics
from recon.tables import Streams, matrix, replace, select_rows, time_ns, times, vector
from recon_analyzers.doctor import DoctorParams, examine_log
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams

PRESETS: Final = (
    *("consumer_mems", "automotive", "rtk", "industrial"),
    *("tactical", "study_one", "study_two", "perfect"),
)
ROADS: Final = ("city", "mixed", "country", "nonstop")
DURATION_S: Final = 300.0
_UPRIGHT: Final = np.cos(np.radians(25.0))
Json = dict[str, Any]


def drive(seed: int, *, lined_up: bool, **more: Any) -> DriveParams:
    """A short drive; lined_up : the box within 6 deg of the vehicle's axes, else at any angle."""
    rng = np.random.default_rng([seed, 1])
    q_vs = normalize(rng.standard_normal(4))
    while np.abs(to_matrix(q_vs)[2]).max() > _UPRIGHT:
        q_vs = normalize(rng.standard_normal(4))
    yaw, pitch, roll = np.radians(rng.uniform(-6.0, 6.0, 3)) if lined_up else map(float, to_euler(q_vs))
    road = ROADS[seed % len(ROADS)]
    shape: dict[str, Any] = {"motion": road, "route": seed, "duration": DURATION_S, "rest": 20.0}
    if "motion" in more:
        shape = {}
    box = {"mount_yaw": float(yaw), "mount_pitch": float(pitch), "mount_roll": float(roll)}
    return DriveParams(**{**shape, **box, "sensors": PRESETS[seed % len(PRESETS)], "seed": seed, **more})


def findings(streams: Streams) -> list[Json]:
    """What the doctor says."""
    given = {name: streams.get(name) for name in ("imu", "gnss", "gnss_2", "metrics")}
    return findings_in(examine_log(**given, reference=None, params=DoctorParams())["metrics"])


@dataclass(frozen=True)
class Fault:
    """One mistake.

    code : that has to be contradicted; told : what the value must be, a text or a number; within : of that number
    spoil : (streams, rng) -> streams; params : of the drive; also : codes that are contradicted with good reason
    """

    code: str
    told: str | float
    spoil: Callable[[Streams, np.random.Generator], Streams]
    within: float = 0.0
    lined_up: bool = True
    params: Mapping[str, Any] | None = None
    name: str = ""

    @property
    def title(self) -> str:
        """For tables."""
        return self.name or self.code

    def found_in(self, found: Iterable[Json]) -> bool:
        """Was it named with its value?"""
        one = next(one for one in found if one["code"] == self.code)
        if one["status"] != "contradicted":
            return False
        if isinstance(self.told, str):
            return bool(one["value"] == self.told)
        return isinstance(one["value"], int | float) and abs(one["value"] - self.told) <= self.within

    def drive(self, seed: int) -> Streams:
        """The streams with the fault in them."""
        params = {"sensors": PRESETS[seed % 7], **(self.params or {})}
        streams = _simulated(drive(seed, lined_up=self.lined_up, **params))
        return self.spoil({name: streams[name] for name in ("imu", "gnss")}, np.random.default_rng([seed, 2]))


@lru_cache(maxsize=4)
def _simulated(params: DriveParams) -> Streams:
    """Several faults are put into the same drive."""
    return simulate_drive(params)


def _nothing(streams: Streams, rng: np.random.Generator) -> Streams:
    return streams


def _imu(**by: Callable[[np.ndarray], np.ndarray]) -> Callable[[Streams, np.random.Generator], Streams]:
    """Change groups of imu."""

    def spoil(streams: Streams, rng: np.random.Generator) -> Streams:
        imu = streams["imu"]
        return {**streams, "imu": replace(imu, **{name: change(matrix(imu, name)) for name, change in by.items()})}

    return spoil


def _flipped(axis: int) -> Callable[[np.ndarray], np.ndarray]:
    return lambda values: values * np.where(np.arange(3) == axis, -1.0, 1.0)


def _swapped(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values[:, [1, 0, 2]])


def _moved(streams: Streams, rng: np.random.Generator) -> Streams:
    """The holder tips by 25 deg half way."""
    imu = streams["imu"]
    up = matrix(imu, "accel").mean(axis=0)
    level = np.cross(up, rng.standard_normal(3))
    q = from_rotvec(np.radians(25.0) * level / np.linalg.norm(level))
    late = (np.arange(imu.num_rows) > imu.num_rows // 2)[:, None]
    turned = {name: np.where(late, rotate(q, matrix(imu, name)), matrix(imu, name)) for name in ("accel", "gyro")}
    return {**streams, "imu": replace(imu, **turned)}


def _stamped(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Streams, np.random.Generator], Streams]:
    """Change the times of gnss, s since its first row."""

    def spoil(streams: Streams, rng: np.random.Generator) -> Streams:
        gnss = streams["gnss"]
        t_ns = time_ns(gnss)
        new = t_ns[0] + np.rint(1e9 * change((t_ns - t_ns[0]) * 1e-9)).astype(np.int64)
        return {**streams, "gnss": replace(gnss, time=times(new))}

    return spoil


def _jumping(t_s: np.ndarray) -> np.ndarray:
    return t_s + np.where(t_s > 0.5 * t_s[-1], 1.0, 0.0)


def _gnss(change: Callable[[pa.Table], pa.Table]) -> Callable[[Streams, np.random.Generator], Streams]:
    return lambda streams, rng: {**streams, "gnss": change(streams["gnss"])}


def _in_km_h(gnss: pa.Table) -> pa.Table:
    return replace(gnss, speed=3.6 * vector(gnss, "speed"))


def _magnetic(gnss: pa.Table) -> pa.Table:
    return replace(gnss, course=np.mod(vector(gnss, "course") - np.radians(12.0), 2.0 * np.pi))


def _anticlockwise(gnss: pa.Table) -> pa.Table:
    return replace(gnss, course=np.mod(0.5 * np.pi - vector(gnss, "course"), 2.0 * np.pi))


def _lat_lon(gnss: pa.Table) -> pa.Table:
    return replace(gnss, lat=vector(gnss, "lon"), lon=vector(gnss, "lat"))


def _other_height(streams: Streams, rng: np.random.Generator) -> Streams:
    gnss = streams["gnss"]
    return {
        **streams,
        "gnss_2": replace(gnss, height=vector(gnss, "height") - 47.0 + rng.normal(0.0, 0.5, gnss.num_rows)),
    }


def _hole(streams: Streams, rng: np.random.Generator) -> Streams:
    t_ns = time_ns(streams["imu"])
    begin = t_ns[0] + int(rng.uniform(0.2, 0.8) * (t_ns[-1] - t_ns[0]))
    return {**streams, "imu": select_rows(streams["imu"], (t_ns < begin) | (t_ns > begin + 1_000_000_000))}


def _uneven(streams: Streams, rng: np.random.Generator) -> Streams:
    t_ns = time_ns(streams["imu"])
    step = float(np.median(np.diff(t_ns)))
    return {
        **streams,
        "imu": replace(
            streams["imu"], time=times(t_ns + np.rint(rng.uniform(-0.4, 0.4, len(t_ns)) * step).astype(np.int64))
        ),
    }


def _held(streams: Streams, rng: np.random.Generator) -> Streams:
    """Rows written twice as often as the sensor measures."""
    imu = streams["imu"]
    rows = np.arange(imu.num_rows) // 2 * 2
    return {**streams, "imu": replace(imu, accel=matrix(imu, "accel")[rows], gyro=matrix(imu, "gyro")[rows])}


def _backwards(streams: Streams, rng: np.random.Generator) -> Streams:
    return {**streams, "metrics": metrics([Metric("rows_out_of_order", 7.0)])}


def _noisy(streams: Streams, rng: np.random.Generator) -> Streams:
    """White noise of 1500 ug/sqrt(Hz), ten times the class."""
    imu = streams["imu"]
    size = 1500e-6 * 9.80665 * np.sqrt(1e9 / np.median(np.diff(time_ns(imu))))
    return {**streams, "imu": replace(imu, accel=matrix(imu, "accel") + size * rng.standard_normal((imu.num_rows, 3)))}


def _clipped(values: np.ndarray) -> np.ndarray:
    return values.clip(-9.9, 9.9)


FAULTS: Final = (
    Fault("speed_unit", "km/h", _gnss(_in_km_h), lined_up=False),
    Fault("accel_unit", "g", _imu(accel=lambda a: a / 9.80665), lined_up=False),
    Fault("gyro_unit", "deg/s", _imu(gyro=np.degrees), lined_up=False),
    Fault("gravity_sign", "down", _imu(accel=np.negative), lined_up=False),
    Fault("forward_axis", "-x", _nothing, params={"mount_yaw": np.pi, "mount_pitch": 0.03, "mount_roll": 0.0}),
    Fault(
        "forward_axis",
        "+y",
        _nothing,
        params={"mount_yaw": -0.5 * np.pi, "mount_pitch": 0.0},
        name="forward_axis, sideways",
    ),
    Fault("axes", "swap x y", _imu(accel=_swapped, gyro=_swapped)),
    Fault("axes", "left-handed", _imu(accel=_flipped(1), gyro=_flipped(1)), lined_up=False, name="axes, oblique box"),
    Fault(
        "axes",
        "FUR",
        _nothing,
        params={"mount_yaw": 0.0, "mount_pitch": 0.0, "mount_roll": 0.5 * np.pi},
        name="axes, on its side",
    ),
    Fault("inverted_axis", "accel_y", _imu(accel=_flipped(1))),
    Fault("inverted_axis", "accel_x", _imu(accel=_flipped(0)), name="inverted_axis, x"),
    Fault("inverted_axis", "gyro_z", _imu(gyro=_flipped(2)), name="inverted_axis, gyro"),
    Fault("mounting", 25.0, _moved, within=5.0, lined_up=False),
    Fault("gnss_position_lag", 0.6, _nothing, 0.2, False, {"gnss_lag": 0.6, "gnss_velocity_lag": 0.0}),
    Fault("gnss_velocity_lag", 0.5, _nothing, 0.1, False, {"gnss_lag": 0.0, "gnss_velocity_lag": 0.5}),
    Fault(
        "clock_drift", 2000.0, _stamped(lambda t: 1.002 * t), within=600.0, lined_up=False, params={"duration": 600.0}
    ),
    Fault(
        "clock_drift", "jump", _stamped(_jumping), lined_up=False, params={"duration": 600.0}, name="clock_drift, jump"
    ),
    Fault("leap_seconds", 18.0, _stamped(lambda t: t + 18.0), lined_up=False),
    Fault("leap_seconds", -37.0, _stamped(lambda t: t - 37.0), lined_up=False, name="leap_seconds, TAI"),
    Fault("time_zone", 2.0, _stamped(lambda t: t + 7200.0), lined_up=False),
    Fault("heading_kind", "magnetic", _gnss(_magnetic), lined_up=False),
    Fault(
        "heading_kind",
        "anticlockwise from east",
        _gnss(_anticlockwise),
        lined_up=False,
        name="heading_kind, mathematical",
    ),
    Fault("height_datum", 47.0, _other_height, within=1.0, lined_up=False),
    Fault("lat_lon", "swapped", _gnss(_lat_lon), lined_up=False),
    Fault("gaps", 1.0, _hole, within=0.05, lined_up=False),
    Fault("jitter", 0.004, _uneven, within=0.003, lined_up=False),
    Fault("duplicates", 0.5, _held, within=0.1, lined_up=False),
    Fault("reversals", 7.0, _backwards, lined_up=False),
    Fault("clipping", 39.2266, _nothing, within=0.01, params={"motion": "crash", "accel_full_scale": 39.2266}),
    Fault("clipping", 9.9, _imu(accel=_clipped), 0.01, params={"sensors": "study_two"}, name="clipping, vibration"),
    Fault("quantisation", 1.0, _imu(accel=np.round), within=1e-6, lined_up=False),
    Fault("dead_channel", "gyro", _imu(gyro=np.zeros_like), lined_up=False),
    Fault(
        "dead_channel", "accel_y", _imu(accel=lambda a: a * np.array([1.0, 0.0, 1.0])), name="dead_channel, one axis"
    ),
    Fault("gnss_sigma", 9.4, _nothing, 3.0, False, {"sensors": "study_one", "gnss_told_sigma": 0.05}),
    Fault("noise_class", 10.0, _noisy, within=2.5, lined_up=False),
)


def _clean(seed: int) -> list[Json]:
    return findings(simulate_drive(drive(seed, lined_up=seed % 3 == 0)))


def _faulty(job: tuple[int, int]) -> tuple[bool, Json]:
    fault, seed = FAULTS[job[0]], job[1]
    found = findings(fault.drive(seed))
    return fault.found_in(found), next(one for one in found if one["code"] == fault.code)


def clean_table(found: Mapping[int, list[Json]]) -> str:
    """How often each code said what, over all drives."""
    counts = Counter((one["code"], one["status"]) for some in found.values() for one in some)
    drives = sum(any(one["status"] == "contradicted" for one in some) for some in found.values())
    total, wrong = sum(counts.values()), sum(n for (_, status), n in counts.items() if status == "contradicted")
    lines = ["| code | confirmed | contradicted | unknown |", "|---|---|---|---|"]
    for code in dict.fromkeys(code for code, _ in counts):
        cells = (str(counts[code, status]) for status in ("confirmed", "contradicted", "unknown"))
        lines.append(f"| {code} | {' | '.join(cells)} |")
    lines.append(
        f"\n{wrong} of {total} findings contradicted ({100 * wrong / total:.2f} %), in {drives} of {len(found)} drives."
    )
    return "\n".join(lines)


def main() -> None:
    """Both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clean", type=int, default=200)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", default="", help="faults whose title begins so")
    parser.add_argument("-v", action="store_true", help="print what was not as it should be")
    given = parser.parse_args()
    with ProcessPoolExecutor(given.workers) as pool:
        clean = dict(zip(range(given.clean), pool.map(_clean, range(given.clean)), strict=True))
        if clean:
            print(clean_table(clean), flush=True)
        for seed, some in clean.items():
            for one in some:
                if given.v and one["status"] == "contradicted":
                    print(seed, json.dumps({key: one[key] for key in ("code", "value", "statistic")}))
        print("\n| fault | told | found with its value |\n|---|---|---|")
        for index, fault in enumerate(FAULTS):
            if not fault.title.startswith(given.only):
                continue
            results = list(pool.map(_faulty, [(index, seed) for seed in range(given.seeds)]))
            hits = sum(hit for hit, _ in results)
            print(f"| {fault.title} | {fault.told} | {hits} of {given.seeds} |", flush=True)
            for seed, (hit, one) in enumerate(results):
                if given.v and not hit:
                    print("   ", seed, json.dumps({key: one[key] for key in ("status", "value", "statistic")}))


if __name__ == "__main__":
    main()
