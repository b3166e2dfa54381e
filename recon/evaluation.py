"""How good a trajectory is: its errors against a reference, and whether its sigmas are honest.

found = evaluate(run["trajectory"], run["reference"], run.get("events"))
found.position["horizontal"].rmse, found.relative[0].percent, found.consistency["position"].nees

The figures are defined in `recon.numerics.evaluation` and `recon.numerics.consistency`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
import pyarrow as pa

from recon.errors import DataError
from recon.mounting import Mounting
from recon.numerics.consistency import Consistency, consistency
from recon.numerics.evaluation import (
    Alignment,
    Errors,
    Motion,
    Statistics,
    aligned,
    associate,
    errors,
    path,
    relative_errors,
    segments,
    statistics,
    turn_between,
)
from recon.numerics.geodesy import Anchor, enu_to_geodetic, geodetic_to_enu
from recon.numerics.rotation import Floats, multiply, rotate
from recon.placing import EARTHS, anchor_of
from recon.rows import spans
from recon.tables import matrix_or_nan, meta, time_ns

SEGMENTS: Final = ((1.0, "s"), (10.0, "s"), (100.0, "m"))
"""Lengths over which relative errors are taken."""
_SAME_FACTS: Final = ("height_datum", "time_scale")
"""Facts of a stream that must agree for the figures to mean anything."""
_GROUPS: Final = {"position": ("pos_n", "pos_std"), "velocity": ("vel_n", "vel_std"), "attitude": ("att", "att_std")}
"""Errors and their sigmas by attribute."""


@dataclass(frozen=True)
class Matched:
    """A trajectory and a reference at common times, in one local frame.

    run, reference : of the same rows; compared : the rows that could have been, those of the stream `clock`, which is
        "trajectory" or "reference", whichever has its rows further apart
    span_s : from the first to the last common row; of_s : the same of the trajectory alone
    same_body : are the attitudes those of the same body? That of a reference may be a camera's
    notes : what one should know before he believes the figures
    """

    run: Motion
    reference: Motion
    compared: int
    clock: str
    span_s: float
    of_s: float
    same_body: bool
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Relative:
    """Errors over all segments of one length: translation m, rotation deg; percent of the way driven in them."""

    length: float
    unit: str
    translation: Statistics
    rotation: Statistics
    percent: float | None


@dataclass(frozen=True)
class Outage:
    """Errors inside one event of the kind outage, None where the reference says nothing there.

    start_ns, end_ns : ns since 1970; horizontal m, velocity m/s, heading deg
    """

    start_ns: int
    end_ns: int
    horizontal: Statistics | None
    velocity: Statistics | None
    heading: Statistics | None


@dataclass(frozen=True)
class Evaluation:
    """Errors of a trajectory against a reference; None where one of the two says nothing.

    align : how the trajectory was aligned before
    rows : matched ones, of the `compared` ones of the stream `clock`; span_s, of_s, notes : see Matched
    position : horizontal, vertical, total in m; velocity : the same in m/s; attitude : roll, pitch, heading, and total,
        the angle of the whole rotation, in deg
    mounting : the constant part of the differences of attitude, which `attitude` holds as well
    consistency : position, velocity, attitude; None too where the trajectory was aligned, which its sigmas do not know
    """

    align: Alignment
    rows: int
    compared: int
    clock: str
    span_s: float
    of_s: float
    notes: tuple[str, ...]
    position: Mapping[str, Statistics | None]
    velocity: Mapping[str, Statistics | None]
    attitude: Mapping[str, Statistics | None]
    mounting: Mounting | None
    relative: tuple[Relative, ...]
    outages: tuple[Outage, ...]
    consistency: Mapping[str, Consistency | None]

    def as_data(self) -> dict[str, Any]:
        """As JSON holds it."""
        return asdict(self)


def evaluate(
    trajectory: pa.Table, reference: pa.Table, events: pa.Table | None = None, *, align: Alignment = "none"
) -> Evaluation:
    """All figures of a trajectory against a reference.

    events : those of the kind outage are looked at one by one
    align : see `recon.numerics.evaluation.aligned`

    Raises DataError where the two have no time in common, or do not say how to align them.
    """
    found = match(trajectory, reference)
    try:
        run = aligned(found.run, found.reference, align)
    except ValueError as error:
        raise DataError(f"the trajectory cannot be aligned by '{align}': {error}") from error
    wrong = errors(run, found.reference)
    mounting = Mounting.between(run, found.reference)
    return Evaluation(
        align,
        len(run),
        found.compared,
        found.clock,
        found.span_s,
        found.of_s,
        found.notes + ((mounting.note,) if mounting and mounting.note else ()),
        _lengths(wrong.pos_n),
        _lengths(wrong.vel_n),
        {name: statistics(np.degrees(sizes)) for name, sizes in _angles(wrong).items()},
        mounting,
        tuple(_relative(run, found.reference)) if found.same_body else (),
        tuple(_outages(run.t_ns, wrong, spans(events, "outage"))),
        dict.fromkeys(_GROUPS) if align != "none" else consistency_of(found),
    )


def reference_in(recording: Mapping[str, pa.Table]) -> tuple[str, pa.Table]:
    """Name and table of what a recording holds to compare with. Raises DataError where it holds nothing."""
    for name in ("reference", "trajectory"):
        if name in recording:
            return name, recording[name]
    has = ", ".join(recording) or "none"
    raise DataError("there is no stream 'reference' or 'trajectory' to compare with", f"its streams are {has}")


def match(trajectory: pa.Table, reference: pa.Table) -> Matched:
    """Both at common times, the reference in the local frame of the trajectory. Raises DataError without such times."""
    for name, table in (("trajectory", trajectory), ("reference", reference)):
        if not table.num_rows:
            raise DataError(f"the {name} has no row")
    own, other = _motion(trajectory), _motion(reference)
    other, notes = _seen_from(trajectory, reference, other)
    run, truth = associate(own, other)
    if not len(run):
        raise DataError(
            "the trajectory and the reference have no time in common at which both say where the vehicle is",
            f"the trajectory runs from {_span(own)}, the reference from {_span(other)}",
        )
    clock, compared = ("reference", len(other)) if other.step_ns > own.step_ns else ("trajectory", len(own))
    body, other_body = (meta(table).get("body", "vehicle") for table in (trajectory, reference))
    if body != other_body:
        notes.append(
            f"the attitude of the reference is that of its {other_body}: a constant difference is no error, and "
            "segments, which are seen from the body, are not compared"
        )
    seconds = _seconds(run), _seconds(own)
    return Matched(run, truth, compared, clock, *seconds, body == other_body, tuple(notes))


def consistency_of(found: Matched) -> dict[str, Consistency | None]:
    """Whether the sigmas of position, velocity and attitude are honest; None where the trajectory gives none.

    Sigmas of the reference, where it has some, are added to those of the trajectory as of independent errors.
    """
    wrong = errors(found.run, found.reference)
    return {
        name: consistency(getattr(wrong, error), _combined(getattr(found.run, std), getattr(found.reference, std)))
        if found.same_body or name != "attitude"
        else None
        for name, (error, std) in _GROUPS.items()
    }


def _combined(own: Floats, other: Floats) -> Floats:
    return np.where(own > 0.0, np.hypot(own, np.nan_to_num(other, nan=0.0)), np.nan)


def _motion(table: pa.Table) -> Motion:
    pos, vel, *sigmas = (matrix_or_nan(table, name) for name in ("pos", "vel", "pos_std", "vel_std", "att_std"))
    return Motion(time_ns(table), pos, vel, matrix_or_nan(table, "q", 4), *sigmas)


def _seen_from(trajectory: pa.Table, reference: pa.Table, motion: Motion) -> tuple[Motion, list[str]]:
    """The reference's motion in the local frame of the trajectory, by way of latitude, longitude and height."""
    facts, other_facts = meta(trajectory), meta(reference)
    notes = [
        f"{name} of the trajectory is {facts[name]}, that of the reference {other_facts[name]}"
        for name in _SAME_FACTS
        if name in facts and name in other_facts and facts[name] != other_facts[name]
    ]
    anchor, other = anchor_of(trajectory), anchor_of(reference)
    if anchor is None or other is None:
        if anchor is not None or other is not None:
            notes.append("only one of the two knows its place on the Earth: positions are compared as they are")
        return motion, notes
    earth, other_earth = (facts_of.get("earth", "wgs84") for facts_of in (facts, other_facts))
    if (anchor, earth) == (other, other_earth):
        return motion, notes
    place = enu_to_geodetic(motion.pos_n, other, EARTHS[other_earth])
    return _turned(motion, geodetic_to_enu(*place, anchor, EARTHS[earth]), other, anchor), notes


