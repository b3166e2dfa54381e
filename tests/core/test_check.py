from __future__ import annotations

import pytest
from helpers import filter_of, gnss_table, imu_table, pipeline_of, problems_of, source_of

from recon.check import check, with_exports
from recon.errors import PluginBroken
from recon.overrides import Override
from recon.parameters import Params, quantity, setting
from recon.pipeline import Pipeline
from recon.registry import Registry
from recon.schema import ANY, EVENTS, GNSS, IMU, SAME, TRAJECTORY, Change, Column, Need
from recon.stages import Delegation, Executor, Exporter, Reader


class Gain(Params):
    gain: float = quantity(1.0, "1/s", gt=0, doc="Gain.")


class Asking(Params):
    kind: str = setting(doc="What the file holds.")


def read(path, params):
    return {}


def hand_over(path, params, registry):
    return {}


def export(*, imu, folder, about, params):
    return []


def work(*, imu, params):
    return {}


LOG = Reader(name="log", summary="A log.", run=read, params=Gain, writes={"imu": IMU, "gnss": GNSS.possible()})
ASKING = Reader(name="asking", summary="Asks.", run=read, params=Asking, writes={"imu": IMU})
ANYONE = Reader(name="any", summary="Any.", run=hand_over, params=Delegation, writes={"imu": IMU.possible()})
CSV = Exporter(name="csv", summary="CSV.", run=export, reads={"imu": IMU.need("accel")})
SAME_IMU = filter_of(work, writes={"imu": SAME}, params=Gain)
TO_VEHICLE = filter_of(
    work, "turn", reads={"imu": IMU.need("accel", frame="sensor")}, writes={"imu": Change(frames={"accel": "vehicle"})}
)
NEEDS_VEHICLE = filter_of(work, "vehicle", reads={"imu": IMU.need("accel", frame="vehicle")}, writes={"imu": SAME})
HEAT = Column("heat", "K", quantity="temperature")
ADDS_HEAT = filter_of(work, "warm", writes={"imu": Change(adds=(HEAT,))})


def found(*steps, records, **options):
    return [problem.as_text() for problem in problems_of(pipeline_of(*steps), *records, **options)]


def test_a_good_pipeline_has_a_plan_and_no_problem():
    plan, problems = check(pipeline_of("use: reader.log", "use: filter.turn"), Registry.of(LOG, TO_VEHICLE))
    assert problems == []
    assert [step.id for step in plan.steps] == ["reader.log", "filter.turn"]
    assert plan.streams["imu"]["accel_x"].frame == "vehicle"
    assert plan.steps[1].inputs == {"imu": "imu"}
    assert plan.resolved()[0] == {
        "id": "reader.log",
        "use": "reader.log",
        "stage_version": 1,
        "distribution": "",
        "distribution_version": "",
        "params": {"gain": 1.0},
        "in": {},
        "out": {},
    }


def test_frames_are_followed_down_the_list():
    records = (LOG, TO_VEHICLE, NEEDS_VEHICLE)
    assert found("use: reader.log", "use: filter.turn", "use: filter.vehicle", records=records) == []
    assert found("use: reader.log", "use: filter.vehicle", records=records) == [
        "test.yaml:4:10: error: filter.vehicle reads imu.accel_x, accel_y, accel_z in frame 'vehicle'; "
        "here it is in frame 'sensor'; put a step that turns it before this one: 'recon plugins aligner' lists them"
    ]


def test_a_column_that_only_a_later_step_writes_says_so():
    uses_heat = filter_of(work, "melt", reads={"imu": Need((HEAT,))}, writes={"imu": SAME})
    (problem,) = found("use: reader.log", "use: filter.melt", "use: filter.warm", records=(LOG, ADDS_HEAT, uses_heat))
    assert problem.startswith("test.yaml:4:10: error: filter.melt reads imu.heat; columns of 'imu' here are time, ")
    assert problem.endswith("\n    test.yaml:5:10: note: filter.warm writes imu.heat, but only later: move it above")


def test_an_absent_stream_names_those_that_are_there():
    fuse = filter_of(lambda *, trajectory, params: {}, "fuse", reads={"trajectory": TRAJECTORY.need("pos")})
    assert found("use: reader.log", "use: filter.fuse", records=(LOG, fuse)) == [
        "test.yaml:4:10: error: filter.fuse reads 'trajectory'; streams here are gnss, imu, metrics"
    ]


def test_an_optional_stream_may_be_absent():
    fuse = filter_of(
        lambda *, trajectory, params: {}, "fuse", reads={"trajectory": TRAJECTORY.need("pos", optional=True)}
    )
    assert found("use: reader.log", "use: filter.fuse", records=(LOG, fuse)) == []


def test_what_only_the_file_can_tell_is_no_problem_yet():
    uses_speed = filter_of(lambda *, gnss, params: {}, "speed", reads={"gnss": GNSS.need("speed")})
    assert found("use: reader.log", "use: filter.speed", records=(LOG, uses_speed)) == []


