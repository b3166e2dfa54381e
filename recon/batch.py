"""The form of batch files: one pipeline over many recordings. What one will do, `recon.batch_plan` says.

    recon: 1
    batch: june_fleet
    pipeline: best_accuracy            # a shipped name or a file
    inputs:
      - glob: data/*/2026-06-*/*.txt   # or  list: drives.csv  with columns path, vehicle, drive
        vehicle: parent 2              # name of the N-th folder above the file, stem, or a regex with a named group
        drive: stem                    # file name without ending; these two are the defaults: parent 1 and stem
    output: results
    defaults: {reader.physycom: {gravity: 9.80665 m/s^2}}
    vehicles:
      A12: {fuser.map: {lever_arm: [0.8 m, -0.3 m, 1.1 m]}}
    exports: [report]
    executor: {use: executor.local, params: {workers: 2}}
    on_error: continue                 # or stop
    retries: 1
    timeout: 10 min
    memory: 2 GB
    resume: true

Paths are relative to the folder of the batch file. A regex is searched for in the path with `/` between its parts, and
its group is called `vehicle` or `drive`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from recon.form import Form
from recon.overrides import Override
from recon.pipeline import FORMAT
from recon.problems import Problem, Where
from recon.units import UnitError, parse_quantity
from recon.yaml_nodes import Node

ON_ERROR: Final = ("continue", "stop")
BYTES: Final = {
    "B": 1,
    "kB": 10**3,
    "MB": 10**6,
    "GB": 10**9,
    "TB": 10**12,
    "KiB": 2**10,
    "MiB": 2**20,
    "GiB": 2**30,
    "TiB": 2**40,
}

_NEEDED: Final = ("batch", "pipeline", "inputs", "output")
_KEYS: Final = (
    *("recon", *_NEEDED, "defaults", "vehicles", "exports", "executor"),
    *("on_error", "retries", "timeout", "memory", "resume"),
)  # fmt: skip
_INPUT_KEYS: Final = ("glob", "list", "vehicle", "drive")
_PARENT: Final = re.compile(r"parent [1-9][0-9]*")
_SIZE: Final = re.compile(rf"([0-9]+(?:\.[0-9]*)?)\s*({'|'.join(BYTES)})")


@dataclass(frozen=True)
class Inputs:
    """Where recordings are: a `glob` with the rules that name vehicle and drive, or a CSV file that lists them."""

    glob: str = ""
    list_file: str = ""
    vehicle: str = "parent 1"
    drive: str = "stem"


@dataclass(frozen=True)
class BatchFile:
    """A batch file. `root` keeps the places, for messages.

    vehicles : by vehicle, what is set for it beyond `defaults`
    executor : "" for the default one
    timeout : s; memory : bytes; None is without limit
    """

    name: str
    pipeline: str
    inputs: tuple[Inputs, ...]
    output: str
    defaults: tuple[Override, ...]
    vehicles: Mapping[str, tuple[Override, ...]]
    exports: tuple[str, ...]
    executor: str
    executor_params: Node
    on_error: str
    retries: int
    timeout: float | None
    memory: int | None
    resume: bool
    root: Node

    @property
    def folder(self) -> Path:
        """What its paths are relative to."""
        return Path(self.root.where.file).parent


def parse(root: Node) -> tuple[BatchFile, list[Problem]]:
    """The batch file that a YAML node holds, as far as it can be understood, and what is wrong with its form."""
    form = Form()
    top = form.mapping(root, "a batch file", _KEYS, needs=_NEEDED)
    form.number_of_format(top.get("recon"), FORMAT)
    vehicles = form.entries(top.get("vehicles"), "vehicles must be a mapping", "write a line for each vehicle")
    exports = form.items(top.get("exports"), "exports", "write [csv]")
    executor, executor_params = _executor(top.get("executor"), form)
    batch = BatchFile(
        name=form.text(top.get("batch"), "batch"),
        pipeline=form.text(top.get("pipeline"), "pipeline"),
        inputs=_inputs(top.get("inputs"), form),
        output=form.text(top.get("output"), "output"),
        defaults=_overrides(top.get("defaults"), "defaults", form),
        vehicles={name: _overrides(node, f"vehicles.{name}", form) for name, node in vehicles.items()},
        exports=tuple(name for node in exports if (name := form.text(node, "an export"))),
        executor=executor,
        executor_params=executor_params,
        on_error=form.choice(top.get("on_error"), "on_error", ON_ERROR),
        retries=_count(top.get("retries"), "retries", form),
        timeout=_seconds(top.get("timeout"), "timeout", form),
        memory=_bytes(top.get("memory"), "memory", form),
        resume=_switch(top.get("resume"), "resume", form),
        root=root,
    )
    return batch, form.problems


def _inputs(node: Node | None, form: Form) -> tuple[Inputs, ...]:
    items = form.items(node, "inputs", "write '- glob: data/*.txt'")
    if node is not None and node.value in (None, ()):
        form.report(node.where, "bad-value", "inputs must name at least one place", "write '- glob: data/*.txt'")
    return tuple(_input(item, form) for item in items)


def _input(item: Node, form: Form) -> Inputs:
    entries = form.mapping(item, "an input", _INPUT_KEYS)
    if isinstance(item.value, Mapping) and ("glob" in entries) == ("list" in entries):
        form.report(item.where, "bad-value", "an input needs either 'glob' or 'list'")
    texts = {key: form.text(node, key) for key, node in entries.items()}
    for key in ("vehicle", "drive"):
        if key in entries and "list" in entries:
            text = f"'{key}' goes with a glob; a list has a column for it"
            form.report(item.where_of_key(key), "bad-value", text)
        elif texts.get(key):
            _check_rule(key, texts[key], entries[key].where, form)
    return Inputs(
        glob=texts.get("glob", ""),
        list_file=texts.get("list", ""),
        vehicle=texts.get("vehicle") or Inputs.vehicle,
        drive=texts.get("drive") or Inputs.drive,
    )


def _check_rule(key: str, rule: str, where: Where, form: Form) -> None:
    """A rule that names a vehicle or a drive: `parent N`, `stem`, or a regex with a group of that name."""
    if rule == "stem" or _PARENT.fullmatch(rule):
        return
    example = f"write 'parent 1', 'stem' or a regex with a group '(?P<{key}>...)'"
    try:
        named = key in re.compile(rule).groupindex
    except (re.error, OverflowError, RecursionError) as error:
        form.report(where, "bad-value", f"{key}: '{rule}' is no regex: {error}", example)
        return
    if not named:
        form.report(where, "bad-value", f"{key}: '{rule}' does not tell the {key}", example)


def _overrides(node: Node | None, what: str, form: Form) -> tuple[Override, ...]:
    example = "write {filter.resample: {rate: 100 Hz}}"
    steps = form.entries(node, f"{what} must be a mapping of steps to parameters", example)
    for step, params in steps.items():
        form.entries(params, f"{step} must be a mapping of its parameters", example)
    return tuple(
        Override(step, params, node.where_of_key(step))
        for step, params in steps.items()
        if node is not None and isinstance(params.value, Mapping)
    )


def _executor(node: Node | None, form: Form) -> tuple[str, Node]:
    if node is None:
        return "", Node.of({}, Where(""))
    entries = form.mapping(node, "executor", ("use", "params"), needs=("use",))
    params = entries.get("params", Node.of({}, node.where))
    form.entries(params, "params must be a mapping", "write 'name: value' lines below it")
    kept = params if isinstance(params.value, Mapping) else Node.of({}, params.where)
    return form.text(entries.get("use"), "use"), kept


def _count(node: Node | None, key: str, form: Form) -> int:
    if node is None:
        return 0
    if isinstance(node.value, int) and not isinstance(node.value, bool) and node.value >= 0:
        return node.value
    form.report(node.where, "bad-value", f"{key} must be a whole number, 0 or more")
    return 0


def _switch(node: Node | None, key: str, form: Form) -> bool:
    if node is not None and not isinstance(node.value, bool):
        form.report(node.where, "bad-value", f"{key} must be true or false")
    return node is None or node.value is True


def _seconds(node: Node | None, key: str, form: Form) -> float | None:
    if node is None:
        return None
    try:
        value = parse_quantity(str(node.value), "s")
    except UnitError as error:
        form.report(node.where, "bad-value", f"{key}: {error}")
        return None
    if value <= 0:
        form.report(node.where, "bad-value", f"{key} must be above 0 s")
    return value


def _bytes(node: Node | None, key: str, form: Form) -> int | None:
    if node is None:
        return None
    found = _SIZE.fullmatch(str(node.value))
    size = float(found[1]) * BYTES[found[2]] if found else 0.0
    if not 0.0 < size < math.inf:
        form.report(node.where, "bad-value", f"{key} must be a size such as 2 GB", f"units are {', '.join(BYTES)}")
        return None
    return int(size)
