"""`recon doctor`: what a log's own data say of its units, axes, clocks, samples and receiver."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeAlias

import typer

from recon.cli import _console as console
from recon.cli._options import (
    AsJson,
    Blocked,
    FirstPartyOnly,
    Overwrite,
    Settings,
    bad_option,
    overrides_of,
    registry_of,
)

if TYPE_CHECKING:
    from recon.overrides import Override
    from recon.pipeline import Pipeline
    from recon.registry import Registry
    from recon.trial import Trial

_HEADS: Final = {
    "contradicted": "wrong, as the data show",
    "confirmed": "right, as far as the data show",
    "unknown": "not told by this log",
}
_WIDTH: Final = 100
_BOTH: Final = ("as it is", "put right")
_Out: TypeAlias = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Keep the findings there, with a report that shows the evidence.")
]
_Write: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="Write a pipeline that puts right what was found, as far as one can, and try it."
    ),
]


def doctor(
    paths: Annotated[list[Path], typer.Argument(metavar="LOG", help="A log, or several files of one drive.")],
    out: _Out = None,
    write: _Write = None,
    settings: Settings = None,
    overwrite: Overwrite = False,
    blocked: Blocked = None,
    first_party_only: FirstPartyOnly = False,
    as_json: AsJson = False,
) -> None:
    """Find out what is wrong with a log before a result is believed: units, axes, clocks, samples, receiver.

    The exit code is 0 whatever it finds.

    Example: recon doctor drive.txt --write fixed.yaml
    """
    from recon import api
    from recon.findings import STAGE, findings_in
    from recon.pipeline import Pipeline

    _refuse_existing(write, overwrite)
    overrides, registry = overrides_of(settings), registry_of(blocked, first_party_only)
    pipeline = Pipeline.of("doctor", "reader.auto", STAGE)
    exports = ["report"] if out is not None else []
    run = api.execute(pipeline, paths, out, overrides, registry=registry, exports=exports, overwrite=overwrite)
    found = findings_in(run.metrics)
    trials = _written(write, found, paths, overrides, registry) if write is not None else None
    if as_json:
        console.write_json(_as_data(paths, found, trials))
        return
    told = [_as_text(", ".join(map(str, paths)), found, run.warnings)]
    told += [f"report: {out / 'exports' / 'report' / 'report.html'}"] if out is not None else []
    told += [f"pipeline: {write}"] if write is not None else []
    console.write("\n".join([*told, *([_verdict(*trials)] if trials is not None else [])]))


def _refuse_existing(write: Path | None, overwrite: bool) -> None:
    from recon.errors import ConfigError
    from recon.problems import Problem

    if write is not None and write.is_dir():
        raise bad_option(f"--write: {write} is a folder", "name a file")
    if write is not None and write.exists() and not overwrite:
        raise ConfigError([Problem(None, "output-exists", f"{write} is there already", "--overwrite replaces it")])


def _written(
    write: Path,
    found: Sequence[dict[str, Any]],
    paths: Sequence[Path],
    overrides: Sequence[Override],
    registry: Registry,
) -> tuple[Trial, Trial] | None:
    """Write the pipeline that puts right what was found; the drive without and with it, None where nothing changes."""
    from recon.storage import staged_file

    cure = _repaired(found, overrides)
    with staged_file(write) as path:
        path.write_text(cure.to_yaml(), encoding="utf-8", newline="\n")
    return _tried(cure, paths, overrides, registry) if any(one["yaml"] for one in found) else None


def _repaired(found: Iterable[dict[str, Any]], overrides: Iterable[Override]) -> Pipeline:
    """The pipeline that puts right what was found."""
    from recon.doctor import fix_in, merged, repaired

    given: list[Any] = [{one.step: one.params.plain()} for one in overrides if one.step.startswith("reader.")]
    return repaired(merged(fix_in(one["yaml"]) for one in found), merged(given))


def _tried(
    cure: Pipeline, paths: Sequence[Path], overrides: Sequence[Override], registry: Registry
) -> tuple[Trial, Trial]:
    """The drive as it is, and put right."""
    from recon.pipeline import Pipeline
    from recon.trial import try_out

    before = [option for option in overrides if option.step.startswith("reader.")]
    plain = Pipeline.from_file("best_accuracy")
    return try_out(plain, paths, before, registry=registry), try_out(cure, paths, registry=registry)


def _verdict(before: Trial, after: Trial) -> str:
    """Whether the cure helped, in numbers."""
    from recon.trial import SPAN_S

    if before.error and after.error:
        return f"it could not be tried: {after.error}"
    rows = [
        ("tried", *_BOTH),
        ("warnings not to trust it", *(one.error or str(one.doubts) for one in (before, after))),
        (f"turning in {SPAN_S:g} s that nothing explains", *(_amount(one.turning, "deg") for one in (before, after))),
        (f"push in {SPAN_S:g} s that nothing explains", *(_amount(one.pushing, "m/s") for one in (before, after))),
    ]
    if after.better_than(before):
        told = "the drive fits as well or better when it is put right"
    else:
        told = "the drive fits worse when it is put right: do not use that pipeline before you know why"
    return f"{console.table(rows)}\n{told}"


def _amount(value: float | None, unit: str) -> str:
    return "-" if value is None else f"{value:.3g} {unit}"


def _as_data(
    paths: Sequence[Path], found: Sequence[dict[str, Any]], trials: tuple[Trial, Trial] | None
) -> dict[str, Any]:
    """What `--json` prints: findings without the curves of their pictures."""
    shown = [{key: value for key, value in one.items() if key != "evidence"} for one in found]
    tried = {"trial": dict(zip(_BOTH, (one.as_data() for one in trials), strict=True))} if trials else {}
    return {"paths": [str(path) for path in paths], "findings": shown, **tried}


def _as_text(name: str, found: Sequence[dict[str, Any]], warnings: Sequence[str]) -> str:
    counts = {status: sum(one["status"] == status for one in found) for status in _HEADS}
    told = ", ".join(f"{count} {_HEADS[status].partition(',')[0]}" for status, count in counts.items())
    lines = [f"{name}: {told}"]
    for status, head in _HEADS.items():
        some = [one for one in found if one["status"] == status]
        if not some:
            continue
        lines += ["", head]
        if status == "contradicted":
            for one in some:
                lines += _at_length(one)
        else:
            lines += _in_short(some, console.width())
    own = {one["explanation"] for one in found}
    others = [text for text in warnings if text.partition(": ")[2] not in own]
    lines += ["", *(f"note: {text}" for text in others)] if others else []
    return "\n".join(lines)


def _in_short(some: Sequence[dict[str, Any]], width: int | None) -> list[str]:
    """A line for each finding; in a terminal of so many columns it goes on below itself, and the value is left out."""
    import textwrap

    from recon.findings import value_text

    told = [(one["code"], value_text(one) or "-", _first_sentence(one["explanation"])) for one in some]
    if width is None:
        return [console.table(told)]
    edge = 4 + max(len(code) for code, _, _ in told)
    lines = [(f"  {code}".ljust(edge), text) for code, _, text in told]
    return [
        textwrap.fill(text, max(width, 2 * edge), initial_indent=head, subsequent_indent=" " * edge)
        for head, text in lines
    ]


def _at_length(one: dict[str, Any]) -> list[str]:
    """A finding that matters, in full, and what to do."""
    import textwrap

    from recon.findings import value_text

    lines = [f"  {one['code']} = {value_text(one)}   ({100.0 * one['confidence']:.1f} % sure)"]
    lines += textwrap.wrap(one["explanation"], _WIDTH, initial_indent="    ", subsequent_indent="    ")
    if one["yaml"]:
        lines += ["    put right by", *(f"      {line}" for line in one["yaml"].rstrip().split("\n"))]
    return lines


def _first_sentence(text: str) -> str:
    return text.split(". ")[0].rstrip(".") + "."
