"""The HTML of a report. Numbers stand in <data value="..."> with all digits of the JSON, shown to what they mean."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from typing import Any, Final

from recon.crash_summary import IMPACTS, SIGN
from recon.learnt import legible, parameters_text, utc
from recon.rounding import milliseconds, rounded
from recon.storage.json_text import to_json
from recon_exporters._findings import is_finding
from recon_exporters._words import unit_symbol, words

Json = dict[str, Any]

_TITLES: Final = {"distance": ("Distance", "m"), "top_speed": ("Top speed", "m/s"), "stops": ("Stops", "")}
_SHORT: Final = 12
"""Cells of so few characters are not broken."""
_CERTAIN: Final = (
    '<p class="hint">A standstill is told where it is certain: the vehicle comes to rest about a second before, and '
    "moves about a second after it. A slammed door parts two of them, which the number of stops counts as one.</p>"
)
_ERRORS: Final = (("position", "m"), ("velocity", "m/s"), ("attitude", "°"))


def asset(name: str) -> str:
    """A style sheet or script that lies beside the package's modules."""
    return (files("recon_exporters") / name).read_text(encoding="utf-8")


def embedded(data: Any) -> str:
    """JSON that may stand inside <script>."""
    return to_json(data).replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def number(value: float | None, sigma: float | None = None, digits: int = 4) -> str:
    """A number: to two digits of its sigma where there is one, else to so many significant digits, null as a dash."""
    if value is None:
        return "–"
    return f'<data value="{value!r}">{shown(float(value), sigma, digits)}</data>'


def shown(value: float, sigma: float | None = None, digits: int = 4) -> str:
    """As `number`, as text alone, with the sign of a minus."""
    return rounded(value, sigma, digits).replace("-", "−")


def crash_step(facts: Json) -> str:
    """The step that judged a crash, "" where none or several did."""
    steps = {row["step"] for row in facts["metrics"] if row["name"] == SIGN and "step" in row}
    return str(steps.pop()) if len(steps) == 1 else ""


def page(facts: Json, drawn: Sequence[tuple[str, str]], notes: Sequence[str]) -> str:
    """The whole document. drawn : title and HTML of the parts with figures, left out where they hold nothing."""
    title = escape(facts["name"])
    parts = [
        f"<header><h1>{title}</h1>{_head(facts)}</header>",
        _warnings(facts["warnings"]),
        *(section(*part) for part in drawn),
        section("Events and outages", _events(facts) + _outages(facts)),
        section("Quality", _sigmas(facts) + _residuals(facts) + _errors(facts) + _estimates(facts)),
        section("What the steps learnt and assumed", _learnt(facts)),
        section("Inputs", _inputs(facts)),
        section("How it was made", _made(facts, notes)),
    ]
    body = "\n".join(part for part in parts if part)
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<link rel="icon" href="data:,">\n'
        f"<style>{asset('_page/report.css')}</style></head>\n<body><main>\n{body}\n</main>\n"
        f'<script type="application/json" id="facts">{embedded(facts)}</script>\n'
        f"<script>{asset('_page/report.js')}</script></body></html>\n"
    )


def section(title: str, content: str) -> str:
    """A part under its title; "" without content."""
    return f"<section><h2>{title}</h2>{content}</section>" if content else ""


def table(head: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "") -> str:
    """Cells of HTML; columns that hold nothing are left out; "" without a row."""
    found = [tuple(row) for row in rows]
    used = [column for column in range(len(head)) if any(row[column] not in ("", "–") for row in found)]
    if not used:
        return ""
    names = "".join(f"<th>{head[column]}</th>" for column in used)
    lines = "".join("<tr>" + "".join(_cell(row[column]) for column in used) + "</tr>" for row in found)
    told = f"<caption>{caption}</caption>" if caption else ""
    return f"<table>{told}<thead><tr>{names}</tr></thead><tbody>{lines}</tbody></table>"


def _cell(content: str) -> str:
    whole = content.startswith("<data") or len(content) <= _SHORT
    return f'<td class="whole">{content}</td>' if whole else f"<td>{content}</td>"


