"""What filter.gyro_temperature gains over filter.gyro_offset on simulated drives with a gyroscope that warms up.

    python tests/benchmarks/gyro_temperature.py [SEEDS] [map [silence]] [hysteresis]

Each seed is a device with slopes and curvatures of its own (sigma 0.02 deg/s/K and 0.0003 deg/s/K^2 on each axis),
driven for 20 minutes on country roads, IMU `consumer_mems`. It starts at 5 to 20 degC and warms up by 15 to 30 K with 8
to 15 minutes; the thermometer has steps of 0.25 K and noise of 0.2 K. In the last two columns only the stop at the
start is known; "remembered" has seen two drives before, of other weather and another offset at power-on. The error is
what is left of the bias in motion, rms over the three axes.

With the word `map` it is fuser.map that takes the drive, with an outage of 60 s each five minutes, or with the word
`silence` with one of four minutes while it warms up: alone, whose bias walks; behind the filter with the device's
calibration, so that the bias is the model's and walks about it; and with what the temperature does taken off as it
truly is, which is the most that a model can do. The errors are then what the outages add to the place, m, and that of
the heading throughout, deg.

With the word `hysteresis` the gyroscope follows the thermometer with 300 s, and the models are those of filter.
gyro_temperature from the stops of the drive.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from aids import place_errors

from recon.numerics.rotation import to_euler
from recon.numerics.signals import wrap_angle
from recon.tables import Array, matrix, replace, seconds
from recon_detectors.standstill_speed import StandstillSpeedParams, standstill_speed
from recon_filters.gyro_offset import GyroOffsetParams, gyro_offset
from recon_filters.gyro_temperature import REFERENCE_K, GyroTemperatureParams, gyro_temperature
from recon_fusers.map import MapParams, fuse_map
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams

SEEDS = 12
LAG_S = 300.0
METHODS = ("gyro_offset", "linear", "quadratic", "first stop", "remembered")
AGAINST = {"linear": "gyro_offset", "quadratic": "gyro_offset", "remembered": "first stop"}


def warmed(seed: int, number: int, duration_s: float, late: bool = False, **more: Any) -> tuple[Any, Array]:
    """The streams, imu with temperature, and the true bias (n, 3) rad/s of the drive of this number of a device.

    late : the gyroscope follows the thermometer with LAG_S
    """
    device, rng = np.random.default_rng(seed), np.random.default_rng((seed, number))
    slope, bend = np.radians(device.normal(0.0, 0.02, 3)), np.radians(device.normal(0.0, 0.0003, 3))
    made = simulate_drive(
        DriveParams(
            motion="country",
            duration=duration_s,
            route=10 * seed + number,
            seed=10 * seed + number,
            imu_rate=50.0,
            gyro_scale=0.0,
            start=f"2024-05-{number + 1:02d}T08:00:00Z",
            **more,
        )
    )
    imu = made["imu"]
    t_s = seconds(imu)
    cold, rise, time_s = rng.uniform(5.0, 20.0), rng.uniform(15.0, 30.0), rng.uniform(480.0, 900.0)
    celsius = cold + rise * -np.expm1(-t_s / time_s)
    inside = cold + rise * (1.0 - (time_s * np.exp(-t_s / time_s) - LAG_S * np.exp(-t_s / LAG_S)) / (time_s - LAG_S))
    above = ((inside if late else celsius) - (REFERENCE_K - 273.15))[:, None]
    moved = slope * above + bend * above**2
    seen = np.round((celsius + rng.normal(0.0, 0.2, len(t_s))) / 0.25) * 0.25
    imu = replace(imu, gyro=matrix(imu, "gyro") + moved, temperature=seen + 273.15)
    return {**made, "imu": imu}, matrix(made["imu_truth"], "gyro_bias") + moved


def stops(made: Any) -> Any:
    """The stops that GNSS tells."""
    return standstill_speed(gnss=made["gnss"], imu=None, params=StandstillSpeedParams())["events"]


def warm_drive(seed: int, number: int, duration_s: float, late: bool = False) -> tuple[Any, Any, Array]:
    """imu with temperature, events, and the true bias (n, 3) rad/s in motion."""
    made, bias = warmed(seed, number, duration_s, late)
    still = np.linalg.norm(matrix(made["reference"], "vel"), axis=1) < 0.1
    return made["imu"], stops(made), np.where(still[:, None], np.nan, bias)


def learnt(seed: int, duration_s: float, folder: str) -> GyroTemperatureParams:
    """Of a device that has seen two drives before."""
    remembering = GyroTemperatureParams(calibration=str(Path(folder, "device.json")))
    for number in (0, 1):
        before = warm_drive(seed, number, duration_s)
        gyro_temperature(imu=before[0], events=before[1], params=remembering)
    return remembering


def mapped(seed: int, silence: bool, duration_s: float = 1200.0) -> dict[str, float]:
    """Errors of fuser.map without and with the model, and with the truth: horizontal in the outages m, heading deg."""
    spans = tuple((start, start + 60.0) for start in np.arange(240.0, duration_s - 60.0, 300.0).tolist())
    spans = ((180.0, 420.0),) if silence else spans
    made, bias = warmed(seed, 2, duration_s, outages=spans)
    reference = made["reference"]
    with tempfile.TemporaryDirectory() as folder:
        params = learnt(seed, duration_s, folder).model_copy(update={"between": "constant"})
        better = gyro_temperature(imu=made["imu"], events=stops(made), params=params)["imu"]
    cold = replace(made["imu"], gyro=matrix(made["imu"], "gyro") - bias + matrix(made["imu_truth"], "gyro_bias"))
    errors: dict[str, float] = {}
    for name, imu in (("without", made["imu"]), ("with", better), ("true", cold)):
        found = fuse_map(imu=imu, gnss=made["gnss"], wheel=None, attitude=None, params=MapParams())["trajectory"]
        _, errors[f"{name} m"] = place_errors(found, reference, spans)
        yaw = to_euler(matrix(found, "q"))[0] - to_euler(matrix(reference, "q"))[0]
        errors[f"{name} deg"] = float(np.degrees(np.sqrt(np.mean(wrap_angle(yaw) ** 2))))
    return errors


def case(seed: int, duration_s: float = 1200.0) -> dict[str, float]:
    """Error of the bias by method, deg/s."""
    imu, events, bias = warm_drive(seed, 2, duration_s)
    found = {"gyro_offset": gyro_offset(imu=imu, events=events, params=GyroOffsetParams())}
    for model in ("linear", "quadratic"):
        found[model] = gyro_temperature(imu=imu, events=events, params=GyroTemperatureParams(model=model))
    first = events.slice(0, 1)
    found["first stop"] = gyro_offset(imu=imu, events=first, params=GyroOffsetParams())
    with tempfile.TemporaryDirectory() as folder:
        found["remembered"] = gyro_temperature(imu=imu, events=first, params=learnt(seed, duration_s, folder))
    return _errors(imu, bias, found)


def late_case(seed: int, duration_s: float = 1200.0) -> dict[str, float]:
    """Error of the bias by model, deg/s, where the gyroscope is not as warm as its thermometer."""
    imu, events, bias = warm_drive(seed, 2, duration_s, late=True)
    found = {
        model: gyro_temperature(imu=imu, events=events, params=GyroTemperatureParams(model=model))
        for model in ("quadratic", "hysteresis")
    }
    return _errors(imu, bias, found)


def _errors(imu: Any, bias: Array, found: dict[str, Any]) -> dict[str, float]:
    taken_off = {name: matrix(imu, "gyro") - matrix(streams["imu"], "gyro") for name, streams in found.items()}
    return {name: float(np.degrees(np.sqrt(np.nanmean((off - bias) ** 2)))) for name, off in taken_off.items()}


def _print_mapped(seeds: range, silence: bool) -> None:
    names = ("without m", "with m", "true m", "without deg", "with deg", "true deg")
    print("seed " + " ".join(f"{name:>12s}" for name in names), flush=True)
    rows = []
    for seed in seeds:
        errors = mapped(seed, silence)
        rows.append([errors[name] for name in names])
        print(f"{seed:4d} " + " ".join(f"{value:12.4f}" for value in rows[-1]), flush=True)
    table = np.array(rows)
    print("all  " + " ".join(f"{value:12.4f}" for value in np.median(table, axis=0)))
    for column, name in ((1, "with"), (2, "true")):
        place, heading = ((table[:, column + i] < table[:, i]).sum() for i in (0, 3))
        print(f"{name} better than without in {place} (place) and {heading} (heading) of {len(table)}")


def main() -> None:
    """Print a line for each seed and the medians."""
    words = sys.argv[1:]
    seeds = range(int(words[0]) if words and words[0].isdigit() else SEEDS)
    if "map" in words:
        _print_mapped(seeds, "silence" in words)
        return
    late = "hysteresis" in words
    cases = [(late_case if late else case)(seed) for seed in seeds]
    methods, against = (("quadratic", "hysteresis"), {"hysteresis": "quadratic"}) if late else (METHODS, AGAINST)
    print("seed " + " ".join(f"{name:>12s}" for name in methods) + "    deg/s")
    for seed, errors in enumerate(cases):
        print(f"{seed:4d} " + " ".join(f"{errors[name]:12.4f}" for name in methods))
    print("all  " + " ".join(f"{np.median([errors[name] for errors in cases]):12.4f}" for name in methods))
    for name, without in against.items():
        print(
            f"{name} better than {without}: {sum(errors[name] < errors[without] for errors in cases)} of {len(cases)}"
        )


if __name__ == "__main__":
    main()
