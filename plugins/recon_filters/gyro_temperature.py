"""Offset of the gyroscopes against their temperature: fitted at stops, used between them, remembered per device.

    offset(t) = c_1 (T - T_0) + c_2 (T - T_0)^2 + c_3 (T_L - T) + r_k,    T_0 = 25 degC,    T_L' = (T - T_L) / lag,

where r_k is what stop k showed beside the model, so that a stop is met exactly and the model tells the change since.
The third term, with the model `hysteresis`, is that of a sensor that is not as warm as its thermometer: on the way up
its offset is another than on the way down.
The slopes c are those that explain best how the offset changed from stop to stop within a drive, over all drives of the
device; each drive has a constant of its own, for a gyroscope wakes up with another offset each time. They are known
beforehand to be about zero: without changes of temperature they stay so, and this is filter.gyro_offset.

`calibration` names a file of one device. It holds the sums of each drive that was run with it, under the time of its
first row: a drive that is run again takes the place of its own, so the result does not depend on how often. The file is
made where it is not there. Do not run drives of one device at the same time: the last to write would win.

Before fuser.map let `between` be constant: the model alone moves the offset then, and the rest is left to its random
walk, which steps from stop to stop would break.

References
    IEEE Std 952-1997: sensitivity of the bias to temperature.
    Thesis, chapter 9.1.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    EVENTS,
    IMU,
    SAME,
    Array,
    DataError,
    Filter,
    Metric,
    Params,
    Streams,
    has,
    hookimpl,
    matrix,
    metrics,
    quantity,
    replace,
    setting,
    time_ns,
    vector,
    warning,
)
from recon.numerics.moving_window import moving_average
from recon.numerics.signals import median_rate
from recon.storage.atomic import staged_file
from recon_filters.gyro_offset import Spans, between_stops, stops_of, without_stops

REFERENCE_K: Final = 298.15
"""25 degrees Celsius, about which the polynomials are."""
_MARK: Final = "recon_gyro_calibration"
_FORMAT: Final = 2
_PIECE_NS: Final = 20_000_000_000
"""A long stop is several: its temperature changes."""
_SMOOTH_S: Final = 10.0
"""A thermometer is coarse and noisy, and the sensor slow to warm up."""
_PRIOR: Final = np.radians((0.05, 0.001, 0.05))
"""rad/s/K, rad/s/K^2 and rad/s/K, sigma of the slopes of consumer sensors."""
_MOST_STEPS: Final = 1_000_000
"""Of a second, in which the lag is followed; longer ones in a log of weeks."""
_TERMS: Final = {"linear": (1.0, 0.0, 0.0), "quadratic": (1.0, 1.0, 0.0), "hysteresis": (1.0, 1.0, 1.0)}
_UNITS: Final = (("per_kelvin", "deg/s/K"), ("per_kelvin_squared", "deg/s/K^2"), ("per_kelvin_behind", "deg/s/K"))


class GyroTemperatureParams(Params):
    """Parameters of filter.gyro_temperature."""

    model: Literal["linear", "quadratic", "hysteresis"] = setting(
        "quadratic", doc="Of the offset against the temperature; hysteresis: quadratic, and behind it by thermal_lag."
    )
    thermal_lag: float = quantity(
        300.0, "s", gt=0, doc="Time constant with which the sensor follows its thermometer; one for all drives."
    )
    between: Literal["hold", "linear", "constant"] = setting(
        "hold",
        doc="What a stop showed beside the model: kept until the next, on a straight line to the next, or the mean of "
        "all stops throughout, for a fuser that follows the rest itself.",
    )
    stop_sigma: float = quantity(
        0.01, "deg/s", gt=0, doc="Of an offset found at a stop, its walk since the last included."
    )
    calibration: str | None = setting(None, doc="File of the device, read and updated; none: this drive alone.")


class Sums(NamedTuple):
    """Of one drive, about its own means: products of the terms (3, 3), and with the offsets (3, 3) rad/s."""

    terms: Array
    offsets: Array


def gyro_temperature(*, imu: pa.Table, events: pa.Table | None, params: GyroTemperatureParams) -> Streams:
    """The imu with the offset taken off gyro; unchanged, with a warning, where there is no standstill.

    imu : gyro rad/s, any frame; temperature K
    events : those of kind standstill count
    raises : DataError where the calibration is no such file
    """
    t_ns, gyro = time_ns(imu), matrix(imu, "gyro", gaps=True)
    drives = _read(params.calibration)
    stops, samples = stops_of(t_ns, gyro, events, longest_ns=_PIECE_NS)
    if not samples:
        return without_stops(imu)
    offsets = np.array([sample.mean(axis=0) for sample in samples])
    terms = _terms(imu, t_ns, params.thermal_lag)
    learnt = [Metric("stops", float(len(stops)), note="in pieces of at most 20 s")]
    if terms is None:
        terms = np.zeros((len(t_ns), len(_PRIOR)))
        learnt.append(warning("imu tells no temperature: only what the stops show is taken off"))
    at_stops = _means(t_ns, stops, terms)
    drives[str(t_ns[0])] = _sums(at_stops, offsets)
    slopes, sigma = _slopes(drives.values(), params)
    beside = _beside(t_ns, stops, offsets - at_stops @ slopes, params.between)
    if params.calibration is not None:
        _write(params.calibration, drives)
    corrected = replace(imu, gyro=gyro - terms @ slopes - beside)
    return {"imu": corrected, "metrics": metrics([*learnt, *_told(slopes, sigma, len(drives))])}


def _terms(imu: pa.Table, t_ns: NDArray[np.int64], lag_s: float) -> Array | None:
    """T - T_0, its square and T_L - T at each row: (n, 3) K, K^2, K; None where no temperature is known."""
    if not has(imu, "temperature"):
        return None
    above = vector(imu, "temperature", gaps=True) - REFERENCE_K
    known = np.isfinite(above)
    if not known.any():
        return None
    filled = np.interp((t_ns - t_ns[0]) * 1e-9, (t_ns[known] - t_ns[0]) * 1e-9, above[known])
    if len(t_ns) > 1:
        filled = moving_average(filled, 2 * round(0.5 * _SMOOTH_S * median_rate(t_ns)) + 1)
    return np.column_stack((filled, filled**2, _behind((t_ns - t_ns[0]) * 1e-9, filled, lag_s)))


def _behind(t_s: Array, kelvin: Array, lag_s: float) -> Array:
    """What follows a temperature with a time constant, less the temperature; they begin as one: (n,) K."""
    from scipy.signal import lfilter  # slow import: only when used

    grid_s = np.linspace(0.0, t_s[-1], 2 + min(int(t_s[-1]), _MOST_STEPS))
    now = np.interp(grid_s, t_s, kelvin)
    kept = np.exp(-grid_s[1] / lag_s)
    after = lfilter([1.0 - kept], [1.0, -kept], now - now[0])[:-1]  # a step later: what it has followed by then
    return np.asarray(np.interp(t_s, grid_s, np.append(0.0, after) + now[0]) - kelvin)


def _means(t_ns: NDArray[np.int64], stops: Spans, terms: Array) -> Array:
    """Means of the terms over each stop: (k, 3)."""
    first, stop = np.searchsorted(t_ns, stops[:, 0], "left"), np.searchsorted(t_ns, stops[:, 1], "right")
    return np.array([terms[a:b].mean(axis=0) for a, b in zip(first, stop, strict=True)])


def _sums(terms: Array, offsets: Array) -> Sums:
    terms, offsets = terms - terms.mean(axis=0), offsets - offsets.mean(axis=0)
    return Sums(terms.T @ terms, terms.T @ offsets)


def _slopes(drives: Iterable[Sums], params: GyroTemperatureParams) -> tuple[Array, Array]:
    """Slopes (3, 3) rad/s/K, rad/s/K^2 and rad/s/K, and their sigma (3,); least squares with the prior."""
    terms, offsets = (np.sum(sums, axis=0) for sums in zip(*drives, strict=True))
    variance = params.stop_sigma**2
    prior = _PRIOR * _TERMS[params.model]
    used = prior > 0.0
    normal = terms[np.ix_(used, used)] / variance + np.diag(prior[used] ** -2)
    slopes, sigma = np.zeros((len(prior), 3)), np.zeros(len(prior))
    slopes[used] = np.linalg.solve(normal, offsets[used] / variance)
    sigma[used] = np.sqrt(np.diag(np.linalg.inv(normal)))
    return slopes, sigma


def _beside(
    t_ns: NDArray[np.int64], stops: Spans, shown: Array, between: Literal["hold", "linear", "constant"]
) -> Array:
    """What the stops showed beside the model, at each row or of all: (n, 3) or (3,) rad/s."""
    if between == "constant":
        return np.asarray(shown.mean(axis=0))
    return between_stops(t_ns, stops, shown, between)


def _read(name: str | None) -> dict[str, Sums]:
    """Sums of the drives in the file, none where there is no file yet."""
    if name is None or not Path(name).exists():
        return {}
    try:
        held = json.loads(Path(name).read_text(encoding="utf-8"))
        if held[_MARK] != _FORMAT:
            raise KeyError(_MARK)
        return {key: _checked(entry) for key, entry in held["drives"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise DataError(
            f"{name} is no calibration of gyroscopes that filter.gyro_temperature wrote",
            "name another file; one that is not there yet is made",
        ) from error


def _checked(entry: Any) -> Sums:
    sums = Sums(*(np.array(entry[name], dtype=np.float64) for name in Sums._fields))
    if sums.terms.shape != (3, 3) or sums.offsets.shape != (3, 3) or not np.isfinite(np.hstack(sums)).all():
        raise ValueError("sums of another shape")
    return sums


def _write(name: str, drives: dict[str, Sums]) -> None:
    held = {key: {name: values.tolist() for name, values in sums._asdict().items()} for key, sums in drives.items()}
    with staged_file(Path(name)) as path:
        path.write_text(
            json.dumps({_MARK: _FORMAT, "drives": dict(sorted(held.items()))}, indent=1) + "\n",
            encoding="utf-8",
            newline="\n",
        )


def _told(slopes: Array, sigma: Array, drives: int) -> list[Metric]:
    note = f"from {drives} drives" if drives > 1 else "from this drive"
    slopes, sigma = np.degrees(slopes), np.degrees(sigma)
    return [
        Metric(f"gyro_{name}_{axis}", float(slopes[row, column]), unit, float(sigma[row]), note=note)
        for row, (name, unit) in enumerate(_UNITS)
        for column, axis in enumerate("xyz")
    ]


@hookimpl
def declare_filters() -> Iterable[Filter]:
    """filter.gyro_temperature."""
    yield Filter(
        name="gyro_temperature",
        summary="Takes off the offset of the gyroscopes by their temperature, as learnt at standstills.",
        params=GyroTemperatureParams,
        reads={
            "imu": IMU.need("gyro", maybe=("temperature",)),
            "events": EVENTS.need("time", "end_time", "kind", optional=True),
        },
        writes={"imu": SAME},
        run=gyro_temperature,
        references=("IEEE Std 952-1997",),
    )
