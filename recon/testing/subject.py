"""A stage under test: its inputs, and its run by the machinery that runs it for users."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeAlias

import pyarrow as pa

from recon.calling import call_exporter
from recon.check import Bound, flow
from recon.declaration import Stage
from recon.manifest import RunInfo, make
from recon.parameters import Params
from recon.pipeline import Pipeline, Step
from recon.plan import Plan
from recon.problems import Where
from recon.recording import Recording
from recon.registry import Registry
from recon.runner import Outcome, run_pipeline
from recon.schema import APPENDED
from recon.stages import Reader, Simulator
from recon.testing.drives import USUAL, Conditions, drive
from recon.testing.serving import serve
from recon.yaml_nodes import Node

ReadBack: TypeAlias = Callable[[Sequence[Path]], Mapping[str, Mapping[str, Any]]]


@dataclass(frozen=True)
class Case:
    """An input of the author's own, beside the ones that the suite makes.

    name : shown in the test's id
    params : where the defaults do not do
    streams : by port; None for the suite's drives
    path : the file that a reader reads; readers need at least one case with a path
    read_back : for exporters, reads the files that were written (paths -> columns by stream) by another road than
        the exporter's own; `time` in ns since 1970 where the format keeps some rows only, a missing number NaN
    """

    name: str = ""
    params: Params | None = None
    streams: Mapping[str, pa.Table] | None = None
    path: Path | None = None
    read_back: ReadBack | None = None


@dataclass(frozen=True)
class Subject:
    """A stage with one case."""

    stage: Stage
    registry: Registry
    case: Case = field(default_factory=Case)

    @property
    def params(self) -> Params:
        """The parameters of the case, else the defaults. Raises AssertionError where one has no default."""
        if self.case.params is not None:
            return self.case.params
        needed = [name for name, info in self.stage.params.model_fields.items() if info.is_required()]
        assert not needed, f"{self.stage.key} needs {needed}: contract(..., cases=[Case(params=...)])"
        return self.stage.params()

    def inputs(self, conditions: Conditions = USUAL) -> dict[str, pa.Table]:
        """What the stage reads, by port: the case's streams, else a drive in the frames that it asks for."""
        if self.case.streams is not None:
            return dict(self.case.streams)
        made = drive(conditions)
        return dict(made) if self.stage.every_stream else serve(made, self.stage.reads)

    def plan(self, inputs: Mapping[str, pa.Table], params: Params | None = None) -> Plan:
        """The plan of a pipeline of this one step. Raises AssertionError where the inputs do not serve the stage."""
        where = Where(f"<{self.stage.key}>")
        step = Step(self.stage.key, self.stage.key, Node.of({}, where), where)
        bound = Bound(step, self.stage, params or self.params)
        schemas = Recording(inputs).schemas()
        plan, problems = flow(Pipeline("contract", (step,)), [bound], self.registry, schemas)
        assert not problems, f"the inputs do not serve {self.stage.key}: {problems[0].text}"
        return plan

    def run(self, inputs: Mapping[str, pa.Table] | None = None, params: Params | None = None) -> dict[str, pa.Table]:
        """What the stage returns, by stream, stamped and checked as in any run; without rows of steps above.

        inputs : by port; the case's or the suite's by default. A reader reads the case's path, a simulator nothing.
        Raises what a run raises: DataError, StageError, ContractError.
        """
        if isinstance(self.stage, Reader | Simulator):
            return self.read(self.case.path) if isinstance(self.stage, Reader) else self._source([], params)
        inputs = self.inputs() if inputs is None else inputs
        outcome = run_pipeline(self.plan(inputs, params), Recording(inputs), self.registry)
        returned = {*outcome.reports[-1].rows, "metrics"}
        return {name: self._own(name, table) for name, table in outcome.recording.items() if name in returned}

    def outcome(self, inputs: Mapping[str, pa.Table]) -> Recording:
        """The whole recording after the stage, with what was not its business. Raises what a run raises."""
        return run_pipeline(self.plan(inputs), Recording(inputs), self.registry).recording

    def export(self, folder: Path, inputs: Mapping[str, pa.Table] | None = None) -> list[Path]:
        """The files that an exporter says it wrote into a folder. Raises what a run raises."""
        recording = Recording(self.inputs() if inputs is None else inputs, {"sources": ["simulated"]})
        plan = self.plan(recording)
        about = RunInfo("contract", make(plan, [], Outcome(recording, []), started=datetime.now(UTC)))
        return call_exporter(plan.steps[-1], recording, folder, about)

    def read(self, path: Path | None) -> dict[str, pa.Table]:
        """What a reader returns for a file."""
        assert path is not None, f"{self.stage.key} needs a file: contract(..., cases=[Case(path=...)])"
        return self._source([path], None)

    def _source(self, paths: list[Path], params: Params | None) -> dict[str, pa.Table]:
        recording = run_pipeline(self.plan({}, params), paths, self.registry).recording
        return {name: self._own(name, table) for name, table in recording.items()}

    def _own(self, name: str, table: pa.Table) -> pa.Table:
        if name not in APPENDED:
            return table
        import pyarrow.compute as pc  # slow import: only when used

        return table.filter(pc.equal(table["step"], self.stage.key))

    def with_params(self, **values: object) -> Subject:
        """The same stage with some parameters changed, in SI."""
        return replace(self, case=replace(self.case, params=self.params.model_copy(update=values)))
