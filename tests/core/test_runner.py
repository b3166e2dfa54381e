from __future__ import annotations

import os
import pickle
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from helpers import clock, filter_of, gnss_table, imu_table, pipeline_of, run_steps, source_of

from recon.calling import call_exporter
from recon.check import check
from recon.errors import ConfigError, ContractError, DataError, NotEnoughData, ReadFailed, StageError
from recon.parameters import Params, bind, quantity
from recon.problems import Where
from recon.recording import Recording
from recon.registry import Registry
from recon.rows import Event, Metric, events, metrics, warning
from recon.runner import run_pipeline
from recon.schema import ANY, EVENTS, GNSS, IMU, METRICS, SAME, Change, Column, Need, by_step
from recon.stages import Delegation, Exporter, Reader
from recon.tables import append, build, matrix, meta, replace, schema_of, vector, with_meta
from recon.yaml_nodes import Node

MADE = source_of({"imu": imu_table()})
TWO = pipeline_of("use: simulator.made", "use: filter.work")


def same(*, imu, params):
    return {"imu": imu}


def raising(error):
    def work(*, imu, params):
        raise error

    return filter_of(work, writes={"imu": SAME})


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


def test_a_returned_stream_replaces_the_one_of_its_name():
    outcome = run_work(lambda *, imu, params: {"imu": replace(imu, accel=matrix(imu, "accel") * 2)})
    assert matrix(outcome.recording["imu"], "accel")[0].tolist() == [0.0, 0.0, 2 * 9.80665]
    assert [report.id for report in outcome.reports] == ["simulator.made", "filter.work"]
    assert outcome.reports[1].rows == {"imu": 4}


def test_what_is_returned_is_stamped_as_planned():
    turned = Change(frames={"accel": "vehicle"}, quantities={"accel": "acceleration"})
    outcome = run_work(same, writes={"imu": turned})
    assert schema_of(outcome.recording["imu"])["accel_x"].frame == "vehicle"
    assert schema_of(outcome.recording["imu"])["accel_x"].quantity == "acceleration"


def test_facts_of_a_stream_survive_every_step():
    made = source_of({"imu": with_meta(imu_table(), time_scale="GPS")})
    outcome = run_steps(TWO, made, filter_of(same, writes={"imu": SAME}))
    assert meta(outcome.recording["imu"]) == {"time_scale": "GPS"}


def test_the_tables_of_a_source_are_left_as_they_are():
    table = imu_table()
    run_steps(TWO, source_of({"imu": table}), filter_of(same, writes={"imu": Change(frames={"accel": "vehicle"})}))
    assert schema_of(table)["accel_x"].frame == "sensor"


def test_events_and_metrics_are_appended_with_the_step():
    def find(*, imu, params):
        return {"events": events([Event(1, 2, "stop")]), "metrics": metrics([Metric("count", 1.0), warning("odd")])}

    pipeline = pipeline_of("use: simulator.made", "use: filter.work", "{use: filter.work, id: again}")
    outcome = run_steps(pipeline, MADE, filter_of(find, writes={"events": EVENTS}))
    assert outcome.recording["events"]["step"].to_pylist() == ["filter.work", "again"]
    assert outcome.recording["metrics"]["step"].to_pylist() == ["filter.work", "filter.work", "again", "again"]
    assert outcome.warnings == ["odd", "odd"]
    assert outcome.reports[1].metrics == [{"name": "count", "value": 1.0}, {"name": "warning", "note": "odd"}]


def test_ports_are_renamed_in_and_out():
    pipeline = pipeline_of("use: simulator.made", "{use: filter.work, in: {imu: imu_2}, out: {imu: imu_3}}")
    made = source_of({"imu": imu_table(), "imu_2": imu_table(2)})
    outcome = run_steps(pipeline, made, filter_of(same, writes={"imu": SAME}))
    assert {name: table.num_rows for name, table in outcome.recording.items()} == {"imu": 4, "imu_2": 2, "imu_3": 2}


