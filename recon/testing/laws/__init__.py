"""The laws, a module for each role; `MODULES` in the order in which they are tested."""

from __future__ import annotations

from types import ModuleType
from typing import Final

from recon.testing.laws import (
    aligners,
    analyzers,
    common,
    declaration,
    detectors,
    executors,
    exporters,
    filters,
    fusers,
    integrators,
    readers,
    robustness,
    simulators,
)

MODULES: Final[tuple[ModuleType, ...]] = (
    declaration,
    common,
    robustness,
    readers,
    simulators,
    filters,
    detectors,
    aligners,
    integrators,
    fusers,
    analyzers,
    exporters,
    executors,
)
