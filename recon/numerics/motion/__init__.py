"""Motions with exact truth: position, velocity, acceleration, attitude and angular rate at any array of times.

Two forms cover all of them. A `Spring` is a closed formula (circle, helix, oscillation). A `Drive` is a row of
`Segment`s, each easing the vehicle from one state to the next; the named drives of `catalogue` are such rows.
"""

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
from recon.numerics.motion.spring import Spring, circle
from recon.numerics.motion.truth import Motion, MotionTruth, specific_force

__all__ = [
    "Drive",
    "Motion",
    "MotionTruth",
    "Segment",
    "Spring",
    "circle",
    "crash",
    "hill",
    "parking",
    "rest",
    "roundabout",
    "rounds",
    "s_curve",
    "specific_force",
    "stop_and_go",
    "straight",
]