def test_a_second_box_of_the_files_is_reached_by_its_number(tmp_path):
    def halve(*, gnss, params):
        return {"gnss": replace(gnss, speed=vector(gnss, "speed") / 2)}

    work = filter_of(halve, reads={"gnss": GNSS.need("speed")}, writes={"gnss": SAME})
    pipeline = pipeline_of("use: reader.log", "{use: filter.work, in: {gnss: gnss_2}, out: {gnss: gnss_2}}")
    files = [log_file(tmp_path, 2, 4, name="a.txt"), log_file(tmp_path, 6, 8, name="b.txt")]
    outcome = run_steps(pipeline, text_reader(), work, source=files)
    assert vector(outcome.recording["gnss"], "speed").tolist() == [2.0, 4.0]
    assert vector(outcome.recording["gnss_2"], "speed").tolist() == [3.0, 4.0]
    assert outcome.recording.meta == {"sources": ["a.txt", "b.txt"]}


def test_what_joining_the_files_learnt_is_told_by_the_step_that_read_them(tmp_path):
    files = [log_file(tmp_path, 2, 4, name="a.txt"), log_file(tmp_path, 6, 8, name="b.txt")]
    outcome = run_steps(pipeline_of("{use: reader.log, id: boxes}"), text_reader(), source=files)
    (told,) = outcome.warnings
    assert told == "gnss_2 (b.txt) is a further sensor beside gnss (a.txt); steps read gnss unless told otherwise"
    assert {"name": "warning", "note": told, "step": "boxes"} in outcome.reports[0].metrics
    with pytest.raises(DataError, match=r"a\.txt and a\.txt hold the same rows"):
        run_steps(pipeline_of("use: reader.log"), text_reader(), source=files[:1] * 2)


def test_a_second_box_that_is_not_there_is_told_before_any_step(tmp_path):
    work = filter_of(lambda *, gnss, params: {}, reads={"gnss": GNSS.need("speed")})
    pipeline = pipeline_of("use: reader.log", "{use: filter.work, in: {gnss: gnss_2}}")
    with pytest.raises(DataError) as caught:
        run_steps(pipeline, text_reader(), work, source=[log_file(tmp_path, 1, 2)])
    assert str(caught.value) == (
        "log.txt does not hold what the pipeline needs: filter.work reads 'gnss_2'; "
        "streams here are gnss, metrics\n  'recon inspect' shows what is in it"
    )


def test_what_only_the_file_could_tell_is_told_with_sensor_and_step(tmp_path):
    work = filter_of(lambda *, gnss, params: {}, reads={"gnss": GNSS.need("pos")})
    reader = text_reader(writes={"gnss": GNSS.possible()})
    with pytest.raises(
        DataError, match=r"log.txt does not hold .* filter.work reads gnss.pos_e, pos_n, pos_u; columns"
    ):
        run_steps(pipeline_of("use: reader.log", "use: filter.work"), reader, work, source=[log_file(tmp_path, 1, 2)])


def test_a_stream_that_a_step_might_have_given_and_did_not_is_told_with_the_step_that_asks():
    maybe = filter_of(lambda *, imu, params: {}, "maybe", writes={"gnss": GNSS.possible()})
    asks = filter_of(lambda *, gnss, params: {}, "asks", reads={"gnss": GNSS.need("speed")})
    pipeline = pipeline_of("use: simulator.made", "use: filter.maybe", "use: filter.asks")
    with pytest.raises(DataError, match=r"step filter.asks: filter.asks reads 'gnss', which no step above gave"):
        run_steps(pipeline, MADE, maybe, asks)


def test_a_column_that_a_step_might_have_given_and_did_not_is_told_with_the_step_that_asks():
    heat = Column("heat", "K", quantity="temperature", optional=True)
    maybe = filter_of(same, "maybe", writes={"imu": Change(adds=(heat,))})
    needs = Need((Column("heat", "K", quantity=ANY),))
    asks = filter_of(lambda *, imu, params: {}, "asks", reads={"imu": needs})
    pipeline = pipeline_of("use: simulator.made", "use: filter.maybe", "use: filter.asks")
    with pytest.raises(DataError, match=r"step filter.asks: filter.asks reads imu.heat; columns of 'imu' here"):
        run_steps(pipeline, MADE, maybe, asks)


def test_an_absent_optional_stream_comes_as_none():
    seen = []

    def work(*, imu, gnss, params):
        seen.append(gnss)
        return {}

    run_work(work, reads={"imu": IMU.need("accel"), "gnss": GNSS.need("speed", optional=True)}, writes={})
    assert seen == [None]