def test_an_unknown_stage_hides_no_other_problem():
    assert found("use: reader.lg", "{use: filter.work, params: {gain: 1}}", records=(LOG, SAME_IMU)) == [
        "test.yaml:3:10: error: there is no stage 'reader.lg'; did you mean 'reader.log'?",
        "test.yaml:4:39: error: filter.work: gain: a unit is missing: write for example '1 1/s'",
    ]


def test_a_wrong_parameter_hides_no_problem_of_the_flow():
    first, second = found("use: reader.log", "{use: filter.vehicle, params: {a: 1}}", records=(LOG, NEEDS_VEHICLE))
    assert "filter.vehicle reads imu.accel_x" in first
    assert "has no parameter 'a'; it has none" in second


def test_ports_are_renamed_in_the_plan():
    plan, problems = check(
        pipeline_of("use: reader.log", "{use: filter.turn, in: {imu: imu_2}, out: {imu: imu_2}}"),
        Registry.of(LOG, TO_VEHICLE),
    )
    assert problems == []
    assert plan.steps[1].inputs == {"imu": "imu_2"}
    assert plan.streams["imu_2"]["accel_x"].frame == "vehicle"
    assert plan.streams["imu"]["accel_x"].frame == "sensor"


def test_a_further_sensor_of_a_stream_that_is_never_read_is_a_problem():
    (problem,) = found("use: reader.log", "{use: filter.turn, in: {imu: mag_2}}", records=(LOG, TO_VEHICLE))
    assert problem == ("test.yaml:4:34: error: filter.turn reads 'mag_2'; streams here are gnss, imu, metrics")


def test_a_further_sensor_is_asked_of_readers_only():
    (problem,) = found(
        "use: simulator.made",
        "{use: filter.turn, in: {imu: imu_2}}",
        records=(source_of({"imu": imu_table()}), TO_VEHICLE),
    )
    assert "filter.turn reads 'imu_2'; streams here are imu, metrics" in problem


def test_an_unknown_port_is_found_at_its_key():
    assert found(
        "use: reader.log", "{use: filter.turn, in: {imy: imu}, out: {gnss: imu}}", records=(LOG, TO_VEHICLE)
    ) == [
        "test.yaml:4:29: error: filter.turn has no port 'imy' under 'in'; did you mean 'imu'?",
        "test.yaml:4:46: error: filter.turn has no port 'gnss' under 'out'; it has imu, metrics",
    ]


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        (
            ["use: filter.work"],
            "3:10: error: the first step is filter.work, which reads no file; begin with '- use: reader.auto'",
        ),
        (
            ["use: reader.log", "{use: reader.log, id: again}"],
            "4:11: error: reader.log must be the first step; a pipeline has one source",
        ),
        (
            ["use: reader.log", "use: executor.local"],
            "4:10: error: executor.local is no step of a pipeline; name it under 'executor:' in a batch file",
        ),
        (
            ["use: reader.log", "use: exporter.csv", "use: filter.work"],
            "4:10: error: exporter.csv must come after all steps that are no exporters; "
            "it is given what the run ends with",
        ),
    ],
)
def test_a_step_in_a_wrong_place(steps, message):
    local = Executor(name="local", summary="Here.", run=lambda jobs, params: iter(()))
    assert f"test.yaml:{message}" in found(*steps, records=(LOG, SAME_IMU, CSV, local))


def test_exporters_may_follow_each_other():
    twice = ["use: reader.log", "use: exporter.csv", "{use: exporter.csv, id: again}"]
    assert found(*twice, records=(LOG, CSV)) == []


def test_a_recording_takes_the_place_of_the_reader():
    pipeline = pipeline_of("use: reader.log", "use: filter.turn")
    plan, problems = check(pipeline, Registry.of(LOG, TO_VEHICLE), given={"imu": IMU})
    assert problems == []
    assert [step.id for step in plan.steps] == ["filter.turn"]


def test_events_and_metrics_are_kept_with_their_step():
    find = filter_of(work, "find", writes={"events": EVENTS})
    plan, _ = check(pipeline_of("use: reader.log", "use: filter.find"), Registry.of(LOG, find))
    assert plan.streams["events"].names[0] == plan.streams["metrics"].names[0] == "step"


def test_overrides_are_checked_like_the_file():
    overrides = [Override.from_option("filter.work.gain=2"), Override.from_option("filter.wrk.gain=2")]
    assert found("use: reader.log", "use: filter.work", records=(LOG, SAME_IMU), overrides=overrides) == [
        "--set filter.work.gain=2: error: filter.work: gain: a unit is missing: write for example '2 1/s'",
        "--set filter.wrk.gain=2: error: 'test' has no step 'filter.wrk'; did you mean 'filter.work'?",
    ]


