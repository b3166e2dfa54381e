"""The run as one page for people, and the same numbers for programs.

    report.html    of a crash the time line, the direction of the force, the pulse and how severe it was by which
                   standard; track, curves over time with bands of two sigma, residuals, events, crashes from close by,
                   quality, estimates, inputs with hashes, pipeline; needs no network and no script, prints on A4
    report.json    the numbers of its tables (see _facts)

Curves of many rows are thinned for the eye (see _decimate), never those of a crash from close by; the page says so.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from recon.findings import findings_in
from recon.hookspecs import hookimpl
from recon.manifest import RunInfo
from recon.parameters import Params, quantity
from recon.recording import Recording
from recon.rounding import rounded
from recon.stages import Exporter
from recon.storage.json_text import to_json
from recon.tables import time_ns
from recon_exporters._chart import Span, Window, events_key, figure, spans_of
from recon_exporters._crash_page import crash_page
from recon_exporters._decimate import SPANS
from recon_exporters._facts import facts_of
from recon_exporters._findings import findings_section
from recon_exporters._page import page
from recon_exporters._panels import Panel, panels_of
from recon_exporters._track_map import track_map

_BEFORE: Final = 1_000_000_000
_AFTER: Final = 3_000_000_000
"""Around a crash, ns."""
_SHORTEST: Final = 1_000_000
"""Span of a chart, ns."""
_MOST_CRASHES: Final = 6
_DELAYS: Final = ("gnss_delay", "gnss_velocity_delay")
"""That of fixes, and by how much that of speeds is longer, s."""
_LEAST_DELAY_S: Final = 0.05
"""Less shows in no chart."""


class ReportParams(Params):
    """Parameters of exporter.report."""

    max_gap: float = quantity(
        2.0,
        "s",
        gt=0,
        doc="No line joins rows further apart; GNSS silent for longer, and for 3 usual steps, is an outage.",
    )


def report(*, streams: Mapping[str, pa.Table], folder: Path, about: RunInfo, params: ReportParams) -> list[Path]:
    """Write `folder/report.html` and `folder/report.json`; their paths."""
    facts = facts_of(streams, about, params.max_gap)
    text = page(facts, *_drawings(facts, streams, params.max_gap))
    paths = [folder / "report.html", folder / "report.json"]
    for path, content in zip(paths, (text, to_json(facts, indent=1) + "\n"), strict=True):
        path.write_text(content, encoding="utf-8", newline="\n", errors="backslashreplace")
    return paths


def _drawings(
    facts: dict[str, Any], streams: Mapping[str, pa.Table], max_gap: float
) -> tuple[list[tuple[str, str]], list[str]]:
    """Parts with figures, their titles and HTML, and what one must know of them."""
    recorded = Recording(streams).span_ns()
    if recorded is None:
        return [], ["The run holds no rows."]
    spans, panels = spans_of(streams.get("events")), panels_of(streams)
    start = recorded[0]
    lasts = [int(curve.t_ns[-1]) for panel in panels for curve in panel.curves]
    whole = Window(start, max([*lasts, start + _SHORTEST]), start)
    charts = _late(facts) + events_key(spans) + "".join(figure(panel, whole, spans, max_gap) for panel in panels)
    findings = findings_section(findings_in(streams.get("metrics")), _start_of_evidence(streams, start))
    parts = [
        ("The crash", crash_page(facts, streams, spans)),
        ("What the data say of the log's conventions", findings),
        ("Track", track_map(streams, spans, start, max_gap)),
        ("Over time", f'<div class="charts">{charts}</div>' if charts else ""),
        ("Crashes, closer", _closeups(panels, spans, whole, max_gap)),
    ]
    return parts, _notes(whole, panels)


def _late(facts: dict[str, Any]) -> str:
    """That GNSS is drawn when it came, where the fuser found that to be later than what it tells; "" elsewhere."""
    found = {row["name"]: row for row in facts["metrics"] if row["name"] in _DELAYS and row["value"] is not None}
    seconds = sum(row["value"] for row in found.values())
    sigma = max((row["sigma"] or 0.0 for row in found.values()), default=0.0)
    if seconds <= max(2.0 * sigma, _LEAST_DELAY_S):
        return ""
    return (
        f'<p class="hint">GNSS is drawn at its own times. Its speeds come {rounded(seconds, sigma)} s (± sigma '
        f"{rounded(sigma, sigma)} s) late, which the trajectory makes up for.</p>"
    )


def _start_of_evidence(streams: Mapping[str, pa.Table], start: int) -> int:
    """Findings count from the first row of imu, else of gnss."""
    tables = (streams[name] for name in ("imu", "gnss") if name in streams and streams[name].num_rows)
    return next((int(time_ns(table)[0]) for table in tables), start)


def _closeups(panels: Sequence[Panel], spans: Sequence[Span], whole: Window, max_gap: float) -> str:
    """The motion around the first crashes, with every row that there is, as far as the run goes."""
    found = []
    for span in [span for span in spans if span.kind == "crash"][:_MOST_CRASHES]:
        ends = max(span.start_ns - _BEFORE, whole.start_ns), min(span.end_ns + _AFTER, whole.end_ns)
        window = Window(*ends, whole.zero_ns)
        shown = [panel for panel in panels if panel.group in ("motion", "sensors")]
        figures = "".join(figure(panel, window, spans, max_gap) for panel in shown)
        title = f"<h3>Crash {(span.start_ns - whole.zero_ns) * 1e-9:.2f} s after the start</h3>"
        found.append(f'{title}<div class="charts">{figures}</div>' if figures else "")
    return "".join(found)


def _notes(window: Window, panels: Sequence[Panel]) -> list[str]:
    """What was left out or moved for the eye, in words."""
    notes = ["Seconds count from the first row of the run. Bands are two standard deviations to either side."]
    if any(len(curve.t_ns) > 2 * SPANS for panel in panels for curve in panel.curves):
        width = (window.end_ns - window.start_ns) * 1e-9 / SPANS
        notes.append(
            f"Curves of more than {2 * SPANS} rows are thinned for the eye: of each {width:.3g} s they show the lowest "
            "and the highest value, and of single points one of every few besides. Tables, and charts of crashes from "
            "close by, rest on every row."
        )
    return notes


@hookimpl
def declare_exporters() -> Iterable[Exporter]:
    """The exporter of reports."""
    yield Exporter(
        name="report",
        summary="One page for people that works offline and prints: track, curves, quality, inputs; also as JSON.",
        params=ReportParams,
        run=report,
        every_stream=True,
    )
