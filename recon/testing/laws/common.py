"""Laws that every stage with results keeps, whatever its role.

A result is the tables that a stage returns, or the files that an exporter writes.

PYTEST_DONT_REWRITE: what a law says is a sentence already.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
import pyarrow as pa

from recon.declaration import Stage
from recon.errors import ContractError, ReconError, StageError
from recon.recording import Recording
from recon.schema import APPENDED, Change
from recon.stages import Aligner, Executor, Exporter, Filter, Reader, Simulator
from recon.storage import read_recording, write_recording
from recon.tables import meta, time_ns, vector, with_meta
from recon.testing.contract import law
from recon.testing.distortions import on_own_memory, rechunked, shifted
from recon.testing.subject import Subject

Result = Mapping[str, pa.Table | bytes]

LATER_NS: Final = 86_400 * 1_000_000_000 + 123_456_789
"""A day and a bit that no rate divides."""
ROUNDING: Final = 1e-9
"""Of the largest number of a column; the clock of a stage may begin anywhere, its numbers have 1e-16."""

_WRONG_TIME: Final = "time does not rise"


def returns(stage: Stage) -> bool:
    """Anything at all, tables or files."""
    return not isinstance(stage, Executor)


def works_on_streams(stage: Stage) -> bool:
    """Anything, from streams that it is given."""
    return not isinstance(stage, Executor | Reader | Simulator)


def returns_streams(stage: Stage) -> bool:
    """Tables, from whatever."""
    return not isinstance(stage, Executor | Exporter)


def transforms(stage: Stage) -> bool:
    """Tables, from tables."""
    return works_on_streams(stage) and not isinstance(stage, Exporter)


def result(subject: Subject, inputs: Mapping[str, pa.Table]) -> Result:
    """What the stage makes of its inputs: tables by stream, or the bytes of files by path."""
    if not isinstance(subject.stage, Exporter):
        return subject.run(inputs)
    with TemporaryDirectory() as folder:
        files = subject.export(Path(folder), inputs)
        return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def assert_same(found: Result, wanted: Result, how: str) -> None:
    """Raises AssertionError, with `how` it came about, where two results differ in a bit."""
    assert list(found) == list(wanted), f"{how} gives {list(found)} in place of {list(wanted)}"
    for name, one in found.items():
        assert one == wanted[name], f"{how} gives another '{name}'"


@law(when=returns)
def same_input_twice_gives_same_output(subject: Subject) -> None:
    """A run depends on nothing but its inputs and parameters."""
    inputs = subject.inputs()
    assert_same(result(subject, inputs), result(subject, inputs), "a second run on the same input")


@law(when=returns)
def nothing_is_printed(subject: Subject) -> None:
    """Standard output belongs to what the command prints, which programs read."""
    with redirect_stdout(StringIO()) as printed:
        result(subject, subject.inputs())
    first = printed.getvalue().strip().partition("\n")[0]
    assert not printed.getvalue(), f"it prints '{first}'; return a metric or a warning in place of it"


@law(when=returns_streams)
def output_matches_plan(subject: Subject) -> None:
    """What is returned is what was declared: streams, columns, types."""
    try:
        returned = subject.run()
    except ContractError as error:
        if _WRONG_TIME in error.message:
            return  # a law of its own
        raise AssertionError(f"{error.message}; declare it under writes, or return what is declared") from error
    if isinstance(subject.stage, Reader) and subject.stage.self_describing:
        return  # the file tells
    (step,) = subject.plan(subject.inputs()).steps
    for name, schema in step.outputs.items():
        assert name in returned or name in APPENDED or schema.uncertain, f"the declared stream '{name}' is not returned"


@law(when=returns_streams)
def times_rise(subject: Subject) -> None:
    """The time of every stream rises from row to row."""
    try:
        subject.run()
    except ContractError as error:
        if _WRONG_TIME in error.message:
            raise AssertionError(f"{error.message}; return rows in the order of their times, each time once") from error


@law(when=works_on_streams)
def inputs_stay_unchanged(subject: Subject) -> None:
    """The tables that a stage is given belong to others, too."""
    inputs = {port: on_own_memory(table) for port, table in subject.inputs().items()}
    before = {port: _bits(table) for port, table in inputs.items()}
    try:
        result(subject, inputs)
    except StageError as error:
        if "read-only" not in error.message:
            raise
        raise AssertionError(f"it writes into its input: {error.message}; work on a copy") from error
    for port, bits in before.items():
        assert _bits(inputs[port]) == bits, f"its input '{port}' is not what it was before the run; work on a copy"


@law(when=works_on_streams)
def same_for_any_chunking(subject: Subject) -> None:
    """Arrow keeps a column in pieces; where they end means nothing."""
    inputs = subject.inputs()
    cut = {port: rechunked(table) for port, table in inputs.items()}
    assert_same(result(subject, cut), result(subject, inputs), "the same table in other chunks")


@law(when=works_on_streams)
def same_after_parquet(subject: Subject) -> None:
    """A recording that was kept as Parquet gives the same as one in memory."""
    _assert_same_after("parquet", subject)


@law(when=works_on_streams)
def same_after_mcap(subject: Subject) -> None:
    """A recording that was kept as MCAP gives the same as one in memory."""
    _assert_same_after("mcap", subject)


@law(Filter, Aligner)
def unrelated_columns_survive(subject: Subject) -> None:
    """Columns and facts of a stream that a stage does not know stay in the stream when it is changed."""
    inputs = subject.inputs()
    changed = [port for port in inputs if isinstance(subject.stage.writes.get(port), Change) and port not in APPENDED]
    marked = {port: _with_extra(inputs[port]) if port in changed else inputs[port] for port in inputs}
    try:
        returned = subject.run(marked)
    except ContractError as error:
        if "'extra'" not in error.message:
            raise
        raise AssertionError(f"{error.message}; change a stream by recon.replace, which keeps the rest") from error
    for port in [port for port in changed if port in returned]:
        table = returned[port]
        assert meta(table).get("extra") == "kept", (
            f"the facts of the stream '{port}' are gone; change a stream by recon.replace, which keeps the rest"
        )
        _, here, there = np.intersect1d(time_ns(table), time_ns(marked[port]), return_indices=True)
        found, wanted = vector(table, "extra", gaps=True)[here], vector(marked[port], "extra")[there]
        known = np.isfinite(found)
        assert np.allclose(found[known], wanted[known], rtol=ROUNDING, atol=0), (
            f"the column 'extra' of the stream '{port}' holds other values than before at the same times"
        )


@law(when=works_on_streams)
def unrelated_streams_survive(subject: Subject) -> None:
    """A further stream, of a name and with columns that nobody knows, does no harm and comes to none."""
    inputs = subject.inputs()
    beside = _with_extra(next(iter(inputs.values())).select(["time"]))
    try:
        if isinstance(subject.stage, Exporter):
            result(subject, {**inputs, "unrelated": beside})
            return
        recording = subject.outcome({**inputs, "unrelated": beside})
    except ReconError as error:
        raise AssertionError(f"a stream 'unrelated' beside those that it knows raised {error.message}") from error
    assert recording["unrelated"] == beside, "the stream 'unrelated' is not what it was"


@law(when=transforms)
def shifting_all_times_shifts_the_result(subject: Subject) -> None:
    """No answer depends on the date: later by a day, it is the same answer a day later."""
    inputs = subject.inputs()
    now, later = subject.run(inputs), subject.run({port: shifted(t, LATER_NS) for port, t in inputs.items()})
    assert list(now) == list(later), f"a day later it returns {list(later)} in place of {list(now)}"
    for name, table in now.items():
        fault = _fault_in_metrics(table, later[name]) if name == "metrics" else _fault_in_shift(table, later[name])
        assert not fault, f"all times shifted by a day: {name}: {fault}; count time from the first row, not from 1970"


def _assert_same_after(store: str, subject: Subject) -> None:
    inputs = subject.inputs()
    with TemporaryDirectory() as folder:
        write_recording(Recording(inputs), Path(folder) / "kept", store)
        kept = read_recording(Path(folder) / "kept")
        again = {port: kept[port] for port in inputs}
        assert_same(result(subject, again), result(subject, inputs), f"the same recording kept as {store}")


def _bits(table: pa.Table) -> bytes:
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    return bytes(sink.getvalue())


def _with_extra(table: pa.Table) -> pa.Table:
    """With a column that no stage knows, which grows with time, and a fact that none knows."""
    t_ns = time_ns(table)
    return with_meta(table.append_column("extra", pa.array((t_ns - t_ns[:1]) * 1e-9 + 1.0)), extra="kept")


def _fault_in_shift(now: pa.Table, later: pa.Table) -> str:
    """How a stream differs from the same a day later, "" where only by the day."""
    if now.num_rows != later.num_rows or now.column_names != later.column_names:
        return f"{later.num_rows} rows of {later.column_names} in place of {now.num_rows} of {now.column_names}"
    for field in now.schema:
        if field.name == "note":
            continue  # may tell a time
        if pa.types.is_timestamp(field.type):
            same = np.array_equal(time_ns(later, field.name), time_ns(now, field.name) + LATER_NS)
        elif pa.types.is_floating(field.type):
            same = _close(vector(now, field.name, gaps=True), vector(later, field.name, gaps=True))
        else:
            same = now[field.name] == later[field.name]
        if not same:
            return f"{field.name} is another"
    return ""


def _fault_in_metrics(now: pa.Table, later: pa.Table) -> str:
    """The same for metrics, where a value may be a time: in s or ns since any date."""
    if now["name"] != later["name"]:
        return "other rows"
    for name in ("value", "sigma", "low", "high"):
        before, after = (vector(table, name, gaps=True) for table in (now, later))
        by = after - before
        is_time = (np.abs(by - LATER_NS * 1e-9) < 1e-5) | (np.abs(by - LATER_NS) < 1e3)
        if not _close(before[~is_time], after[~is_time]):
            far = np.nan_to_num(np.abs(by), nan=np.inf) * ~(is_time | (np.isnan(before) & np.isnan(after)))
            return f"another {name} of {now['name'][int(far.argmax())]}"
    return ""


def _close(first: np.ndarray, second: np.ndarray) -> bool:
    largest = np.nanmax(np.abs(first), initial=0.0) if np.isfinite(first).any() else 0.0
    return np.allclose(first, second, rtol=0.0, atol=ROUNDING * largest, equal_nan=True)
