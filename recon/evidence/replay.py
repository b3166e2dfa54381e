"""A sealed run, run again."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from recon import api
from recon.arithmetic import Arithmetic
from recon.errors import Difference, PluginNotFound
from recon.evidence.sameness import OTHER, ROUNDED, SAME_BYTES, SAME_NUMBERS, Kinship, kinships, unlike, unlike_data
from recon.pipeline import Pipeline
from recon.registry import Registry, Source
from recon.stages import Exporter, Reader, role_of

_COMPARED: Final = ("plan", "inputs", "steps", "warnings", "store")
_VERSIONS: Final = ("stage_version", "distribution_version")


def pipeline_of(manifest: Mapping[str, Any]) -> Pipeline:
    """The pipeline of a run without its exporters, which change no number."""
    found = Pipeline.from_text(manifest["pipeline"]["text"], "pipeline.yaml")
    return replace(found, steps=tuple(step for step in found.steps if role_of(step.use) != Exporter.role))


def sources_of(manifest: Mapping[str, Any], registry: Registry) -> list[Source]:
    """Where the stages of a run come from here, the readers that reader.auto chose among them.

    Raises PluginNotFound where one is not installed.
    """
    found = []
    for key, origin in _stages(manifest):
        if key not in registry:
            text = f"the run cannot be made again: its stage '{key}' is not installed here"
            raise PluginNotFound(text, f"pip install {origin}" if origin else registry.suggest(key))
        found.append(registry.source(key))
    return found


def _stages(manifest: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Each stage that made numbers, and what pip would install it from, "" where that is not known."""
    for step in manifest["plan"]:
        if role_of(step["use"]) != Exporter.role:
            yield step["use"], "==".join(filter(None, (step.get("distribution"), step.get("distribution_version"))))
    for row in (row for step in manifest["steps"] for row in step["metrics"]):
        if row.get("name") == "reader" and role_of(str(row.get("method"))) == Reader.role:
            yield row["method"], ""


def run_again(manifest: Mapping[str, Any], inputs: Sequence[Path], folder: Path, registry: Registry) -> api.Run:
    """Run a manifest's pipeline on these inputs, into a folder; with its arithmetic, where that can be had."""
    told = arithmetic_of(manifest)
    if told not in (None, Arithmetic.used()) and registry.options is not None:
        finished = _run_as_told(manifest, told, inputs, folder, registry.options)
        if finished is not None:
            return finished
    store = manifest["store"]
    return api.execute(pipeline_of(manifest), list(inputs) or None, folder, [], registry=registry, store=store)


def arithmetic_of(manifest: Mapping[str, Any]) -> Arithmetic | None:
    """What a run was computed by; None where its manifest does not tell, as those of the first versions."""
    return Arithmetic.from_data(manifest["environment"].get("arithmetic"))


def _run_as_told(
    manifest: Mapping[str, Any],
    told: Arithmetic,
    inputs: Sequence[Path],
    folder: Path,
    options: Sequence[str],
) -> api.Run | None:
    """As `run_again`, in a process that is asked for an arithmetic when it starts.

    None where it fails, as on an instruction that the processor lacks, or is given another arithmetic.
    """
    with TemporaryDirectory(prefix="recon-replay-") as scratch:
        pipeline = Path(scratch) / "pipeline.yaml"
        pipeline.write_text(pipeline_of(manifest).to_yaml(), encoding="utf-8", newline="\n")
        command = [sys.executable, "-P", "-m", "recon", "run", str(pipeline), *map(str, inputs), "--out", str(folder)]
        command += ["--store", manifest["store"], *options]
        try:
            done = subprocess.run(command, env=told.environment(), capture_output=True, check=False)
        except OSError:
            return None
    if done.returncode:
        return None
    finished = api.open(folder)
    if finished.manifest["environment"]["arithmetic"] == told.as_data():
        return finished
    shutil.rmtree(folder)
    return None


def compare(sealed: api.Run, again: api.Run) -> bool:
    """Did a run give the same bytes? Raises Difference where a number, or what is told of it, is another one."""
    fault = unlike(sealed.recording, again.recording)
    if fault:
        raise _unlike(fault, kinships(sealed.recording, again.recording))
    fault = unlike_data(_comparable(sealed.manifest), _comparable(again.manifest), "")
    if fault:
        raise Difference(f"run again, its manifest is another one: {fault}")
    return bool(sealed.manifest["outputs"] == again.manifest["outputs"])


def _unlike(fault: str, streams: Sequence[Kinship]) -> Difference:
    """What the first difference is, and how alike each stream is; rounding is told as such."""
    data = tuple(stream._asdict() for stream in streams)
    told = "the result is another one"
    if only_rounded(data):
        farthest = max(stream.size or 0.0 for stream in streams)
        told = f"every number is within {farthest:.1e} of its size of the sealed one, but not within 1e-9"
    error = Difference(f"run again, {told}: {fault}\n{as_text(streams)}")
    error.streams = data
    return error


def only_rounded(streams: Sequence[Mapping[str, object]]) -> bool:
    """Do the streams of a Difference differ by no more than rounding makes of them?"""
    return bool(streams) and all(stream["how"] != OTHER for stream in streams)


def as_text(streams: Sequence[Kinship]) -> str:
    """Streams by how they came out again, a line each kind or, where numbers moved, each stream."""
    lines = []
    for how, words in ((SAME_BYTES, "the same bytes"), (SAME_NUMBERS, "the same within 1e-9")):
        alike = [stream.stream for stream in streams if stream.how == how]
        lines += [f"{words}: {', '.join(alike)}"] if alike else []
    for stream in streams:
        if stream.how in (ROUNDED, OTHER):
            size = "not the same rows or words" if stream.size is None else f"within {stream.size:.1e} of their size"
            sigmas = "" if stream.sigmas is None else f", values within {stream.sigmas:.1e} of their sigma"
            lines.append(f"{size}{sigmas}: {stream.stream}")
    return "\n".join(f"  {line}" for line in lines)


def _comparable(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """What must come out again; versions may be others if the numbers are the same."""
    found = {key: manifest[key] for key in _COMPARED}
    found["plan"] = [
        {key: value for key, value in step.items() if key not in _VERSIONS}
        for step in manifest["plan"]
        if role_of(step["use"]) != Exporter.role
    ]
    return found
