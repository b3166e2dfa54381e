"""Each law of what a stage makes of its input, broken by a stage made for it."""

from __future__ import annotations

from itertools import count
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from broken_laws import broken_laws

from recon import (
    GNSS,
    IMU,
    SAME,
    Exporter,
    Filter,
    Metric,
    Params,
    Streams,
    build,
    matrix,
    metrics,
    replace,
    seconds,
    select_rows,
    time_ns,
    vector,
)

CALLS = count()


def fickle(*, imu: pa.Table, params: Params) -> Streams:
    return {"imu": imu, "metrics": metrics([Metric("calls", float(next(CALLS)))])}


def printing(*, imu: pa.Table, params: Params) -> Streams:
    print(f"{imu.num_rows} rows")  # noqa: T201 - what is wrong with it
    return {"imu": imu}


def talkative(*, imu: pa.Table, params: Params) -> Streams:
    return {"imu": replace(imu, jerk=np.zeros(imu.num_rows))}


def quiet(*, imu: pa.Table, params: Params) -> Streams:
    return {}


def reversed_rows(*, imu: pa.Table, params: Params) -> Streams:
    return {"imu": select_rows(imu, np.arange(imu.num_rows)[::-1])}


def in_place(*, imu: pa.Table, params: Params) -> Streams:
    vector(imu, "accel_x", gaps=True)[:1] = 0.0
    return {"imu": imu}


def in_its_memory(*, imu: pa.Table, params: Params) -> Streams:
    memory = imu["accel_x"].chunk(0).buffers()[1] if imu.num_rows else None
    if memory is not None and memory.is_mutable:
        np.frombuffer(memory)[0] += 1.0
    return {"imu": imu}


def first_chunk(*, imu: pa.Table, params: Params) -> Streams:
    length = len(imu["accel_x"].chunk(0)) if imu.num_rows else 0
    return {"imu": imu, "metrics": metrics([Metric("rows", float(length))])}


def by_kind_of_memory(*, imu: pa.Table, params: Params) -> Streams:
    memory = imu["accel_x"].chunk(0).buffers()[1] if imu.num_rows else None
    return {"imu": imu, "metrics": metrics([Metric("mutable", float(memory is not None and memory.is_mutable))])}


def by_bitmap(*, imu: pa.Table, params: Params) -> Streams:
    bitmap = imu["accel_x"].chunk(0).buffers()[0] if imu.num_rows else None
    return {"imu": imu, "metrics": metrics([Metric("bytes", float(bitmap.size if bitmap is not None else 0))])}


def rebuilt(*, imu: pa.Table, params: Params) -> Streams:
    accel, gyro = (matrix(imu, group, gaps=True) for group in ("accel", "gyro"))
    return {"imu": build(IMU, time=time_ns(imu), accel=accel, gyro=gyro)}


def forgetful(*, imu: pa.Table, params: Params) -> Streams:
    return {"imu": imu.replace_schema_metadata(None)}


def mixed_up(*, imu: pa.Table, params: Params) -> Streams:
    if "extra" in imu.column_names:
        imu = replace(imu, extra=vector(imu, "extra")[::-1])
    return {"imu": imu}


def needs_gnss(*, imu: pa.Table, gnss: pa.Table | None, params: Params) -> Streams:
    return {"imu": imu, "metrics": metrics([Metric("rows", float(gnss.num_rows))])}


def needs_temperature(*, imu: pa.Table, params: Params) -> Streams:
    return {"imu": imu, "metrics": metrics([Metric("rows", float(len(imu["temperature"])))])}


def from_first_row(*, imu: pa.Table, params: Params) -> Streams:
    return {"imu": imu, "metrics": metrics([Metric("first", float(vector(imu, "accel_x", gaps=True)[0]))])}


def with_differences(*, imu: pa.Table, params: Params) -> Streams:
    if imu.num_rows:
        np.diff(seconds(imu)).min()
    return {"imu": imu}


def whole_numbers(*, imu: pa.Table, params: Params) -> Streams:
    for value in vector(imu, "accel_x", gaps=True):
        int(value)
    return {"imu": imu}


def known_steps(*, imu: pa.Table, params: Params) -> Streams:
    steps = np.diff(time_ns(imu))
    longest = np.unique(steps)[-1:] if (steps > 0).all() else []
    return {"imu": imu, "metrics": metrics([Metric("rate", {10_000_000: 100.0}[int(step)]) for step in longest])}


def known_shortest_step(*, imu: pa.Table, params: Params) -> Streams:
    steps = np.unique(np.diff(time_ns(imu)))
    return {"imu": imu, "metrics": metrics([Metric("rate", {10_000_000: 100.0}[int(step)]) for step in steps[:1]])}


