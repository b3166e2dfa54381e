from __future__ import annotations

import math
from typing import Any, Literal

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from recon.parameters import NoParams, Params, bind, json_schema, quantity, setting, unit_of
from recon.pipeline import Pipeline, Step
from recon.problems import Where
from recon.yaml_nodes import Node, load

HERE = Where("x.yaml")


class Sample(Params):
    cutoff: float = quantity(12.0, "Hz", gt=0, le=100, doc="Frequency.")
    tilt: float | None = quantity(None, "deg", ge=-180, doc="Angle.")
    noise: float = quantity(0.24, "deg/sqrt(h)", doc="Angular random walk.")
    warmth: float = quantity(20.0, "degC", doc="Temperature.")
    arm: tuple[float, float, float] = quantity((0.0, 10.0, -5.0), "cm", doc="Lever arm.")
    other_arm: tuple[float, float, float] | None = quantity(None, "m", doc="Another lever arm.")
    outages: tuple[tuple[float, float], ...] = quantity((), "s", doc="Pairs of start and end.")
    order: int = setting(4, gt=0, doc="Order.")
    share: float = setting(0.5, ge=0, doc="A share.")
    side: Literal["left", "right"] = setting("left", doc="Side.")
    exact: bool = setting(True, doc="Switch.")
    names: tuple[str, ...] = setting((), doc="Names.")
    columns: dict[str, str] = setting({}, doc="Columns by name.")


class Asking(Params):
    gain: float = setting(doc="Gain of the loop.")


def bound(text):
    params, problems = bind(Sample, load(text, "x.yaml"), "filter.sample")
    assert problems == []
    return params


def refused(text, params=Sample):
    found, problems = bind(params, load(text, "x.yaml"), "filter.sample")
    assert found is None
    return [problem.as_text() for problem in problems]


def test_defaults_are_kept_in_si():
    params = Sample()
    assert params.noise == 0.24 * math.pi / 180 / 60
    assert params.warmth == 293.15
    assert params.arm == (0.0, 0.1, -0.05)
    assert params.tilt is None


def test_a_number_in_python_is_si_and_a_text_has_its_unit():
    assert Sample(tilt=0.5).tilt == 0.5
    assert Sample(tilt="90 deg").tilt == math.pi / 2
    assert Sample(arm=(1.0, 2.0, 3.0)).arm == (1.0, 2.0, 3.0)
    assert Sample(arm=["1 m", "2 cm", 3.0]).arm == (1.0, 0.02, 3.0)


def test_text_needs_the_unit():
    assert refused("cutoff: 12") == [
        "x.yaml:1:9: error: filter.sample: cutoff: a unit is missing: write for example '12 Hz'"
    ]
    assert bound("cutoff: 0.012 kHz").cutoff == 12.0


def test_each_part_of_a_list_needs_the_unit():
    assert bound("other_arm: [1 m, 20 mm, -3 cm]").other_arm == (1.0, 0.02, -0.03)
    assert refused("other_arm: [1 m, 2, 3 m]") == [
        "x.yaml:1:12: error: filter.sample: other_arm: a unit is missing: write for example '2 m'"
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("cutoff: 3 m", "1:9: error: filter.sample: cutoff: '3 m' is a length (m); needs a unit like Hz"),
        ("cutoff: 0 Hz", "1:9: error: filter.sample: cutoff: must be greater than 0 Hz"),
        ("cutoff: 1 kHz", "1:9: error: filter.sample: cutoff: must be at most 100 Hz"),
        ("cutoff:", "1:8: error: filter.sample: cutoff: must be a number with a unit like Hz"),
        ("cutoff: true", "1:9: error: filter.sample: cutoff: must be a number with a unit like Hz"),
        ("tilt: -4 rad", "1:7: error: filter.sample: tilt: must be at least -180 deg"),
        ("arm: 1 m", "1:6: error: filter.sample: arm: must be a list"),
        ("arm: [1 m, 2 m]", "1:6: error: filter.sample: arm: has too few entries"),
        ("arm: [1 m, 2 m, 3 m, 4 m]", "1:6: error: filter.sample: arm: has too many entries"),
        ("order: 0", "1:8: error: filter.sample: order: must be greater than 0"),
        ("order: 1.5", "1:8: error: filter.sample: order: must be a whole number"),
        ("order: four", "1:8: error: filter.sample: order: must be a whole number"),
        ("share: much", "1:8: error: filter.sample: share: must be a number"),
        ("exact: yes", "1:8: error: filter.sample: exact: must be true or false"),
        ("exact: 1", "1:8: error: filter.sample: exact: must be true or false"),
        ("side: lefft", "1:7: error: filter.sample: side: must be 'left' or 'right'; did you mean 'left'?"),
        ("names: imu", "1:8: error: filter.sample: names: must be a list"),
        ("names: [imu, 2]", "1:14: error: filter.sample: names: must be text"),
        ("columns: [a]", "1:10: error: filter.sample: columns: must be a mapping"),
        ("columns: {a: 1}", "1:14: error: filter.sample: columns: must be text"),
        ("cutof: 1 Hz", "1:1: error: filter.sample has no parameter 'cutof'; did you mean 'cutoff'?"),
    ],
)
def test_a_wrong_value_is_one_sentence_at_its_place(text, message):
    assert refused(text) == [f"x.yaml:{message}"]


