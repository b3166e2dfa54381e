from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from recon.errors import ConfigError
from recon.overrides import Override, with_overrides
from recon.pipeline import Pipeline, Step, find, shipped
from recon.problems import Where
from recon.yaml_nodes import Node

HERE = Where("<test>")

FULL = """\
recon: 1
name: full
about: Everything.
store: mcap
steps:
  - use: reader.auto
  - use: filter.clean
    id: rear
    params: {window: 50 ms, nested: {a: [1, x]}}
    in: {imu: imu_2}
    out: {imu: imu_3}
"""


def plain(pipeline):
    return (pipeline.name, pipeline.about, pipeline.store, [step.to_plain() for step in pipeline.steps])


def messages(text):
    with pytest.raises(ConfigError) as caught:
        Pipeline.from_text(text, "p.yaml")
    return [problem.as_text() for problem in caught.value.problems]


def test_a_pipeline_is_read_with_the_places_of_its_steps():
    pipeline = Pipeline.from_text(FULL, "p.yaml")
    auto, rear = pipeline.steps
    assert (pipeline.name, pipeline.about, pipeline.store, pipeline.file) == ("full", "Everything.", "mcap", "p.yaml")
    assert (auto.use, auto.id, auto.where) == ("reader.auto", "reader.auto", Where("p.yaml", 6, 10))
    assert (rear.id, rear.inputs, rear.outputs) == ("rear", {"imu": "imu_2"}, {"imu": "imu_3"})
    assert rear.params.plain() == {"window": "50 ms", "nested": {"a": [1, "x"]}}


def test_a_pipeline_without_name_is_called_like_its_file(tmp_path):
    file = tmp_path / "crash_2.yaml"
    file.write_text("steps:\n  - use: reader.auto\n", encoding="utf-8")
    pipeline = Pipeline.from_file(file)
    assert (pipeline.name, pipeline.about, pipeline.store) == ("crash_2", "", "parquet")


def test_keys_without_value_count_as_not_there():
    text = "name:\nabout:\nsteps:\n  - use: reader.auto\n    id:\n    params:\n    in:\n    out:\n"
    (step,) = Pipeline.from_text(text, "p.yaml").steps
    assert (step.id, step.params.plain(), step.inputs, step.outputs) == ("reader.auto", {}, {}, {})


def test_all_problems_of_the_form_are_found_at_once():
    text = "recon: 2\nsteps:\n  - use: a.b\n    parms: {}\n  - id: x\n  - {use: a.b, params: [1]}\n"
    assert messages(text) == [
        "p.yaml:1:8: error: recon: 2 is not known; write 1",
        "p.yaml:4:5: error: a step has no key 'parms'; did you mean 'params'?",
        "p.yaml:5:5: error: a step needs the key 'use'",
        "p.yaml:6:24: error: params must be a mapping; write 'name: value' lines below it",
        "p.yaml:6:11: error: two steps are called 'a.b'; give one of them an id of its own\n"
        "    p.yaml:3:10: note: the first is here",
    ]


def test_the_text_of_a_pipeline_reads_back():
    pipeline = Pipeline.from_text(FULL)
    assert plain(Pipeline.from_text(pipeline.to_yaml())) == plain(pipeline)


NASTY = st.sampled_from(
    [
        *("1e-3", "on", "off", "yes", "12:30", "0x1F", "0o7", "null", "~", "true", ".inf", ".nan", "1_000", "+1", ".5"),
        *("5.", "2001-12-14", "<<", "=", "- a", "a: b", "a #b", "#a", "'", '"', "{a}", "[a]", "&a", "*a", "!a", "|"),
        *("%a", "@a", "`a", "? a", "a:", " lead", "trail ", "two  words", "deg/sqrt(h)", "50 ms", "ünï", "日本", "🚗"),
        *("a\nb", "\n", "a\n\n b\n", "a\r\nb", "\t", "a\tb", "word " * 60, "x" * 300, "\ufeff", "\x07", "\x85"),
    ]
)
TEXT = NASTY | st.text(st.characters(exclude_categories=["Cs"]), min_size=1)
NAME = st.from_regex(r"\w[\w.-]{0,20}", fullmatch=True)
SCALAR = st.none() | st.booleans() | st.integers(-(2**63), 2**63 - 1) | TEXT | st.just("")
NUMBER = st.floats(allow_nan=False, allow_infinity=False)
VALUE = st.recursive(
    SCALAR | NUMBER, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3), max_leaves=6
)
STEP = st.builds(
    lambda use, params, inputs, outputs: Step(use, use, Node.of(params, HERE), HERE, inputs, outputs),
    TEXT,
    st.dictionaries(TEXT, VALUE, max_size=3),
    st.dictionaries(TEXT, TEXT, max_size=2),
    st.dictionaries(TEXT, TEXT, max_size=2),
)


@given(NAME, st.just("") | TEXT, st.lists(STEP, min_size=1, max_size=3, unique_by=lambda step: step.id))
@example("ünï-1.5", "a\u2029b", [Step("a.b", "a.b", Node.of({"\u2028": "\u2029 "}, HERE), HERE)])
def test_any_pipeline_survives_its_own_text(name, about, steps):
    pipeline = Pipeline(name, tuple(steps), about)
    assert plain(Pipeline.from_text(pipeline.to_yaml())) == plain(pipeline)


def test_a_shipped_pipeline_is_found_by_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert find("thesis") == shipped()["thesis"]
    assert Pipeline.from_file("thesis").name == "thesis"


