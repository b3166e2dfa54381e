"""`recon schema`: JSON Schema of pipeline and batch files, for editors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from recon.cli import _console as console
from recon.cli._options import Blocked, FirstPartyOnly, registry_of
from recon.cli._results import accounted


def schema(
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Write it there.")] = None,
    blocked: Blocked = None,
    first_party_only: FirstPartyOnly = False,
) -> None:
    """Print the JSON Schema of pipeline and batch files.

    It covers the stages that are installed. Example: recon schema --out recon.schema.json
    """
    from recon.yaml_schema import yaml_schema

    made = yaml_schema(registry_of(blocked, first_party_only))
    if out is None:
        console.write_json(made)
        return
    from recon.storage import staged_file

    with accounted({"the schema": out}):
        with staged_file(out) as path:
            path.write_text(json.dumps(made, indent=2) + "\n", encoding="utf-8", newline="\n")
        console.write(str(out))
