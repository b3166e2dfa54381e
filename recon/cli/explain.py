"""`recon explain`: from a number of a run back through the steps to the rows of the log."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from recon.cli import _console as console
from recon.cli._options import AsJson, Blocked, FirstPartyOnly, registry_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from recon.explanation import Explanation, Link
    from recon.log_rows import Rows

_MOST_LEARNT: Final = 8


def explain(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a finished run, or a sealed file.")],
    metric: Annotated[str, typer.Argument(metavar="METRIC", help="Name of a metric, or STEP.NAME.")],
    inputs: Annotated[
        list[Path] | None,
        typer.Option("--input", metavar="LOG", help="The log, where it is no longer where the run read it."),
    ] = None,
    blocked: Blocked = None,
    first_party_only: FirstPartyOnly = False,
    as_json: AsJson = False,
) -> None:
    """Walk from a number back through the steps that made it to the rows of the log.

    Example: recon explain drive-crash delta_v_long_max
    """
    from recon import api, evidence, explanation

    registry = registry_of(blocked, first_party_only)
    with ExitStack() as stack:
        finished, log = stack.enter_context(evidence.unsealed(run)) if run.is_file() else (api.open(run), [])
        found = explanation.explain(finished, metric, inputs or log, registry=registry)
    console.write_json(found.as_data()) if as_json else console.write(as_text(found))


def as_text(found: Explanation) -> str:
    """The walk for people, from the number down to the log."""
    from recon.rounding import milliseconds

    row = found.metric
    told = [("given by", found.step), ("method", row.get("method") or ""), ("note", row.get("note") or "")]
    parts = [f"{row['name']} = {_value(row)}", console.table([line for line in told if line[1]])]
    for link in found.links:
        parts += ["", *_link(link)]
    parts += ["", "log"]
    shown = ""
    for entry in found.inputs:
        for part in entry.get("files", [entry]):
            parts.append(f"  {part['name']}, {part['bytes']:,} bytes, SHA-256 {part['sha256']}")
    for rows in found.rows:
        about = f"  {rows.about}, {milliseconds(rows.start)} to {milliseconds(rows.end)} UTC"
        parts += [about] * (about != shown) + list(_rows(rows))
        shown = about
    if found.missing:
        parts.append(f"  its rows cannot be shown: {found.missing}")
    return "\n".join(parts)


def _value(row: Mapping[str, Any]) -> str:
    from recon.rounding import rounded, with_unit

    if row.get("value") is None:
        return "no number"
    sigma = row.get("sigma")
    text = with_unit(rounded(row["value"], sigma, 6), row.get("unit"))
    if sigma is not None:
        text += f", sigma {rounded(sigma, sigma)}"
    if row.get("low") is not None and row.get("high") is not None:
        text += f", 95 % between {rounded(row['low'], sigma)} and {rounded(row['high'], sigma)}"
    return text


def _link(link: Link) -> Iterator[str]:
    from recon.learnt import legible, parameters_text
    from recon.rounding import counted, rounded, with_unit

    stage = f"{link.use}, " if link.use != link.id else ""
    yield f"{link.id} ({stage}version {link.version} of {link.distribution})"
    wrote = ", ".join(f"{name} ({counted(count, 'row')})" for name, count in link.writes.items())
    params = parameters_text(link.params)
    told = [row for row in map(legible, link.learnt) if row.get("value") is not None]
    learnt = [f"{row['name']} {with_unit(rounded(row['value'], row.get('sigma')), row.get('unit'))}" for row in told]
    more = f", and {len(learnt) - _MOST_LEARNT} more" if len(learnt) > _MOST_LEARNT else ""
    rows = [
        ("reads", ", ".join(link.reads)),
        ("writes", wrote),
        ("with", params),
        ("learnt", ", ".join(learnt[:_MOST_LEARNT]) + more),
    ]
    yield console.table([row for row in rows if row[1]])


def _rows(rows: Rows) -> Iterator[str]:
    place = f"lines {rows.lines[0]:,} to {rows.lines[1]:,} of {rows.file}" if rows.lines else rows.file
    yield f"    {rows.stream}: rows {rows.rows[0]:,} to {rows.rows[1]:,} of {rows.of:,}, {place}"
    for number, text in zip(dict.fromkeys(rows.lines or ()), rows.texts, strict=False):
        yield f"      {number:,}: {text}"
