"""Texts for the reader of CSV files, read with a mapping, and how they are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recon.errors import ReadFailed
from recon.parameters import bind
from recon.problems import Where
from recon.tables import Streams
from recon.yaml_nodes import Node, load
from recon_readers.csv import CsvParams, read

G = 9.80665
NS = 1_000_000_000
IMU = "imu: {time: {column: t, format: relative}, accel: {columns: [ax, ay, az], unit: g}}"
ROWS = "t,ax,ay,az\n0.00,0.1,0.2,1.0\n0.01,0.1,0.3,1.0\n0.02,0.2,0.2,1.0\n"
MAPPINGS = Path(__file__).parent / "plugins" / "csv_mappings"
BOTH = """
imu:
  time: {column: t, format: relative}
  accel: {columns: [ax, ay, az], unit: m/s^2}
  gyro: {columns: [gx, gy, gz], unit: rad/s}
gnss:
  time: {column: t, format: relative}
  lat: {column: lat}
  lon: {column: lon}
  speed: {column: v, unit: m/s}
"""


def params_of(mapping: str, **form: Any) -> CsvParams:
    node = Node.of({"columns": load(mapping, "mapping.yaml").plain(), **form}, Where("test"))
    params, problems = bind(CsvParams, node, "reader.csv")
    assert not problems, [problem.as_text() for problem in problems]
    assert isinstance(params, CsvParams)
    return params


def read_text(folder: Path, text: str | bytes, mapping: str = IMU, name: str = "log.csv", **form: Any) -> Streams:
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read(path=path, params=params_of(mapping, **form))


def refusal(folder: Path, text: str | bytes, mapping: str = IMU, **form: Any) -> ReadFailed:
    with pytest.raises(ReadFailed) as caught:
        read_text(folder, text, mapping, **form)
    assert "\n" not in caught.value.message
    assert caught.value.hint
    return caught.value


def ns(text: str) -> int:
    return int(np.datetime64(text, "ns").astype(np.int64))


def drive(n: int = 400, every: int = 20, *, blank: bool = False) -> str:
    """An IMU at 100 Hz and a receiver at 5 Hz whose values are repeated or blank in between."""
    rng = np.random.default_rng(1)
    lines = ["t,ax,ay,az,gx,gy,gz,lat,lon,v"]
    for row in range(n):
        last = row // every * every
        place = f"{44.5 + 1e-5 * last:.6f},{11.3 + 1e-5 * last:.6f},{10 + 0.01 * last:.2f}"
        values = ",".join(f"{value:.5f}" for value in [*(rng.normal([0, 0, 9.8])), *rng.normal(size=3) / 10])
        lines.append(f"{row / 100:.2f},{values},{place if row == last or not blank else ',,'}")
    return "\n".join(lines) + "\n"
