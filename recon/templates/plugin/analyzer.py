"""How far and how fast the vehicle went."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pyarrow as pa

from recon import TRAJECTORY, Analyzer, Metric, Params, Streams, hookimpl, matrix, metrics, quantity, seconds
from recon.errors import NotEnoughData


class TotalsParams(Params):
    """Parameters of analyzer.$name."""

    moving: float = quantity(1.0, "km/h", ge=0, doc="Speed up to which the vehicle counts as standing.")


def totals(*, trajectory: pa.Table, params: TotalsParams) -> Streams:
    """The metrics distance, top_speed and mean_speed, the last while it moves.

    trajectory : vel m/s, local
    raises : NotEnoughData without a row, DataError on missing values
    """
    if not trajectory.num_rows:
        raise NotEnoughData("trajectory", needed="1 row", found="none")
    speed = np.linalg.norm(matrix(trajectory, "vel"), axis=1)
    moving = speed[speed > params.moving]
    path = np.diff(seconds(trajectory)) * (speed[:-1] + speed[1:]) / 2.0
    found = [
        Metric("distance", float(path.sum()), "m"),
        Metric("top_speed", float(speed.max()), "m/s"),
        Metric("mean_speed", float(moving.mean()) if len(moving) else 0.0, "m/s", note="while it moves"),
    ]
    return {"metrics": metrics(found)}


@hookimpl
def declare_analyzers() -> Iterable[Analyzer]:
    """analyzer.$name."""
    yield Analyzer(
        name="$name",
        summary="Distance, top speed and mean speed.",
        params=TotalsParams,
        run=totals,
        reads={"trajectory": TRAJECTORY.need("vel")},
    )
