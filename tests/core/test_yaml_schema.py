"""The JSON Schema of YAML files, judged by a validator of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from jsonschema import Draft202012Validator

from recon.parameters import Params, quantity, setting
from recon.pipeline import shipped
from recon.registry import Registry, Source
from recon.schema import IMU, SAME
from recon.stages import Filter
from recon.yaml_nodes import load, load_file
from recon.yaml_schema import yaml_schema


class Shape(Params):
    order: int = setting(2, gt=0, doc="Order.")


class SmoothParams(Params):
    count: int = setting(gt=0, doc="Number of samples.")
    length: float = quantity(5.0, "ms", gt=0, doc="Length.")
    shape: Shape = setting(Shape(), doc="Shape.")


def smooth(*, imu: pa.Table, params: Params) -> dict[str, pa.Table]:
    return {"imu": imu}


SMOOTH = Filter(
    name="smooth", summary="S.", run=smooth, params=SmoothParams, reads={"imu": IMU.need("accel")}, writes={"imu": SAME}
)
BATCH = """\
recon: 1
batch: june_fleet
pipeline: best_accuracy
inputs:
  - glob: data/*/2026-06-*/*.txt
    vehicle: parent 2
    drive: stem
  - list: drives.csv
output: results
defaults: {reader.physycom: {gravity: 9.80665 m/s^2}}
vehicles:
  A12: {filter.moving_average: {window: 20 ms}, my_step: {anything: 1}}
exports: [csv, exporter.csv]
on_error: continue
retries: 1
timeout: 10 min
memory: 2 GB
resume: true
"""
READER = "  - use: reader.auto\n"


@pytest.fixture(scope="module")
def schema() -> dict[str, Any]:
    return yaml_schema(Registry.installed())


def is_valid(schema: dict[str, Any], text: str) -> bool:
    return Draft202012Validator(schema).is_valid(load(text, "x.yaml").plain())


def test_it_is_a_schema(schema: dict[str, Any]) -> None:
    Draft202012Validator.check_schema(schema)


def test_every_reference_leads_somewhere(schema: dict[str, Any]) -> None:
    def references(part: Any) -> list[str]:
        if isinstance(part, list):
            return [found for item in part for found in references(item)]
        if not isinstance(part, dict):
            return []
        own = [part["$ref"]] if isinstance(part.get("$ref"), str) else []
        return own + [found for item in part.values() for found in references(item)]

    found = references(schema)
    assert found
    assert {name.removeprefix("#/$defs/") for name in found} <= set(schema["$defs"])


@pytest.mark.parametrize("name", sorted(shipped()))
def test_it_takes_the_pipelines_that_come_with_recon(schema: dict[str, Any], name: str) -> None:
    Draft202012Validator(schema).validate(load_file(shipped()[name]).plain())


def test_it_takes_a_batch_file(schema: dict[str, Any]) -> None:
    Draft202012Validator(schema).validate(load(BATCH, "b.yaml").plain())


def test_it_takes_whatever_a_step_may_say(schema: dict[str, Any]) -> None:
    text = f"""\
recon: 1
name: x
about: y
store: mcap
steps:
{READER}    params: {{reader.physycom: {{gravity: 9.81 m/s^2}}}}
  - use: filter.moving_average
    id: rear
    params:
    in: {{imu: imu_2}}
    out: {{imu: imu_2}}
"""
    assert is_valid(schema, text)


@pytest.mark.parametrize(
    "text",
    [
        "steps: []",
        "name: x",
        f"nmae: x\nsteps:\n{READER}",
        f"recon: 2\nsteps:\n{READER}",
        f"store: csv\nsteps:\n{READER}",
        "steps:\n  - use: reader.atuo",
        f"steps:\n{READER}    parms: {{}}",
        f"steps:\n{READER}    params: {{gravity: 9.81 m/s^2}}",
        f"steps:\n{READER}    params: {{reader.physycom: {{gravty: 9.81 m/s^2}}}}",
        f"steps:\n{READER}    params: {{reader.physycom: {{gravity: 9.81}}}}",
        f"steps:\n{READER}  - use: filter.moving_average\n    params: {{windw: 20 ms}}",
        f"steps:\n{READER}    in: [imu]",
        BATCH.replace("pipeline: best_accuracy\n", ""),
        BATCH.replace("retries: 1", "retries: -1"),
        BATCH.replace("2 GB", "2 GBit"),
        BATCH.replace("10 min", "10"),
        BATCH.replace("- list: drives.csv", "- {list: drives.csv, glob: x}"),
        BATCH.replace("window: 20 ms", "windw: 20 ms"),
        BATCH.replace("[csv, ", "[cvs, "),
        BATCH + f"steps:\n{READER}",
    ],
)
def test_it_refuses_what_the_check_refuses(schema: dict[str, Any], text: str) -> None:
    assert not is_valid(schema, text)


def test_a_parameter_that_is_needed_is_needed_in_a_step_only() -> None:
    made = yaml_schema(Registry.of(SMOOTH))
    assert not is_valid(made, "steps: [{use: filter.smooth}]")
    assert not is_valid(made, "steps: [{use: filter.smooth, params: {length: 5 ms}}]")
    assert is_valid(made, "steps: [{use: filter.smooth, params: {count: 5}}]")
    least = "batch: x\npipeline: y\ninputs: [{glob: a}]\noutput: z\n"
    assert is_valid(made, least + "defaults: {filter.smooth: {length: 5 ms}}")


def test_types_of_parameters_are_found_below_the_stage() -> None:
    made = yaml_schema(Registry.of(SMOOTH))
    assert is_valid(made, "steps: [{use: filter.smooth, params: {count: 5, shape: {order: 4}}}]")
    assert not is_valid(made, "steps: [{use: filter.smooth, params: {count: 5, shape: {order: 0}}}]")


def test_a_stage_that_is_broken_may_have_any_parameters() -> None:
    registry = Registry({"filter.broken": [Source("d", "1", "no_such_module")]})
    made = yaml_schema(registry)
    assert is_valid(made, "steps: [{use: filter.broken, params: {any: thing}}]")
    assert "no_such_module" in made["$defs"]["filter.broken"]["description"]


def test_it_is_made_anew_equally(schema: dict[str, Any], tmp_path: Path) -> None:
    assert yaml_schema(Registry.installed()) == schema
