"""`recon verify`: a sealed file, checked byte by byte and run again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from recon.cli import _console as console
from recon.cli._options import AsJson, Blocked, FirstPartyOnly, registry_of

if TYPE_CHECKING:
    from recon.evidence import Verified


def verify(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A sealed run.")],
    sha256: Annotated[
        str | None, typer.Option("--sha256", metavar="HEX", help="SHA-256 of the file, as it was noted.")
    ] = None,
    blocked: Blocked = None,
    first_party_only: FirstPartyOnly = False,
    as_json: AsJson = False,
) -> None:
    """Check every byte of a sealed run, run it again and compare each number. Exit code 7 at the first difference.

    Example: recon verify drive-crash.zip --sha256 5d41...
    """
    from recon import evidence
    from recon.errors import Difference

    registry = registry_of(blocked, first_party_only)
    try:
        found = evidence.verify(file, sha256=sha256, registry=registry)
    except Difference as difference:
        if as_json:
            told = {"file": file.name, "agreement": "", "difference": difference.message, "hint": difference.hint}
            console.write_json({**told, "streams": difference.streams})
        raise
    console.write_json(found.as_data()) if as_json else console.write(as_text(found, noted=sha256 is not None))


def as_text(found: Verified, *, noted: bool) -> str:
    """What was found, for people."""
    rows = [
        ("file", found.file),
        ("SHA-256", f"{found.sha256}{', as noted' if noted else ''}"),
        ("bytes", f"all of {found.files} files as they were sealed"),
        ("log", ", ".join(found.inputs) or "none: simulated"),
        ("run again", found.agreement + (" within 1e-9" if found.agreement == "same numbers" else "")),
        ("computed by", found.arithmetic),
        *((f"exports/{name}", told) for name, told in found.exports.items()),
        *(("note", note) for note in found.notes),
    ]
    told = console.table([row for row in rows if row[1]])
    return told if noted else f"{told}\ncompare the SHA-256 with the one that was noted when it was sealed"
