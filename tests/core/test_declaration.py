from __future__ import annotations

from functools import partial

import pytest

from recon.parameters import Params
from recon.schema import EVENTS, GNSS, IMU, METRICS, SAME, Change
from recon.stages import Detector, Filter


def clean(*, imu, params):
    return {"imu": imu}


def filter_with(**declared):
    facts = {"reads": {"imu": IMU.need("accel")}, "writes": {"imu": SAME}, "run": clean, **declared}
    return Filter(name=facts.pop("name", "clean"), summary=facts.pop("summary", "Cleans."), **facts)


def test_the_key_is_role_and_name():
    assert filter_with().key == "filter.clean"


def test_a_good_declaration_has_no_faults():
    assert filter_with().faults() == []
    assert filter_with(run=partial(clean)).faults() == []


@pytest.mark.parametrize(
    ("declared", "fault"),
    [
        ({"name": "Low-Pass"}, "the name 'Low-Pass' must be of lower-case letters, digits and _"),
        ({"name": ""}, "the name '' must be of lower-case letters, digits and _"),
        ({"summary": " "}, "the summary is empty"),
        ({"params": dict}, "params must be a subclass of recon.Params"),
        ({"params": Params()}, "params must be a subclass of recon.Params"),
        ({"writes": {"gnss": SAME}}, "it changes the stream 'gnss', which it does not read"),
        ({"reads": {}, "writes": {}}, "its function takes the argument(s) ['imu'], which it does not declare to read"),
        (
            {"reads": {"imu": IMU.need("accel"), "gnss": GNSS.need()}},
            "its function does not take the argument(s) ['gnss'], which it is given",
        ),
        ({"run": "clean"}, "run is no function whose arguments can be read"),
    ],
)
def test_a_fault_of_a_declaration_is_a_sentence(declared, fault):
    assert filter_with(**declared).faults() == [fault]


def test_outputs_follow_the_schema_of_the_input():
    level = filter_with(writes={"imu": Change(frames={"accel": "level"})})
    outputs = level.outputs({"imu": IMU.only("accel")}, level.params())
    assert outputs["imu"]["accel_x"].frame == "level"
    assert outputs["imu"].names == ("time", "accel_x", "accel_y", "accel_z")


def test_every_stage_may_return_metrics():
    assert filter_with().outputs({"imu": IMU}, filter_with().params())["metrics"] == METRICS


def test_a_changed_stream_that_is_absent_is_not_an_output():
    assert "imu" not in filter_with().outputs({}, filter_with().params())


def test_a_plan_takes_the_place_of_what_is_written():
    def plan(schemas, params):
        return {"events": EVENTS}

    def find(*, imu, params):
        return {}

    stage = Detector(name="a", summary="A.", run=find, reads={"imu": IMU.need()}, plan=plan)
    assert set(stage.outputs({"imu": IMU}, stage.params())) == {"events", "metrics"}
