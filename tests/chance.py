"""What chance makes of numbers."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from recon.numerics.rotation import Floats


def assert_standard_normal(samples: Floats) -> None:
    """Their sum of squares is that of independent standard normals."""
    low, high = (float(chi2.ppf(p, samples.size)) for p in (1e-6, 1.0 - 1e-6))
    assert low < np.sum(samples**2) < high
