"""What exporters run that write tracks and events into one file of text."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from recon.manifest import RunInfo
from recon_exporters._tracks import Chart, MapParams, chart_of


@dataclass(frozen=True)
class TrackFile:
    """The function of such an exporter.

    name : of the file; document : its text, piece by piece, for what is on the map
    """

    name: str
    document: Callable[[Chart], Iterable[str]]

    def __call__(
        self,
        *,
        trajectory: pa.Table | None,
        gnss: pa.Table | None,
        events: pa.Table | None,
        folder: Path,
        about: RunInfo,
        params: MapParams,
    ) -> list[Path]:
        """Write `folder/name`; its path. Raises NothingToExport where no row has a latitude and longitude."""
        text = self.document(chart_of(trajectory, gnss, events, about, params))
        path = folder / self.name
        with path.open("w", encoding="utf-8", newline="\n") as file:
            file.writelines(text)
        return [path]
