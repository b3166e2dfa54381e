"""How far a batch is: a live bar on a terminal, otherwise plain lines, or a JSON object for each drive."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Final

from recon.cli import _console as console

if TYPE_CHECKING:
    from recon.fleet.driver import State, Told

LINE_S: Final = 10.0
"""Between two lines that say how far it is."""


@contextmanager
def progress(*, as_json: bool) -> Iterator[Told]:
    """A function for the batch to tell its state to; what it shows goes to standard error."""
    if as_json:
        yield _json_line
    elif sys.stderr.isatty():
        with _live() as shown:
            yield shown
    else:
        yield _Lines()


def _json_line(state: State) -> None:
    counts: dict[str, Any] = {
        "time": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "total": state.total,
        "kept": state.kept,
        "ended": state.ended,
        "failed": state.failed,
        "running": state.running,
    }
    if state.outcome is not None:
        last = state.outcome
        told = {"job": last.job, "code": last.code, "reason": last.text, "seconds": round(last.seconds, 3)}
        counts |= told
    console.write_error(json.dumps(counts))


def failure_line(state: State) -> str:
    """Why the last drive failed, "" where it did not."""
    last = state.outcome
    return "" if last is None or last.ok else f"failed: {last.job}: {last.code}: {last.text}"


class _Lines:
    """A line for each failure, and one every now and then for the whole."""

    def __init__(self) -> None:
        self._started = self._told = time.monotonic()

    def __call__(self, state: State) -> None:
        if line := failure_line(state):
            console.write_error(line)
        now = time.monotonic()
        ends = state.ended in (0, state.total)
        if ends or now - self._told > LINE_S:
            self._told = now
            console.write_error(_line(state, now - self._started))


def _line(state: State, seconds: float) -> str:
    text = f"[{state.ended}/{state.total}] {state.failed} failed, {state.running} running"
    if not state.ended:
        return f"{text}, {state.kept} were done before"
    rate = state.ended / max(seconds, 1e-3)
    left = (state.total - state.ended) / rate
    return f"{text}, {rate * 60:.0f} drives/min, {left:.0f} s left"


@contextmanager
def _live() -> Iterator[Told]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        MofNCompleteColumn(),
        BarColumn(),
        TextColumn("{task.description}", markup=False),
        TimeRemainingColumn(),
    )
    started = time.monotonic()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)

        def show(state: State) -> None:
            rate = 60.0 * state.ended / max(time.monotonic() - started, 1e-3)
            text = f"{rate:.0f}/min, {state.running} running, {state.failed} failed"
            bar.update(task, completed=state.ended, total=state.total, description=text)
            if line := failure_line(state):
                bar.console.print(line, markup=False, highlight=False)

        yield show
