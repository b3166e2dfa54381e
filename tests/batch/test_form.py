"""Batch files: their form, and what they set in the pipeline that they name."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from recon.batch import BatchFile, Inputs, parse
from recon.batch_plan import check_batch
from recon.parameters import Params, quantity, setting
from recon.registry import Registry
from recon.schema import IMU, SAME
from recon.stages import Delegation, Executor, Exporter, Filter, Reader
from recon.yaml_nodes import load, load_file

WHOLE = """\
recon: 1
batch: june_fleet
pipeline: smooth.yaml
inputs:
  - glob: data/*/2026-06-*/*.txt
    vehicle: parent 2
    drive: stem
  - glob: more/**/*.txt
    vehicle: '(?P<vehicle>[^/]+)/log'
  - list: drives.csv
output: results
defaults: {reader.box: {gravity: 9.80665 m/s^2}}
vehicles:
  A12: {smooth: {window: 20 ms}}
  B7: {smooth: {window: 30 ms}, reader.box: {gravity: 9.81 m/s^2}}
exports: [count]
executor: {use: executor.pool, params: {workers: 2}}
on_error: stop
retries: 1
timeout: 10 min
memory: 2 GB
resume: false
"""
LEAST = "batch: june\npipeline: smooth.yaml\ninputs: [{glob: '*.txt'}]\noutput: results\n"
PIPELINE = "steps:\n  - use: reader.auto\n  - {use: filter.smooth, id: smooth}\n"


class BoxParams(Params):
    gravity: float = quantity(9.80665, "m/s^2", gt=0, doc="Acceleration that the file writes as 1.")


class SmoothParams(Params):
    window: float = quantity(50.0, "ms", gt=0, doc="Length.")


class PoolParams(Params):
    workers: int = setting(1, gt=0, doc="Processes.")


def read(path: Path, params: Params) -> dict[str, pa.Table]:
    return {}


def read_any(path: Path, params: Params, registry: Registry) -> dict[str, pa.Table]:
    return {}


def smooth(*, imu: pa.Table, params: Params) -> dict[str, pa.Table]:
    return {"imu": imu}


def count(*, imu: pa.Table, folder: Path, about: object, params: Params) -> list[Path]:
    return []


def pool(jobs: object, params: Params) -> Iterator[Any]:
    yield from ()


REGISTRY = Registry.of(
    Reader(name="auto", summary="Any.", run=read_any, params=Delegation, writes={"imu": IMU}),
    Reader(name="box", summary="Box.", run=read, params=BoxParams, writes={"imu": IMU}),
    Filter(
        name="smooth", summary="S.", run=smooth, params=SmoothParams, reads={"imu": IMU.need("accel")},
        writes={"imu": SAME},
    ),
    Exporter(name="count", summary="Rows.", run=count, reads={"imu": IMU.need("accel")}),
    Executor(name="pool", summary="Pool.", run=pool, params=PoolParams),
)  # fmt: skip


def form_problems(text: str) -> list[str]:
    return [problem.as_text() for problem in parse(load(text, "b.yaml"))[1]]


@pytest.fixture
def problems(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):  # type: ignore[no-untyped-def]
    """What is wrong with the content of a batch file that lies beside the pipeline `smooth.yaml`."""
    monkeypatch.chdir(tmp_path)
    Path("smooth.yaml").write_text(PIPELINE)

    def check(text: str) -> list[str]:
        Path("b.yaml").write_text(text)
        batch, faults = parse(load_file("b.yaml"))
        assert faults == []
        return [problem.as_text() for problem in check_batch(batch, REGISTRY)]

    return check


def whole() -> BatchFile:
    batch, faults = parse(load(WHOLE, "fleet/june.yaml"))
    assert faults == []
    return batch


# --- form -----------------------------------------------------------------------------------------------------------


def test_a_whole_file_is_understood() -> None:
    batch = whole()
    assert (batch.name, batch.pipeline, batch.output) == ("june_fleet", "smooth.yaml", "results")
    assert batch.folder == Path("fleet")
    assert batch.inputs == (
        Inputs(glob="data/*/2026-06-*/*.txt", vehicle="parent 2", drive="stem"),
        Inputs(glob="more/**/*.txt", vehicle="(?P<vehicle>[^/]+)/log", drive="stem"),
        Inputs(list_file="drives.csv"),
    )
    assert [(o.step, o.params.plain()) for o in batch.defaults] == [("reader.box", {"gravity": "9.80665 m/s^2"})]
    assert [o.step for o in batch.vehicles["B7"]] == ["smooth", "reader.box"]
    assert batch.exports == ("count",)
    assert (batch.executor, batch.executor_params.plain()) == ("executor.pool", {"workers": 2})
    assert (batch.on_error, batch.retries, batch.resume) == ("stop", 1, False)
    assert (batch.timeout, batch.memory) == (600.0, 2_000_000_000)


def test_what_is_left_out_has_a_default() -> None:
    batch, faults = parse(load(LEAST, "b.yaml"))
    assert faults == []
    assert (batch.defaults, batch.vehicles, batch.exports, batch.executor) == ((), {}, (), "")
    assert (batch.on_error, batch.retries, batch.resume) == ("continue", 0, True)
    assert (batch.timeout, batch.memory) == (None, None)
    assert batch.inputs == (Inputs(glob="*.txt", vehicle="parent 1", drive="stem"),)


@pytest.mark.parametrize(
    ("size", "expected"), [("1 B", 1), ("1.5 kB", 1500), ("512 MiB", 512 * 2**20), ("1TB", 10**12)]
)
def test_sizes_are_bytes(size: str, expected: int) -> None:
    assert parse(load(f"{LEAST}memory: {size}\n", "b.yaml"))[0].memory == expected


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("recon: 2", "b.yaml:5:8: error: recon: 2 is not known; write 1"),
        ("retires: 1", "b.yaml:5:1: error: a batch file has no key 'retires'; did you mean 'retries'?"),
        ("retries: -1", "b.yaml:5:10: error: retries must be a whole number, 0 or more"),
        ("retries: true", "b.yaml:5:10: error: retries must be a whole number, 0 or more"),
        ("resume: 1", "b.yaml:5:9: error: resume must be true or false"),
        ("timeout: 10", "b.yaml:5:10: error: timeout: a unit is missing: write for example '10 s'"),
        ("timeout: 0 s", "b.yaml:5:10: error: timeout must be above 0 s"),
        ("timeout: 2 GB", "b.yaml:5:10: error: timeout: unknown unit 'GB'"),
        ("memory: 2", "b.yaml:5:9: error: memory must be a size such as 2 GB; units are B, kB, MB, GB, TB, KiB,"),
        ("memory: 0 GB", "b.yaml:5:9: error: memory must be a size such as 2 GB"),
        ("on_error: ignore", "b.yaml:5:11: error: on_error is 'ignore'; write continue or stop"),
        ("exports: csv", "b.yaml:5:10: error: exports must be a list; write [csv]"),
        ("exports: [1]", "b.yaml:5:11: error: an export must be text; put it in quotes"),
        ("on_error: 1", "b.yaml:5:11: error: on_error must be text; put it in quotes"),
        ("executor: executor.pool", "b.yaml:5:11: error: executor must be a mapping; its keys are use, params"),
        ("executor: {params: {}}", "b.yaml:5:11: error: executor needs the key 'use'"),
        ("executor: {use: a.b, params: 1}", "b.yaml:5:30: error: params must be a mapping"),
        ("defaults: [1]", "b.yaml:5:11: error: defaults must be a mapping of steps to parameters"),
        ("defaults: {smooth: 1}", "b.yaml:5:20: error: smooth must be a mapping of its parameters"),
        ("vehicles: [A12]", "b.yaml:5:11: error: vehicles must be a mapping"),
        ("vehicles: {A12: 1}", "b.yaml:5:17: error: vehicles.A12 must be a mapping of steps to parameters"),
    ],
)
def test_a_wrong_line_is_told_with_its_place(line: str, message: str) -> None:
    (problem,) = form_problems(f"{LEAST}{line}\n")
    assert problem.startswith(message)


@pytest.mark.parametrize(
    ("item", "message"),
    [
        ("{}", "b.yaml:3:10: error: an input needs either 'glob' or 'list'"),
        ("{glob: a, list: b}", "b.yaml:3:10: error: an input needs either 'glob' or 'list'"),
        ("{glob: a, vehicle: parent 0}", "b.yaml:3:29: error: vehicle: 'parent 0' does not tell the vehicle; write"),
        (
            "{glob: a, vehicle: '(?P<drive>.*)'}",
            "b.yaml:3:29: error: vehicle: '(?P<drive>.*)' does not tell the vehicle",
        ),
        ("{glob: a, drive: '(?P<drive>'}", "b.yaml:3:27: error: drive: '(?P<drive>' is no regex: missing )"),
        ("{list: a, drive: stem}", "b.yaml:3:20: error: 'drive' goes with a glob; a list has a column for it"),
        ("{golb: a}", "b.yaml:3:11: error: an input has no key 'golb'; did you mean 'glob'?"),
        ("data", "b.yaml:3:10: error: an input must be a mapping; its keys are glob, list, vehicle, drive"),
    ],
)
def test_a_wrong_input_is_told_with_its_place(item: str, message: str) -> None:
    text = f"batch: june\npipeline: smooth.yaml\ninputs: [{item}]\noutput: results\n"
    assert form_problems(text)[0].startswith(message)


def test_every_key_that_is_needed_is_asked_for_at_once() -> None:
    assert form_problems("batch: june\ninputs: []\n") == [
        "b.yaml:1:1: error: a batch file needs the key 'pipeline'",
        "b.yaml:1:1: error: a batch file needs the key 'output'",
        "b.yaml:2:9: error: inputs must name at least one place; write '- glob: data/*.txt'",
    ]


# --- content --------------------------------------------------------------------------------------------------------


def test_a_whole_file_has_no_problem(problems: Any) -> None:
    assert problems(WHOLE) == []
    assert problems(LEAST) == []


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            "defaults: {smooth: {windw: 1 s}}",
            "b.yaml:5:21: error: filter.smooth has no parameter 'windw'; did you mean 'window'?",
        ),
        ("defaults: {smooth: {window: 5 m}}", "b.yaml:5:29: error: filter.smooth: window: '5 m' is a length"),
        (
            "defaults: {smoth: {window: 1 s}}",
            "b.yaml:5:12: error: 'smooth' has no step 'smoth'; did you mean 'smooth'?",
        ),
        (
            "defaults: {reader.box: {gravty: 1 g}}",
            "b.yaml:5:25: error: reader.box has no parameter 'gravty'; did you mean 'gravity'?",
        ),
        ("vehicles: {A: {}, B: {smooth: {window: 0 s}}}", "b.yaml:5:40: error: filter.smooth: window: "),
        ("exports: [count, cuont]", "b.yaml:5:18: error: there is no stage 'exporter.cuont'; did you mean"),
        ("executor: {use: executor.poll}", "b.yaml:5:17: error: there is no stage 'executor.poll'; did you mean"),
        ("executor: {use: filter.smooth}", "b.yaml:5:17: error: filter.smooth runs no jobs; name an executor"),
        (
            "executor: {use: executor.pool, params: {worker: 2}}",
            "b.yaml:5:41: error: executor.pool has no parameter 'worker'; did you mean 'workers'?",
        ),
    ],
)
def test_what_fits_nowhere_is_told_with_its_place_in_the_batch_file(problems: Any, line: str, message: str) -> None:
    (problem,) = problems(f"{LEAST}{line}\n")
    assert problem.startswith(message)


def test_a_fault_of_the_defaults_is_told_once_however_many_vehicles_there_are(problems: Any) -> None:
    found = problems(f"{LEAST}defaults: {{smooth: {{windw: 1 s}}}}\nvehicles: {{A: {{}}, B: {{}}}}\n")
    assert len(found) == 1


def test_a_pipeline_that_is_not_there_is_told_where_it_is_named(problems: Any) -> None:
    missing = str(Path("gone.yaml"))
    (problem,) = problems(LEAST.replace("smooth.yaml", "gone.yaml"))
    assert problem == f"b.yaml:2:11: error: {missing}: there is no such file"
    (problem,) = problems(LEAST.replace("smooth.yaml", "thessis"))
    assert problem == "b.yaml:2:11: error: there is no pipeline 'thessis'; did you mean 'thesis'?"


def test_faults_of_the_pipeline_keep_their_own_place(problems: Any) -> None:
    Path("smooth.yaml").write_text(PIPELINE + "  - use: filter.smoth\n")
    (problem,) = problems(LEAST)
    assert problem == "smooth.yaml:4:10: error: there is no stage 'filter.smoth'; did you mean 'filter.smooth'?"


def test_the_pipeline_lies_relative_to_the_batch_file(tmp_path: Path) -> None:
    (tmp_path / "smooth.yaml").write_text(PIPELINE)
    (tmp_path / "b.yaml").write_text(LEAST)
    batch, _ = parse(load_file(tmp_path / "b.yaml"))
    assert check_batch(batch, REGISTRY) == []


@pytest.mark.parametrize("line", [f"memory: {'9' * 400} GB", "memory: 0 GB"])
def test_a_size_beyond_all_numbers_is_refused(line: str) -> None:
    _, problems = parse(load(f"batch: b\npipeline: thesis\ninputs: []\noutput: out\n{line}\n", "b.yaml"))
    assert "memory must be a size such as 2 GB" in [problem.text for problem in problems]