def _turned(motion: Motion, pos_n: Floats, from_anchor: Anchor, to_anchor: Anchor) -> Motion:
    """Velocity and attitude in the axes of another anchor; sigmas stay, whose axes turn by 0.2 mrad in a kilometre."""
    turn = turn_between(from_anchor, to_anchor)
    vel_n, q_nv = rotate(turn, motion.vel_n), multiply(turn, motion.q_nv)
    return Motion(motion.t_ns, pos_n, vel_n, q_nv, motion.pos_std, motion.vel_std, motion.att_std)


def _lengths(vectors: Floats) -> dict[str, Statistics | None]:
    """vectors : (n, 3), local."""
    sizes = {
        "horizontal": np.hypot(vectors[:, 0], vectors[:, 1]),
        "vertical": vectors[:, 2],
        "total": np.linalg.norm(vectors, axis=1),
    }
    return {name: statistics(np.asarray(values)) for name, values in sizes.items()}


def _angles(wrong: Errors) -> dict[str, Floats]:
    roll, pitch, yaw = wrong.att.T
    return {"roll": roll, "pitch": pitch, "heading": yaw, "total": wrong.angle}


def _relative(run: Motion, reference: Motion) -> Iterable[Relative]:
    """For each of SEGMENTS of which there is at least one; only rows whose poses are known in full."""
    poses = np.column_stack([run.pos_n, run.q_nv, reference.pos_n, reference.q_nv])
    whole = np.asarray(np.isfinite(poses).all(axis=1))
    if not whole.any():
        return
    run, reference = run.rows(whole), reference.rows(whole)
    way = path(reference.pos_n)
    along = {"s": (run.t_ns - run.t_ns[0]) * 1e-9, "m": way}
    for length, unit in SEGMENTS:
        pairs = segments(along[unit], length)
        translation, rotation = relative_errors(run, reference, pairs)
        moved, turned = statistics(translation), statistics(np.degrees(rotation))
        if moved is not None and turned is not None:
            driven = float((way[pairs[:, 1]] - way[pairs[:, 0]]).mean())
            yield Relative(length, unit, moved, turned, 100.0 * moved.mean / driven if driven > 0.0 else None)


def _outages(t_ns: Any, wrong: Errors, found: Iterable[tuple[int, int]]) -> Iterable[Outage]:
    horizontal = np.hypot(wrong.pos_n[:, 0], wrong.pos_n[:, 1])
    velocity = np.linalg.norm(wrong.vel_n, axis=1)
    for start, end in found:
        inside = (t_ns >= start) & (t_ns <= end)
        heading = np.degrees(wrong.att[inside, 2])
        yield Outage(start, end, statistics(horizontal[inside]), statistics(velocity[inside]), statistics(heading))


def _seconds(motion: Motion) -> float:
    return float(motion.t_ns[-1] - motion.t_ns[0]) * 1e-9


def _span(motion: Motion) -> str:
    first, last = (str(np.datetime64(int(t), "ns").astype("datetime64[ms]")) for t in motion.t_ns[[0, -1]])
    return f"{first} to {last}"
