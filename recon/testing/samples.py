"""Files of many kinds, small and made on the spot: what a reader must know as its own, or leave alone.

A file of a format that a reader of recon owns is nobody else's. The others belong to whoever can read them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from recon.recording import Recording
from recon.schema import APPENDED
from recon.storage import write_recording
from recon.tables import seconds, vector
from recon.testing.drives import drive

_ROWS: Final = 400


@dataclass(frozen=True)
class Sample:
    """A file, and the reader that owns its format, "" where none does."""

    path: Path
    owner: str = ""


def samples(folder: Path) -> dict[str, Sample]:
    """One file of each kind in the folder, by what it is."""
    found = {}
    for name, (file, owner, write) in _KINDS.items():
        path = folder / file
        write(path)
        found[name] = Sample(path, owner)
    return found


def _some() -> Recording:
    """Four seconds of all streams of the drive."""
    whole = drive()
    return Recording({name: t if name in APPENDED else t.slice(0, _ROWS) for name, t in whole.items()}, whole.meta)


def _physycom(path: Path) -> None:
    imu = drive()["imu"].slice(0, _ROWS)
    values = [vector(imu, f"accel_{axis}") / 9.80665 for axis in "xyz"]
    values += [np.degrees(vector(imu, f"gyro_{axis}")) for axis in "xyz"]
    size = np.sqrt(sum(axis**2 for axis in values[:3]))
    t_s = seconds(imu)
    rows = np.column_stack([518_716_448.0 + t_s, 36.0 + t_s, *values, size, t_s])
    lines = ["\t".join(f"{value:.6f}" for value in row) for row in rows.tolist()]
    header = "# timestamp speed ax ay az gx gy gz |a| timestamp_rel".replace(" ", "\t")
    path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8", newline="\n")


def _parquet(path: Path) -> None:
    write_recording(_some(), path, "parquet")


def _mcap(path: Path) -> None:
    write_recording(_some(), path, "mcap")


def _table(path: Path) -> None:
    lines = [f"{0.1 * row:.1f},{row % 7},word" for row in range(50)]
    path.write_text("\n".join(["day,count,remark", *lines]) + "\n", encoding="utf-8", newline="\n")


def _json(path: Path) -> None:
    path.write_text(json.dumps({"name": "a pipeline", "steps": [1, 2, 3]}), encoding="utf-8", newline="\n")


def _noise(path: Path) -> None:
    path.write_bytes(np.random.default_rng(1).bytes(4096))


def _empty(path: Path) -> None:
    path.write_bytes(b"")


_KINDS: Final[Mapping[str, tuple[str, str, Callable[[Path], None]]]] = {
    "a physycom log": ("inertial.txt", "reader.physycom", _physycom),
    "a folder of recon's Parquet files": ("kept_parquet", "reader.parquet", _parquet),
    "a folder with recon's MCAP file": ("kept_mcap", "reader.mcap", _mcap),
    "a CSV table of no sensor": ("table.csv", "", _table),
    "a JSON file": ("notes.json", "", _json),
    "random bytes": ("noise.bin", "", _noise),
    "an empty file": ("empty.log", "", _empty),
}