def _name(text: str | None) -> str:
    """The name of a file or a step, which may be broken behind its parts."""
    return re.sub(r"([_./])", r"\1<wbr>", escape(text or ""))


def _metric(name: str | None) -> str:
    """A metric in words; its name, by which programs know it, shows under the pointer."""
    text = words(name)
    return f'<span title="{escape(name or "")}">{escape(text[:1].upper() + text[1:])}</span>'


def _head(facts: Json) -> str:
    summary, pipeline = facts["summary"], facts["pipeline"] or {}
    start = escape(f"{milliseconds(summary['start'])} {utc(facts['metrics'])}")
    cells = [
        ("From", "no date: the log's clock has a zero of its own" if _relative(facts) else start),
        ("Lasts", f"{number(summary.get('duration', summary['span']))} s"),
    ]
    for key, (title, unit) in _TITLES.items():
        if key in summary:
            sigma = summary.get(f"{key}_sigma")
            told = f", sigma {number(sigma, sigma)}" if sigma else ""
            kmh = f" ({shown(3.6 * summary[key], 3.6 * sigma if sigma else None)} km/h)" if unit == "m/s" else ""
            cells.append((title, f"{number(summary[key], sigma)} {unit}{told}{kmh}".strip()))
    cells.append(("Pipeline", escape(str(pipeline.get("name", "–")))))
    return "<dl>" + "".join(f"<div><dt>{name}</dt><dd>{text}</dd></div>" for name, text in cells) + "</dl>"


def _relative(facts: Json) -> bool:
    """Has the log's clock a zero of its own, so that there is no date?"""
    return any(stream["facts"].get("clock") == "relative" for stream in facts["streams"].values())


def _when(facts: Json, time: str) -> str:
    """A time in a table, nothing where there is no date."""
    return "" if _relative(facts) else escape(milliseconds(time))


def _warnings(warnings: Sequence[str]) -> str:
    counts = {text: list(warnings).count(text) for text in dict.fromkeys(warnings)}
    lines = "".join(f"<li>{escape(text)}{f' ({n} times)' if n > 1 else ''}</li>" for text, n in counts.items())
    return f'<section class="warnings"><h2>Read this first</h2><ul>{lines}</ul></section>' if lines else ""


def _events(facts: Json) -> str:
    rows = (
        (
            number(row["t_s"], 0.01),
            _when(facts, row["time"]),
            number(row["duration"], 0.01),
            escape(words(row["kind"] or "event")),
            "" if row["value"] is None else f"{number(row['value'])} {escape(unit_symbol(row['unit']))}",
            escape(row["note"] or ""),
            _name(row.get("step")),
        )
        for row in sorted(facts["events"], key=lambda row: row["t_s"])
    )
    head = ("after [s]", "time, UTC", "lasts [s]", "event", "value", "note", "step")
    stands = any(row["kind"] == "standstill" for row in facts["events"])
    return table(head, rows) + _CERTAIN * stands or (
        "<p>No events were found.</p>" if "events" in facts["streams"] else ""
    )


def _outages(facts: Json) -> str:
    rows = (
        (number(gap["t_s"], 0.01), _when(facts, gap["time"]), number(gap["duration"], 0.01), escape(gap["stream"]))
        for gap in facts["outages"]
    )
    return table(("after [s]", "time, UTC", "lasts [s]", "stream"), rows, "GNSS that is silent")


def _sigmas(facts: Json) -> str:
    rows = (
        (
            f"{row['name']} [{unit_symbol(row['unit'])}]",
            *(number(row[key], digits=3) for key in ("median", "p95", "max")),
        )
        for row in facts["sigmas"]
    )
    head = ("sigma of", "median", "95 %", "largest")
    absent = "<p>The trajectory gives no standard deviations.</p>" if "trajectory" in facts["streams"] else ""
    return table(head, rows, "Standard deviations of the trajectory (one sigma)") or absent


