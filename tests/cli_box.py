"""A distribution of a simulator, a reader and what can go wrong, for the tests of the command line."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

PLUGIN = '''
"""Stages of another distribution: a simulator, a reader, and what can go wrong."""

import time

import numpy as np

from recon import GNSS, IMU, SAME, Exporter, Filter, Metric, Params, Reader, Simulator, Sniff, build, hookimpl, metrics
from recon import quantity, setting, warning


class Still(Params):
    rows: int = setting(100, gt=0, doc="Number of samples at 100 Hz.")
    pause: float = quantity(0.0, "s", ge=0, doc="Time that the last 10 samples come late.")


def streams(rows, pause=0.0):
    t_ns = np.arange(rows) * 10_000_000
    t_ns[-10:] += round(pause * 1e9)
    accel = np.tile([0.0, 0.0, 9.80665], (rows, 1))
    return {"imu": build(IMU, time=t_ns, accel=accel, gyro=np.zeros((rows, 3)))}


def still(params):
    return streams(params.rows, params.pause)


def read(path, params):
    learnt = [Metric("assumed_rate", 100.0, "Hz"), *[warning("the box is new")] * 3]
    return {**streams(int(path.read_text().split()[1])), "metrics": metrics(learnt)}


def sniff(path, head):
    return Sniff(0.9 if head.startswith(b"still ") else 0.0, "first word")


class Wait(Params):
    time: float = quantity(0.0, "s", ge=0, doc="How long nothing happens.")


def wait(*, imu, params):
    time.sleep(params.time)
    return {"imu": imu}


def fail(*, imu, params):
    raise ZeroDivisionError("nobody foresaw this")


def talk(*, imu, params):
    print("a stage talks")
    return {"imu": imu}


def write(*, imu, folder, about, params):
    (folder / "rows.txt").write_text(str(imu.num_rows))
    return [folder / "rows.txt"]


def write_name(*, imu, folder, about, params):
    text = f"{about.name} of {about.manifest['inputs'][0]['name']}"
    (folder / "name.txt").write_text(text, encoding="utf-8")
    return [folder / "name.txt"]


def write_late(*, imu, folder, about, params):
    time.sleep(60)
    return []


def write_nothing(*, imu, folder, about, params):
    raise ZeroDivisionError("nobody foresaw this")


def write_much(*, imu, folder, about, params):
    with open("/dev/full", "w") as file:
        file.write("more than fits")
    return []


@hookimpl
def declare_simulators():
    yield Simulator(name="still", summary="A box at rest.", params=Still, run=still, writes={"imu": IMU})


@hookimpl
def declare_readers():
    yield Reader(name="still", summary="A box at rest.", run=read, sniff=sniff, writes={"imu": IMU})


@hookimpl
def declare_filters():
    needs = {"imu": IMU.need("accel")}
    yield Filter(name="wait", summary="Waits.", params=Wait, run=wait, reads=needs, writes={"imu": SAME})
    yield Filter(name="fail", summary="Fails.", run=fail, reads=needs, writes={"imu": SAME})
    yield Filter(name="talk", summary="Prints.", run=talk, reads=needs, writes={"imu": SAME})


@hookimpl
def declare_exporters():
    needs = {"imu": IMU.need("accel")}
    yield Exporter(name="count", summary="Rows.", run=write, reads=needs)
    yield Exporter(name="name", summary="Names.", run=write_name, reads=needs)
    yield Exporter(name="late", summary="Waits.", run=write_late, reads=needs)
    yield Exporter(name="fail", summary="Fails.", run=write_nothing, reads=needs)
    yield Exporter(name="full", summary="Fills the disk.", run=write_much, reads=needs)
'''
STAGES = (
    "simulator.still",
    "reader.still",
    "filter.wait",
    "filter.fail",
    "filter.talk",
    "exporter.count",
    "exporter.name",
    "exporter.late",
    "exporter.fail",
    "exporter.full",
)
PIPELINE = """\
name: box
steps:
  - use: reader.auto
  - use: filter.wait
"""


class Ended(NamedTuple):
    code: int
    out: str
    err: str


Cli = Callable[..., Ended]


def spawn(*words: str, cwd: Path, env: Mapping[str, str], **streams: int) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "recon", *words]
    return subprocess.Popen(command, cwd=cwd, env=env, text=True, encoding="utf-8", **streams)


def entries(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}
