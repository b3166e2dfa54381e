"""Files and readers at the head of a pipeline: what is refused, what a file tells of itself, handing over."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import clock, filter_of, imu_table, pipeline_of, run_steps
from runner_stages import MADE, log_file, same, text_reader

from recon.errors import ConfigError, DataError, ReadFailed
from recon.parameters import Params, bind, quantity
from recon.problems import Where
from recon.rows import Metric, metrics
from recon.schema import EVENTS, GNSS, IMU, METRICS, SAME, by_step
from recon.stages import Delegation, Reader
from recon.tables import append, build, schema_of, vector
from recon.yaml_nodes import Node


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


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no named pipes in folders")
def test_a_pipe_is_refused_rather_than_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ReadFailed, match="this is a device or a pipe"):
        run_steps(pipeline_of("use: reader.log"), text_reader(), source=[tmp_path / "pipe"])
