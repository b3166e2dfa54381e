"""How far a run is: a live bar on a terminal, otherwise a plain line for each step."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from recon.cli import _console as console

if TYPE_CHECKING:
    from recon.runner import Progress


@contextmanager
def progress() -> Iterator[Progress]:
    """A function for the runner to tell its steps to; what it shows goes to standard error."""
    if sys.stderr.isatty():
        with _live() as shown:
            yield shown
    else:
        yield _line


def _line(done: int, total: int, step: str) -> None:
    if step:
        console.write_error(f"[{done + 1}/{total}] {step}")


@contextmanager
def _live() -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (
        SpinnerColumn(),
        MofNCompleteColumn(),
        BarColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.description}", markup=False),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, total, step: bar.update(task, completed=done, total=total, description=step or "writing")
