"""A batch smoother for IMU and satellite data: the most probable trajectory of a whole drive.

The unknowns are the state of the box at knots every two seconds; between knots the samples are integrated once into
increments. Everything runs over whole arrays, so the long axis comes last: vectors (3, n), matrices (3, 3, n),
quaternions (4, n) scalar first, all float64. Raw samples are (n, 3), as elsewhere.

Frames: n Cartesian axes East, North, Up at the anchor, fixed to the rotating Earth; l local level at the place;
s sensor (box); v vehicle (ISO 8855). R_ns takes sensor vectors to n.

References
    Forster, Carlone, Dellaert, Scaramuzza (2017), "On-manifold preintegration for real-time visual-inertial odometry",
    IEEE T-RO 33(1), 1-21.
"""

from __future__ import annotations

from recon.numerics.smoothing.earth import geodetic, level_rotation, positions_n
from recon.numerics.smoothing.estimate import Estimate, estimate, sigmas
from recon.numerics.smoothing.full_rate import Motion, between_knots, full_rate
from recon.numerics.smoothing.measurements import Fixes
from recon.numerics.smoothing.model import Drive, Impact, Model, Noise
from recon.numerics.smoothing.samples import Samples, regular_samples
from recon.numerics.smoothing.smoother import Smoother
from recon.numerics.smoothing.solved import Solved

__all__ = [
    "Drive",
    "Estimate",
    "Fixes",
    "Impact",
    "Model",
    "Motion",
    "Noise",
    "Samples",
    "Smoother",
    "Solved",
    "between_knots",
    "estimate",
    "full_rate",
    "geodetic",
    "level_rotation",
    "positions_n",
    "regular_samples",
    "sigmas",
]
