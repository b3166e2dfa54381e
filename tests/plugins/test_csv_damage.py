"""Damaged tables give rows or an error that says what is wrong."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest
from csv_logs import BOTH, drive, params_of
from metric_rows import rows_named

from recon.errors import DataError
from recon.tables import Streams, time_ns
from recon_readers.csv import propose, read, sniff

FUZZED = 200


def damaged(text: bytes, chance: random.Random) -> bytes:
    """One to four changes: cut off, flip bits, delete, duplicate, or put in bytes that mean something."""
    data = bytearray(text)
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(data) or 1)
        span = chance.randint(1, 200)
        match chance.randrange(5):
            case 0:
                del data[at:]
            case 1 if data:
                data[at] ^= 1 << chance.randrange(8)
            case 2:
                del data[at : at + span]
            case 3:
                data[at:at] = data[at : at + span]
            case _:
                data[at:at] = chance.choice(
                    [b'"', b"\n", b",", b";", b"\t", b"1e999", b"\0", b"nan", b"#", b"\r", b"-"]
                )
    return bytes(data)


def outcome(path: Path) -> tuple[Streams, DataError | None]:
    try:
        return read(path=path, params=params_of(BOTH)), None
    except DataError as error:
        return {}, error


@pytest.mark.parametrize("seed", range(FUZZED))
def test_a_damaged_text_gives_rows_or_an_error_of_ours(tmp_path: Path, seed: int) -> None:
    chance = random.Random(seed)
    text = drive(60, 10, blank=bool(seed % 2))
    if seed % 3 == 0:
        text = text.replace(",", "\t" if seed % 2 else ";")
    if seed % 5 == 0:
        text = text.replace("\n", '\t"a\nb"\n' if "\t" in text else ',"a\nb"\n')
    path = tmp_path / "log.csv"
    path.write_bytes(damaged(text.encode(), chance))
    streams, error = outcome(path)
    if error is not None:
        assert error.hint
        assert "\n" not in error.message
    else:
        for name in streams.keys() - {"metrics"}:
            assert (np.diff(time_ns(streams[name])) > 0).all()
        (total,) = rows_named(streams, "rows_read")
        for row in rows_named(streams, "rows_used"):
            assert row["value"] <= total["value"]
    sniff(path, path.read_bytes()[:65536])
    text_or_none = propose([path])
    if text_or_none is not None:
        params_of(text_or_none)
