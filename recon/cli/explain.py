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
        about = f"  {rows.about}, {rows.start} to {rows.end}"
        parts += [about] * (about != shown) + list(_rows(rows))
        shown = about
    if found.missing:
        parts.append(f"  its rows cannot be shown: {found.missing}")
    return "\n".join(parts)


def _value(row: Mapping[str, Any]) -> str:
    if row.get("value") is None:
        return "no number"
    text = f"{row['value']:.9g} {row.get('unit') or ''}".rstrip()
    if row.get("sigma") is not None:
        text += f", sigma {row['sigma']:.3g}"
    if row.get("low") is not None and row.get("high") is not None:
        text += f", 95 % between {row['low']:.6g} and {row['high']:.6g}"
    return text


def _link(link: Link) -> Iterator[str]:
    stage = f"{link.use}, " if link.use != link.id else ""
    yield f"{link.id} ({stage}version {link.version} of {link.distribution})"
    wrote = ", ".join(f"{name} ({count:,} rows)" for name, count in link.writes.items())
    params = ", ".join(f"{name} {value}" for name, value in link.params.items())
    learnt = [
        f"{row['name']} {row['value']:.6g} {row.get('unit', '')}".rstrip() for row in link.learnt if "value" in row
    ]
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