def test_an_unknown_name_says_what_was_meant():
    with pytest.raises(ConfigError) as caught:
        find("thesi")
    assert str(caught.value) == "error: there is no pipeline 'thesi'; did you mean 'thesis'?"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("drive.txt", b"t\tax\n0\t1\n"),
        ("drive.mcap", b"\x89MCAP0\r\n"),
        ("big.csv", b"1,2\n" * 1_500_000),
        ("d1", None),
    ],
)
def test_a_log_in_the_place_of_the_pipeline_is_told(tmp_path, name, content):
    log = tmp_path / name
    log.mkdir() if content is None else log.write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        Pipeline.from_file(log)
    told = f"error: {log} is no pipeline; name the pipeline before the log, as in 'recon run best_accuracy LOG'"
    assert [problem.as_text() for problem in caught.value.problems] == [told]


def test_a_batch_file_in_the_place_of_a_pipeline_is_one_problem(tmp_path):
    file = tmp_path / "fleet.yaml"
    file.write_text("recon: 1\nbatch: fleet\npipeline: thesis\ninputs: [{glob: d/*}]\noutput: out\n")
    with pytest.raises(ConfigError) as caught:
        Pipeline.from_file(file)
    told = f"{file}:1:1: error: this is a batch file, not a pipeline; run it with recon batch"
    assert [problem.as_text() for problem in caught.value.problems] == [told]


def test_a_path_is_never_taken_for_a_shipped_name(tmp_path):
    with pytest.raises(ConfigError, match="there is no such file"):
        Pipeline.from_file(tmp_path / "thesis.yaml")


def test_an_option_is_read_as_yaml():
    override = Override.from_option("filter.clean.window=[50 ms, 1e-3, on]")
    assert (override.step, override.params.plain()) == ("filter.clean", {"window": ["50 ms", 0.001, "on"]})
    assert Override.from_option("a.b.c=").params.plain() == {"c": ""}
    assert Override.from_option("a.b.c=x=y").params.plain() == {"c": "x=y"}


def test_an_option_may_name_a_file(tmp_path):
    file = tmp_path / "columns.yaml"
    file.write_text("ax: accel_x\n", encoding="utf-8")
    assert Override.from_option(f"reader.csv.columns=@{file}").params.plain() == {"columns": {"ax": "accel_x"}}


@pytest.mark.parametrize("option", ["window=1", "filter.clean.window", ".x=1", "a.=1", "=1"])
def test_an_option_that_sets_nothing_is_refused(option):
    with pytest.raises(ConfigError) as caught:
        Override.from_option(option)
    assert str(caught.value) == f"--set {option}: error: this sets nothing; write --set STEP.PARAMETER=VALUE"


def test_a_long_option_is_cut_where_it_is_named():
    assert len(str(Override.from_option(f"a.b={'x' * 10_000}").where)) < 100


def test_data_that_yaml_cannot_hold_is_refused():
    with pytest.raises(ConfigError, match=r"override filter.a.b: error: YAML cannot hold <object"):
        Override.from_data("filter.a.b", object())
    with pytest.raises(ConfigError, match="this names no parameter of a step"):
        Override.from_data("window", 1)


def overridden(*options, delegates=lambda step: False):
    overrides = [Override.from_option(option) for option in options]
    return with_overrides(Pipeline.from_text(FULL, "p.yaml"), overrides, delegates)


def test_an_override_is_laid_over_the_parameters_of_its_step():
    pipeline, problems = overridden("rear.nested.b=1", "rear.window=1 s", "rear.nested={c: 2}")
    assert [problem.as_text() for problem in problems] == [
        "--set rear.nested.b=1: error: 'full' has no step 'rear.nested'; the steps are reader.auto, rear"
    ]
    assert pipeline.steps[1].params.plain() == {"window": "1 s", "nested": {"a": [1, "x"], "c": 2}}


def test_an_override_leaves_the_pipeline_as_it_was():
    before = Pipeline.from_text(FULL)
    after, _ = with_overrides(before, [Override.from_data("rear.window", "1 s")], lambda step: False)
    assert before.steps[1].params.plain()["window"] == "50 ms"
    assert after.steps[1].params.plain()["window"] == "1 s"
    assert "window: 1 s" in after.to_yaml()


def test_an_override_of_a_reader_goes_to_the_step_that_hands_over():
    pipeline, problems = overridden("reader.dat.gain=2", delegates=lambda step: step.use == "reader.auto")
    assert problems == []
    assert pipeline.steps[0].params.plain() == {"reader.dat": {"gain": 2}}


def test_an_override_that_names_a_step_alone_asks_for_the_parameter():
    _, (problem,) = overridden("reader.auto=1")
    assert problem.as_text() == (
        "--set reader.auto=1: error: 'reader.auto' is a step, and the name of a parameter is missing; "
        "write reader.auto.NAME, with a name that 'recon plugins show reader.auto' lists"
    )


def test_an_override_for_no_step_lists_the_steps():
    _, (problem,) = overridden("zzz.x=1")
    assert problem.as_text() == "--set zzz.x=1: error: 'full' has no step 'zzz'; the steps are reader.auto, rear"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("steps:\n  - use: 5\n", "p.yaml:2:10: error: use must be text; put it in quotes"),
        ("steps:\n  - use: [a.b]\n", "p.yaml:2:10: error: use must be text; put it in quotes"),
        ("steps:\n  - use:\n", "p.yaml:2:9: error: use names no stage; write '- use: reader.auto'"),
        ("store: 1\nsteps:\n  - use: a.b\n", "p.yaml:1:8: error: store must be text; put it in quotes"),
        ("name: [a]\nsteps:\n  - use: a.b\n", "p.yaml:1:7: error: name must be text; put it in quotes"),
        ("steps:\n  - {use: a.b, in: {imu: 2}}\n", "p.yaml:2:26: error: in.imu must be text; put it in quotes"),
    ],
)
def test_what_is_no_text_is_one_problem(text, problem):
    assert messages(text) == [problem]
