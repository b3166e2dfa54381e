"""`recon batch`: a pipeline over all drives of a fleet."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from recon.cli import _console as console
from recon.cli._batch_progress import progress
from recon.cli._options import AsJson
from recon.errors import StorageError

if TYPE_CHECKING:
    from recon.fleet.driver import Fleet, Report

EXIT_SOME_FAILED: Final = 6
MOST_LISTED: Final = 20
_GOES_ON: Final = "what is done is kept; the same command goes on from there"


def batch(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Batch file.")],
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check all and say what would be done.")] = False,
    only: Annotated[str, typer.Option(metavar="VEHICLE", help="The drives of one vehicle.")] = "",
    executor: Annotated[
        str, typer.Option(metavar="NAME", help="Executor in place of the file's: local, serial, dask, ...")
    ] = "",
    verify: Annotated[
        bool, typer.Option("--verify", help="Hold what is done already to the hashes of its files too.")
    ] = False,
    log_json: Annotated[bool, typer.Option("--log-json", help="Progress as a line of JSON for each drive.")] = False,
    as_json: AsJson = False,
) -> None:
    """Run a pipeline over a fleet; what is done already is not done again.

    Example: recon batch pipelines/fleet.yaml --dry-run
    """
    from recon.fleet import driver
    from recon.registry import Registry

    fleet = driver.load(file, Registry.installed(), executor)
    _warn(fleet)
    if dry_run:
        planned = _planned(fleet, only, verify=verify)
        console.write_json(planned) if as_json else console.write(_planned_text(planned))
        return
    try:
        with progress(as_json=log_json) as told:
            report = driver.run(fleet, told, only=only, verify=verify)
    except KeyboardInterrupt as interruption:
        interruption.args = (_GOES_ON,)
        raise
    except StorageError as error:
        raise _going_on(error) from error
    facts = _facts(fleet, report)
    console.write_json(facts) if as_json else console.write(_text(facts))
    if report.unwritten is not None:
        raise _going_on(report.unwritten)
    if report.failures:
        raise typer.Exit(EXIT_SOME_FAILED)


def _going_on(error: StorageError) -> StorageError:
    return StorageError(error.message, "\n".join(filter(None, (error.hint, _GOES_ON))))


def _warn(fleet: Fleet) -> None:
    foreign = sorted(set(fleet.batch.vehicles) - set(fleet.drives.vehicles))
    for name in foreign[:MOST_LISTED]:
        where = fleet.batch.root.at(["vehicles", name]).where
        console.write_error(f"{where}: warning: no input is of the vehicle '{name}'")
    if not fleet.executor.isolates and (fleet.batch.timeout is not None or fleet.batch.memory is not None):
        console.write_error(f"warning: {fleet.executor.key} keeps neither the timeout nor the memory limit")


def _planned(fleet: Fleet, only: str, *, verify: bool) -> dict[str, Any]:
    from recon.fleet import driver
    from recon.fleet.compacted import read_index

    drives = driver.chosen(fleet, only)
    todo = driver.remaining(fleet, drives, read_index(fleet.root), verify=verify)
    return {
        "batch": fleet.batch.name,
        "pipeline": fleet.pipeline.name,
        "executor": fleet.executor.key,
        "output": str(fleet.root.place),
        "vehicles": len(drives.vehicles),
        "done_before": len(drives) - len(todo),
        "to_do": [{"job": drive.key, "input": str(drive.place)} for drive in todo],
    }


def _planned_text(planned: dict[str, Any]) -> str:
    todo = planned["to_do"]
    rows = [(key.replace("_", " "), str(value)) for key, value in planned.items() if key != "to_do"]
    lines = [console.table([*rows, ("to do", str(len(todo)))])]
    lines += ["{job}  {input}".format(**drive).replace("\n", r"\n") for drive in todo[:MOST_LISTED]]
    more = len(todo) - MOST_LISTED
    return "\n".join([*lines, f"... and {more} more, see --json"] if more > 0 else lines)


def _facts(fleet: Fleet, report: Report) -> dict[str, Any]:
    return {
        "batch": fleet.batch.name,
        "output": str(fleet.root.place),
        "done": report.done,
        "done_before": report.kept,
        "failed": len(report.failures),
        "superseded": report.superseded,
        "stopped": report.stopped,
        "recorded": report.unwritten is None,
        "failures": [
            {"job": one.drive.key, "input": str(one.drive.place), "code": one.outcome.code, "reason": one.outcome.text}
            for one in report.failures
        ],
    }


def _text(facts: dict[str, Any]) -> str:
    from recon.fleet.driver import AGAIN
    from recon.fleet.root import SUPERSEDED

    rows = [(key.replace("_", " "), str(facts[key])) for key in ("done", "done_before", "failed", "output")]
    lines = [console.table(rows)]
    counts = Counter(failure["code"] for failure in facts["failures"])
    lines += [f"failed: {count} {code}" for code, count in counts.most_common()]
    if again := sum(counts[code] for code in AGAIN):
        lines.append(f"{again} of them may go well another time: the same command does them again")
    if facts["superseded"]:
        lines.append(f"{facts['superseded']} older results of failed drives were moved to {SUPERSEDED} in the output")
    if facts["stopped"] and facts["recorded"]:
        lines.append("stopped at the first failure (on_error: stop)")
    return "\n".join(lines)