def test_a_recording_takes_the_place_of_the_reader():
    recording = Recording({"imu": imu_table(), "events": events([Event(1, 2, "stop")])}, {"sources": ["here"]})

    def find(*, imu, params):
        return {"events": events([Event(3, 4, "stop")])}

    pipeline = pipeline_of("use: reader.log", "use: filter.work")
    outcome = run_steps(pipeline, text_reader(), filter_of(find, writes={"events": EVENTS}), source=recording)
    assert [report.id for report in outcome.reports] == ["filter.work"]
    assert outcome.recording["events"]["step"].to_pylist() == [None, "filter.work"]
    assert outcome.recording.meta == {"sources": ["here"]}
    assert recording["events"].num_rows == 1


def test_progress_names_each_step_as_it_begins():
    registry = Registry.of(MADE, filter_of(same, writes={"imu": SAME}))
    told = []
    run_pipeline(check(TWO, registry)[0], [], registry, lambda *step: told.append(step))
    assert told == [(0, 2, "simulator.made"), (1, 2, "filter.work"), (2, 2, "")]


# --- what a stage returns -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        (None, "it did not return a mapping of stream names to Arrow tables"),
        ({"imu": [1]}, "it did not return a mapping of stream names to Arrow tables"),
        ({"imu": imu_table(), "mag": imu_table()}, "it returned the stream 'mag', which it does not declare"),
        ({"imu": imu_table(), "imu_2": imu_table()}, "it returned the stream 'imu_2', which it does not declare"),
        ({}, "it did not return the stream 'imu', which it declares"),
        ({"imu": gnss_table()}, "stream 'imu': it returned ['speed'], which it does not declare and did not return"),
    ],
)
def test_a_stage_that_breaks_its_contract(returned, message):
    with pytest.raises(ContractError) as caught:
        run_work(lambda *, imu, params: returned)
    assert caught.value.message.startswith(f"step filter.work: {message}")
    assert caught.value.exit_code == 5


def test_a_reader_that_breaks_its_contract_is_named(tmp_path):
    with pytest.raises(ContractError, match=r"step reader.log: it returned the stream 'gnss'"):
        run_steps(
            pipeline_of("use: reader.log"), text_reader(writes={"imu": IMU.possible()}), source=[log_file(tmp_path, 1)]
        )


def test_a_metric_that_is_not_finite_is_kept_in_the_table_alone():
    outcome = run_work(lambda *, imu, params: {"imu": imu, "metrics": metrics([Metric("a", float("inf"), "s")])})
    assert outcome.recording["metrics"]["value"].to_pylist() == [float("inf")]
    assert outcome.reports[1].metrics == [{"name": "a", "unit": "s"}]


# --- what a stage raises --------------------------------------------------------------------------------------------


def test_an_unforeseen_error_becomes_a_stage_error_that_keeps_its_cause():
    cause = ZeroDivisionError("division by zero")
    with pytest.raises(StageError) as caught:
        run_steps(TWO, MADE, raising(cause))
    assert caught.value.__cause__ is cause
    assert caught.value.step == "filter.work"
    assert str(caught.value) == (
        f"step filter.work: ZeroDivisionError: division by zero\n  this is a fault of {__name__}; '-v' shows where"
    )
    assert not isinstance(caught.value, ContractError)


def test_a_simulator_that_fails_on_a_file_is_a_stage_error():
    def run(params):
        raise OSError(28, "No space left on device")

    failing = type(MADE)(name="made", summary="Fails.", run=run, writes={"imu": IMU})
    with pytest.raises(StageError, match=r"step simulator.made: OSError: \[Errno 28\]"):
        run_steps(pipeline_of("use: simulator.made"), failing)


def test_too_little_memory_is_said_in_words():
    with pytest.raises(StageError, match=r"step filter.work: there is not enough memory"):
        run_steps(TWO, MADE, raising(MemoryError()))


def test_a_data_error_names_the_step_and_keeps_its_kind_and_facts():
    with pytest.raises(NotEnoughData) as caught:
        run_steps(TWO, MADE, raising(NotEnoughData("standstill", needed="2 s", found="0.5 s", hint="wait longer")))
    assert str(caught.value) == ("step filter.work: not enough standstill: needs 2 s, found 0.5 s\n  wait longer")
    assert caught.value.exit_code == 4
    again = pickle.loads(pickle.dumps(caught.value))
    assert (str(again), again.needed) == (str(caught.value), "2 s")


