"""Files for the viewer of Rerun, made by its exporter."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from exporter_tables import drive

from recon.manifest import RunInfo
from recon_exporters import rerun as module
from recon_exporters.rerun import RerunParams


def export(folder: Path, about: RunInfo | None = None, rate: float | None = None, **streams: pa.Table) -> Path:
    (path,) = module.rerun(streams=streams, folder=folder, about=about or RunInfo("run"), params=RerunParams(rate=rate))
    assert path == folder / "run.rrd"
    return path


def moving(rows: int = 301, **groups: Any) -> pa.Table:
    rng = np.random.default_rng(3)
    groups = {"accel": rng.normal(size=(rows, 3)), "gyro": rng.normal(size=(rows, 3)), **groups}
    return drive(np.arange(rows) / 10, **groups)
