"""A small log with a blow, and a pipeline that finds it, for the tests of seals and explanations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from recon import Pipeline
from recon.arithmetic import Arithmetic

PIPELINE = Pipeline.of("blow", "reader.auto", "filter.moving_average", "detector.shock")
ROWS = 400
BLOW = (200, 206)
"""Rows of 3 g along x, the first and the one behind the last."""


def write_log(path: Path) -> Path:
    """An inertial log of the physycom group at 100 Hz under a header, its last second at rest."""
    rng = np.random.default_rng(1)
    time = 555_081_678.0 + 0.01 * np.arange(ROWS)
    speed = np.where(np.arange(ROWS) < 300, 20.0 + np.floor(np.arange(ROWS) / 10) * 0.1, 0.0)
    accel = rng.normal([0.0, 0.0, 1.0], 0.01, (ROWS, 3))
    accel[slice(*BLOW), 0] = 3.0
    gyro = rng.normal(0.0, 0.1, (ROWS, 3))
    lines = ["# timestamp\tspeed\tax\tay\taz\tgx\tgy\tgz\tabs\trel"]
    for row in range(ROWS):
        numbers = (speed[row], *accel[row], *gyro[row], np.linalg.norm(accel[row]), 0.01 * row)
        lines.append(f"{time[row]:.4f}\t" + "\t".join(f"{number:.5f}" for number in numbers))
    path.write_text("\n".join(lines) + "\n")
    return path


def older_arithmetic(arithmetic: Arithmetic) -> Arithmetic:
    """As a processor of 2011 computes, which every later one of its kind can."""
    names = [name for name in ("AVX", "X86_V3") if name in arithmetic.simd]
    if not any(kernel.startswith("openblas") for kernel in arithmetic.blas) or not names:
        pytest.skip("here is no OpenBLAS, or no processor that has an older arithmetic to choose")
    return Arithmetic(("openblas Sandybridge",), arithmetic.simd[: arithmetic.simd.index(names[0])], 1)
