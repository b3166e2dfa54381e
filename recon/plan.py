"""A plan: the steps of a pipeline bound to stages, parameters and schemas."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from recon.declaration import Stage
from recon.parameters import Params
from recon.pipeline import Pipeline, Step
from recon.registry import Source
from recon.schema import STREAMS, Schema
from recon.stages import EVERYTHING, Exporter, Reader, Simulator, Wanted


@dataclass(frozen=True)
class PlannedStep:
    """A step with its stage and parameters.

    inputs : stream by port, for the ports whose streams are there; all of them for a stage of every stream
    outputs : schema by stream of what the step returns
    """

    step: Step
    stage: Stage
    params: Params
    source: Source
    inputs: Mapping[str, str]
    outputs: Mapping[str, Schema]

    @property
    def id(self) -> str:
        """The step's id in its pipeline."""
        return self.step.id

    def stream_of(self, port: str) -> str:
        """The stream that a returned port is kept as."""
        return self.step.outputs.get(port, port)

    def resolved(self) -> dict[str, Any]:
        """Stage, origin and every parameter in SI, as JSON data."""
        return {
            "id": self.id,
            "use": self.stage.key,
            "stage_version": self.stage.version,
            "distribution": self.source.distribution,
            "distribution_version": self.source.version,
            "params": self.params.as_si(),
            "in": dict(self.step.inputs),
            "out": dict(self.step.outputs),
        }


ASKED_LATER: Final = ("reference", "frames")
"""Streams that no step need read: `recon evaluate` and whoever refers to a camera frame ask a finished run for them."""


@dataclass(frozen=True)
class Plan:
    """What a run will do, and the schema of every stream at its end."""

    pipeline: Pipeline
    steps: tuple[PlannedStep, ...]
    streams: Mapping[str, Schema]

    def wanted(self) -> Wanted:
        """What the steps behind the source read; everything where none does, or an exporter takes every stream."""
        later = [step for step in self.steps if not isinstance(step.stage, Reader | Simulator)]
        columns: dict[str, frozenset[str]] = {}
        for step in later:
            if isinstance(step.stage, Exporter) and step.stage.every_stream:
                return EVERYTHING
            for port, need in step.stage.reads.items():
                stream = step.step.inputs.get(port, port)
                columns[stream] = columns.get(stream, frozenset()) | {column.name for column in need.columns}
        if not columns:
            return EVERYTHING
        return Wanted({**columns, **{name: frozenset(STREAMS[name].names) for name in ASKED_LATER}})

    def resolved(self) -> list[dict[str, Any]]:
        """The steps as JSON data."""
        return [step.resolved() for step in self.steps]
