"""What a run says of its crash: read from the rows of the step that judged it, by its severest impact."""

from __future__ import annotations

import pyarrow as pa
import pytest

from recon.api import Run
from recon.cli._results import as_data, as_text
from recon.crash_summary import SIGN, crash_summary
from recon.recording import Recording
from recon.rows import Event, Metric, events, metrics
from recon.tables import with_meta

START_NS = 1714550400_000000000
SECOND = 1_000_000_000
DELTA_V = Metric(SIGN, 43.21, "km/h", 0.31, 42.6, 43.8, "as 49 CFR 563")
PDOF = Metric("pdof", -58.7, "deg", 1.2, -61.0, -56.3)
UNKNOWN = Metric("speed_before", None, "km/h", note="no trajectory tells it")


def stepped(table: pa.Table, steps: list[str]) -> pa.Table:
    """As the runner keeps rows, with the step that gave them."""
    return table.append_column("step", pa.array(steps, pa.string()))


def recording(rows: list[Metric], steps: list[str] | None = None, clock: str = "absolute") -> Recording:
    """A log of ten seconds with two impacts, the second one the severer."""
    impacts = [
        Event(START_NS, START_NS + 10 * SECOND, "trip"),
        Event(START_NS + 2 * SECOND, START_NS + 3 * SECOND, "impact", 8.0, "km/h"),
        Event(START_NS + 5 * SECOND, START_NS + 6 * SECOND, "impact", 43.21, "km/h"),
    ]
    happened = with_meta(stepped(events(impacts), ["analyzer.crash"] * 3), clock=clock)
    return Recording({"events": happened, "metrics": stepped(metrics(rows), steps or ["analyzer.crash"] * len(rows))})


def test_the_severest_impact_gives_the_time_and_the_step_that_judged_it_the_numbers() -> None:
    other = Metric("pdof", 12.0, "deg")
    steps = ["analyzer.crash", "analyzer.crash", "another", "analyzer.crash"]
    found = crash_summary(recording([Metric("impacts", 2.0), DELTA_V, other, PDOF], steps))
    assert found is not None
    assert (found["impacts"], found["time"], found["after_s"]) == (2, "2024-05-01T08:00:05.000000000Z", 5.0)
    assert (found[SIGN]["value"], found["pdof"]["value"]) == (43.21, -58.7)
    assert found[SIGN]["method"] == "as 49 CFR 563"


def test_where_no_step_or_several_judged_crashes_there_is_no_summary() -> None:
    assert crash_summary(recording([DELTA_V])) is None
    assert crash_summary(recording([Metric("impacts", 1.0), Metric("impacts", 1.0)])) is None
    assert crash_summary(Recording({})) is None


@pytest.mark.parametrize(
    ("clock", "at"),
    [("absolute", "2024-05-01 08:00:05.000 UTC, 5.00 s after the start"), ("relative", "5.00 s after the start")],
)
def test_a_run_prints_time_delta_v_and_direction_of_its_crash(clock: str, at: str) -> None:
    told = as_text(Run(recording([Metric("impacts", 2.0), DELTA_V, PDOF, UNKNOWN], clock=clock), {}))
    assert f"  crash               {at}, the severest of 2\n" in told
    assert "  delta-V             43.2 km/h (95 %: 42.6 to 43.8 km/h)\n" in told
    assert "  direction of force  -59 deg (95 %: -61 to -56 deg), clockwise from the front: 10 o'clock\n" in told
    assert "  speed before        not known: no trajectory tells it\n" in told
    supposed = Metric(
        "speed_before", 57.5, "km/h", 2.5, 52.6, 62.4, "delta-V over 1 + restitution", "as if into a wall"
    )
    told = as_text(Run(recording([Metric("impacts", 2.0), DELTA_V, supposed]), {}))
    assert "  speed before  58 km/h (95 %: 53 to 62 km/h), as if into a wall\n" in told


def test_a_time_that_rests_on_what_was_assumed_of_the_clock_says_so() -> None:
    run = Run(recording([Metric("impacts", 1.0), Metric("assumed_clock_offset", 3600.0, "s")]), {})
    assert "2024-05-01 08:00:05.000 UTC (the log's clock taken for UTC+1 h), 5.00 s after" in as_text(run)
    found = crash_summary(run.recording)
    assert found is not None
    assert found["time_scale"] == "UTC (the log's clock taken for UTC+1 h)"


def test_a_run_without_a_crash_says_so() -> None:
    found = Recording(
        {"metrics": stepped(metrics([Metric("impacts", 0.0, note="none was found")]), ["analyzer.crash"])}
    )
    run = Run(found, {"pipeline": {"name": "crash"}})
    assert "  crash     none was found\n" in as_text(run)
    assert as_data(run)["crash"] == {"impacts": 0, "note": "none was found"}
    assert "crash" not in as_data(Run(Recording({}), {"pipeline": {"name": "thesis"}}))
