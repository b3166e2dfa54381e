"""Distributions as an installer leaves them: a folder with modules and a dist-info."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path


def install(
    folder: Path,
    distribution: str,
    version: str = "1.0",
    *,
    modules: Mapping[str, str] | None = None,
    points: Mapping[str, str] | None = None,
) -> Path:
    """Write a distribution into a folder that is then put on the path.

    modules : text by file name below the folder; points : entry points of the group recon.plugins
    """
    info = folder / f"{distribution.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    metadata = f"Metadata-Version: 2.1\nName: {distribution}\nVersion: {version}\n"
    (info / "METADATA").write_text(metadata, encoding="utf-8")
    lines = "".join(f"{name} = {value}\n" for name, value in (points or {}).items())
    (info / "entry_points.txt").write_text(f"[recon.plugins]\n{lines}", encoding="utf-8")
    for name, text in (modules or {}).items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder
