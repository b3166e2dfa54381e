"""From a pipeline to a plan without any data: every problem is found and placed before a file is opened.

`check` binds names to stages and YAML to parameters, then `flow` follows the schemas down the list. What depends on
the file stays optional; the runner calls `flow` again with the schemas that the reader really gave.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from recon.declaration import Schemas, Stage
from recon.errors import PluginBroken, PluginNotFound
from recon.overrides import Override, with_overrides
from recon.parameters import Params, bind
from recon.pipeline import Pipeline, Step
from recon.plan import Plan, PlannedStep
from recon.problems import Problem, Where, did_you_mean
from recon.registry import Registry
from recon.schema import APPENDED, STREAM_NAME, STREAMS, Mismatch, Need, by_step, match, unnumbered
from recon.stages import Delegation, Exporter, Reader, Simulator, role_of
from recon.yaml_nodes import Node

TRIM: Final = "filter.trim"
"""The stage that leaves out all but a span of time."""


@dataclass(frozen=True)
class Bound:
    """A step whose stage and parameters are known."""

    step: Step
    stage: Stage
    params: Params


def check(
    pipeline: Pipeline, registry: Registry, overrides: Iterable[Override] = (), *, given: Schemas | None = None
) -> tuple[Plan, list[Problem]]:
    """The plan of a pipeline, and every problem; the plan may be run only when there is none.

    overrides : parameters set from outside
    given : schemas of a recording that takes the place of the first step's

    Raises PluginBroken, PluginConflict or PluginInvalid where a stage that is named cannot be used.
    """
    pipeline, problems = with_overrides(pipeline, overrides, lambda step: _delegates(step, registry))
    steps = pipeline.steps
    if given is not None and steps and role_of(steps[0].use) in ("reader", "simulator"):
        steps = steps[1:]
    bound: list[Bound] = []
    for step in steps:
        found, faults = _bind(step, registry)
        problems += faults
        if found is not None:
            bound.append(found)
    misplaced = _order_problems(steps, needs_source=given is None)
    whole = len(bound) == len(steps) and not misplaced
    plan, faults = flow(pipeline, bound, registry, given or {}, whole=whole)
    return plan, _in_order(problems + misplaced + faults)


def flow(
    pipeline: Pipeline, steps: Sequence[Bound], registry: Registry, given: Schemas, *, whole: bool = True
) -> tuple[Plan, list[Problem]]:
    """Follow the schemas down the steps. whole : no step is missing, so an absent stream is a problem."""
    streams = dict(given)
    planned: list[PlannedStep] = []
    lacks: list[tuple[int, str, Mismatch, str]] = []
    problems: list[Problem] = []
    for index, bound in enumerate(steps):
        problems += _port_problems(bound)
        ports = {name: name for name in streams} if bound.stage.every_stream else {}
        served = True
        for port, need in bound.stage.reads.items():
            stream = bound.step.inputs.get(port, port)
            if stream in streams:
                ports[port] = stream
            found = [(index, stream, lack, port) for lack in _lacks(need, stream, streams, whole=whole)]
            served = served and not found and (port in ports or need.optional)
            lacks += found
        outputs = _outputs(bound, {port: streams[stream] for port, stream in ports.items()}, served=served)
        planned.append(
            PlannedStep(bound.step, bound.stage, bound.params, registry.source(bound.stage.key), ports, outputs)
        )
        for stream, schema in outputs.items():
            streams[stream] = by_step(stream) if stream in APPENDED else schema
        if isinstance(bound.stage, Reader):
            streams.update(_further_sensors(steps, outputs))
    problems += [_flow_problem(planned, *lack) for lack in lacks]
    return Plan(pipeline, tuple(planned), streams), problems


def _further_sensors(steps: Sequence[Bound], read: Schemas) -> Schemas:
    """Streams such as `imu_2` that steps ask for: only the files can tell whether they are there."""
    asked = {bound.step.inputs.get(port, port) for bound in steps for port in bound.stage.reads} - set(read)
    return {stream: read[unnumbered(stream)].possible() for stream in asked if unnumbered(stream) in read}


def _delegates(step: Step, registry: Registry) -> bool:
    if role_of(step.use) != "reader" or step.use not in registry:
        return False
    stage = registry.get(step.use)
    return isinstance(stage, Reader) and stage.delegates


def _bind(step: Step, registry: Registry) -> tuple[Bound | None, list[Problem]]:
    try:
        stage = registry.get(step.use)
    except PluginNotFound as error:
        return None, [Problem(step.where, "unknown-stage", error.message, error.hint)]
    params, problems = (
        _bind_delegation(stage, step, registry)
        if isinstance(stage, Reader) and stage.delegates
        else bind(stage.params, step.params, stage.key)
    )
    if params is None:  # its defaults, so that the flow is still checked
        params, _ = bind(stage.params, Node.of({}, step.where), stage.key)
    return (Bound(step, stage, params) if params is not None else None), problems


def _bind_delegation(stage: Stage, step: Step, registry: Registry) -> tuple[Params | None, list[Problem]]:
    """Parameters of a reader that hands over: those under the name of a reader are checked against that reader."""
    entries = step.params.value if isinstance(step.params.value, Mapping) else {}
    own = {name: node for name, node in entries.items() if role_of(name) != "reader"}
    direct = own.pop("readers", None)
    params, problems = bind(stage.params, Node(own, step.params.where, step.params.keys), stage.key)
    if direct is not None:
        hint = "write each reader's name on a line of its own, as 'reader.physycom: {gravity: 9.81 m/s^2}'"
        where = step.params.where_of_key("readers")
        problems.append(Problem(where, "unknown-parameter", f"{stage.key} has no parameter 'readers'", hint))
    for name, node in entries.items():
        if role_of(name) != "reader":
            continue
        if name not in registry:
            absent = registry.not_found(name)
            problems.append(Problem(step.params.where_of_key(name), "unknown-stage", absent.message, absent.hint))
        elif not isinstance(node.value, Mapping):
            problems.append(Problem(node.where, "bad-value", f"{name} must be a mapping of its parameters"))
        else:
            problems += _optional_bind(registry.get(name), node)
    if not isinstance(params, Delegation):
        return params, problems
    handed = {name: node.plain() for name, node in entries.items() if role_of(name) == "reader"}
    return params.model_copy(update={"readers": handed}), problems


def _optional_bind(stage: Stage, node: Node) -> list[Problem]:
    """Problems of parameters that will be used only if this reader is chosen: what is missing is asked for then."""
    _, problems = bind(stage.params, node, stage.key)
    return [problem for problem in problems if problem.code != "missing-parameter"]


def _order_problems(steps: Sequence[Step], *, needs_source: bool) -> list[Problem]:
    """Readers and simulators come first and only there, exporters last; executors belong into batch files."""
    found = []
    roles = [role_of(step.use) for step in steps]
    for index, step in enumerate(steps):
        role = roles[index]
        if role == "executor":
            text, hint = f"{step.use} is no step of a pipeline", "name it under 'executor:' in a batch file"
            found.append(Problem(step.where, "misplaced-step", text, hint))
        elif role in ("reader", "simulator") and (index or not needs_source):
            text, hint = f"{step.use} must be the first step", "a pipeline has one source"
            found.append(Problem(step.where, "misplaced-step", text, hint))
        elif role and role not in ("reader", "simulator") and needs_source and not index:
            text = f"the first step is {step.use}, which reads no file"
            found.append(Problem(step.where, "misplaced-step", text, "begin with '- use: reader.auto'"))
        if role == "exporter" and set(roles[index:]) != {"exporter"}:
            text = f"{step.use} must come after all steps that are no exporters"
            found.append(Problem(step.where, "misplaced-step", text, "it is given what the run ends with"))
    return found


def _port_problems(bound: Bound) -> list[Problem]:
    """Names under `in` and `out` that are not ports of the stage, and streams that `out` may not name."""
    known = {"in": list(bound.stage.reads), "out": [*bound.stage.writes, "metrics"]}
    named = {"in": bound.step.inputs, "out": bound.step.outputs}
    found = []
    for key, ports in named.items():
        for port, stream in ports.items():
            where = bound.step.node.at([key]).where_of_key(port) if bound.step.node else bound.step.where
            if port not in known[key] and not (key == "out" and bound.stage.plan is not None):
                hint = did_you_mean(port, known[key]) or f"it has {', '.join(known[key]) or 'none'}"
                text = f"{bound.stage.key} has no port '{port}' under '{key}'"
                found.append(Problem(where, "unknown-port", text, hint))
            elif fault := _stream_fault(port, stream, list(ports.values())) if key == "out" else "":
                found.append(Problem(where, "bad-stream", f"{bound.stage.key}: {fault}"))
    return found


def _stream_fault(port: str, stream: str, streams: Sequence[str]) -> str:
    """Why what a port returns may not be kept under that name; "" where it may."""
    if not STREAM_NAME.fullmatch(stream):
        return f"a stream cannot be called '{stream}': use lower-case letters, digits and _"
    if streams.count(stream) > 1:
        return f"two ports are kept as '{stream}'"
    kind = unnumbered(stream)
    if kind in STREAMS and STREAMS[kind] is not STREAMS.get(unnumbered(port)):
        return f"{port} cannot be kept as '{stream}', the name of streams of another kind"
    return ""


def _lacks(need: Need, stream: str, streams: Schemas, *, whole: bool) -> list[Mismatch]:
    if stream in streams:
        return match(need, streams[stream], stream)
    if need.optional or not whole:
        return []
    return [Mismatch((), f"'{stream}'; streams here are {', '.join(sorted(streams)) or 'none'}", missing=True)]


def _outputs(bound: Bound, inputs: Schemas, *, served: bool) -> Schemas:
    """Schemas of what the step returns, by stream; what cannot be planned because its needs are not served is left out.

    Raises PluginBroken where the stage's own plan fails although they are.
    """
    try:
        planned = bound.stage.outputs(inputs, bound.params)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a plan is somebody else's code, and may even exit
        if served:
            text = f"{bound.stage.key} cannot be planned: {type(error).__name__}: {error}"
            raise PluginBroken(text, "tell its author") from error
        planned = {}
    return {bound.step.outputs.get(port, port): schema for port, schema in planned.items()}


def _flow_problem(planned: Sequence[PlannedStep], index: int, stream: str, lack: Mismatch, port: str) -> Problem:
    bound = planned[index]
    notes: tuple[tuple[Where, str], ...] = ()
    for later in planned[index + 1 :]:
        written = later.outputs.get(stream)
        if lack.missing and written is not None and (not lack.columns or any(n in written for n in lack.columns)):
            what = f"{stream}.{lack.columns[0]}" if lack.columns else f"'{stream}'"
            text = f"{later.stage.key} writes {what}, but only later: move it above"
            notes = ((later.step.where, text),)
            break
    where = bound.step.where
    if bound.step.node is not None and port in bound.step.inputs:
        where = bound.step.node.at(["in", port]).where
    code = "missing-input" if lack.missing else "wrong-input"
    return Problem(where, code, f"{bound.stage.key} reads {lack.text}", lack.hint, notes)


def _in_order(problems: Iterable[Problem]) -> list[Problem]:
    return sorted(problems, key=lambda p: (p.where.file, p.where.line, p.where.column) if p.where else ("", 0, 0))


def settled(plan: Plan, registry: Registry, streams: Schemas) -> tuple[Plan, list[Problem]]:
    """The plan of the steps between the source and the exporters, now that the streams are known."""
    rest = [
        Bound(step.step, step.stage, step.params)
        for step in plan.steps
        if not isinstance(step.stage, Reader | Simulator | Exporter)
    ]
    return flow(plan.pipeline, rest, registry, streams)


def with_span(pipeline: Pipeline, start: str | None, stop: str | None) -> Pipeline:
    """The pipeline of the rows between two times alone, as `--from` and `--to` ask for.

    start, stop : as filter.trim takes them, which comes behind the first step; None for the first and the last row
    """
    given = {name: text for name, text in (("start", start), ("stop", stop)) if text is not None}
    if not given:
        return pipeline
    where = Where("--from, --to")
    params = Node.of(given, where)
    if TRIM in (step.id for step in pipeline.steps):
        steps = [step.with_params(params) if step.id == TRIM else step for step in pipeline.steps]
    else:
        steps = [*pipeline.steps[:1], Step(TRIM, TRIM, params, where), *pipeline.steps[1:]]
    return replace(pipeline, steps=tuple(steps))


def with_exports(pipeline: Pipeline, names: Iterable[str]) -> Pipeline:
    """The pipeline with exporters appended, as `--export NAME` asks for."""
    steps = list(pipeline.steps)
    for name in [names] if isinstance(names, str) else names:
        use = name if role_of(name) == Exporter.role else f"{Exporter.role}.{name}"
        where = Where(f"--export {name}")
        steps.append(Step(use, use, Node.of({}, where), where))
    return replace(pipeline, steps=tuple(steps))
