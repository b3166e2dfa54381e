"""`recon view`: a finished run in the Rerun viewer, of which it needs no part but to find it."""

from __future__ import annotations

import subprocess
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from recon.cli import _console as console
from recon.cli._options import Blocked, FirstPartyOnly, registry_of
from recon.cli._results import accounted
from recon.cli._signals import Terminated
from recon.errors import PluginError
from recon.extras import missing

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recon.registry import Registry

EXPORTER: Final = "rerun"
PROGRAMS: Final = ("rerun", "rerun.exe", "Rerun.app/Contents/MacOS/Rerun")
"""The viewer inside the package rerun_cli of rerun-sdk. It is started itself: its Python wrapper drops the exit code,
and leaves it running when it is stopped."""
CLOSED: Final = "the viewer is closed"
LOCAL: Final = ("--bind", "127.0.0.1")
"""The viewer would listen on every address."""


def view(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a finished run.")],
    web: Annotated[bool, typer.Option("--web", help="In the browser rather than in a window of its own.")] = False,
    blocked: Blocked = None,
    first_party_only: FirstPartyOnly = False,
) -> None:
    """Open a finished run in the Rerun viewer, until that is closed: in the browser, until Ctrl-C.

    Example: recon view drive-thesis
    """
    program, registry = _viewer(), registry_of(blocked, first_party_only)
    with accounted({f"export {EXPORTER}": run / "exports" / EXPORTER}):
        files = _made(run, registry)
        console.write("\n".join(str(file) for file in files))
        ports = ("--web-viewer", "--port", "auto", "--web-viewer-port", "0") if web else ("--port", "auto")
        code = _closed([program, *files, *LOCAL, *ports], web=web)
        if code:
            hint = "" if web else "where there is no display, add --web"
            raise PluginError(f"the Rerun viewer ended with exit code {code}", hint)


def _closed(command: Sequence[str | Path], *, web: bool) -> int:
    """The viewer's exit code, when it is closed. Ctrl-C closes it too: a viewer in the browser has no other end."""
    try:
        return subprocess.run(command, check=False).returncode
    except Terminated as error:
        error.args = (CLOSED,)
        raise
    except KeyboardInterrupt:
        if web:
            console.write_error(CLOSED)
        return 0


def _viewer() -> Path:
    """The viewer's program. Raises PluginError where it is not installed."""
    package = find_spec("rerun_cli")
    folders = [Path(place) for place in (package.submodule_search_locations or ())] if package else []
    there = [folder / program for folder in folders for program in PROGRAMS if (folder / program).is_file()]
    if not there:
        raise missing("recon view", "rerun-sdk", extra="rerun")
    return there[0]


def _made(run: Path, registry: Registry) -> Sequence[Path]:
    """The run's Rerun file: the one that is there, else a new one."""
    from recon import api

    finished = api.open(run)
    there = sorted((run / "exports" / EXPORTER).glob("*.rrd"))
    return there or api.export(finished, [EXPORTER], registry)
