"""recon: what a vehicle did, from the log of its sensors.

    import recon
    run = recon.run("thesis", "drive.txt")
    run.trajectory.at("2017-08-03T12:22:10Z")

Every public name is imported on first use, so that `import recon` costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

__version__ = "0.1.0"

if TYPE_CHECKING:
    from recon.api import Run, evaluate, open, read, run
    from recon.errors import (
        ConfigError,
        ContractError,
        DataError,
        NotEnoughData,
        NothingToExport,
        PluginError,
        ReadFailed,
        ReconError,
        StageError,
        StorageError,
    )
    from recon.hookspecs import hookimpl
    from recon.movement import Movement, Movements
    from recon.parameters import Params, quantity, setting
    from recon.pipeline import Pipeline
    from recon.recording import Recording
    from recon.registry import Registry
    from recon.rows import Event, Metric, events, metrics, spans, warning
    from recon.schema import (
        ANY,
        ATTITUDE,
        BARO,
        EVENTS,
        FRAMES,
        GNSS,
        GROUND,
        IMU,
        KNOTS,
        MAG,
        METRICS,
        REFERENCE,
        RESIDUALS,
        SAME,
        TRAJECTORY,
        VISUAL,
        WHEEL,
        Change,
        Column,
        Need,
        Schema,
    )
    from recon.stages import (
        Aligner,
        Analyzer,
        Detector,
        Executor,
        Exporter,
        Filter,
        Fuser,
        Integrator,
        Live,
        Reader,
        Simulator,
        Sniff,
    )
    from recon.tables import (
        Array,
        Streams,
        build,
        has,
        matrix,
        meta,
        replace,
        seconds,
        select_rows,
        time_ns,
        times,
        vector,
        with_meta,
    )
    from recon.trajectory import Pose, Poses, Trajectory

_HOMES = {
    "api": "Run evaluate open read run",
    "errors": "ConfigError ContractError DataError NotEnoughData NothingToExport PluginError ReadFailed ReconError "
    "StageError StorageError",
    "hookspecs": "hookimpl",
    "movement": "Movement Movements",
    "parameters": "Params quantity setting",
    "pipeline": "Pipeline",
    "recording": "Recording",
    "registry": "Registry",
    "rows": "Event Metric events metrics spans warning",
    "schema": "ANY ATTITUDE BARO EVENTS FRAMES GNSS GROUND IMU KNOTS MAG METRICS REFERENCE RESIDUALS SAME TRAJECTORY "
    "VISUAL WHEEL Change Column Need Schema",
    "stages": "Aligner Analyzer Detector Executor Exporter Filter Fuser Integrator Live Reader Simulator Sniff",
    "tables": "Array Streams build has matrix meta replace seconds select_rows time_ns times vector with_meta",
    "trajectory": "Pose Poses Trajectory",
}
_MODULE_OF = {name: module for module, names in _HOMES.items() for name in names.split()}

__all__ = [
    "ANY",
    "ATTITUDE",
    "BARO",
    "EVENTS",
    "FRAMES",
    "GNSS",
    "GROUND",
    "IMU",
    "KNOTS",
    "MAG",
    "METRICS",
    "REFERENCE",
    "RESIDUALS",
    "SAME",
    "TRAJECTORY",
    "VISUAL",
    "WHEEL",
    "Aligner",
    "Analyzer",
    "Array",
    "Change",
    "Column",
    "ConfigError",
    "ContractError",
    "DataError",
    "Detector",
    "Event",
    "Executor",
    "Exporter",
    "Filter",
    "Fuser",
    "Integrator",
    "Live",
    "Metric",
    "Movement",
    "Movements",
    "Need",
    "NotEnoughData",
    "NothingToExport",
    "Params",
    "Pipeline",
    "PluginError",
    "Pose",
    "Poses",
    "ReadFailed",
    "Reader",
    "ReconError",
    "Recording",
    "Registry",
    "Run",
    "Schema",
    "Simulator",
    "Sniff",
    "StageError",
    "StorageError",
    "Streams",
    "Trajectory",
    "__version__",
    "build",
    "evaluate",
    "events",
    "has",
    "hookimpl",
    "matrix",
    "meta",
    "metrics",
    "open",
    "quantity",
    "read",
    "replace",
    "run",
    "seconds",
    "select_rows",
    "setting",
    "spans",
    "time_ns",
    "times",
    "vector",
    "warning",
    "with_meta",
]


def __getattr__(name: str) -> object:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'recon' has no attribute '{name}'")
    value = getattr(import_module(f"recon.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
