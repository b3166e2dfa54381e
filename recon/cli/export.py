"""`recon export`: files for other programs, from a finished run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from recon.cli import _console as console
from recon.cli._options import Blocked, FirstPartyOnly, Settings, overrides_of, registry_of
from recon.cli._results import accounted


def export(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a finished run.")],
    names: Annotated[list[str], typer.Argument(metavar="NAME", help="Exporters, see 'recon plugins exporter'.")],
    settings: Settings = None,
    blocked: Blocked = None,
    first_party_only: FirstPartyOnly = False,
) -> None:
    """Export a finished run for other programs.

    Example: recon export drive-thesis blender --set exporter.blender.render=still
    """
    from recon import api

    overrides, registry = overrides_of(settings), registry_of(blocked, first_party_only)
    wanted = list(dict.fromkeys(names))
    made = {f"export {name}": run / "exports" / name.removeprefix("exporter.") for name in wanted}
    with accounted(made):
        files = api.export(api.open(run), wanted, registry, overrides)
        console.write("\n".join(str(path) for path in files))
