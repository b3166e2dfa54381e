"""What made a result: DIR/manifest.json, written last, so that a folder with a manifest is complete.

Everything but the block `environment` is the same for equal runs: same recon and plugins, pipeline, parameters and
input bytes give the same text and the same output hashes.
"""

from __future__ import annotations

import hashlib
import json
import platform
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import recon
from recon.arithmetic import Arithmetic
from recon.errors import ReadFailed
from recon.plan import Plan, PlannedStep
from recon.runner import Outcome
from recon.storage.atomic import EXPORT_MANIFEST, MANIFEST, MARK
from recon.storage.json_text import name_of, readable, to_json

NUMBER: Final = 1


@dataclass(frozen=True)
class RunInfo:
    """What an exporter is told of the run: the manifest, and the names that it is shown under."""

    name: str
    manifest: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", readable(self.name))

    @property
    def warnings(self) -> Sequence[str]:
        """What the user should know before he believes the result."""
        return list(self.manifest.get("warnings", []))


def digest(path: Path) -> str:
    """SHA-256 of a file, as hexadecimal text."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def describe_input(path: Path) -> dict[str, Any]:
    """Name, size and hash of an input; of a folder, those of all its files. Raises ReadFailed."""
    try:
        if not path.is_dir():
            return {"name": name_of(path), "bytes": path.stat().st_size, "sha256": digest(path)}
        parts = [describe_input(part) | {"name": part.relative_to(path).as_posix()} for part in _files_below(path)]
    except OSError as error:
        raise ReadFailed(path, f"it cannot be read: {error.strerror or error}") from error
    return {"name": name_of(path), "files": parts}


def _files_below(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def describe_outputs(folder: Path, files: Iterable[Path]) -> list[dict[str, Any]]:
    """Path relative to the folder, size and hash of each file."""
    return [
        {"file": path.relative_to(folder).as_posix(), "bytes": path.stat().st_size, "sha256": digest(path)}
        for path in sorted(files)
    ]


def make(
    plan: Plan,
    inputs: Sequence[Path],
    outcome: Outcome,
    *,
    store: str = "",
    outputs: Sequence[Mapping[str, Any]] = (),
    started: datetime,
) -> dict[str, Any]:
    """The manifest of a finished run, as JSON data: equal to what is read back."""
    made = {
        MARK: NUMBER,
        "recon": recon.__version__,
        "pipeline": {"name": plan.pipeline.name, "text": plan.pipeline.to_yaml()},
        "plan": plan.resolved(),
        "inputs": [describe_input(path) for path in inputs],
        "steps": [
            {"id": report.id, "rows": dict(report.rows), "metrics": list(report.metrics)} for report in outcome.reports
        ],
        "warnings": list(outcome.warnings),
        "store": store,
        "outputs": list(outputs),
        "environment": {
            "started": started.isoformat(timespec="milliseconds"),
            "seconds": round((datetime.now(UTC) - started).total_seconds(), 3),
            "step_seconds": {report.id: round(report.seconds, 4) for report in outcome.reports},
            "inputs": [str(path.resolve()) for path in inputs],
            "host": platform.node(),
            "platform": platform.platform(),
            "python": sys.version.split()[0],
            "packages": _packages(),
            "arithmetic": Arithmetic.used().as_data(),
        },
    }
    return dict(json.loads(to_json(made)))


@cache
def _packages() -> dict[str, str]:
    """Versions of the packages on which the numbers rest; looking them up takes longer than a small table."""
    return {name: version(name) for name in ("numpy", "pyarrow", "scipy")}


def write(manifest: Mapping[str, Any], folder: Path) -> Path:
    """Write DIR/manifest.json."""
    path = folder / MANIFEST
    path.write_text(to_json(manifest, indent=1) + "\n", encoding="utf-8", newline="\n")
    return path


def write_export(step: PlannedStep, folder: Path, written: Sequence[Path], run: str) -> Path:
    """Write the manifest of an export beside its files. run : the name that it shows the run under"""
    made = {MARK: NUMBER, "recon": recon.__version__, "run": run, "export": step.resolved()}
    path = folder / EXPORT_MANIFEST
    text = to_json({**made, "outputs": describe_outputs(folder, written)}, indent=1)
    path.write_text(text + "\n", encoding="utf-8", newline="\n")
    return path


def is_there(folder: Path) -> bool:
    """Does the folder hold a manifest of recon, or one too damaged to tell? A whole one of another program is none."""
    try:
        content = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except OSError:
        return False
    except (ValueError, RecursionError):
        return True
    return isinstance(content, dict) and MARK in content


def read(folder: Path) -> dict[str, Any]:
    """The manifest of a finished run. Raises ReadFailed where there is none, a damaged one, or one of a newer recon."""
    path = folder / MANIFEST
    if not folder.exists():
        raise ReadFailed(folder, "there is no such file or folder", hint="name the folder of a run")
    if not path.is_file():
        raise ReadFailed(folder, "this is no finished run: it holds no manifest.json", hint="name the folder of a run")
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ReadFailed(path, "it is damaged or cannot be read", hint=_MAKE_AGAIN) from error
    if not isinstance(manifest, dict) or not isinstance(manifest.get(MARK), int):
        raise ReadFailed(path, "this is no manifest of recon", hint="name the folder of a run")
    if manifest[MARK] > NUMBER:
        raise ReadFailed(path, f"it was written by a newer recon ({manifest.get('recon')})", hint="update recon")
    fault = _fault(manifest)
    if fault:
        raise ReadFailed(path, f"it is damaged: {fault}", hint=_MAKE_AGAIN)
    return manifest


_MAKE_AGAIN: Final = "copy or make the result again"

_SHAPE: Final[Mapping[str, Any]] = {
    "recon": str,
    "pipeline": {"name": str, "text": str},
    "plan": [{"id": str, "use": str, "stage_version": int, "params": dict}],
    "inputs": [{"name": str}],
    "steps": [{"id": str, "rows": dict, "metrics": [dict]}],
    "warnings": [str],
    "store": str,
    "outputs": [{"file": str, "sha256": str}],
    "environment": dict,
}
"""Of what readers rely on: a type, the shape of all items of a list, or those of the keys of an object."""


def _fault(value: Any, shape: Any = _SHAPE, where: str = "") -> str:
    """What in a manifest is not as `make` leaves it, as far as readers rely on it; "" where all is."""
    if isinstance(shape, Mapping) and isinstance(value, Mapping):
        parts = [(value.get(key), inside, f"{where}.{key}" if where else key) for key, inside in shape.items()]
    elif isinstance(shape, list) and isinstance(value, list):
        parts = [(item, shape[0], f"{where}[{number}]") for number, item in enumerate(value)]
    elif isinstance(shape, type) and isinstance(value, shape):
        return ""
    else:
        return f"'{where}' is missing or of a wrong type"
    return next(filter(None, (_fault(*part) for part in parts)), "")
