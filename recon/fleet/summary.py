"""What the owner of a fleet wants to know, from ROOT/jobs.parquet: how much was driven, what failed, what is worst."""

from __future__ import annotations

from collections import Counter
from typing import Any, Final

import pyarrow as pa

from recon.errors import ReadFailed
from recon.fleet.compacted import JOBS, OK
from recon.fleet.places import Place

WORST: Final = 10
"""Drives that are named."""

_COLUMNS: Final = ("vehicle", "drive", "status", "code", "duration", "distance", "warnings", "pos_std")


def summarize(root: Place) -> dict[str, Any]:
    """drives, vehicles, hours, kilometres; failures by reason; the drives of the worst quality, worst first.

    Quality is the median of the trajectory's own sigma of position, then the number of warnings.
    Raises ReadFailed where there is no file of jobs.
    """
    from pyarrow.parquet import read_table

    place = root / JOBS
    try:
        with place.filesystem.open_input_file(place.path) as file:
            rows = read_table(file, columns=list(_COLUMNS)).to_pylist()
    except (OSError, pa.ArrowException) as error:
        hint = "name the output of a batch; 'recon batch' writes this file when it ends"
        raise ReadFailed(str(place), "the jobs of a batch cannot be read from it", hint=hint) from error
    good = [row for row in rows if row["status"] == OK]
    worst = sorted(good, key=lambda row: (-(row["pos_std"] or 0.0), -row["warnings"], row["vehicle"], row["drive"]))
    failures = Counter(row["code"] for row in rows if row["status"] != OK)
    return {
        "drives": len(rows),
        "done": len(good),
        "failed": len(rows) - len(good),
        "vehicles": len({row["vehicle"] for row in rows}),
        "hours": sum(row["duration"] or 0.0 for row in good) / 3600.0,
        "kilometres": sum(row["distance"] or 0.0 for row in good) / 1000.0,
        "failures": dict(failures.most_common()),
        "worst": [{key: row[key] for key in ("vehicle", "drive", "pos_std", "warnings")} for row in worst[:WORST]],
    }
