"""What analyzer.doctor found, as a part of the page: each contradiction in words, with the curves that show it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape
from typing import Any, Final

import numpy as np

from recon.findings import PREFIX, value_text
from recon_exporters._chart import Window, figure
from recon_exporters._panels import Curve, Panel
from recon_exporters._words import unit_symbol

_ROLES: Final = ("x", "y", "z")
_NO_LINE_OVER_S: Final = 1e9
"""Curves of evidence are thinned: between their points nothing is missing."""
_HEADS: Final = {"confirmed": "Confirmed", "unknown": "Not told by this log"}


def is_finding(row: Mapping[str, Any]) -> bool:
    """Is a row of metrics one of analyzer.doctor's?"""
    return str(row["name"] or "").startswith(PREFIX)


def findings_section(found: Iterable[Mapping[str, Any]], start_ns: int) -> str:
    """HTML; "" without a finding. start_ns : zero of the times of evidence"""
    some = list(found)
    parts, drawn = [], list[Any]()
    for one in (one for one in some if one["status"] == "contradicted"):
        evidence = one.get("evidence")
        parts.append(_at_length(one, None if evidence in drawn else evidence, start_ns))
        drawn.append(evidence)
    if some and not parts:
        parts.append("<p>The data contradict nothing.</p>")
    for status, head in _HEADS.items():
        lines = "".join(
            f"<li><b>{escape(one['code'])}</b>{_value(one)}: {escape(one['explanation'])}</li>"
            for one in some
            if one["status"] == status
        )
        parts.append(f"<h3>{head}</h3><ul>{lines}</ul>" if lines else "")
    return "".join(parts)


def _value(one: Mapping[str, Any]) -> str:
    text = value_text(one)
    return f" = {escape(text)}" if text else ""


def _at_length(one: Mapping[str, Any], evidence: Mapping[str, Any] | None, start_ns: int) -> str:
    """evidence : the curves that show it; None where there are none, or where they are drawn above"""
    sure = f"{100.0 * one['confidence']:.1f} % sure"
    fix = f"<p>Put right by:</p><pre>{escape(one['yaml'])}</pre>" if one["yaml"] else ""
    head = f"<h3>{escape(one['code'])}{_value(one)} <small>({sure})</small></h3>"
    return f"{head}<p>{escape(one['explanation'])}</p>{_figure(evidence, one['code'], start_ns)}{fix}"


def _figure(evidence: Mapping[str, Any] | None, code: str, start_ns: int) -> str:
    if not evidence:
        return ""
    curves = []
    for role, told in zip(_ROLES, evidence["curves"], strict=False):
        t_ns = start_ns + np.rint(1e9 * np.asarray(told["t_s"])).astype(np.int64)
        if len(t_ns):
            curves.append(Curve(told["name"], "accepted" if told["points"] else role, t_ns, np.asarray(told["values"])))
    if not curves:
        return ""
    first, last = min(int(c.t_ns[0]) for c in curves), max(int(c.t_ns[-1]) for c in curves)
    panel = Panel(f"evidence_{code}", evidence["title"], unit_symbol(evidence["unit"]), "evidence", curves)
    return figure(panel, Window(first, max(last, first + 1_000_000), start_ns), (), _NO_LINE_OVER_S)
