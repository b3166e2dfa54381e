"""Finished runs side by side: what made them, what they found, and how far their trajectories are apart.

found = compare([recon.open("a"), recon.open("b")])
found.settings, found.results, found.distances[0].found.position["horizontal"].rmse
found.errors[1].found.position["horizontal"].rmse

Settings and results are rows with a value for each run; a row of which all values are the same is left out of
`settings`, as are parameters of steps that not all runs have. Metrics count by step and name, the second of a name with
its number. Trajectories are held against that of the first run, by the figures of `recon.evaluation`, and against a
reference, where one is given or a run holds one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

from recon.errors import DataError
from recon.evaluation import Evaluation, evaluate
from recon.recording import Recording
from recon.rows import WARNING
from recon.tables import with_meta

if TYPE_CHECKING:
    import pyarrow as pa

    from recon.api import Run

_MEASURED: Final = ("gnss", "reference", "wheel")
"""Streams of the first run that are drawn beside the trajectories."""
_UNITS: Final = {
    "distance": "m", "distance_sigma": "m", "duration": "s", "top_speed": "m/s", "top_speed_sigma": "m/s",
}  # fmt: skip


@dataclass(frozen=True)
class Row:
    """One thing in all runs: its name, its unit, and a value for each run, None where a run does not know it."""

    name: str
    unit: str
    values: tuple[Any, ...]

    @property
    def differs(self) -> bool:
        """Is one value unlike the others?"""
        return any(value != self.values[0] for value in self.values[1:])

    @property
    def everywhere(self) -> bool:
        """Does every run know it?"""
        return all(value is not None for value in self.values)


@dataclass(frozen=True)
class Distance:
    """How far the trajectory of `run` is from that of the first run, or from the reference: figures, or why not."""

    run: str
    found: Evaluation | None
    reason: str = ""


@dataclass(frozen=True)
class Comparison:
    """Runs side by side.

    runs : their names; settings : what differs in how they were made; results : what they found, differing or not
    distances : of the trajectories of all runs but the first
    errors : of the trajectories of all runs, against one reference; empty where there is none
    """

    runs: tuple[str, ...]
    settings: tuple[Row, ...]
    results: tuple[Row, ...]
    distances: tuple[Distance, ...]
    errors: tuple[Distance, ...]

    def as_data(self) -> dict[str, Any]:
        """As JSON holds it."""
        return asdict(self)


def compare(runs: Sequence[Run], reference: pa.Table | None = None) -> Comparison:
    """Two or more runs side by side. Raises DataError for fewer.

    reference : what the trajectories err against; by default the stream `reference` of the first run that holds one
    """
    if len(runs) < 2:
        raise DataError("a comparison needs two runs", "name another one")
    common = set.intersection(*({step["id"] for step in run.manifest["plan"]} for run in runs))
    held = (run.recording["reference"] for run in runs if "reference" in run.recording)
    truth = next(held, None) if reference is None else reference
    settings = [dict(_settings(run.manifest, common)) for run in runs]
    results = [dict(_results(run)) for run in runs]
    return Comparison(
        names_of(runs),
        tuple(row for row in _rows(settings) if row.differs),
        tuple(_rows(results)),
        tuple(_distances(runs[1:], names_of(runs)[1:], runs[0].recording.get("trajectory"))),
        tuple(_distances(runs, names_of(runs), truth)) if truth is not None else (),
    )


def names_of(runs: Sequence[Run]) -> tuple[str, ...]:
    """A name for each run: of its folder, with as much of the path as tells them apart."""
    folders = [run.folder.resolve() if run.folder else None for run in runs]
    depth = 1
    while depth < 8:
        names = [
            "/".join(folder.parts[-depth:]) if folder else f"run {number}" for number, folder in enumerate(folders, 1)
        ]
        if len(set(names)) == len(names):
            return tuple(names)
        depth += 1
    return tuple(f"run {number}" for number in range(1, len(runs) + 1))


def overlay(runs: Sequence[Run]) -> Recording:
    """All trajectories as one recording, for exporters: trajectory, trajectory_2, ..., each with its fact `run`.

    What was measured is that of the first run. Raises DataError where no run has a trajectory.
    """
    tables: dict[str, pa.Table] = {}
    for name, run in zip(names_of(runs), runs, strict=True):
        if "trajectory" in run.recording:
            stream = f"trajectory_{len(tables) + 1}" if tables else "trajectory"
            tables[stream] = with_meta(run.recording["trajectory"], run=name)
    if not tables:
        raise DataError("none of the runs has a trajectory: there is nothing to lay over each other")
    first = runs[0].recording
    return Recording({**tables, **{name: first[name] for name in _MEASURED if name in first}})


def _settings(manifest: Mapping[str, Any], common: set[str]) -> Iterator[tuple[str, tuple[str, Any]]]:
    """What made a run, by name: (unit, value); parameters of the steps in `common`, in SI."""
    yield "recon", ("", manifest["recon"])
    yield "pipeline", ("", manifest["pipeline"]["name"])
    yield "inputs", ("", ", ".join(f"{part.get('name')} {digest[:12]}" for part, digest in _digests(manifest)))
    yield "steps", ("", ", ".join(step["id"] for step in manifest["plan"]))
    for step in (step for step in manifest["plan"] if step["id"] in common):
        yield f"{step['id']} version", ("", step["stage_version"])
        for name, value in step["params"].items():
            yield f"{step['id']}.{name}", ("", value)


def _digests(manifest: Mapping[str, Any]) -> Iterator[tuple[Mapping[str, Any], str]]:
    for entry in manifest["inputs"]:
        for part in entry.get("files", [entry]):
            yield part, str(part.get("sha256", ""))


def _results(run: Run) -> Iterator[tuple[str, tuple[str, Any]]]:
    """What a run found, by name: (unit, value)."""
    for name, value in run.summary().items():
        yield name, (_UNITS.get(name, ""), value)
    seen: dict[str, int] = {}
    for row in run.metrics.to_pylist() if run.metrics is not None else ():
        name = f"{row.get('step') or ''}.{row['name']}"
        if row["value"] is None or row["name"] == WARNING:
            continue
        seen[name] = seen.get(name, 0) + 1
        yield name if seen[name] == 1 else f"{name} {seen[name]}", (row["unit"] or "", row["value"])


def _rows(found: Sequence[Mapping[str, tuple[str, Any]]]) -> Iterator[Row]:
    """A row for each name in any of them, in the order of the first that has it."""
    for name in dict.fromkeys(name for one in found for name in one):
        units = [one[name][0] for one in found if name in one]
        yield Row(name, units[0], tuple(one[name][1] if name in one else None for one in found))


def _distances(runs: Sequence[Run], names: Sequence[str], reference: pa.Table | None) -> Iterable[Distance]:
    for name, run in zip(names, runs, strict=True):
        table = run.recording.get("trajectory")
        if reference is None or table is None:
            yield Distance(name, None, "no trajectory")
            continue
        try:
            yield Distance(name, evaluate(table, reference))
        except DataError as error:
            yield Distance(name, None, error.message)
