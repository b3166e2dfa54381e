"""Positions as a text table: a line that names the columns, then seconds since the first row and metres.

    t_s,pos_e,pos_n,pos_u
    0,12.5,-3.25,0

Numbers have 17 digits, so that they read back to the same double; what is missing is nan.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from recon import TRAJECTORY, Exporter, Params, hookimpl, matrix, seconds, setting


class TableParams(Params):
    """Parameters of exporter.$name."""

    every: int = setting(1, gt=0, doc="1 writes every row, 10 every tenth.")


def write_table(*, trajectory: pa.Table, folder: Path, about: Any, params: TableParams) -> list[Path]:
    """Write `positions.csv` into the folder; its path.

    trajectory : pos m, local
    about : the manifest of the run, its name and its warnings
    """
    rows = np.column_stack([seconds(trajectory), matrix(trajectory, "pos", gaps=True)])[:: params.every]
    path = folder / "positions.csv"
    np.savetxt(path, rows, fmt="%.17g", delimiter=",", header="t_s,pos_e,pos_n,pos_u", comments="", encoding="utf-8")
    return [path]


@hookimpl
def declare_exporters() -> Iterable[Exporter]:
    """exporter.$name."""
    yield Exporter(
        name="$name",
        summary="Positions as a text table.",
        params=TableParams,
        run=write_table,
        reads={"trajectory": TRAJECTORY.need("pos")},
    )
