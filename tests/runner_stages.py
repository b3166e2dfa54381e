"""Stages and steps for the tests of the runner."""

from __future__ import annotations

import numpy as np
from helpers import clock, filter_of, imu_table, pipeline_of, run_steps, source_of

from recon.rows import Metric, metrics
from recon.schema import GNSS, SAME
from recon.stages import Reader
from recon.tables import build

MADE = source_of({"imu": imu_table()})
TWO = pipeline_of("use: simulator.made", "use: filter.work")


def same(*, imu, params):
    return {"imu": imu}


def run_work(run, **declared):
    return run_steps(TWO, MADE, filter_of(run, **{"writes": {"imu": SAME}, **declared}))


def text_reader(*, name="log", writes=None):
    """Reads one speed of each line."""

    def read(path, params):
        speed = np.loadtxt(path, ndmin=1)
        return {"gnss": build(GNSS, time=clock(len(speed)), speed=speed), "metrics": metrics([Metric("lines", 1.0)])}

    return Reader(name=name, summary="A log.", run=read, writes=writes or {"gnss": GNSS.only("speed")})


def log_file(folder, *speeds, name="log.txt"):
    path = folder / name
    path.write_text("\n".join(str(speed) for speed in speeds), encoding="utf-8")
    return path
