"""Small streams, stages and pipelines that the tests of the core share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from recon import GNSS, IMU, Filter, Pipeline, Recording, Registry, Simulator, build
from recon.check import check
from recon.declaration import Stage
from recon.problems import Problem
from recon.runner import Outcome, Source, run_pipeline
from recon.schema import STREAMS

START_NS = 1_500_000_000_000_000_000
STEP_NS = 10_000_000


def clock(rows: int, start_ns: int = START_NS) -> np.ndarray:
    """(rows,) int64 ns at 100 Hz."""
    return start_ns + STEP_NS * np.arange(rows, dtype=np.int64)


def imu_table(rows: int = 4, start_ns: int = START_NS) -> pa.Table:
    """A box at rest whose gyroscope counts its rows."""
    gyro = np.arange(3.0 * rows).reshape(rows, 3)
    return build(IMU, time=clock(rows, start_ns), accel=np.tile([0.0, 0.0, 9.80665], (rows, 1)), gyro=gyro)


def gnss_table(rows: int = 3, start_ns: int = START_NS) -> pa.Table:
    """Speeds of 0, 1, 2, ... m/s."""
    return build(GNSS, time=clock(rows, start_ns), speed=np.arange(float(rows)))


def source_of(streams: Mapping[str, pa.Table], name: str = "made") -> Simulator:
    """A simulator that gives these streams, each planned with all columns of its canonical schema."""
    writes = {stream: STREAMS.get(stream, IMU) for stream in streams if stream != "metrics"}
    return Simulator(name=name, summary="Given streams.", run=lambda params: dict(streams), writes=writes)


def filter_of(run: Any, name: str = "work", **declared: Any) -> Filter:
    """A filter that reads and changes imu unless told otherwise."""
    return Filter(name=name, summary="Some work.", run=run, **{"reads": {"imu": IMU.need("accel", "gyro")}, **declared})


def pipeline_of(*steps: str, name: str = "test") -> Pipeline:
    """A pipeline of YAML steps, each the text behind its dash."""
    return Pipeline.from_text(f"name: {name}\nsteps:\n" + "".join(f"  - {step}\n" for step in steps), "test.yaml")


def problems_of(pipeline: Pipeline, *records: Stage, **options: Any) -> list[Problem]:
    """What the check finds."""
    return check(pipeline, Registry.of(*records), **options)[1]


def run_steps(pipeline: Pipeline, *records: Stage, source: Source = ()) -> Outcome:
    """Check and run a pipeline that has no problem."""
    registry = Registry.of(*records)
    given = source.schemas() if isinstance(source, Recording) else None
    plan, problems = check(pipeline, registry, given=given)
    assert problems == []
    return run_pipeline(plan, source, registry)
