"""Files for people in a seal, made again from its results.

An exporter that `repeats` gives the same bytes from the same streams and parameters, so its files can be held against
the results beside them. Files that cannot are told with the reason: those of an exporter that does not, or that is not
installed here, and those that no export.json beside them tells the origin of.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from recon import api
from recon.calling import call_exporter
from recon.check import Bound, flow
from recon.errors import Difference, PluginError, ReconError
from recon.evidence import contents
from recon.evidence.archive import Entry
from recon.evidence.sameness import SAME_BYTES
from recon.manifest import RunInfo, digest
from recon.pipeline import Pipeline, Step
from recon.plan import PlannedStep
from recon.problems import Where
from recon.registry import Registry, Source
from recon.stages import Exporter
from recon.storage.atomic import EXPORT_MANIFEST
from recon.yaml_nodes import Node

_WHERE: Final = Where(EXPORT_MANIFEST)


def told_by(entries: Sequence[Entry]) -> dict[str, dict[str, Any] | None]:
    """What export.json tells of each export of a seal, by its folder; None where there is none, or no whole one."""
    names = [entry.name.split("/") for entry in entries if entry.name.startswith(f"{contents.EXPORTS}/")]
    found: dict[str, dict[str, Any] | None] = {parts[1]: None for parts in names}
    for entry in entries:
        folder, _, rest = entry.name.removeprefix(f"{contents.EXPORTS}/").partition("/")
        if rest == EXPORT_MANIFEST and folder in found:
            with entry.open() as source:
                found[folder] = _told(source.read())
    return found


def _told(text: bytes) -> dict[str, Any] | None:
    try:
        data = json.loads(text)
        step, name = data["export"], data["run"]
        shaped = isinstance(step["use"], str) and isinstance(name, str) and isinstance(step["params"], dict)
        ports = dict(step.get("in", {}))
        shaped &= all(isinstance(word, str) for pair in ports.items() for word in pair)
    except (ValueError, RecursionError, TypeError, KeyError, AttributeError):
        return None
    return {"use": step["use"], "params": step["params"], "in": ports, "run": name} if shaped else None


def sources_of(told: Mapping[str, Mapping[str, Any] | None], registry: Registry) -> tuple[list[Source], list[str]]:
    """Where the exporters of a seal come from here, and the packages that their bytes also rest on."""
    sources: list[Source] = []
    packages: set[str] = set()
    for step in filter(None, told.values()):
        if step["use"] in registry:
            sources.append(registry.source(step["use"]))
            stage = registry.get(step["use"])
            packages.update(stage.made_with if isinstance(stage, Exporter) else ())
    return sources, sorted(packages)


def made_again(
    sealed: api.Run, entries: Sequence[Entry], folder: Path, registry: Registry, notes: Sequence[str]
) -> dict[str, str]:
    """How each export of a seal comes out again from its results: SAME_BYTES, or why that is not known.

    folder : a new one, to make them in; notes : what is another one here than when it was sealed

    Raises Difference at the first file that comes out otherwise, though nothing is another one here.
    """
    found = {}
    for name, told in told_by(entries).items():
        if told is None:
            found[name] = f"not checked: no {EXPORT_MANIFEST} tells what made it"
            continue
        try:
            step = _step(told, sealed, registry)
            if not (isinstance(step.stage, Exporter) and step.stage.repeats):
                found[name] = f"not checked: {told['use']} never gives the same bytes"
                continue
            (folder / name).mkdir(parents=True)
            about = RunInfo(told["run"], sealed.manifest)
            made = call_exporter(step, sealed.recording, folder / name, about)
        except PluginError as error:
            found[name] = f"not checked: {error.message}"
            continue
        except ReconError as error:
            text = f"{contents.EXPORTS}/{name} cannot be made from the results: {error.message}"
            raise Difference(text, _since(notes)) from error
        fault = _unlike(name, entries, {path.relative_to(folder / name).as_posix(): path for path in made})
        if fault and not notes:
            raise Difference(fault, _since(notes))
        found[name] = f"made again, with other bytes: {fault}; perhaps {_since(notes)}" if fault else SAME_BYTES
    return found


def _since(notes: Sequence[str]) -> str:
    return f"since {'; '.join(notes)}" if notes else "code and packages are those of the seal, so it was changed"


def _step(told: Mapping[str, Any], sealed: api.Run, registry: Registry) -> PlannedStep:
    """Raises PluginNotFound; Difference where no such step can be made of the results."""
    stage = registry.get(told["use"])
    step = Step(stage.key, stage.key, Node.of({}, _WHERE), _WHERE, inputs=told["in"])
    try:
        bound = Bound(step, stage, stage.params.model_validate(told["params"]))
    except ValidationError as error:
        raise Difference(f"{EXPORT_MANIFEST} tells parameters that {stage.key} does not have") from error
    plan, problems = flow(Pipeline("export", (step,)), [bound], registry, sealed.recording.schemas())
    if problems:
        raise Difference(problems[0].text)
    return plan.steps[0]


def _unlike(name: str, entries: Sequence[Entry], made: Mapping[str, Path]) -> str:
    """The first file of an export that is not as it was made again; "" where all are."""
    base = f"{contents.EXPORTS}/{name}/"
    kept = {entry.name.removeprefix(base): entry for entry in entries if entry.name.startswith(base)}
    kept.pop(EXPORT_MANIFEST)
    for file in sorted({*kept, *made}):
        if file not in made:
            return f"{base}{file} is none of the files that the exporter makes of the results"
        if file not in kept:
            return f"{base}{file} is missing"
        if kept[file].sha256() != digest(made[file]):
            return f"{base}{file} does not follow from the results"
    return ""