def test_an_interruption_passes_through():
    interruption = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt) as caught:
        run_steps(TWO, MADE, raising(interruption))
    assert caught.value is interruption


@pytest.mark.parametrize("exit", [SystemExit(0), GeneratorExit()])
def test_a_stage_that_exits_ends_its_step_and_not_the_program(exit):
    with pytest.raises(StageError, match=type(exit).__name__):
        run_steps(TWO, MADE, raising(exit))


# --- sources --------------------------------------------------------------------------------------------------------


def test_a_missing_file_is_told_with_its_path(tmp_path):
    with pytest.raises(ReadFailed) as caught:
        run_steps(pipeline_of("use: reader.log"), text_reader(), source=[tmp_path / "no.txt"])
    assert str(caught.value) == f"{tmp_path / 'no.txt'}: there is no such file or folder"


def test_a_folder_in_place_of_a_file_is_told_in_words(tmp_path):
    def read(path, params):
        return {"gnss": path.read_bytes()}

    reader = Reader(name="log", summary="A log.", run=read, writes={"gnss": GNSS})
    with pytest.raises(ReadFailed, match="it cannot be read: "):
        run_steps(pipeline_of("use: reader.log"), reader, source=[tmp_path])


def test_a_log_without_rows_is_refused_by_name(tmp_path):
    reader = Reader(
        name="log",
        summary="A log.",
        run=lambda path, params: {"imu": imu_table(0), "metrics": metrics([Metric("lines", 0.0)])},
        writes={"imu": IMU},
    )
    with pytest.raises(DataError, match=r"empty.txt holds no rows"):
        run_steps(pipeline_of("use: reader.log"), reader, source=[log_file(tmp_path, name="empty.txt")])


def test_a_reader_without_file_and_a_simulator_with_one_are_refused(tmp_path):
    with pytest.raises(DataError, match=r"step reader.log has no file to read"):
        run_steps(pipeline_of("use: reader.log"), text_reader())
    with pytest.raises(DataError, match=r"step simulator.made makes its own data and reads no file"):
        run_steps(pipeline_of("use: simulator.made"), MADE, source=[tmp_path])


# --- a reader whose files tell frames and quantities themselves -----------------------------------------------------


def kept_reader(**streams):
    return Reader(
        name="kept",
        summary="Kept streams.",
        run=lambda path, params: dict(streams),
        self_describing=True,
        writes={"imu": IMU.open_ended(), "events": EVENTS.possible(), "metrics": METRICS},
    )


NEEDS_VEHICLE = filter_of(same, reads={"imu": IMU.need("accel", frame="vehicle")}, writes={"imu": SAME})
KEPT = pipeline_of("use: reader.kept", "use: filter.work")


def test_what_a_file_tells_of_itself_is_kept(tmp_path):
    turned = build(IMU.only("accel", frame="vehicle"), time=clock(2), accel=np.zeros((2, 3)))
    outcome = run_steps(KEPT, kept_reader(imu=turned), NEEDS_VEHICLE, source=[log_file(tmp_path, 1)])
    assert schema_of(outcome.recording["imu"])["accel_x"].frame == "vehicle"


def test_a_file_that_tells_another_frame_is_refused_before_any_step(tmp_path):
    with pytest.raises(DataError, match=r"log.txt does not hold .* in frame 'vehicle'; here it is in frame 'sensor'"):
        run_steps(KEPT, kept_reader(imu=imu_table()), NEEDS_VEHICLE, source=[log_file(tmp_path, 1)])


def test_rows_of_an_earlier_run_keep_their_step_and_yield_to_the_same_step(tmp_path):
    def earlier(step):
        return build(by_step("metrics"), step=[step], name=["found"], value=[1.0])

    def learn(*, imu, params):
        return {"metrics": metrics([Metric("found", 2.0)])}

    old = append(earlier("filter.work"), earlier("filter.other"))
    stages = kept_reader(imu=imu_table(), metrics=old), filter_of(learn)
    kept = run_steps(KEPT, *stages, source=[log_file(tmp_path, 1)]).recording["metrics"]
    assert kept.select(["step", "value"]).to_pylist() == [
        {"step": "filter.other", "value": 1.0},
        {"step": "filter.work", "value": 2.0},
    ]


