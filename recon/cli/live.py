"""`recon live`: a pipeline over a log that is still being written."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from recon.cli import _console as console
from recon.cli._options import AsJson, Blocked, FirstPartyOnly, Settings, bad_option, overrides_of, registry_of
from recon.cli._signals import Terminated
from recon.errors import EXIT_INTERRUPTED, StorageError

if TYPE_CHECKING:
    import pyarrow as pa

    from recon.live.session import Session
    from recon.live.view import LiveView
    from recon.tables import Streams


_LEAST_PAUSE_S: Final = 0.01
"""s between two looks for more: without a pause it would do nothing but look."""
_REASON_S: Final = 3.0
"""s between two words on what it is waiting for."""


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
    waits, pause = _seconds("--lag", lag, 0.0), _seconds("--every", every, _LEAST_PAUSE_S)
    with _viewer(rerun, rrd) as shown:
        session = Session(steps, source, out or Path("live.mcap"), waits, registry)
        _tell_begin(session, pipeline, as_json)
        with _going_on(session):
            stopped = _follow_until_stopped(session, _Teller(pause, as_json, shown), pause, until_end)
    _tell_end(session, stopped=stopped is not None)
    if stopped:
        raise typer.Exit(stopped.exit_code if isinstance(stopped, Terminated) else EXIT_INTERRUPTED)


@contextmanager
def _going_on(session: Session) -> Iterator[None]:
    """Where more of a result cannot be written, it is told what becomes of it."""
    try:
        yield
    except StorageError as error:
        kept = "what was written is kept; the same command goes on with it" if session.result.begun else ""
        error.hint = "\n".join(filter(None, (error.hint, kept)))
        raise


def _follow_until_stopped(session: Session, teller: _Teller, pause: float, until_end: bool) -> KeyboardInterrupt | None:
    """As `_follow`, and how the user stopped it; the result is made whole however it ends."""
    try:
        _follow(session, teller, pause, until_end)
    except KeyboardInterrupt as error:
        return error
    finally:
        session.close()
    return None


def _tell_begin(session: Session, pipeline: str, as_json: bool) -> None:
    """What the user should know of a session that begins."""
    if session.goes_on and not as_json:
        console.write(f"going on with {session.result.path}")
    if left := session.steps.left_out:
        console.write_error(f"left to 'recon run {pipeline}' afterwards: {', '.join(left)}")


def _tell_end(session: Session, *, stopped: bool) -> None:
    """What the user should know of a session that is over."""
    for note in session.warnings:
        console.write_error(f"warning: {note}")
    if session.awaits and not session.resumed:
        console.write_error(f"no trajectory: it was waiting for {session.awaits}")
    found = f"result in {session.result.path}" if session.result.begun else "nothing came"
    console.write_error(f"{'stopped, ' if stopped else ''}{found}")


def _follow(session: Session, teller: _Teller, pause: float, until_end: bool) -> None:
    """Look for more every `pause` s until there is no more to come."""
    ended = False
    while not ended:
        begun, came = time.monotonic(), False
        for told in session.new():
            came = True
            teller.take(told)
        ended = session.ended or (until_end and not came)
        for told in session.new(last=True) if ended else ():
            teller.take(told)
        teller.rest(session)
        if not ended:
            time.sleep(max(0.0, pause - (time.monotonic() - begun)))


class _Teller:
    """Tells a user what comes, a result every `pause` s, however much comes at once."""

    def __init__(self, pause: float, as_json: bool, shown: LiveView | None) -> None:
        self.pause, self.as_json, self.shown = pause, as_json, shown
        self._latest: pa.Table | None = None
        self._told_at = self._reason_at = -math.inf
        self._bad = self._wrong = self._unused = self._doubts = 0

    def take(self, told: Streams) -> None:
        """What a step of a session told."""
        if self.shown is not None:
            self.shown.show(told)
        self._latest = told.get("latest", self._latest)
        if time.monotonic() - self._told_at >= self.pause:
            self._tell()

    def rest(self, session: Session) -> None:
        """Nothing more has come for now: the newest result, or what is missing; and the lines that were left out."""
        self._tell()
        if session.awaits and time.monotonic() - self._reason_at >= _REASON_S:
            self._reason_at = time.monotonic()
            if session.heard is None:
                console.write_error(f"waiting for {session.awaits}")
            else:
                self._write({**_gnss_facts(session.heard), "waiting_for": session.awaits})
        if unused := session.live.unused[self._unused :]:
            console.write_error(f"left to 'recon run {session.steps.pipeline}' afterwards: {', '.join(unused)}")
            self._unused = len(session.live.unused)
        for line in session.bad[self._bad :][:1]:
            console.write_error(f"{line}: left out")
        for note in session.clock.wrong[self._wrong :][:1]:
            console.write_error(note)
        for doubt in session.units.doubts[self._doubts :]:
            console.write_error(f"warning: {doubt}")
        self._bad, self._wrong, self._doubts = len(session.bad), len(session.clock.wrong), len(session.units.doubts)

    def _tell(self) -> None:
        if self._latest is not None:
            self._write(_facts(self._latest))
            self._told_at, self._latest = time.monotonic(), None

    def _write(self, facts: dict[str, Any]) -> None:
        console.write(json.dumps(facts) if self.as_json else _line(facts))


def _gnss_facts(row: pa.Table) -> dict[str, Any]:
    """As `_facts`, of a row of gnss: the heading is not known."""
    from recon.tables import vector

    def known(name: str) -> float | None:
        value = float(vector(row, name, gaps=True)[0]) if name in row.column_names else math.nan
        return value if math.isfinite(value) else None

    east, north = known("pos_std_e"), known("pos_std_n")
    return {
        "time": row["time"][0].as_py().isoformat(timespec="milliseconds"),
        "lat": known("lat"),
        "lon": known("lon"),
        "height_m": known("height"),
        "speed_m_s": known("speed"),
        "heading_deg": None,
        "position_sigma_m": None if east is None or north is None else math.hypot(east, north),
    }


def _facts(row: pa.Table) -> dict[str, Any]:
    """What is known of now, numbers that are not known as null."""
    from recon.numerics.rotation import heading_from_yaw, to_euler
    from recon.tables import matrix, vector

    def known(value: float) -> float | None:
        return value if math.isfinite(value) else None

    sigma = matrix(row, "pos_std", gaps=True)[0]
    return {
        "time": row["time"][0].as_py().isoformat(timespec="milliseconds"),
        "lat": known(float(vector(row, "lat", gaps=True)[0])),
        "lon": known(float(vector(row, "lon", gaps=True)[0])),
        "height_m": known(float(vector(row, "height", gaps=True)[0])),
        "speed_m_s": math.hypot(*matrix(row, "vel")[0]),
        "heading_deg": math.degrees(heading_from_yaw(to_euler(matrix(row, "q")[0])[0])),
        "position_sigma_m": known(math.hypot(sigma[0], sigma[1])),
        "waiting_for": "",
    }


def _line(facts: dict[str, Any]) -> str:
    parts = [facts["time"].partition("+")[0]]
    if facts["lat"] is not None and facts["lon"] is not None:
        parts.append(f"{facts['lat']:.7f} {facts['lon']:.7f}")
    if facts["speed_m_s"] is not None:
        parts.append(f"{3.6 * facts['speed_m_s']:6.1f} km/h")
    heading, sigma = facts["heading_deg"], facts["position_sigma_m"]
    parts.append("heading unknown" if heading is None else f"heading {heading:5.1f} deg")
    if sigma is not None:
        parts.append(f"± {sigma:.1f} m")
    if facts["waiting_for"]:
        parts.append(f"(GNSS alone; waiting for {facts['waiting_for']})")
    return "  ".join(parts)


def _seconds(option: str, text: str, least: float) -> float:
    from recon.units import UnitError, parse_quantity

    try:
        value = parse_quantity(text, "s")
    except UnitError as error:
        raise bad_option(str(error), "write for example '10 s'", option) from error
    if value < least:
        wrong = f"{text} is negative" if value < 0.0 else f"{text} is less than {least:g} s"
        raise bad_option(wrong, "write for example '10 s'", option)
    return value


@contextmanager
def _viewer(wanted: bool, file: Path | None) -> Iterator[LiveView | None]:
    """The view that is asked for, closed however the run ends."""
    if not wanted and file is None:
        yield None
        return
    from recon.live.view import LiveView

    shown = LiveView(file)
    try:
        yield shown
    finally:
        shown.close()
