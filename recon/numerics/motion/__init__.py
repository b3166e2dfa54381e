"""Motions with exact truth: position, velocity, acceleration, attitude and angular rate at any array of times.

Two forms cover all of them. A `Spring` is a closed formula (circle, helix, oscillation). A `Drive` is a row of
`Segment`s, each easing the vehicle from one state to the next; the named drives of `catalogue` and the long ones of
`traffic` are such rows. A `SprungBody` rides on a drive; `Struck` adds impacts from aside; `OnEarth` sets a motion down
on the rotating ellipsoid."""

from recon.numerics.motion.body import Springs, SprungBody
from recon.numerics.motion.catalogue import (
    crash,
    hill,
    parking,
    rest,
    roundabout,
    rounds,
    s_curve,
    stop_and_go,
    straight,
)
from recon.numerics.motion.drive import Drive, Segment
from recon.numerics.motion.earth import EarthTruth, OnEarth
from recon.numerics.motion.impacts import Impact, Struck
from recon.numerics.motion.spring import Spring, circle
from recon.numerics.motion.traffic import TRAFFIC, ferry, traffic
from recon.numerics.motion.truth import Motion, MotionTruth, RoadTruth, specific_force

__all__ = [
    "TRAFFIC",
    "Drive",
    "EarthTruth",
    "Impact",
    "Motion",
    "MotionTruth",
    "OnEarth",
    "RoadTruth",
    "Segment",
    "Spring",
    "Springs",
    "SprungBody",
    "Struck",
    "circle",
    "crash",
    "ferry",
    "hill",
    "parking",
    "rest",
    "roundabout",
    "rounds",
    "s_curve",
    "specific_force",
    "stop_and_go",
    "straight",
    "traffic",
]
