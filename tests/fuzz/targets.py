"""What is fuzzed: whole samples, made here, and what is done with each damaged one."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import recon
from recon import Pipeline, Registry
from recon.api import execute
from recon.batch import parse as parse_batch
from recon.batch_plan import check_batch
from recon.errors import ConfigError
from recon.form import is_batch
from recon.overrides import Override
from recon.schema import unnumbered
from recon.stages import Reader
from recon.tables import conform
from recon.validation import validate_pipeline
from recon.yaml_nodes import load_file

sys.path.insert(0, str(Path(__file__).parents[1]))
import measurement_logs
from binary_samples import (
    LOGS,
    ardupilot_samples,
    comma2k19_samples,
    foreign_mcap_samples,
    frames_samples,
    mcap_samples,
    mf4_samples,
    navego_samples,
    parquet_samples,
    rosbag_samples,
    ulog_samples,
)
from text_samples import (
    COLUMNS,
    Sample,
    csv_samples,
    edr_csv_samples,
    gnsslogger_samples,
    phyphox_samples,
    physycom_samples,
    sensor_logger_samples,
    yaml_samples,
)

HEAD_BYTES: Final = 65536


@dataclass(frozen=True)
class Target:
    """samples : made once; attempt : gives rows or raises a ReconError for the file or folder it is given."""

    samples: Callable[[], Sequence[Sample]]
    attempt: Callable[[Path], None]


@cache
def registry() -> Registry:
    return Registry.installed()


def read_by(key: str, *overrides: Override) -> Callable[[Path], None]:
    """Ask a reader whether a file is its own, and what it makes of it, then read it as a run does.

    Rows must be whole Arrow data.
    """

    def attempt(path: Path) -> None:
        reader = registry().get(key)
        assert isinstance(reader, Reader)
        assert reader.sniff is not None
        reader.sniff(path, b"" if path.is_dir() else path.read_bytes()[:HEAD_BYTES])
        if reader.propose is not None:
            reader.propose([path])
        found = execute(Pipeline.of("read", key), path, None, overrides, registry=registry()).recording
        for table in found.values():
            table.validate(full=True)
        if path.is_dir() and (path / "manifest.json").exists():
            recon.open(path)._repr_html_()

    return attempt


def validate(path: Path) -> None:
    """What `recon validate` does."""
    root = load_file(path)
    if is_batch(root):
        batch, problems = parse_batch(root)
        problems = problems + check_batch(batch, registry())
    else:
        pipeline, problems = validate_pipeline(root, registry())
        if not problems:
            Pipeline.from_text(pipeline.to_yaml())
    if problems:
        raise ConfigError(problems)


_GIVEN: Final[Mapping[str, Mapping[str, Any]]] = {"ubx": {"at_rest": "up"}, "vbox": {"axes": "FLU"}}
"""Parameters without which a reader leaves a stream out."""


def logger_target(name: str) -> Target:
    """Ask a reader of one format, then let it read, without the bookkeeping of a run; rows must be as it declares."""
    key = f"reader.{name}"

    def attempt(path: Path) -> None:
        reader = registry().get(key)
        assert isinstance(reader, Reader)
        assert reader.sniff is not None
        reader.sniff(path, b"" if path.is_dir() else path.read_bytes()[:HEAD_BYTES])
        params = reader.params(**_GIVEN.get(name, {}))
        declared = reader.outputs({}, params)
        for stream, table in reader.run(path=path, params=params).items():
            home = stream if stream in declared else unnumbered(stream)
            conform(table, declared[home], stream=stream, step=key).validate(full=True)

    return Target(LOGS[name], attempt)


_MAPPING: Final = Override.from_data("reader.csv.columns", COLUMNS)
_CHANNELS: Final = Override.from_data("reader.mf4.channels", measurement_logs.CHANNELS)
_FOUR_COLUMNS: Final = Override.from_data("reader.physycom.sensor", "accelerometer")
TARGETS: Final[dict[str, Target]] = {
    "physycom": Target(physycom_samples, read_by("reader.physycom", _FOUR_COLUMNS)),
    "csv": Target(csv_samples, read_by("reader.csv", _MAPPING)),
    "yaml": Target(yaml_samples, validate),
    "parquet": Target(parquet_samples, read_by("reader.parquet")),
    "mcap": Target(mcap_samples, read_by("reader.mcap")),
    **{name: logger_target(name) for name in LOGS},
    "sensor_logger": Target(sensor_logger_samples, read_by("reader.sensor_logger")),
    "phyphox": Target(phyphox_samples, read_by("reader.phyphox")),
    "gnsslogger": Target(gnsslogger_samples, read_by("reader.gnsslogger")),
    "foreign_mcap": Target(foreign_mcap_samples, read_by("reader.mcap")),
    "rosbag": Target(rosbag_samples, read_by("reader.rosbag")),
    "mf4": Target(mf4_samples, read_by("reader.mf4", _CHANNELS)),
    "ulog": Target(ulog_samples, read_by("reader.ulog")),
    "ardupilot": Target(ardupilot_samples, read_by("reader.ardupilot")),
    "comma2k19": Target(comma2k19_samples, read_by("reader.comma2k19")),
    "navego": Target(navego_samples, read_by("reader.navego")),
    "edr_csv": Target(edr_csv_samples, read_by("reader.edr_csv")),
    "frames": Target(frames_samples, read_by("reader.frames")),
}
