"""The motion that the parameters of simulator.drive describe: who drives, how the car leans, where on the Earth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np

from recon.numerics import motion as motions
from recon.numerics.geodesy import Anchor
from recon.numerics.motion import Drive, EarthTruth, Impact, Motion, OnEarth, Springs, SprungBody, Struck
from recon.numerics.rotation import Floats, conjugate, rotate, yaw_from_heading
from recon_simulators.drive_params import TAKES, DriveParams

_ROADS: Final[Mapping[str, Callable[..., Drive]]] = {
    "straight": motions.straight,
    "circle": motions.rounds,
    "spring": partial(motions.rounds, slope=0.1),
    "roundabout": motions.roundabout,
    "s_curve": motions.s_curve,
    "hill": motions.hill,
    "parking": motions.parking,
}
"""Motions whose length follows from their road."""
_ARGUMENTS: Final = {"pulse": "pulse_s", "rest": "rest_s", "again": "again_s"}
"""What the functions of recon.numerics.motion call them, where that differs."""
_LASTS_S: Final = {"rest": 60.0, "city": 300.0}
_LONG_S: Final = 600.0
_DELTA_V, _SKID, _SHORTEST_SKID_S = 12.0, 7.0, 0.3
"""m/s, lost in a crash where nothing is said; m/s^2, of tyres that skid; s."""


@dataclass(frozen=True)
class Route:
    """A motion on the Earth, seen from the record; times are those since the record began.

    drive : of the middle of the rear axle;  earth : of the IMU;  anchor : place of the IMU where the motion starts
    begin_s : of the record, after the motion's own start;  duration_s : of the record
    carried : s, when a ferry moves the vehicle
    """

    drive: Drive
    earth: OnEarth
    anchor: Anchor
    begin_s: float
    duration_s: float
    carried: tuple[float, float] | None

    def at(self, t_s: Floats) -> EarthTruth:
        """Truth of the IMU at the times (n,) s."""
        return self.earth.at(t_s + self.begin_s)

    def wheel_speed(self, t_s: Floats) -> Floats:
        """Speed of the rear wheels, negative in reverse, zero on a ferry: (n,) m/s."""
        axle = self.drive.at(t_s + self.begin_s)
        speed = rotate(conjugate(axle.q_nv), axle.vel_n)[:, 0]
        if self.carried is None:
            return speed
        start, end = self.carried
        return np.where((start <= t_s) & (t_s <= end), 0.0, speed)

    def turn_rate(self, t_s: Floats) -> Floats:
        """Of the rear axle about its vertical axis, zero on a ferry: (n,) rad/s."""
        rate = self.drive.at(t_s + self.begin_s).gyro_v[:, 2]
        return rate if self.carried is None else np.where(self.wheel_speed(t_s) == 0.0, 0.0, rate)


def route_of(params: DriveParams, springs: Springs, rear_axle_v: tuple[float, float, float]) -> Route:
    """The motion of the parameters; a record that outlasts its drive ends standing. Raises ValueError."""
    route, bounce = np.random.default_rng(params.route).spawn(2)
    drive, carried, duration_s = _drive(params, route)
    drive = Drive(drive.segments, float(yaw_from_heading(params.heading)))
    anchor = Anchor(np.degrees(params.lat), np.degrees(params.lon), params.height)
    body: Motion = SprungBody(drive, springs, rear_axle_v, carried, bounce)
    if params.motion == "crash":
        body = Struck(body, _impacts(params, drive))
    earth = OnEarth(body, anchor, params.begin + duration_s)
    seen = None if carried is None else (carried[0] - params.begin, carried[1] - params.begin)
    return Route(drive, earth, anchor, params.begin, duration_s, seen)


def _crash(params: DriveParams, given: Mapping[str, Any]) -> Drive:
    """The part of a crash that the road takes: along it. Raises ValueError."""
    own = {name: value for name, value in given.items() if name not in ("direction", "spin")}
    lost = own.get("delta_v", _DELTA_V) * np.cos(params.direction)
    return motions.crash(**{**own, "delta_v": max(float(lost), 0.0)})


def _impacts(params: DriveParams, drive: Drive) -> list[Impact]:
    """The rest of it: pushes from aside and from behind, and the spin, where the drive has its pulses."""
    edges, delta_v = drive.edges_s, params.delta_v if params.delta_v is not None else _DELTA_V
    ahead, left = -min(np.cos(params.direction), 0.0) * delta_v, np.sin(params.direction) * delta_v
    found = []
    for first, share in ((3, 1.0), (5, 0.5))[: 1 if params.again is None else 2]:
        push = share * float(ahead), share * float(left)
        skid_s = max(2.0 * float(np.hypot(*push)) / _SKID, _SHORTEST_SKID_S)
        spin = params.spin if first == 3 else 0.0
        found.append(Impact(edges[first], edges[first + 1] - edges[first], push, skid_s, spin))
    return found


def _drive(params: DriveParams, rng: np.random.Generator) -> tuple[Drive, tuple[float, float] | None, float]:
    """The drive, its crossing on a ferry, and the length of the record in s."""
    own = {name: getattr(params, name) for name in TAKES[params.motion] if name != "route"}
    given = {_ARGUMENTS.get(name, name): value for name, value in own.items() if value is not None}
    if params.motion == "crash":
        drive = _crash(params, given)
        return drive, None, params.duration or max(drive.duration_s - params.begin, 0.0)
    if params.motion in _ROADS:
        drive = _ROADS[params.motion](**given)
        return drive, None, params.duration or max(drive.duration_s - params.begin, 0.0)
    duration_s = params.duration or _LASTS_S.get(params.motion, _LONG_S)
    return *_long_drive(params.motion, params.begin + duration_s, rng, given), duration_s


def _long_drive(
    motion: str, until_s: float, rng: np.random.Generator, given: Mapping[str, Any]
) -> tuple[Drive, tuple[float, float] | None]:
    """A drive that is as long as asked, and its crossing on a ferry."""
    if motion == "rest":
        return motions.rest(until_s), None
    if motion == "ferry":
        return motions.ferry(until_s, rng, **given)
    if motion == "city":
        if until_s <= given.get("rest_s", 10.0):
            raise ValueError(
                f"a city drive of {until_s:g} s that rests for {given.get('rest_s', 10.0):g} s never moves"
            )
        return motions.stop_and_go(until_s, rng, **given), None
    return motions.traffic(motion, until_s, rng, **given), None