def by_date(*, imu: pa.Table, params: Params) -> Streams:
    drift = 1e-12 * time_ns(imu)[:, None] * 1e-9
    return {"imu": replace(imu, gyro=matrix(imu, "gyro", gaps=True) + drift)}


def dates_in_metrics(*, imu: pa.Table, params: Params) -> Streams:
    times = [float(t) for t in time_ns(imu)[:1] * 1e-9]
    return {"imu": imu, "metrics": metrics([Metric("begin", t, "s") for t in times])}


def stage(run, **declared) -> Filter:
    reads = {"imu": IMU.need("accel", "gyro")}
    return Filter(
        **{"name": "wrong", "summary": "Is wrong.", "run": run, "reads": reads, "writes": {"imu": SAME}, **declared}
    )


READS_GNSS = {"imu": IMU.need("accel"), "gnss": GNSS.need(optional=True)}
READS_TEMPERATURE = {"imu": IMU.need("accel", maybe=["temperature"])}


@pytest.mark.parametrize(
    ("run", "law", "words"),
    [
        (first_chunk, "same_for_any_chunking", "the same table in other chunks gives another 'metrics'"),
        (printing, "nothing_is_printed", " rows'; return a metric or a warning in place of it"),
        (rebuilt, "unrelated_columns_survive", "did not return ['extra']"),
        (forgetful, "unrelated_columns_survive", "the facts of the stream 'imu' are gone"),
        (mixed_up, "unrelated_columns_survive", "'extra' of the stream 'imu' holds other values than before"),
        (from_first_row, "empty_streams_give_a_result_or_a_data_error", "'imu' without a row raised step filter.wrong"),
        (
            with_differences,
            "one_row_gives_a_result_or_a_data_error",
            "'imu' of one row raised step filter.wrong: Value",
        ),
        (whole_numbers, "missing_values_give_a_result_or_a_data_error", "'imu' with a tenth of its rows null raised"),
        (
            known_steps,
            "a_gap_gives_a_result_or_a_data_error",
            "'imu' with a gap in the middle raised step filter.wrong",
        ),
        (known_shortest_step, "wrong_times_give_a_result_or_a_data_error", "'imu' with repeated times raised KeyError"),
        (by_date, "shifting_all_times_shifts_the_result", "imu: gyro_x is another; count time from the first row"),
    ],
)
def test_a_wrong_stage_breaks_its_law_and_no_other(run, law: str, words: str):
    broken = broken_laws(stage(run))
    assert words in broken[law]
    assert broken.keys() == {law}


@pytest.mark.parametrize(
    ("run", "law", "words"),
    [
        (fickle, "same_input_twice_gives_same_output", "a second run on the same input gives another 'metrics'"),
        (talkative, "output_matches_plan", "it returned ['jerk'], which it does not declare"),
        (quiet, "output_matches_plan", "it did not return the stream 'imu', which it declares"),
        (reversed_rows, "times_rise", "time does not rise at row 1"),
        (in_place, "inputs_stay_unchanged", "it writes into its input: step filter.wrong: ValueError"),
        (in_its_memory, "inputs_stay_unchanged", "its input 'imu' is not what it was before the run"),
        (by_bitmap, "same_after_parquet", "the same recording kept as parquet gives another 'metrics'"),
        (by_kind_of_memory, "same_after_mcap", "the same recording kept as mcap gives another 'metrics'"),
    ],
)
def test_a_wrong_stage_breaks_its_law(run, law: str, words: str):
    assert words in broken_laws(stage(run))[law]


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (
            stage(needs_gnss, reads=READS_GNSS),
            "a recording without the optional stream 'gnss' raised step filter.wrong",
        ),
        (stage(needs_temperature, reads=READS_TEMPERATURE), "a 'imu' without the optional temperature raised"),
    ],
)
def test_what_is_optional_and_needed_breaks_its_law(wrong: Filter, words: str):
    assert words in broken_laws(wrong)["optional_streams_and_columns_may_be_absent"]


def test_dates_in_metrics_break_no_law():
    assert broken_laws(stage(dates_in_metrics)) == {}


def known_streams(*, streams, folder: Path, about: object, params: Params) -> list[Path]:
    units = {"imu": 1, "gnss": 2, "mag": 3, "baro": 4, "wheel": 5, "attitude": 6, "trajectory": 7}
    units |= {"reference": 8, "events": 9, "metrics": 10, "frames": 11, "residuals": 12}
    (folder / "units.txt").write_text(str([units[name] for name in streams]), encoding="utf-8")
    return [folder / "units.txt"]


def test_an_exporter_that_knows_all_streams_breaks_its_law():
    wrong = Exporter(name="wrong", summary="Is wrong.", run=known_streams, every_stream=True)
    broken = broken_laws(wrong)
    assert "beside those that it knows raised step exporter.wrong: KeyError" in broken["unrelated_streams_survive"]
