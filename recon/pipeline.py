"""Pipelines: a YAML list of steps, read from top to bottom.

    recon: 1
    name: thesis
    about: One sentence.
    store: parquet
    steps:
      - use: filter.gyro_offset
        id: offset
        params: {between: linear}
        in: {imu: imu_2}        # port: stream
        out: {imu: imu_2}

There are no expressions, loops, includes or interpolation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from recon.errors import ConfigError
from recon.form import Form, is_batch
from recon.problems import Problem, Where, did_you_mean
from recon.registry import GROUP, PIPELINE
from recon.storage import STORES
from recon.yaml_nodes import Node, load, load_file

FORMAT: Final = 1

_ENDINGS: Final = (".yaml", ".yml")
_PIPELINE_KEYS: Final = ("recon", "name", "about", "store", "steps")
_STEP_KEYS: Final = ("use", "id", "params", "in", "out")


@dataclass(frozen=True)
class Step:
    """One line of work: which stage, under which id, with which parameters; ports renamed to streams."""

    use: str
    id: str
    params: Node
    where: Where
    inputs: Mapping[str, str] = field(default_factory=dict)
    outputs: Mapping[str, str] = field(default_factory=dict)
    node: Node | None = None

    def with_params(self, params: Node) -> Step:
        """The step with parameters laid over its own; mappings are merged."""
        return replace(self, params=_merged(self.params, params))

    def to_plain(self) -> dict[str, Any]:
        """The step as YAML would hold it, without what is left at its default."""
        plain: dict[str, Any] = {"use": self.use}
        if self.id != self.use:
            plain["id"] = self.id
        parts = {"params": self.params.plain(), "in": dict(self.inputs), "out": dict(self.outputs)}
        return plain | {key: value for key, value in parts.items() if value}


@dataclass(frozen=True)
class Pipeline:
    """A named list of steps. `file` is what it was read from, for messages."""

    name: str
    steps: tuple[Step, ...]
    about: str = ""
    store: str = "parquet"
    file: str = "<pipeline>"

    @classmethod
    def from_file(cls, source: str | Path) -> Pipeline:
        """Read a YAML file, or a shipped pipeline by its name. Raises ConfigError with every problem of its form."""
        pipeline, problems = parse(_loaded(find(source)))
        if problems:
            raise ConfigError(problems)
        return pipeline

    @classmethod
    def from_text(cls, text: str, file: str = "<text>") -> Pipeline:
        """Read YAML from a string. Raises ConfigError."""
        pipeline, problems = parse(load(text, file))
        if problems:
            raise ConfigError(problems)
        return pipeline

    @classmethod
    def of(cls, name: str, *uses: str) -> Pipeline:
        """A pipeline of stages with their default parameters."""
        where = Where(f"<{name}>")
        return cls(name, tuple(Step(use, use, Node.of({}, where), where) for use in uses), file=where.file)

    def to_yaml(self) -> str:
        """The pipeline as text that reads back to the same pipeline."""
        import yaml

        plain: dict[str, Any] = {"recon": FORMAT, "name": self.name}
        if self.about:
            plain["about"] = self.about
        if self.store != "parquet":
            plain["store"] = self.store
        plain["steps"] = [step.to_plain() for step in self.steps]
        return yaml.dump(plain, Dumper=_dumper(), sort_keys=False, allow_unicode=True, width=110)


def _dumper() -> type[Any]:
    """A dumper that quotes what YAML 1.2 would not read back as text, and escapes line ends that it does not know."""
    import yaml

    from recon.yaml_scalars import reads_as_text

    class Dumper(yaml.SafeDumper):
        pass

    def text(dumper: yaml.SafeDumper, value: str) -> yaml.Node:
        style = '"' if set(value) & set("\x85\u2028\u2029") else None if reads_as_text(value) else "'"
        return dumper.represent_scalar("tag:yaml.org,2002:str", value, style=style)

    Dumper.add_representer(str, text)
    return Dumper


def shipped() -> dict[str, Path]:
    """Pipelines that come with recon, and those of other distributions (entry points `pipeline.<name>`), by name."""
    found = own()
    for point in entry_points(group=GROUP):
        if point.name.startswith(PIPELINE):
            found.setdefault(point.name.removeprefix(PIPELINE), _packaged(point.value))
    return found


def own() -> dict[str, Path]:
    """Pipelines that come with recon, by name."""
    files = (path for folder in _shipped_folders() for path in sorted(folder.glob("*.yaml")))
    return {path.stem: path for path in files if not _is_batch(path)}


def _is_batch(path: Path) -> bool:
    """Does the file say how a pipeline runs over many drives, rather than being one?"""
    return any(line.startswith("batch:") for line in path.read_text(encoding="utf-8").splitlines())


def _packaged(place: str) -> Path:
    """The file that "package:path" names, found without an import of the package."""
    package, _, resource = place.partition(":")
    spec = find_spec(package.partition(".")[0])
    folders = (spec.submodule_search_locations if spec else None) or [""]
    return Path(folders[0], *package.split(".")[1:], *resource.split("/"))


def _shipped_folders() -> list[Path]:
    here = Path(__file__).parent
    installed, checkout = here / "pipelines", here.parent / "pipelines"
    return [installed] if installed.is_dir() else [checkout] if checkout.is_dir() else []


def find(source: str | Path) -> Path:
    """The file of a pipeline that is given by its path or by the name of a shipped one. Raises ConfigError."""
    path = Path(source)
    if path.suffix in _ENDINGS or len(path.parts) > 1 or path.is_file():
        return path
    mine = own()
    known = mine if path.name in mine else shipped()  # the names of other distributions are slow to find
    if path.name in known:
        return known[path.name]
    hint = did_you_mean(path.name, known) or f"shipped: {', '.join(sorted(known))}; a file ends in .yaml"
    raise ConfigError([Problem(None, "unknown-pipeline", f"there is no pipeline '{source}'", hint)])


def _loaded(path: Path) -> Node:
    """What the file of a pipeline holds. Raises ConfigError, which knows a log and a batch file from a pipeline."""
    may_be_log = path.suffix not in _ENDINGS and path.exists()
    try:
        root = load_file(path)
    except ConfigError:
        if not may_be_log:
            raise
        raise _no_pipeline(path) from None
    if may_be_log and not isinstance(root.value, Mapping):
        raise _no_pipeline(path)
    if is_batch(root):
        text = "this is a batch file, not a pipeline"
        raise ConfigError([Problem(root.where, "bad-value", text, "run it with recon batch")])
    return root


def _no_pipeline(path: Path) -> ConfigError:
    hint = "name the pipeline before the log, as in 'recon run best_accuracy LOG'"
    return ConfigError([Problem(None, "unknown-pipeline", f"{path} is no pipeline", hint)])


def parse(root: Node) -> tuple[Pipeline, list[Problem]]:
    """The pipeline that a YAML node holds, as far as it can be understood, and what is wrong with its form."""
    form = Form()
    top = form.mapping(root, "a pipeline", _PIPELINE_KEYS, needs=("steps",))
    form.number_of_format(top.get("recon"), FORMAT)
    store = form.choice(top.get("store"), "store", STORES)
    steps = _steps(top.get("steps"), form)
    name = form.name(top.get("name"), "name") or Path(root.where.file).stem
    return Pipeline(name, steps, form.text(top.get("about"), "about"), store, root.where.file), form.problems


def _steps(node: Node | None, form: Form) -> tuple[Step, ...]:
    if node is None:
        return ()
    if not isinstance(node.value, tuple) or not node.value:
        text = "steps must be a list with at least one step"
        form.report(node.where, "bad-value", text, "write '- use: reader.auto'")
        return ()
    steps = [step for item in node.value if (step := _step(item, form)) is not None]
    first: dict[str, Step] = {}
    for step in steps:
        if first.setdefault(step.id, step) is not step:
            notes = ((first[step.id].where, "the first is here"),)
            text = f"two steps are called '{step.id}'"
            form.problems.append(Problem(step.where, "duplicate-id", text, "give one of them an id of its own", notes))
    return tuple(steps)


def _step(item: Node, form: Form) -> Step | None:
    if isinstance(item.value, str):
        form.report(item.where, "bad-value", "a step must be a mapping", f"write '- use: {item.value}'")
        return None
    entries = form.mapping(item, "a step", _STEP_KEYS, needs=("use",))
    if "use" not in entries:
        return None
    use = form.text(entries["use"], "use")
    if not use:
        if entries["use"].value in ("", None):
            form.report(entries["use"].where, "bad-value", "use names no stage", "write '- use: reader.auto'")
        return None
    params = entries.get("params", Node.of({}, item.where))
    if not isinstance(params.value, Mapping):
        form.entries(params, "params must be a mapping", "write 'name: value' lines below it")
        params = Node.of({}, params.where)
    return Step(
        use=use,
        id=form.name(entries.get("id"), "id") or use,
        params=params,
        where=entries["use"].where,
        inputs=_renames(entries.get("in"), "in", form),
        outputs=_renames(entries.get("out"), "out", form),
        node=item,
    )


def _renames(node: Node | None, key: str, form: Form) -> dict[str, str]:
    ports = form.entries(node, f"{key} must be a mapping of ports to streams", "write {imu: imu_2}")
    named = {port: form.text(stream, f"{key}.{port}") for port, stream in ports.items()}
    return {port: stream for port, stream in named.items() if stream}


def _merged(old: Node, new: Node) -> Node:
    """`new` laid over `old`: mappings are merged key by key, anything else is replaced."""
    if not (isinstance(old.value, Mapping) and isinstance(new.value, Mapping)):
        return new
    entries = dict(old.value)
    for key, value in new.value.items():
        entries[key] = _merged(entries[key], value) if key in entries else value
    return Node(entries, old.where, {**old.keys, **new.keys})