# --- a reader that hands over ---------------------------------------------------------------------------------------


class Scale(Params):
    scale: float = quantity(1.0, "m/s", gt=0, doc="Speed of one count.")


def counts(path: Path, params: Scale):
    speed = np.loadtxt(path, ndmin=1) * params.scale
    return {"gnss": build(GNSS, time=clock(len(speed)), speed=speed)}


def first_of_all(path, params, registry):
    """Hands over to reader.counts, whatever the file."""
    chosen = registry.get("reader.counts")
    given = Node.of(params.readers.get(chosen.key, {}), Where(chosen.key))
    bound, problems = bind(chosen.params, given, chosen.key)
    if bound is None:
        raise ConfigError(problems)
    unused = [Metric("not_used", note=name) for name in params.readers if name != chosen.key]
    return {**chosen.run(path=path, params=bound), "metrics": metrics(unused)}


COUNTS = Reader(name="counts", summary="Counts.", run=counts, params=Scale, writes={"gnss": GNSS.only("speed")})
FIRST = Reader(
    name="first", summary="Hands over.", run=first_of_all, params=Delegation, writes={"gnss": GNSS.possible()}
)


def test_a_reader_that_hands_over_is_given_registry_and_parameters(tmp_path):
    step = "{use: reader.first, params: {reader.counts: {scale: 3.6 km/h}, reader.log: {}}}"
    outcome = run_steps(pipeline_of(step), FIRST, COUNTS, text_reader(), source=[log_file(tmp_path, 1, 5)])
    assert vector(outcome.recording["gnss"], "speed").tolist() == [1.0, 5.0]
    assert outcome.recording["metrics"]["note"].to_pylist() == ["reader.log"]
    assert outcome.recording["metrics"]["step"].to_pylist() == ["reader.first"]


# --- exporters ------------------------------------------------------------------------------------------------------


def exported(run, folder, **declared):
    stage = Exporter(name="out", summary="Out.", run=run, **declared)
    plan, problems = check(pipeline_of("use: simulator.made", "use: exporter.out"), Registry.of(MADE, stage))
    assert problems == []
    return call_exporter(plan.steps[1], Recording({"imu": imu_table(), "gnss": gnss_table()}), folder, None)


def test_an_exporter_gets_its_streams_or_all_of_them(tmp_path):
    def one(*, imu, folder, about, params):
        (folder / "rows").write_text(str(imu.num_rows))
        return [folder / "rows"]

    def every(*, streams, folder, about, params):
        (folder / "rows").write_text(",".join(streams))
        return [folder / "rows"]

    assert exported(one, tmp_path, reads={"imu": IMU.need("accel")}) == [tmp_path / "rows"]
    exported(every, tmp_path, every_stream=True)
    assert (tmp_path / "rows").read_text() == "imu,gnss"


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        (lambda folder: None, "it did not return a list of paths"),
        (lambda folder: ["a.csv"], "it did not return a list of paths"),
        (lambda folder: [folder.parent / "a.csv"], "which is outside of its folder"),
        (lambda folder: [folder / "a.csv"], "it did not write a.csv, which it names"),
    ],
)
def test_an_exporter_that_breaks_its_contract(tmp_path, returned, message):
    with pytest.raises(ContractError, match=message):
        exported(lambda *, folder, about, params: returned(folder), tmp_path)


def test_exporters_are_left_to_the_caller():
    stage = Exporter(name="out", summary="Out.", run=lambda *, folder, about, params: 1 / 0)
    outcome = run_steps(pipeline_of("use: simulator.made", "use: exporter.out"), MADE, stage)
    assert [report.id for report in outcome.reports] == ["simulator.made"]


def test_stages_may_return_plain_arrow_tables():
    bare = pa.table({name: imu_table()[name] for name in imu_table().column_names})
    outcome = run_work(lambda *, imu, params: {"imu": bare})
    assert schema_of(outcome.recording["imu"]) == schema_of(imu_table())


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no named pipes in folders")
def test_a_pipe_is_refused_rather_than_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ReadFailed, match="this is a device or a pipe"):
        run_steps(pipeline_of("use: reader.log"), text_reader(), source=[tmp_path / "pipe"])
