"""One step of a run, called: what it is given, what becomes of what it raises, and whether it returned what it said."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa

from recon.arithmetic import one_thread
from recon.errors import ContractError, DataError, NothingToExport, ReadFailed, ReconError, StageError
from recon.plan import PlannedStep
from recon.recording import Recording
from recon.schema import APPENDED, METRICS, Schema, match, unnumbered
from recon.stages import Exporter, Reader
from recon.tables import Streams, conform, schema_of


def call(step: PlannedStep, recording: Recording) -> Streams:
    """What a step makes of a recording, as `checked`. Raises DataError, StageError, ContractError."""
    tables = _tables(step, recording)
    try:
        returned = guarded(step, lambda: step.stage.run(**tables, params=step.params))
    except OSError as error:
        raise StageError(step.id, f"{type(error).__name__}: {error}") from error
    with _blamed(step):
        return checked(step, returned)


def call_exporter(step: PlannedStep, recording: Recording, folder: Path, about: object) -> list[Path]:
    """Let an exporter write into a folder.

    Raises NothingToExport where the recording lacks what it reads, ContractError where it names a file outside of it.
    """
    tables = _tables(step, recording)
    returned = guarded(step, lambda: step.stage.run(**tables, folder=folder, about=about, params=step.params))
    with _blamed(step):
        return _written(step, returned, folder)


def _written(step: PlannedStep, returned: Any, folder: Path) -> list[Path]:
    """The files that an exporter named. Raises ContractError where they are not there, or not in the folder."""
    if not isinstance(returned, Sequence) or not all(isinstance(path, Path) for path in returned):
        raise ContractError(step.id, f"it did not return a list of paths but {_kind(returned)}")
    files = list(returned)
    outside = [path for path in files if not path.resolve().is_relative_to(folder.resolve())]
    if outside:
        raise ContractError(step.id, f"it wrote {outside[0]}, which is outside of its folder")
    absent = [path for path in files if not path.is_file()]
    if absent:
        raise ContractError(step.id, f"it did not write {absent[0].name}, which it names")
    return files


def guarded(step: PlannedStep, work: Callable[[], Any]) -> Any:
    """Whatever a stage raises becomes an error of ours that names the step; OSError passes. On one thread of BLAS."""
    try:
        with one_thread():
            return work()
    except ReadFailed:
        raise
    except ReconError as error:
        error.message = f"step {step.id}: {error.message}"
        raise
    except OSError:
        raise
    except MemoryError as error:
        raise StageError(step.id, "there is not enough memory") from error
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a stage is somebody else's code, and may even exit
        hint = f"{_fault_of(step)}; '-v' shows where"
        raise StageError(step.id, f"{type(error).__name__}: {error}", hint) from error


@contextmanager
def _blamed(step: PlannedStep) -> Iterator[None]:
    """A contract that is broken in the block is told with whose fault that is."""
    try:
        yield
    except ContractError as error:
        error.hint = error.hint or _fault_of(step)
        raise


def _fault_of(step: PlannedStep) -> str:
    return f"this is a fault of {step.source or step.stage.key}"


def _kind(returned: Any) -> str:
    """What a stage returned, by its type; of a mapping the first entry that is no table."""
    if not isinstance(returned, Mapping):
        return "None" if returned is None else f"a {type(returned).__name__}"
    name, value = next((name, value) for name, value in returned.items() if not isinstance(value, pa.Table))
    return f"a {type(value).__name__} for '{name}'"


def checked(step: PlannedStep, returned: Any) -> Streams:
    """What a step returned, by stream, stamped; raises ContractError where it is not what was planned."""
    if not isinstance(returned, Mapping) or not all(isinstance(t, pa.Table) for t in returned.values()):
        text = "it did not return a mapping of stream names to Arrow tables"
        raise ContractError(step.id, f"{text} but {_kind(returned)}")
    streams = {step.stream_of(port): table for port, table in returned.items()}
    if isinstance(step.stage, Reader) and step.stage.self_describing:
        return {name: conform(table, schema_of(table), stream=name, step=step.id) for name, table in streams.items()}
    planned = step.outputs
    for name in streams:
        if _planned_for(name, step) is None:
            raise ContractError(step.id, f"it returned the stream '{name}', which it does not declare")
    for name, schema in planned.items():
        if name not in streams and name not in APPENDED and not schema.uncertain:
            raise ContractError(step.id, f"it did not return the stream '{name}', which it declares")
    return {
        name: conform(table, _planned_for(name, step) or METRICS, stream=name, step=step.id)
        for name, table in streams.items()
    }


def _tables(step: PlannedStep, recording: Recording) -> dict[str, Any]:
    """What a step reads, by port; `streams` of one that reads every stream.

    Raises DataError where an earlier step left out what it might have given; for an exporter that is NothingToExport.
    """
    error = NothingToExport if isinstance(step.stage, Exporter) else DataError
    tables: dict[str, Any] = {"streams": dict(recording)} if step.stage.every_stream else {}
    for port, need in step.stage.reads.items():
        stream = step.step.inputs.get(port, port)
        tables[port] = table = recording.get(stream)
        if table is None and not need.optional:
            raise error(f"step {step.id}: {step.stage.key} reads '{stream}', which no step above gave")
        faults = match(need, schema_of(table), stream) if table is not None else []
        if faults:
            missing = all(fault.missing for fault in faults)
            raise (error if missing else DataError)(f"step {step.id}: {step.stage.key} reads {faults[0].text}")
    return tables


def _planned_for(name: str, step: PlannedStep) -> Schema | None:
    """The schema planned for a stream; a reader's `imu_2` is planned with its `imu`."""
    if name not in step.outputs and isinstance(step.stage, Reader):
        name = unnumbered(name)
    return step.outputs.get(name)
