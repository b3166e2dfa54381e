"""Pictures of a stream `frames` in a Rerun file: those that lie beside the log, as the files that they are."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import rerun as rr

from recon.manifest import RunInfo
from recon.schema import unnumbered
from recon.tables import time_ns
from recon_exporters._rerun_style import times

PICTURES: Final = (".jpg", ".jpeg", ".png", ".webp")


def draw_frames(file: rr.RecordingStream, streams: Mapping[str, pa.Table], about: RunInfo) -> list[str]:
    """Write the pictures of all streams of frames; the names of those that have some."""
    roots = [Path(path) for path in about.manifest.get("environment", {}).get("inputs", [])]
    drawn: dict[str, None] = {}
    for name, table in streams.items():
        if unnumbered(name) != "frames":
            continue
        for t_ns, text in zip(time_ns(table), table["file"].to_pylist(), strict=True):
            path = picture_of(roots, text)
            if path is not None:
                picture = rr.EncodedImage.columns(blob=[np.frombuffer(path.read_bytes(), dtype=np.uint8)])
                file.send_columns(f"camera/{name}", [times(np.array([t_ns]))], picture)
                drawn[name] = None
    return list(drawn)


def picture_of(roots: list[Path], text: str | None) -> Path | None:
    """The file of a frame, which lies in an input or beside it; None for what is no picture or is not there."""
    if text is None or Path(text).suffix.lower() not in PICTURES:
        return None
    for root in roots:
        folder = root if root.is_dir() else root.parent
        path = (folder / text).resolve()
        if path.is_relative_to(folder.resolve()) and path.is_file():
            return path
    return None
