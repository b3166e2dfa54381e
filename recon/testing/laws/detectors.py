"""Laws of detectors: what a list of events must be so that later steps can rely on it.

PYTEST_DONT_REWRITE: what a law says is a sentence already.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import pyarrow as pa

from recon.schema import APPENDED
from recon.stages import Detector
from recon.tables import replace, time_ns, vector
from recon.testing.contract import law
from recon.testing.subject import Subject

BURST_S: Final = (4.0, 0.3)
"""Period and length of the bursts, the first at the very beginning, in which what is read is multiplied."""
BURST: Final = 20.0


@law(Detector)
def events_lie_inside_what_was_read(subject: Subject) -> None:
    """No event begins before the first row or ends after the last of what the detector reads."""
    for inputs, found in _findings(subject):
        read = [time_ns(table) for name, table in inputs.items() if name not in APPENDED and table.num_rows]
        first, last = min(int(t[0]) for t in read), max(int(t[-1]) for t in read)
        early = int((time_ns(found) < first).sum())
        late = int((time_ns(found, "end_time") > last).sum())
        assert not early, f"{early} of {found.num_rows} events begin before the first row of what was read"
        assert not late, f"{late} of {found.num_rows} events end after the last row of what was read"


@law(Detector)
def events_are_sorted_by_time(subject: Subject) -> None:
    """Events come in the order in which they begin."""
    for _, found in _findings(subject):
        falls = np.flatnonzero(np.diff(time_ns(found)) < 0)
        assert not len(falls), f"event {int(falls[0]) + 1} begins before the one above it; `recon.events` sorts them"


@law(Detector)
def no_event_ends_before_it_begins(subject: Subject) -> None:
    """The end of an event is its beginning or later."""
    for _, found in _findings(subject):
        negative = np.flatnonzero(time_ns(found, "end_time") < time_ns(found))
        assert not len(negative), f"event {int(negative[0])} ends before it begins"


@law(Detector)
def events_of_one_kind_do_not_overlap(subject: Subject) -> None:
    """What happens once is one event: those of a kind follow each other."""
    for _, found in _findings(subject):
        kinds = np.array(found["kind"].to_pylist(), dtype=object)
        for kind in set(kinds.tolist()):
            chosen = np.flatnonzero(kinds == kind)
            begin, end = time_ns(found)[chosen], time_ns(found, "end_time")[chosen]
            order = np.argsort(begin, kind="stable")
            overlap = np.flatnonzero(begin[order][1:] < np.maximum.accumulate(end[order])[:-1])
            assert not len(overlap), f"{len(overlap)} events of kind '{kind}' begin before the one above them ends"


def _findings(subject: Subject) -> Iterator[tuple[dict[str, pa.Table], pa.Table]]:
    """Inputs and events of a calm and of a violent drive."""
    calm = subject.inputs()
    for inputs in (calm, {name: _violent(subject, name, table) for name, table in calm.items()}):
        returned = subject.run(inputs)
        assert "events" in returned, "a detector must return 'events', an empty table where it finds nothing"
        yield inputs, returned["events"]


def _violent(subject: Subject, name: str, table: pa.Table) -> pa.Table:
    """The stream with bursts in all numbers that the detector asks for."""
    if name in APPENDED or not table.num_rows:
        return table
    t_ns = time_ns(table)
    burst = (t_ns - t_ns[0]) * 1e-9 % BURST_S[0] < BURST_S[1]
    asked = [c.name for c in subject.stage.reads[name].columns if c.name in table.column_names and c.name != "time"]
    numbers = [column for column in asked if pa.types.is_floating(table[column].type)]
    factor = np.where(burst, BURST, 1.0)
    return replace(table, **{column: factor * vector(table, column, gaps=True) for column in numbers})
