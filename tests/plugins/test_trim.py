"""filter.trim, and `start` and `stop` of a run: the rows between two times, of every stream."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

import recon
from recon import ConfigError, DataError, Pipeline, Recording, build
from recon.schema import EVENTS, GNSS, IMU
from recon.tables import time_ns, with_meta
from recon_filters.trim import TrimParams, trim

BEGIN_NS = 1_714_550_400_000_000_000  # 2024-05-01T08:00:00Z
SECOND_NS = 1_000_000_000


def log() -> dict[str, pa.Table]:
    """Ten seconds of imu, and of gnss that began two seconds before it; a column and a fact that nobody knows."""
    t_ns = BEGIN_NS + np.arange(101) * SECOND_NS // 10
    imu = build(IMU, time=t_ns, accel=np.zeros((101, 3)), gyro=np.zeros((101, 3)))
    fixes_ns = BEGIN_NS + np.arange(-2, 11) * SECOND_NS
    gnss = build(GNSS, time=fixes_ns, lat=np.full(13, 44.0), lon=np.full(13, 11.0))
    return {"imu": with_meta(imu.append_column("lamp", pa.array(range(101))), box="A12"), "gnss": gnss}


def seconds_of(table: pa.Table) -> list[float]:
    return [round((t - BEGIN_NS) / SECOND_NS, 9) for t in time_ns(table).tolist()]


@pytest.mark.parametrize(
    ("start", "stop"),
    [
        ("2.5 s", "4 s"),
        ("2024-05-01T08:00:02.5Z", "2024-05-01T10:00:04+02:00"),
        ("2500 ms", "2024-05-01 08:00:04"),
    ],
)
def test_both_ends_are_kept_and_seconds_count_from_the_first_row_of_the_imu(start: str, stop: str) -> None:
    returned = trim(streams=log(), params=TrimParams(start=start, stop=stop))
    assert seconds_of(returned["imu"]) == [round(2.5 + 0.1 * i, 9) for i in range(16)]
    assert seconds_of(returned["gnss"]) == [3.0, 4.0]


def test_rows_that_stay_keep_all_that_they_hold() -> None:
    kept = trim(streams=log(), params=TrimParams(stop="0.2 s"))["imu"]
    assert kept["lamp"].to_pylist() == [0, 1, 2]
    assert kept.schema == log()["imu"].schema
    assert recon.tables.meta(kept)["box"] == "A12"


def test_without_an_imu_seconds_count_from_the_first_row_of_all() -> None:
    streams = {"gnss": log()["gnss"]}
    assert seconds_of(trim(streams=streams, params=TrimParams(start="10 s"))["gnss"]) == [8.0, 9.0, 10.0]


def test_events_are_not_returned_for_they_would_come_twice() -> None:
    events = build(EVENTS, time=np.array([BEGIN_NS]), end_time=np.array([BEGIN_NS]), kind=["shock"])
    assert "events" not in trim(streams={**log(), "events": events}, params=TrimParams(start="5 s"))


def test_it_says_what_was_kept() -> None:
    rows = trim(streams=log(), params=TrimParams(start="2.55 s", stop="4 s"))["metrics"].to_pylist()
    told = {row["name"]: (row["value"], row["note"]) for row in rows}
    assert told["start"] == (pytest.approx(2.6), "after the first row of the log: 2024-05-01 08:00:02.600 UTC")
    assert told["duration"] == (pytest.approx(1.4), "until 2024-05-01 08:00:04.000 UTC")
    assert told["rows_dropped"][0] == 101 - 15 + 13 - 2


def test_a_span_without_a_row_is_refused_with_the_span_of_the_log() -> None:
    with pytest.raises(DataError, match="no row lies between 1 h and the last row") as caught:
        trim(streams=log(), params=TrimParams(start="1 h"))
    assert caught.value.hint == (
        "the log runs from 2024-05-01 07:59:58.000 UTC to 2024-05-01 08:00:10.000 UTC, "
        "which is -2.000 s to 10.000 s after its first row"
    )


def test_an_end_before_the_beginning_is_refused() -> None:
    with pytest.raises(DataError, match=r"start \(4 s\) is behind stop \(2024-05-01T08:00:03Z\)"):
        trim(streams=log(), params=TrimParams(start="4 s", stop="2024-05-01T08:00:03Z"))


def test_what_is_no_time_is_told_before_a_file_is_read() -> None:
    with pytest.raises(ConfigError, match=r"filter\.trim: start: '40' is no time: write for example '120 s'"):
        recon.run(Pipeline.of("p", "reader.auto"), "no_such_file.txt", start="40")


def test_a_run_of_a_part_is_that_of_a_log_that_holds_the_part() -> None:
    whole, part = Recording(log()), Recording(trim(streams=log(), params=TrimParams(start="3 s", stop="7 s")))
    pipeline = Pipeline.of("p", "reader.auto", "filter.moving_average")
    cut = recon.run(pipeline, whole, start="3 s", stop="7 s")
    assert cut.recording["imu"] == recon.run(pipeline, part).recording["imu"]
    assert [step["id"] for step in cut.manifest["steps"]] == ["filter.trim", "filter.moving_average"]


def test_a_pipeline_that_trims_is_told_another_span_from_outside() -> None:
    pipeline = Pipeline.from_text(
        "recon: 1\nsteps:\n- use: reader.auto\n- use: filter.trim\n  params: {start: 1 s, stop: 9 s}\n"
    )
    run = recon.run(pipeline, Recording(log()), start="8 s")
    assert seconds_of(run.recording["gnss"]) == [8.0, 9.0]
