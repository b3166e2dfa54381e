"""What a stage of any role declares, and what is wrong with a declaration. The roles follow in recon.stages."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, TypeAlias

from recon.parameters import NoParams, Params
from recon.schema import METRICS, Change, Need, Schema

Schemas: TypeAlias = dict[str, Schema]
PlanFunction: TypeAlias = Callable[[Mapping[str, Schema], Any], Schemas]


@dataclass(frozen=True, kw_only=True)
class Stage:
    """What every role declares.

    name : without the role; the entry point is "<role>.<name>"
    summary : one sentence for lists
    run : the function
    version : raised whenever the results for given inputs change
    params : class of the parameters
    reads : by argument name, what is needed of that stream
    writes : by stream name, its schema, or how the stream of that name that was read is changed
    plan : the same step on schemas, where `writes` does not suffice: (schemas by port, params) -> schemas by port
    every_stream : its function takes `streams`, all streams by name, in place of single ones
    references : papers, standards
    """

    role: ClassVar[str] = ""
    given: ClassVar[tuple[str, ...]] = ("params",)

    name: str
    summary: str
    run: Callable[..., Any]
    version: int = 1
    params: type[Params] = NoParams
    reads: Mapping[str, Need] = field(default_factory=dict)
    writes: Mapping[str, Schema | Change] = field(default_factory=dict)
    plan: PlanFunction | None = None
    every_stream: bool = False
    references: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """What YAML writes after `use:`."""
        return f"{self.role}.{self.name}"

    def outputs(self, inputs: Mapping[str, Schema], params: Params) -> Schemas:
        """Schemas of the streams that a run on inputs of these schemas returns."""
        if self.plan is not None:
            planned = dict(self.plan(inputs, params))
        else:
            planned = {}
            for name, effect in self.writes.items():
                if isinstance(effect, Schema):
                    planned[name] = effect
                elif name in inputs:
                    planned[name] = effect.apply(inputs[name])
        return {**planned, "metrics": METRICS}

    def faults(self) -> list[str]:
        """What is wrong with the declaration, as sentences; empty where nothing is."""
        found = []
        if not self.name.replace("_", "").isalnum() or self.name != self.name.lower():
            found.append(f"the name '{self.name}' must be of lower-case letters, digits and _")
        if not (isinstance(self.params, type) and issubclass(self.params, Params)):
            return [*found, "params must be a subclass of recon.Params"]
        if not self.summary.strip():
            found.append("the summary is empty")
        found += [f"reads['{name}'] is no Need" for name, need in self.reads.items() if not isinstance(need, Need)]
        found += [
            f"writes['{name}'] is neither a Schema nor a Change"
            for name, effect in self.writes.items()
            if not isinstance(effect, Schema | Change)
        ]
        changed = [name for name, effect in self.writes.items() if isinstance(effect, Change)]
        found += [
            f"it changes the stream '{name}', which it does not read"
            for name in changed
            if name not in self.reads and self.plan is None
        ]
        return found + self._argument_faults()

    def _argument_faults(self) -> list[str]:
        try:
            arguments = inspect.signature(self.run).parameters
        except (TypeError, ValueError):
            return ["run is no function whose arguments can be read"]
        taken = set(arguments)
        needed = {*self.given, *self.reads, *self._also_given()}
        missing, unknown = sorted(needed - taken), sorted(taken - needed)
        found = [f"its function does not take the argument(s) {missing}, which it is given"] if missing else []
        if unknown:
            found.append(f"its function takes the argument(s) {unknown}, which it does not declare to read")
        unnamed = sorted(name for name, one in arguments.items() if one.kind is one.POSITIONAL_ONLY)
        if unnamed:
            found.append(f"its function does not take the argument(s) {unnamed} by name, as they are given")
        return found

    def _also_given(self) -> set[str]:
        return {"streams"} if self.every_stream else set()
