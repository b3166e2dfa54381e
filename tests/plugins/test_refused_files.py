"""What is no log is refused by every reader in one sentence with what to do, whatever it is called."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from recon import Pipeline, Registry
from recon.api import execute
from recon.errors import DataError
from recon.overrides import Override
from recon.stages import Reader

REGISTRY = Registry.installed()
READERS = REGISTRY.names(Reader.role)
NO_LOGS = {
    "empty.txt": b"",
    "byte.mp4": b"\0",
    "blank.csv": b"\n",
    "zeros.bin": bytes(1000),
    "random.mf4": np.random.default_rng(1).bytes(3000),
    "packed.nmea": gzip.compress(b"$GPRMC,," * 100),
    "wide.nmea": "$GPRMC,193304,A\n".encode("utf-16"),
    "report.bag": b"%PDF-1.7\n%\xe2\xe3\xcf\xd3\n" + bytes(range(256)),
}

MAPPING = {"imu": {"time": {"column": 1, "format": "relative"}, "accel": {"columns": [2, 3, 4], "unit": "g"}}}
"""Without one reader.csv asks for it, whatever the file is."""


@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_log_is_refused(tmp_path: Path, reader: str) -> None:
    folder = tmp_path / "folder.bag"
    folder.mkdir()
    places = [folder, tmp_path / "absent.txt"]
    for name, content in NO_LOGS.items():
        places.append(tmp_path / name)
        places[-1].write_bytes(content)
    told = [Override.from_data("reader.csv.columns", MAPPING)] if reader == "reader.csv" else []
    for place in places:
        with pytest.raises(DataError) as caught:
            execute(Pipeline.of("read", reader), place, None, told, registry=REGISTRY)
        assert place.name in str(caught.value)