def test_an_unknown_name_like_no_other_lists_what_there_is():
    assert refused("x: 1", Asking) == [
        "x.yaml:1:1: error: filter.sample needs the parameter 'gain'; Gain of the loop.",
        "x.yaml:1:1: error: filter.sample has no parameter 'x'; it has gain",
    ]
    assert refused("x: 1", NoParams) == ["x.yaml:1:1: error: filter.sample has no parameter 'x'; it has none"]


def test_lists_may_be_nested():
    assert bound("outages: [[1 s, 2 s], [1 min, 2 min]]").outages == ((1.0, 2.0), (60.0, 120.0))
    assert Sample(outages=((1.0, 2.0),)).as_text()["outages"] == [["1 s", "2 s"]]


def test_all_problems_are_found_at_once():
    assert len(refused("cutoff: 1\norder: 0\nside: up\n")) == 3


def test_parameters_are_frozen_finite_and_closed():
    with pytest.raises(ValidationError, match="frozen"):
        Sample().order = 5
    with pytest.raises(ValidationError, match="finite"):
        Sample(share=math.inf)
    with pytest.raises(ValidationError, match="Extra inputs"):
        Sample(ordr=5)


def test_description_shows_defaults_as_people_write_them():
    shown = {info.name: (info.default, info.unit) for info in Sample.describe()}
    assert shown["noise"] == ("0.24 deg/sqrt(h)", "deg/sqrt(h)")
    assert shown["arm"] == ("[0 cm, 10 cm, -5 cm]", "cm")
    assert shown["tilt"] == ("none", "deg")
    assert shown["exact"] == ("true", "")
    assert [info.default for info in Asking.describe()] == ["required"]


class Kinds(Params):
    a: float = setting(1.0, doc="A.")
    b: int | None = setting(None, doc="B.")
    c: bool = setting(True, doc="C.")
    d: Literal["one", "two", "three"] = setting("one", doc="D.")
    e: tuple[float, float, float] = setting((0.0, 0.0, 0.0), doc="E.")
    f: tuple[str, ...] = setting((), doc="F.")
    g: tuple[tuple[float, float], ...] = setting((), doc="G.")
    h: dict[str, Any] = setting({}, doc="H.")
    i: tuple[bool, ...] = setting((), doc="I.")


def test_types_are_told_in_words():
    assert [info.type for info in Kinds.describe()] == [
        "number",
        "whole number or none",
        "true or false",
        "'one', 'two' or 'three'",
        "list of 3 numbers",
        "list of texts",
        "list of lists of 2 numbers",
        "mapping",
        "list of true or false",
    ]


def test_si_values_are_json_data():
    assert Sample(arm=(1.0, 2.0, 3.0)).as_si()["arm"] == [1.0, 2.0, 3.0]
    assert Sample().as_si()["warmth"] == 293.15


FINITE = st.floats(allow_nan=False, allow_infinity=False)


@given(
    st.builds(
        Sample,
        cutoff=st.floats(5e-324, 100.0),
        tilt=st.none() | st.floats(-math.pi, 1e300),
        noise=FINITE,
        warmth=FINITE,
        arm=st.tuples(FINITE, FINITE, FINITE),
        share=st.floats(0, allow_infinity=False),
        order=st.integers(1, 2**62),
        names=st.lists(st.sampled_from(["1e-3", "on", "12:30", "null", "0x1F", " a "])).map(tuple),
    )
)
def test_parameters_survive_yaml_to_the_last_bit(params):
    step = Step("filter.sample", "filter.sample", Node.of(params.as_text(), HERE), HERE)
    (again,) = Pipeline.from_text(Pipeline("p", (step,)).to_yaml()).steps
    assert bind(Sample, again.params, "filter.sample") == (params, [])


def test_the_json_schema_accepts_what_binding_accepts():
    schema = json_schema(Sample)
    jsonschema.Draft202012Validator.check_schema(schema)
    valid = jsonschema.Draft202012Validator(schema).is_valid
    good = {"cutoff": "12 Hz", "tilt": None, "arm": ["1 m", "2 m", "3 m"], "order": 2, "side": "right", "exact": False}
    assert valid(good)
    assert bind(Sample, Node.of(good, HERE), "x")[1] == []
    assert schema["properties"]["cutoff"]["default"] == "12 Hz"


@pytest.mark.parametrize(
    "wrong", [{"cutoff": 12}, {"cutoff": "12"}, {"order": 0}, {"side": "up"}, {"arm": [1, 2, 3]}, {"odd": 1}]
)
def test_the_json_schema_refuses_what_binding_refuses(wrong):
    assert not jsonschema.Draft202012Validator(json_schema(Sample)).is_valid(wrong)
    assert bind(Sample, Node.of(wrong, HERE), "x")[1] != []


def test_only_quantities_have_a_unit():
    assert (unit_of(Sample, "cutoff"), unit_of(Sample, "order")) == ("Hz", "")
