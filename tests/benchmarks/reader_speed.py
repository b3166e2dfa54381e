"""How fast reader.nmea and reader.ubx are beside the libraries that parse the same bytes one message at a time.

    python tests/benchmarks/reader_speed.py

Both read the drive of the test suite, once for each hour of a day; pynmeagps and pyubx2 parse alone, without making
columns. Processor time.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

from pynmeagps import NMEAReader
from pyubx2 import UBXReader

sys.path.append(str(Path(__file__).parents[1] / "fuzz"))
import log_files

import recon_readers.nmea
import recon_readers.ubx
from recon_readers.nmea import NmeaParams
from recon_readers.ubx import UbxParams

ROWS = 250


def processor_s(work: Callable[[], object]) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start


def nmea_of_a_day() -> bytes:
    lines = [line[1:].partition("*")[0].split(",") for line in log_files.nmea(ROWS).decode().split()]
    timed = [line[0][2:] in ("GGA", "GST", "RMC") for line in lines]
    texts = [
        ",".join([line[0], f"{hour:02d}{line[1][2:]}" if has_time else line[1], *line[2:]])
        for hour in range(24)
        for line, has_time in zip(lines, timed, strict=True)
    ]
    return "".join(log_files.sentence(text) + "\r\n" for text in texts).encode()


def ubx_of_a_day() -> bytes:
    payloads = [log_files.nav_pvt(log_files.gnss(ROWS), row)[6:-2] for row in range(ROWS)]
    return b"".join(
        log_files.message(1, 7, payload[:8] + bytes([hour]) + payload[9:]) for hour in range(24) for payload in payloads
    )


def main() -> None:
    made = {"nmea": nmea_of_a_day(), "ubx": ubx_of_a_day()}
    with tempfile.TemporaryDirectory() as folder:
        paths = {name: Path(folder, f"drive.{name}") for name in made}
        for name, path in paths.items():
            path.write_bytes(made[name])
        nmea, ubx = paths["nmea"], paths["ubx"]
        recon_readers.nmea.read(nmea, NmeaParams())  # what is imported when used is not counted
        own = {
            "nmea": processor_s(lambda: recon_readers.nmea.read(nmea, NmeaParams())),
            "ubx": processor_s(lambda: recon_readers.ubx.read(ubx, UbxParams())),
        }
    library = {
        "nmea": processor_s(lambda: [None for _ in NMEAReader(BytesIO(made["nmea"]))]),
        "ubx": processor_s(lambda: [None for _ in UBXReader(BytesIO(made["ubx"]), protfilter=2)]),
    }
    for name, theirs in library.items():
        size = len(made[name]) / 1e6
        print(
            f"{name}: {size:.1f} MB, library {theirs:.2f} s, reader {own[name]:.2f} s, {theirs / own[name]:.0f} times"
        )


if __name__ == "__main__":
    main()
