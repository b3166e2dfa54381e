"""A pipeline is run: streams from step to step, exporters, and what each step is told."""

from __future__ import annotations

import pyarrow as pa
import pytest
from helpers import filter_of, gnss_table, imu_table, pipeline_of, run_steps, source_of
from runner_stages import MADE, TWO, log_file, run_work, same, text_reader

from recon.calling import call_exporter
from recon.check import check
from recon.errors import ContractError, DataError
from recon.recording import Recording
from recon.registry import Registry
from recon.rows import Event, Metric, events, metrics, warning
from recon.runner import run_pipeline
from recon.schema import ANY, EVENTS, GNSS, IMU, SAME, Change, Column, Need
from recon.stages import Exporter
from recon.tables import matrix, meta, replace, schema_of, vector, with_meta


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