def test_an_override_is_in_the_plan():
    overrides = [Override.from_data("filter.work.gain", "2 1/s")]
    plan, problems = check(pipeline_of("use: reader.log", "use: filter.work"), Registry.of(LOG, SAME_IMU), overrides)
    assert problems == []
    assert plan.steps[1].params == Gain(gain=2.0)
    assert "gain: 2 1/s" in plan.pipeline.to_yaml()


def test_parameters_of_other_readers_are_checked_against_them():
    step = "{use: reader.any, params: {reader.log: {gian: 2 1/s}, reader.lgo: {}, reader.asking: {}, odd: 1}}"
    assert found(step, records=(LOG, ANYONE, ASKING)) == [
        "test.yaml:3:45: error: reader.log has no parameter 'gian'; did you mean 'gain'?",
        "test.yaml:3:59: error: there is no stage 'reader.lgo'; did you mean 'reader.log'?",
        "test.yaml:3:94: error: reader.any has no parameter 'odd'; it has readers",
    ]


def test_parameters_of_other_readers_are_handed_on_as_text():
    overrides = [Override.from_option("reader.log.gain=2 1/s")]
    plan, problems = check(pipeline_of("use: reader.any"), Registry.of(LOG, ANYONE), overrides)
    assert problems == []
    assert plan.steps[0].params == Delegation(readers={"reader.log": {"gain": "2 1/s"}})


def test_a_typo_in_an_override_of_another_reader_is_found():
    overrides = [Override.from_option("reader.log.gian=2 1/s"), Override.from_option("reader.lgo.gain=2 1/s")]
    assert found("use: reader.any", records=(LOG, ANYONE), overrides=overrides) == [
        "--set reader.lgo.gain=2 1/s: error: there is no stage 'reader.lgo'; did you mean 'reader.log'?",
        "--set reader.log.gian=2 1/s: error: reader.log has no parameter 'gian'; did you mean 'gain'?",
    ]


def test_an_override_of_another_reader_needs_a_reader_that_hands_over():
    overrides = [Override.from_option("reader.any.x=1")]
    assert found("use: reader.log", records=(LOG, ANYONE), overrides=overrides) == [
        "--set reader.any.x=1: error: 'test' has no step 'reader.any'; the steps are reader.log"
    ]


def test_exports_are_appended_by_their_short_or_full_name():
    exported = with_exports(Pipeline.of("p", "reader.log"), ["csv", "exporter.kml"])
    assert [step.use for step in exported.steps] == ["reader.log", "exporter.csv", "exporter.kml"]


def test_a_wrong_export_is_found_with_its_option():
    exported = with_exports(pipeline_of("use: reader.log"), ["cvs"])
    assert [problem.as_text() for problem in problems_of(exported, LOG, CSV)] == [
        "--export cvs: error: there is no stage 'exporter.cvs'; did you mean 'exporter.csv'?"
    ]


def test_a_plan_function_that_breaks_is_a_broken_plugin():
    def plan(schemas, params):
        raise RuntimeError("no plan")

    broken = filter_of(work, plan=plan)
    with pytest.raises(PluginBroken, match=r"filter.work cannot be planned: RuntimeError: no plan"):
        problems_of(pipeline_of("use: reader.log", "use: filter.work"), LOG, broken)


def test_needs_of_any_frame_take_every_frame():
    assert all(column.frame == ANY for column in IMU.need("accel").columns)


@pytest.mark.parametrize(
    ("out", "message"),
    [
        (
            "{imu: ../../evil}",
            "filter.both: a stream cannot be called '../../evil': use lower-case letters, digits and _",
        ),
        ("{imu: IMU}", "filter.both: a stream cannot be called 'IMU': use lower-case letters, digits and _"),
        ("{imu: x, gnss: x}", "filter.both: two ports are kept as 'x'"),
        ("{imu: gnss}", "filter.both: imu cannot be kept as 'gnss', the name of streams of another kind"),
        ("{imu: metrics}", "filter.both: imu cannot be kept as 'metrics', the name of streams of another kind"),
    ],
)
def test_a_stream_is_kept_under_a_name_of_its_kind(out, message):
    both = filter_of(
        lambda *, imu, gnss, params: {"imu": imu, "gnss": gnss},
        "both",
        reads={"imu": IMU.need("accel"), "gnss": GNSS.need("speed")},
        writes={"imu": SAME, "gnss": SAME},
    )
    source = source_of({"imu": imu_table(), "gnss": gnss_table()})
    problems = problems_of(pipeline_of("use: simulator.made", f"{{use: filter.both, out: {out}}}"), source, both)
    assert message in [problem.text for problem in problems]


def test_a_further_sensor_may_be_kept_beside_the_first():
    same = filter_of(lambda *, imu, params: {"imu": imu}, writes={"imu": SAME})
    steps = pipeline_of("use: simulator.made", "{use: filter.work, out: {imu: imu_2}}")
    assert problems_of(steps, source_of({"imu": imu_table()}), same) == []
