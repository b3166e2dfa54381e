"""Named drives of a car: each a short row of segments, each beginning at rest so that a stop exists.

Lengths in m, speeds in m/s, angles in rad, times in s. Every drive starts at the origin towards the east.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from recon.numerics.motion.drive import Drive, Segment, duration_of

# m/s^2: largest acceleration, deceleration and lateral acceleration of an ordinary driver; deceleration of a skid.
_LAUNCH, _BRAKE, _CORNER, _SKID = 2.0, 3.0, 2.5, 8.0
_SHORTEST_STOP_S = 2.0


def rest(duration_s: float) -> Drive:
    """Standing still on a level road."""
    return Drive((Segment(duration_s, 0.0),))


def straight(speed: float = 15.0, cruise_s: float = 10.0, rest_s: float = 10.0) -> Drive:
    """Accelerate, hold the speed, brake."""
    return _journey(rest_s, speed, [Segment(cruise_s, speed)])


def s_curve(speed: float = 10.0, radius: float = 40.0, angle: float = 1.0, rest_s: float = 10.0) -> Drive:
    """A bend to the left by `angle`, twice as much to the right, and back to the first direction."""
    bends = (_bend(turn, radius, speed) for turn in (angle, -2.0 * angle, angle))
    return _journey(rest_s, speed, [segment for bend in bends for segment in bend])


def roundabout(speed: float = 6.0, radius: float = 15.0, exit_angle: float = np.pi, rest_s: float = 10.0) -> Drive:
    """Enter to the right, circle to the left, leave to the right, heading `exit_angle` from the direction of entry."""
    aside = _bend(-np.pi / 4.0, radius, speed)
    around = _bend(exit_angle + np.pi / 2.0, radius, speed)
    return _journey(rest_s, speed, [*aside, *around, *aside])


def rounds(
    speed: float = 8.0, radius: float = 20.0, turns: float = 5.0, slope: float = 0.0, rest_s: float = 10.0
) -> Drive:
    """Full circles to the left; with a slope they are the coil spring of a ramp that winds upwards."""
    steer_in, around, steer_out = _bend(2.0 * np.pi * turns, radius, speed)
    road = [replace(steer_in, slope=slope), replace(around, slope=slope), steer_out]
    return _journey(rest_s, speed, road)


def hill(speed: float = 12.0, slope: float = 0.1, rest_s: float = 10.0) -> Drive:
    """Up with the slope, over the crest and down again; the pitch follows the road."""
    road = [Segment(4.0, speed), *_hump(speed, slope, 5.0), *_hump(speed, -slope, 5.0), Segment(4.0, speed)]
    return _journey(rest_s, speed, road)


def parking(rest_s: float = 10.0) -> Drive:
    """Forward past a gap on the right, back into it steering right then left, a little forward."""
    lock = 1.0 / 6.0
    return Drive(
        (
            Segment(rest_s, 0.0),
            Segment(3.0, 3.5),
            Segment(3.0, 0.0),
            Segment(1.0, 0.0),
            Segment(2.0, -1.2, curvature=-lock),
            Segment(2.0, -1.2, curvature=-lock),
            Segment(2.0, -1.2, curvature=lock),
            Segment(2.0, -1.2, curvature=lock),
            Segment(2.0, 0.0),
            Segment(1.0, 0.0),
            Segment(1.5, 0.8),
            Segment(1.5, 0.0),
            Segment(5.0, 0.0),
        )
    )


def crash(
    speed: float = 15.0,
    delta_v: float = 12.0,
    pulse_s: float = 0.1,
    dive: float = 0.05,
    rest_s: float = 10.0,
    again_s: float | None = None,
) -> Drive:
    """Drive, lose `delta_v` in a haversine pulse that ends `dive` nose down, settle back while skidding to rest.

    The peak deceleration is 2 delta_v / pulse_s. The pulse is the segment of that duration: see `Drive.edges_s`. A
    second one follows `again_s` after the first and takes half of the speed that is left.
    Raises ValueError where delta_v is not in [0, speed], or the second comes while the first lasts.
    """
    if not 0.0 <= delta_v <= speed:
        raise ValueError(f"a crash from {speed} m/s loses between 0 and {speed} m/s, not {delta_v}")
    if again_s is not None and again_s <= pulse_s:
        raise ValueError(f"the second impact comes {again_s} s after the first, which lasts {pulse_s} s")
    left = speed - delta_v
    pulses = [Segment(pulse_s, left, dive=dive)]
    if again_s is not None:
        left /= 2.0
        pulses += [Segment(again_s - pulse_s, speed - delta_v, dive=dive), Segment(pulse_s, left, dive=dive)]
    return Drive(
        (
            Segment(rest_s, 0.0),
            _change(0.0, speed),
            Segment(5.0, speed),
            *pulses,
            Segment(max(0.3, 2.0 * left / _SKID), 0.0),
            Segment(rest_s, 0.0),
        )
    )


def stop_and_go(duration_s: float, rng: np.random.Generator, rest_s: float = 10.0) -> Drive:
    """City drive of `duration_s`: launches, straights, bends, hills and stops in random order.

    Once the next stretch and a stop no longer fit, the vehicle brakes and stands until the end.
    """
    segments, elapsed_s, speed = [Segment(rest_s, 0.0)], rest_s, 0.0
    while True:
        stretch = _stretch(rng, speed)
        end_speed = stretch[-1].speed
        brake = [_change(end_speed, 0.0)] if end_speed else []
        if elapsed_s + duration_of(stretch) + duration_of(brake) + _SHORTEST_STOP_S > duration_s:
            break
        segments += stretch
        elapsed_s, speed = elapsed_s + duration_of(stretch), end_speed
    closing = [_change(speed, 0.0)] if speed else []
    return Drive((*segments, *closing, Segment(duration_s - elapsed_s - duration_of(closing), 0.0)))


def _stretch(rng: np.random.Generator, speed: float) -> list[Segment]:
    """The next thing that happens in the city at a given speed."""
    if speed == 0.0:
        return [_change(0.0, rng.uniform(7.0, 15.0))]
    kind = rng.choice(["cruise", "bend", "hill", "stop"], p=[0.35, 0.35, 0.15, 0.15])
    if kind == "cruise":
        new = rng.uniform(7.0, 15.0)
        return [_change(speed, new), Segment(rng.uniform(3.0, 12.0), new, bank=rng.uniform(-0.04, 0.04))]
    if kind == "bend":
        radius, angle = rng.uniform(12.0, 30.0), rng.uniform(0.3, 1.8) * rng.choice([-1.0, 1.0])
        corner_speed = np.sqrt(_CORNER * radius)
        return [_change(speed, corner_speed), *_bend(angle, radius, corner_speed)]
    if kind == "hill":
        return _hump(speed, rng.uniform(-0.08, 0.08), rng.uniform(3.0, 6.0))
    return [_change(speed, 0.0), Segment(rng.uniform(_SHORTEST_STOP_S, 15.0), 0.0)]


def _journey(rest_s: float, speed: float, road: Iterable[Segment]) -> Drive:
    """Rest, accelerate, follow the road, brake, rest for 5 s."""
    ends = _change(0.0, speed), _change(speed, 0.0)
    return Drive((Segment(rest_s, 0.0), ends[0], *road, ends[1], Segment(5.0, 0.0)))


def _change(old: float, new: float) -> Segment:
    """A change of speed straight ahead; the peak of the haversine is the ordinary driver's limit."""
    limit = _LAUNCH if new > old else _BRAKE
    return Segment(max(1.0, 2.0 * abs(new - old) / limit), new)


def _bend(angle: float, radius: float, speed: float) -> list[Segment]:
    """Steer in, hold the radius, steer out: together `angle`, positive to the left.

    Steering in and out over the length L each turns by L / (2 radius), the arc between by the rest.
    """
    steer = radius * min(1.0, abs(angle) / 2.0)
    arc = radius * abs(angle) - steer
    curvature = np.copysign(1.0 / radius, angle)
    return [
        Segment(steer / speed, speed, curvature=curvature),
        Segment(arc / speed, speed, curvature=curvature),
        Segment(steer / speed, speed),
    ]


def _hump(speed: float, slope: float, part_s: float) -> list[Segment]:
    """Into a slope, along it, and back to level road, each in `part_s`."""
    return [Segment(part_s, speed, slope=slope), Segment(part_s, speed, slope=slope), Segment(part_s, speed)]
