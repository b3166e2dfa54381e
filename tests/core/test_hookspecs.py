"""Every hook's docstring is a complete module: each is installed, checked and run here."""

from __future__ import annotations

import inspect
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import clock
from plugin_files import install

from recon import hookspecs
from recon.calling import call_exporter
from recon.check import check
from recon.pipeline import Pipeline
from recon.recording import Recording
from recon.registry import Registry
from recon.runner import run_pipeline
from recon.schema import GNSS, IMU, TRAJECTORY
from recon.stages import ROLES
from recon.tables import build, matrix, vector

EXAMPLES = {
    "reader": "dat",
    "simulator": "still",
    "filter": "clip",
    "detector": "fastest",
    "aligner": "flip",
    "integrator": "yaw_only",
    "fuser": "follow",
    "analyzer": "top_speed",
    "exporter": "npy",
    "executor": "one_by_one",
}


def example(role):
    """The module in the docstring: all that stands behind its first paragraph."""
    _, _, module = inspect.getdoc(getattr(hookspecs, f"declare_{role}s")).partition("\n\n")
    return module


@pytest.fixture
def registry(tmp_path, monkeypatch):
    """The examples, found by their entry points."""
    install(
        tmp_path,
        "hook-examples",
        modules={f"hook_example_{role}.py": example(role) for role in EXAMPLES},
        points={f"{role}.{name}": f"hook_example_{role}" for role, name in EXAMPLES.items()},
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    yield Registry.installed()
    for role in EXAMPLES:
        sys.modules.pop(f"hook_example_{role}", None)


def run(registry, role, source, *before):
    pipeline = Pipeline.of("example", *before, f"{role}.{EXAMPLES[role]}")
    given = source.schemas() if isinstance(source, Recording) else None
    plan, problems = check(pipeline, registry, given=given)
    assert problems == []
    return run_pipeline(plan, source, registry).recording


def imu_in(frame):
    """Two seconds of a turn to the left at 0.5 rad/s, at 100 Hz."""
    accel, gyro = np.tile([1.0, 2.0, 9.8], (201, 1)), np.tile([0.1, 0.2, 0.5], (201, 1))
    return build(IMU.only("accel", "gyro", frame=frame), time=clock(201), accel=accel, gyro=gyro)


def drive():
    """A trajectory of two rows and GNSS 3 m east of it."""
    pos = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    trajectory = build(TRAJECTORY, time=clock(2), pos=pos, vel=np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]]))
    return Recording(
        {"trajectory": trajectory, "gnss": build(GNSS, time=clock(2), pos=pos + np.array([3.0, 0.0, 0.0]))}
    )


def test_every_role_has_a_hook_with_an_example():
    assert list(EXAMPLES) == list(ROLES)
    assert all("@hookimpl" in example(role) for role in ROLES)


@pytest.mark.parametrize("role", EXAMPLES)
def test_the_example_declares_what_its_entry_point_says(registry, role):
    stage = registry.get(f"{role}.{EXAMPLES[role]}")
    assert isinstance(stage, ROLES[role])
    assert registry.source(stage.key).distribution == "hook-examples"


def test_the_reader_reads_and_knows_its_files(registry, tmp_path):
    path = tmp_path / "log.dat"
    path.write_text("# my logger\n0.0 1.5\n0.5 2.5\n", encoding="utf-8")
    gnss = run(registry, "reader", [path])["gnss"]
    assert vector(gnss, "speed").tolist() == [1.5, 2.5]
    assert registry.get("reader.dat").sniff(path, path.read_bytes()).confidence > 0.5
    assert registry.get("reader.dat").sniff(path, b"\x00").confidence == 0.0


def test_the_simulator_rests(registry):
    assert matrix(run(registry, "simulator", [])["imu"], "accel").tolist() == [[0.0, 0.0, 9.80665]] * 100


def test_the_filter_leaves_what_is_small(registry):
    imu = run(registry, "filter", [], "simulator.still")["imu"]
    assert matrix(imu, "accel").tolist() == [[0.0, 0.0, 9.80665]] * 100


def test_the_detector_finds_the_moment(registry, tmp_path):
    path = tmp_path / "log.dat"
    path.write_text("0.0 1.5\n0.5 2.5\n1.0 2.0\n", encoding="utf-8")
    events = run(registry, "detector", [path], "reader.dat")["events"]
    assert events.select(["step", "kind"]).to_pylist() == [{"step": "detector.fastest", "kind": "fastest"}]


def test_the_aligner_turns_the_box(registry):
    recording = run(registry, "aligner", Recording({"imu": imu_in("level")}))
    assert matrix(recording["imu"], "accel")[0].tolist() == [-1.0, -2.0, 9.8]
    assert recording.schemas()["imu"]["accel_x"].frame == "vehicle"
    assert recording["metrics"]["value"].to_pylist() == [180.0]


def test_the_integrator_turns_by_rate_times_time(registry):
    attitude = run(registry, "integrator", Recording({"imu": imu_in("vehicle")}))["attitude"]
    # 0.5 rad/s over 2 s is 1 rad; 200 sums of numbers near one, each rounded to 1.1e-16
    np.testing.assert_allclose(matrix(attitude, "q")[-1], [np.cos(0.5), 0, 0, np.sin(0.5)], atol=200 * 1.1e-16)


def test_the_fuser_follows_gnss(registry):
    assert matrix(run(registry, "fuser", drive())["trajectory"], "pos")[:, 0].tolist() == [3.0, 4.0]


def test_the_analyzer_finds_the_highest_speed(registry):
    assert run(registry, "analyzer", drive())["metrics"]["value"].to_pylist() == [5.0]


def test_the_exporter_writes_its_file(registry, tmp_path):
    plan, problems = check(Pipeline.of("example", "exporter.npy"), registry, given=drive().schemas())
    assert problems == []
    (path,) = call_exporter(plan.steps[0], drive(), tmp_path, None)
    assert np.load(path).shape == (2, 3)


def test_the_executor_runs_every_job(registry):
    executor = registry.get("executor.one_by_one")
    jobs = [SimpleNamespace(run=lambda number=number: number) for number in range(3)]
    assert list(executor.run(jobs, executor.params())) == [0, 1, 2]
