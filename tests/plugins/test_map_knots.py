from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from smoothing_drives import Log, simulate

from recon.errors import DataError
from recon.numerics.smoothing import Model, estimate
from recon_fusers._map_knots import _covariances


def test_covariances_that_are_none_to_working_precision_refuse_the_log():
    """As where a drive that was flung about hardly converged; numpy's error would be told as a fault of recon."""
    sim = simulate(Log(kind="nonstop", seconds=120.0))
    found = estimate(sim.drive, Model(), sim.log.noise, False)
    count = found.solved.state.knots
    level = np.tile(np.eye(3), (count, 1, 1))
    singular = replace(found.inverse, conditional=found.inverse.conditional.copy())
    singular.conditional[5, 3, 3] = -1.0
    _covariances(found, np.arange(count), level, level)
    with pytest.raises(DataError, match="does not determine a trajectory"):
        _covariances(replace(found, inverse=singular), np.arange(count), level, level)
