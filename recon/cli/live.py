"""`recon live`: a pipeline over a log that is still being written."""

from __future__ import annotations

import json
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from recon.cli import _console as console
from recon.cli._options import AsJson, Blocked, FirstPartyOnly, Settings, overrides_of, registry_of
from recon.cli._signals import EXIT_TERMINATED, Terminated
from recon.errors import EXIT_INTERRUPTED, ConfigError
from recon.problems import Problem, Where

if TYPE_CHECKING:
    import pyarrow as pa

    from recon.live.session import Session
    from recon.live.view import LiveView


def live(
    pipeline: Annotated[str, typer.Argument(metavar="PIPELINE", help="Name of a shipped pipeline, or a YAML file.")],
    source: Annotated[
        str,
        typer.Argument(metavar="SOURCE", help="A text log that grows, - for standard input, or tcp://127.0.0.1:5000."),
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="MCAP file for the result; by default live.mcap.")
    ] = None,
    lag: Annotated[str, typer.Option(metavar="TIME", help="How long a row waits before it is final.")] = "10 s",
    every: Annotated[str, typer.Option(metavar="TIME", help="How often a result is given.")] = "1 s",
    until_end: Annotated[
        bool, typer.Option("--until-end", help="End where the file ends, rather than wait for more.")
    ] = False,
    rerun: Annotated[bool, typer.Option("--view", help="Show it in the Rerun viewer as it goes.")] = False,
    rrd: Annotated[Path | None, typer.Option("--rrd", metavar="FILE", help="Write what the viewer would show.")] = None,
    settings: Settings = None,
    blocked: Blocked = None,
    first_party_only: FirstPartyOnly = False,
    as_json: AsJson = False,
) -> None:
    """Follow a drive while it is logged: where it is now, and a trajectory that is final some seconds later.

    Example: recon live best_accuracy drive.txt --out drive.mcap
    """
    from recon.live.session import Session, following
    from recon.pipeline import Pipeline

    registry = registry_of(blocked, first_party_only)
    steps = following(Pipeline.from_file(pipeline), registry, overrides_of(settings))
    waits, pause = _seconds("--lag", lag), _seconds("--every", every)
    shown = _viewer(rerun, rrd)
    session = Session(steps, source, out or Path("live.mcap"), waits, registry)
    if session.resumed and not as_json:
        console.write(f"going on with {session.result.path}")
    if steps.left_out:
        console.write_error(f"left to 'recon run {pipeline}' afterwards: {', '.join(steps.left_out)}")
    stopped: KeyboardInterrupt | None = None
    try:
        _follow(session, pause, until_end, shown, as_json)
    except KeyboardInterrupt as error:
        stopped = error
    finally:
        session.close()
        if shown is not None:
            shown.close()
    found = f"result in {session.result.path}" if session.result.begun else "nothing came"
    console.write_error(f"{'stopped, ' if stopped else ''}{found}")
    if stopped:
        raise typer.Exit(EXIT_TERMINATED if isinstance(stopped, Terminated) else EXIT_INTERRUPTED)


def _follow(session: Session, pause: float, until_end: bool, shown: LiveView | None, as_json: bool) -> None:
    """Give a result every `pause` s until there is no more to come."""
    ended = False
    while not ended:
        begun = time.monotonic()
        told = session.step()
        ended = session.ended or (until_end and not session.waiting)
        if ended:
            told = {**told, **session.step(last=True)}
        if "latest" in told:
            facts = _facts(told["latest"])
            console.write(json.dumps(facts) if as_json else _line(facts))
        if shown is not None:
            shown.show(told)
        if not ended:
            time.sleep(max(0.0, pause - (time.monotonic() - begun)))


def _facts(row: pa.Table) -> dict[str, Any]:
    """What is known of now, numbers that are not known as null."""
    from recon.numerics.rotation import heading_from_yaw, to_euler
    from recon.tables import matrix, vector

    def known(value: float) -> float | None:
        return value if math.isfinite(value) else None

    sigma = matrix(row, "pos_std", gaps=True)[0]
    return {
        "time": row["time"][0].as_py().isoformat(),
        "lat": known(float(vector(row, "lat", gaps=True)[0])),
        "lon": known(float(vector(row, "lon", gaps=True)[0])),
        "height_m": known(float(vector(row, "height", gaps=True)[0])),
        "speed_m_s": math.hypot(*matrix(row, "vel")[0]),
        "heading_deg": math.degrees(heading_from_yaw(to_euler(matrix(row, "q")[0])[0])),
        "position_sigma_m": known(math.hypot(sigma[0], sigma[1])),
    }


def _line(facts: dict[str, Any]) -> str:
    place = "" if facts["lat"] is None else f"  {facts['lat']:.7f} {facts['lon']:.7f}"
    return (
        f"{facts['time'][:23]}{place}  {3.6 * facts['speed_m_s']:6.1f} km/h  heading {facts['heading_deg']:5.1f} deg"
        f"  ± {facts['position_sigma_m']:.1f} m"
    )


def _seconds(option: str, text: str) -> float:
    from recon.units import UnitError, parse_quantity

    try:
        value = parse_quantity(text, "s")
    except UnitError as error:
        raise ConfigError([Problem(Where(option), "bad-option", str(error), "write for example '10 s'")]) from error
    if value < 0.0:
        raise ConfigError([Problem(Where(option), "bad-option", f"{text} is negative", "write for example '10 s'")])
    return value


def _viewer(wanted: bool, file: Path | None) -> LiveView | None:
    if not wanted and file is None:
        return None
    from recon.live.view import LiveView

    return LiveView(file)