def _residuals(facts: Json) -> str:
    rows = (
        (
            escape(f"{words(row['sensor'])} {words(row['component'])}"),
            *(number(row[key]) for key in ("accepted", "rejected")),
            *(number(row[key], digits=3) for key in ("mean", "rms", "rms_in_sigmas")),
            number(None if row["beyond_2_sigma"] is None else 100.0 * row["beyond_2_sigma"], digits=3),
        )
        for row in facts["residuals"]
    )
    head = ("residuals of", "accepted", "rejected", "mean", "rms", "rms / sigma (true: 1)", "beyond 2σ (true: 4.6) [%]")
    return table(head, rows, "Measurements minus trajectory, in m, m/s or the sensor's own unit")


def _errors(facts: Json) -> str:
    errors = facts["errors"]
    if errors is None:
        return ""
    rows = (
        (f"{group}, {name} [{symbol}]", *(number(part[key], digits=3) for key in ("rmse", "median", "p95", "max")))
        for group, symbol in _ERRORS
        for name, part in errors.get(group, {}).items()
        if part is not None
    )
    notes = "".join(f"<p>{escape(note)}</p>" for note in errors["notes"])
    return table(("error of", "rms", "median", "95 %", "largest"), rows, "Errors against the reference") + notes


def _is_estimate(row: Json) -> bool:
    return row["sigma"] is not None or row["low"] is not None


def _shown_above(facts: Json, row: Json) -> bool:
    """Is it one of the numbers of the crash?"""
    step = crash_step(facts)
    return bool(step) and row["step"] == step and row["name"] != IMPACTS


def _estimates(facts: Json) -> str:
    rows = (
        (*_estimate(row), *_remarks(row))
        for row in facts["metrics"]
        if _is_estimate(row) and not _shown_above(facts, row)
    )
    head = ("estimate", "value", "±&nbsp;sigma", "from", "to", "unit", "method", "note", "step")
    return table(head, rows, "Estimates with their uncertainty: mounting, biases, delays and others")


def _estimate(row: Json) -> Sequence[str]:
    value, sigma = row["value"], row["sigma"]
    edges = [number(row[key], sigma) for key in ("low", "high")]
    return _metric(row["name"]), number(value, sigma), number(sigma, sigma), *edges, escape(unit_symbol(row["unit"]))


def _remarks(row: Json) -> Sequence[str]:
    return [escape(row["method"] or ""), escape(row["note"] or ""), _name(row.get("step"))]


def _learnt(facts: Json) -> str:
    rows = (
        (_metric(row["name"]), number(row["value"]), escape(unit_symbol(row["unit"])), *_remarks(row))
        for row in map(legible, facts["metrics"])
        if not (_is_estimate(row) or is_finding(row) or row["name"] == "warning" or _shown_above(facts, row))
    )
    return table(("name", "value", "unit", "method", "note", "step"), rows)


def _inputs(facts: Json) -> str:
    listed = [
        (f"{entry['name']}/{part['name']}" if "files" in entry else part["name"], part["bytes"], part["sha256"])
        for entry in facts["inputs"] or ()
        for part in entry.get("files", [entry])
    ]
    rows = ((_name(name), number(size, digits=12), f"<code>{digest}</code>") for name, size, digest in listed)
    return table(("file", "bytes", "SHA-256"), rows)


def _made(facts: Json, notes: Sequence[str]) -> str:
    versions = {"recon": facts["recon"], **facts["versions"]}
    told = ", ".join(f"{escape(name)} {escape(str(text))}" for name, text in versions.items() if text)
    steps = (
        (
            _name(step["id"]),
            escape(f"{step['distribution']} {step['distribution_version']}"),
            escape(parameters_text(step["params"])),
        )
        for step in facts["plan"] or ()
    )
    text = escape((facts["pipeline"] or {}).get("text", ""))
    return (
        "".join(f"<p>{escape(note)}</p>" for note in notes)
        + (f"<p>Made by {told}.</p>" if told else "")
        + (f"<pre>{text}</pre>" if text else "")
        + table(("step", "from", "parameters in SI"), steps)
    )
