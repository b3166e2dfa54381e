"""Long drives through town and country: stretches in random order on roads with grade and camber.

Every drive begins at the origin towards the east with a rest on a level road. A stretch is what a driver does next: a
turn, a curve, a roundabout, a stop, a fast road, a parking manoeuvre. `TRAFFIC` says how often each comes; the random
generator alone decides which and how. Speeds in m/s, accelerations in m/s^2, angles in rad, times in s.

Grade and camber change along the road as Gauss-Markov processes over the distance travelled, and stay as they are
while the vehicle stands.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final, TypeAlias

import numpy as np

from recon.numerics.motion.drive import Drive, Segment, duration_of

Stretch: TypeAlias = list[Segment]

_GRADE, _GRADE_M = 0.03, 150.0
_CAMBER, _CAMBER_M = 0.015, 80.0
"""Sigma in rad, and the distance over which it changes."""
_LATERAL = 3.0
"""Largest lateral acceleration in a bend."""
_SHORTEST_S = 0.8
"""Of a change of speed."""
_HALT_S = 3.0
_TRIES = 10
"""Stretches that are too long for the time left, before the drive ends."""
_DECK_S = 60.0

TRAFFIC: Final[Mapping[str, Mapping[str, float]]] = {
    "country": {"cruise": 0.3, "turn": 0.3, "stop": 0.15, "curve": 0.2, "fast": 0.05},
    "mixed": {
        "cruise": 0.25,
        "turn": 0.23,
        "stop": 0.11,
        "curve": 0.17,
        "fast": 0.06,
        "roundabout": 0.06,
        "hard_stop": 0.03,
        "creep": 0.05,
        "park": 0.04,
    },
    "nonstop": {"cruise": 0.35, "turn": 0.25, "curve": 0.25, "fast": 0.1, "roundabout": 0.05},
    "reverse": {"back": 0.5, "back_turn": 0.35, "halt": 0.15},
}
"""Share of each stretch in the drives of that name."""


def traffic(kind: str, duration_s: float, rng: np.random.Generator, rest_s: float = 30.0) -> Drive:
    """A drive of `duration_s` with the stretches of TRAFFIC[kind].

    Once nothing fits any more, the vehicle brakes and stands until the end; that of `nonstop` goes on beyond
    `duration_s` instead. Raises ValueError where nothing fits at all.
    """
    shares = TRAFFIC[kind]
    segments, elapsed_s, speed, misses = [Segment(rest_s, 0.0)], rest_s, 0.0, 0
    while elapsed_s < duration_s and misses < _TRIES:
        stretch = _STRETCHES[str(rng.choice(list(shares), p=list(shares.values())))](speed, rng)
        halt_s = duration_of(_halt(stretch[-1].speed)) + _HALT_S
        if elapsed_s + duration_of(stretch) + halt_s > duration_s and kind != "nonstop":
            misses += 1
            continue
        segments += stretch
        elapsed_s, speed = elapsed_s + duration_of(stretch), stretch[-1].speed
    if not any(segment.speed for segment in segments):
        raise ValueError(f"a drive of {duration_s:g} s that rests for {rest_s:g} s never moves")
    closing = _halt(speed)
    left_s = duration_s - elapsed_s - duration_of(closing)
    return Drive(tuple(_on_roads([*segments, *closing, Segment(max(left_s, _HALT_S), 0.0)], rng)))


def ferry(duration_s: float, rng: np.random.Generator, rest_s: float = 30.0) -> tuple[Drive, tuple[float, float]]:
    """A drive to a quay and on board, a crossing, stern first out of the harbour, and a drive off; and its span in s.

    The crossing takes half of the duration. Within the span, the wheels stand. Raises ValueError where the duration
    leaves no time for a crossing.
    """
    if duration_s < 8.0 * _DECK_S:
        raise ValueError(f"a drive with a ferry takes {8.0 * _DECK_S:g} s at least, not {duration_s:g} s")
    on_board = [*_town(duration_s / 4.0, rng, rest_s), Segment(5.0, 1.0), Segment(4.0, 0.0)]
    crossing_s, full = duration_s / 2.0 - 2.0 * _DECK_S, rng.uniform(6.0, 9.0)
    ship = [
        Segment(_DECK_S, 0.0),
        Segment(0.1 * crossing_s, -2.5, curvature=0.004),
        Segment(0.1 * crossing_s, 0.0),
        Segment(0.2 * crossing_s, full),
        Segment(0.2 * crossing_s, full, curvature=rng.uniform(-0.001, 0.001)),
        Segment(0.2 * crossing_s, full),
        Segment(0.2 * crossing_s, 0.0),
        Segment(_DECK_S, 0.0),
    ]
    start_s, ship_s = duration_of(on_board), duration_of(ship)
    ashore = _town(duration_s - start_s - ship_s, rng, _HALT_S)
    return Drive((*on_board, *ship, *ashore)), (start_s, start_s + ship_s)


def _town(duration_s: float, rng: np.random.Generator, rest_s: float) -> Stretch:
    return list(traffic("mixed", duration_s, rng, rest_s).segments)


def _cruise(speed: float, rng: np.random.Generator) -> Stretch:
    new = rng.uniform(10.0, 19.0)
    return [*_change(speed, new, rng), Segment(rng.uniform(5.0, 25.0), new)]


def _fast(speed: float, rng: np.random.Generator) -> Stretch:
    new = rng.uniform(22.0, 33.0)
    return [*_change(speed, new, rng), Segment(rng.uniform(20.0, 60.0), new)]


def _turn(speed: float, rng: np.random.Generator) -> Stretch:
    """A street corner: 60 to 110 deg in a few seconds."""
    new = rng.uniform(5.0, 9.0)
    rate = min(np.radians(rng.uniform(15.0, 30.0)), _LATERAL / new)
    return [*_change(speed, new, rng), *_bend(np.radians(rng.uniform(60.0, 110.0)) * _side(rng), rate, new)]


def _curve(speed: float, rng: np.random.Generator) -> Stretch:
    """A bend of the road, 5 to 25 s long."""
    new = rng.uniform(10.0, 19.0)
    rate = min(np.radians(rng.uniform(1.0, 8.0)), 2.5 / new)
    return [*_change(speed, new, rng), *_bend(rate * rng.uniform(5.0, 25.0) * _side(rng), rate, new)]


def _roundabout(speed: float, rng: np.random.Generator) -> Stretch:
    """Aside, around by one to three quarters, aside."""
    new = rng.uniform(5.0, 8.0)
    rate = min(new / rng.uniform(10.0, 18.0), _LATERAL / new)
    aside = _bend(-np.pi / 4.0, rate, new)
    return [*_change(speed, new, rng), *aside, *_bend(np.pi / 2.0 * (1 + rng.integers(1, 4)), rate, new), *aside]


def _stop(speed: float, rng: np.random.Generator) -> Stretch:
    return [*_change(speed, 0.0, rng), Segment(rng.uniform(8.0, 35.0), 0.0)]


def _hard_stop(speed: float, rng: np.random.Generator) -> Stretch:
    """Braking at up to 6 to 9 m/s^2."""
    return [Segment(max(_SHORTEST_S, 2.0 * speed / rng.uniform(6.0, 9.0)), 0.0), Segment(rng.uniform(3.0, 8.0), 0.0)]


def _creep(speed: float, rng: np.random.Generator) -> Stretch:
    """A queue: walking pace and slower, without coming to a stop."""
    paces = rng.uniform(0.4, 1.5, 3)
    crawl = [Segment(rng.uniform(3.0, 8.0), pace) for pace in paces for _ in range(2)]
    return [*_change(speed, float(paces[0]), rng), *crawl]


def _park(speed: float, rng: np.random.Generator) -> Stretch:
    """Stop beside a gap, back into it with full lock to one side and then the other, stand, and pull out."""
    back, lock = -rng.uniform(0.8, 1.4), _side(rng) / rng.uniform(5.0, 7.0)
    return [
        *_change(speed, 0.0, rng),
        Segment(1.5, 0.0),
        Segment(2.0, back, curvature=-lock),
        Segment(2.0, back, curvature=-lock),
        Segment(2.0, back, curvature=lock),
        Segment(2.0, back, curvature=lock),
        Segment(2.0, 0.0),
        Segment(rng.uniform(8.0, 35.0), 0.0),
        Segment(3.0, 2.0, curvature=lock),
        Segment(3.0, 2.5),
    ]


def _back(speed: float, rng: np.random.Generator) -> Stretch:
    new = -rng.uniform(1.0, 4.0)
    return [*_change(speed, new, rng), Segment(rng.uniform(5.0, 20.0), new)]


def _back_turn(speed: float, rng: np.random.Generator) -> Stretch:
    new = -rng.uniform(1.0, 2.5)
    rate = min(np.radians(rng.uniform(8.0, 20.0)), _LATERAL / -new)
    return [*_change(speed, new, rng), *_bend(np.radians(rng.uniform(30.0, 110.0)) * _side(rng), rate, new)]


def _halt(speed: float) -> Stretch:
    """Gently to a stop."""
    return [Segment(max(_SHORTEST_S, abs(speed) / 1.5), 0.0)] if speed else []


_STRETCHES: Final[Mapping[str, Callable[[float, np.random.Generator], Stretch]]] = {
    "cruise": _cruise,
    "turn": _turn,
    "curve": _curve,
    "fast": _fast,
    "roundabout": _roundabout,
    "stop": _stop,
    "hard_stop": _hard_stop,
    "creep": _creep,
    "park": _park,
    "back": _back,
    "back_turn": _back_turn,
    "halt": _stop,
}


def _change(old: float, new: float, rng: np.random.Generator) -> Stretch:
    """A change of speed straight ahead at 0.6 to 1.7 m/s^2 on average, twice that at its peak."""
    if old == new:
        return []
    return [Segment(max(_SHORTEST_S, abs(new - old) / rng.uniform(0.6, 1.7)), new)]


def _bend(angle: float, rate: float, speed: float) -> Stretch:
    """Steer in, hold the yaw rate, steer out: together `angle`, positive to the left.

    Steering takes 1 s, or half of the whole where that is less; in and out each turn by half of what the time held
    would.
    """
    whole_s = abs(angle) / rate
    steer_s = min(1.0, whole_s / 2.0)
    curvature = np.copysign(rate / speed, angle) * np.sign(speed)
    return [
        Segment(steer_s, speed, curvature=curvature),
        Segment(max(whole_s - steer_s, 0.1), speed, curvature=curvature),
        Segment(steer_s, speed),
    ]


def _on_roads(segments: Sequence[Segment], rng: np.random.Generator) -> Stretch:
    """The same stretches on roads with grade and camber, up to the last one, which stands as the road lies."""
    slope, bank, speed, laid = 0.0, 0.0, 0.0, []
    for segment in segments:
        length = abs(speed + segment.speed) / 2.0 * segment.duration_s
        if length:
            slope = _next(slope, _GRADE, length / _GRADE_M, rng)
            bank = _next(bank, _CAMBER, length / _CAMBER_M, rng)
        laid.append(replace(segment, slope=slope, bank=bank))
        speed = segment.speed
    return laid


def _next(value: float, sigma: float, fade: float, rng: np.random.Generator) -> float:
    """The next value of a Gauss-Markov process, e^-fade of which is the old one."""
    kept = np.exp(-fade)
    return float(kept * value + np.sqrt(1.0 - kept**2) * sigma * np.clip(rng.standard_normal(), -3.0, 3.0))


def _side(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))
