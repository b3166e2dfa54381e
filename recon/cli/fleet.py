"""`recon fleet summary`: what became of a fleet."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from recon.cli import _console as console
from recon.cli._options import AsJson, bad_option

if TYPE_CHECKING:
    from collections.abc import Sequence


def fleet(
    words: Annotated[list[str], typer.Argument(metavar="summary ROOT", help="Output of a batch, a folder or URI.")],
    as_json: AsJson = False,
) -> None:
    """Print hours, kilometres, failures and the worst drives of a fleet.

    Example: recon fleet summary results
    """
    from recon.fleet.places import Place
    from recon.fleet.summary import summarize

    match words:
        case ["summary", root]:
            found = summarize(Place.of(root))
        case _:
            raise bad_option("this asks for nothing", "write 'recon fleet summary ROOT'")
    if as_json:
        console.write_json(found)
    else:
        console.write(as_text(found))


def as_text(found: dict[str, Any]) -> str:
    """The summary for people."""
    from recon.rounding import counted

    of = counted(found["vehicles"], "vehicle")
    drives = f"{found['drives']:,} of {of}: {found['done']} done, {found['failed']} failed"
    parts = [
        console.table(
            [
                ("drives", drives),
                ("driven", f"{found['hours']:,.1f} h, {found['kilometres']:,.1f} km"),
            ]
        )
    ]
    if found["failures"]:
        parts.append("failures\n" + console.table([(code, str(n)) for code, n in found["failures"].items()]))
    if found["worst"]:
        parts.append("worst quality first\n" + console.table([_HEAD, *map(_worst, found["worst"])]))
    return "\n\n".join(parts)


_HEAD = ("vehicle", "drive", "sigma of position", "warnings")


def _worst(row: dict[str, Any]) -> Sequence[str]:
    sigma = "unknown" if row["pos_std"] is None else f"{row['pos_std']:.2f} m"
    vehicle, drive = (row[key].replace("\n", r"\n") for key in ("vehicle", "drive"))
    return (vehicle, drive, sigma, str(row["warnings"]))
