"""`recon blender-extension`: recon for people who never open a terminal, as one file that Blender installs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from recon.cli import _console as console
from recon.cli._options import bad_option
from recon.problems import did_you_mean, one_of


def blender_extension(
    platform: Annotated[
        str | None,
        typer.Option("--platform", metavar="NAME", help="linux-x64, windows-x64 or macos-arm64; by default this one."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Where the zip goes.")] = Path(),
) -> None:
    """Build the extension for Blender 4.2 to 5.0: pip fetches the wheels.

    Example: recon blender-extension --platform windows-x64 --out dist
    """
    from recon.blender_extension import PLATFORMS, build_extension

    chosen = platform or {"win32": "windows-x64", "darwin": "macos-arm64"}.get(sys.platform, "linux-x64")
    if chosen not in PLATFORMS:
        hint = did_you_mean(chosen, PLATFORMS) or f"write {one_of(list(PLATFORMS))}"
        raise bad_option(f"there is no platform '{chosen}'", hint, f"--platform {chosen}")
    made = build_extension(chosen, out)
    further = [
        ("Blender 4.2 to 5.0", "drop the file on the window, or Preferences > Get Extensions > Install from Disk"),
        ("Blender 3.4", "Preferences > Add-ons > Install"),
        ("then", "3D view, sidebar (key N), tab 'recon'"),
    ]
    console.write("\n".join([f"{made}  ({made.stat().st_size / 1e6:.0f} MB)", "", "next", console.table(further)]))
