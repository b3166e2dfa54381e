"""One IMU from all boxes of a vehicle, each weighted by its noise; a box that disagrees is voted out, and named.

The boxes measure in the axes and the clock and at the place of imu, as aligner.boxes leaves them. The result keeps the
rows of imu; further boxes are read between their rows. See recon.numerics.virtual_imu for the weights and the vote.
Noise and wandering biases of k alike boxes shrink by the root of k, and so does what they do to attitude.

References
    Skog, Nilsson, Haendel, Nehorai (2016), "Inertial sensor arrays, maximum likelihood, and Cramer-Rao bound", IEEE
    Trans. Signal Processing 64(16).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    EVENTS,
    IMU,
    SAME,
    Event,
    Fuser,
    Metric,
    Params,
    Streams,
    events,
    hookimpl,
    matrix,
    metrics,
    quantity,
    replace,
    time_ns,
    warning,
)
from recon.numerics.signals import interpolate, runs
from recon.numerics.virtual_imu import combine, noise_density
from recon.schema import FURTHER_IMUS

_LOOSE: Final = 0.8
"""Of the time since it first lost a vote in which a box that came loose loses them."""


class VirtualImuParams(Params):
    """Parameters of fuser.virtual_imu."""

    max_gap: float = quantity(0.1, "s", gt=0, le=10, doc="Between rows of a box further apart it counts as absent.")


def virtual_imu(
    *,
    imu: pa.Table,
    imu_2: pa.Table | None,
    imu_3: pa.Table | None,
    imu_4: pa.Table | None,
    params: VirtualImuParams,
) -> Streams:
    """The weighted mean of all boxes at the rows of imu."""
    tables = zip(FURTHER_IMUS, (imu_2, imu_3, imu_4), strict=True)
    boxes = {"imu": imu, **{name: table for name, table in tables if table is not None and table.num_rows}}
    t_ns = time_ns(imu)
    if len(boxes) == 1 or not len(t_ns):
        alone = warning("there is only one box (imu): it is the virtual IMU")
        return {"imu": imu, "events": events([]), "metrics": metrics([alone])}
    values, densities = zip(*(_read(table, t_ns, params.max_gap) for table in boxes.values()), strict=True)
    found = combine(t_ns, np.stack(values), np.array(densities))
    disagreements = {name: runs(out) for name, out in zip(boxes, found.out, strict=True) if out.any()}
    learnt = [
        *_shares(list(boxes), found.shares, densities),
        *(_verdict(name, spans, t_ns, len(boxes)) for name, spans in disagreements.items()),
    ]
    happened = [
        Event(int(t_ns[start]), int(t_ns[stop - 1]), "box_disagrees", note=f"{name} is left out")
        for name, spans in disagreements.items()
        for start, stop in spans
    ]
    merged = replace(imu, gyro=found.values[:, :3], accel=found.values[:, 3:])
    return {"imu": merged, "events": events(happened), "metrics": metrics(learnt)}


def _read(table: pa.Table, t_ns: NDArray[np.int64], max_gap: float) -> tuple[NDArray[np.float64], tuple[float, float]]:
    """Gyro and accel of a box at the times, and the densities of their noise: (n, 6)."""
    own_ns, sensors = time_ns(table), [matrix(table, group) for group in ("gyro", "accel")]
    at_times = interpolate(t_ns, own_ns, np.hstack(sensors), round(max_gap * 1e9))
    return at_times, (noise_density(own_ns, sensors[0]), noise_density(own_ns, sensors[1]))


def _shares(
    names: list[str], shares: NDArray[np.float64], densities: Iterable[tuple[float, float]]
) -> Iterable[Metric]:
    """How much each box counts, and the noise that says so."""
    for name, share, density in zip(names, shares.tolist(), densities, strict=True):
        for sensor, part, noise, unit in zip(
            ("gyro", "accel"), share, density, ("rad/s/sqrt(Hz)", "m/s^2/sqrt(Hz)"), strict=True
        ):
            yield Metric(
                f"{name}_{sensor}_share", part, "1", method="inverse variance", note=f"noise {noise:.2g} {unit}"
            )


def _verdict(name: str, spans: NDArray[np.intp], t_ns: NDArray[np.int64], boxes: int) -> Metric:
    """A warning that names a box that was voted out."""
    lost = spans[:, 1] - spans[:, 0]
    seconds = float(lost.sum()) / len(t_ns) * float(t_ns[-1] - t_ns[0]) * 1e-9
    first = (t_ns[spans[0, 0]] - t_ns[0]) * 1e-9
    if boxes == 2:
        return warning(f"imu and {name} disagree for {seconds:.0f} s; which is wrong two cannot tell, imu was believed")
    if lost.sum() >= _LOOSE * (len(t_ns) - spans[0, 0]):
        return warning(f"{name} came loose {first:.0f} s after the start: from there on it was left out")
    return warning(
        f"{name} disagrees with the other boxes for {seconds:.0f} s, first at {first:.0f} s: it was left out"
    )


@hookimpl
def declare_fusers() -> Iterable[Fuser]:
    """Declare fuser.virtual_imu."""
    yield Fuser(
        name="virtual_imu",
        summary="One IMU from all boxes, each weighted by its noise; a box that disagrees is voted out and named.",
        params=VirtualImuParams,
        reads={
            "imu": IMU.need("accel", "gyro"),
            **{name: IMU.need("accel", "gyro", optional=True) for name in FURTHER_IMUS},
        },
        writes={"imu": SAME, "events": EVENTS},
        run=virtual_imu,
        references=("Skog, Nilsson, Haendel, Nehorai 2016",),
    )
