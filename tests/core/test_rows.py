from __future__ import annotations

import math

from recon.rows import Event, Metric, events, metrics, spans, warning, warnings_of
from recon.schema import EVENTS, METRICS


def test_events_are_sorted_by_start_then_end():
    table = events([Event(20, 30, "crash"), Event(10, 40, "stop"), Event(10, 15, "stop", 3.0, "m/s", "short")])
    assert table["kind"].to_pylist() == ["stop", "stop", "crash"]
    assert table["value"].to_pylist() == [3.0, None, None]
    assert table.column_names == list(EVENTS.names)


def test_metrics_keep_their_order_and_unknown_numbers_are_null():
    table = metrics([Metric("b", 2.0, "m", sigma=0.1), Metric("a", math.nan)])
    assert table["name"].to_pylist() == ["b", "a"]
    assert table["value"].to_pylist() == [2.0, None]
    assert table.column_names == list(METRICS.names)


def test_no_rows_make_a_table_of_the_same_columns():
    assert events([]).schema.equals(events([Event(1, 2, "stop")]).schema, check_metadata=True)
    assert metrics([]).schema.equals(metrics([Metric("a")]).schema, check_metadata=True)


def test_warnings_are_found_among_metrics():
    assert warnings_of(metrics([Metric("a", 1.0, note="no"), warning("mind the gap")])) == ["mind the gap"]
    assert warnings_of(None) == []


def test_spans_are_those_of_one_kind():
    table = events([Event(20, 30, "stop"), Event(1, 2, "crash"), Event(10, 40, "stop")])
    assert spans(table, "stop") == [(10, 40), (20, 30)]
    assert spans(table, "outage") == spans(None, "stop") == []
