"""Memory and time of reading large logs, each in a process of its own, against the size of what was read.

    python tests/benchmarks/reading.py [KIND ...] [--size 5e7 5e8]     2e9 by asking for it
    python tests/benchmarks/reading.py camera_bag camera_mcap camera_sqlite --size 1e10

Each log is one sensor or two at a usual rate, as `reading_logs.py`, `reading_text_logs.py` and `reading_binary_logs.py`
write them. The logs with a camera have images of 50 MB, which are holes in the file but in SQLite.

Peak is what the process holds at most beyond what it holds after it has read a small log of the same kind; what a
process holds at most that it started (MDF) stands beside it. Both are told by Linux only.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import reading_binary_logs as binaries
import reading_logs as logs
import reading_text_logs as texts

CSV = {
    "imu": {
        "time": {"column": "t", "format": "unix", "unit": "ns"},
        "accel": {"columns": ["ax", "ay", "az"], "unit": "m/s^2"},
        "gyro": {"columns": ["gx", "gy", "gz"], "unit": "rad/s"},
    }
}
MF4 = {
    "imu": {
        "axes": "FLU",
        "accel": {"columns": ["AccX", "AccY", "AccZ"], "unit": "m/s^2"},
        "gyro": {"columns": ["RateX", "RateY", "RateZ"], "unit": "rad/s"},
    }
}
KINDS = {
    "csv": (logs.write_csv, "drive.csv", {"reader.csv.columns": CSV}),
    "physycom": (logs.write_physycom, "drive.txt", {}),
    "nmea": (logs.write_nmea, "drive.nmea", {}),
    "vbox": (texts.write_vbox, "drive.vbo", {"reader.vbox.axes": "FLU"}),
    "rtklib": (texts.write_rtklib, "drive.pos", {}),
    "kf_gins": (texts.write_kf_gins, "imu.txt", {}),
    "kitti": (texts.write_kitti, "drive", {}),
    "nhtsa": (texts.write_nhtsa, "v1.EV5", {}),
    "novatel": (texts.write_novatel, "drive.log", {}),
    "sensor_logger": (texts.write_sensor_logger, "recording", {}),
    "phyphox": (texts.write_phyphox, "recording", {}),
    "gnsslogger": (texts.write_gnsslogger, "drive.txt", {}),
    "gpx": (texts.write_gpx, "drive.gpx", {}),
    "kml": (texts.write_kml, "drive.kml", {}),
    "mcap": (logs.write_mcap, "drive.mcap", {}),
    "bag": (logs.write_bag, "drive.bag", {}),
    "ubx": (binaries.write_ubx, "drive.ubx", {}),
    "ulog": (binaries.write_ulog, "drive.ulg", {}),
    "dataflash": (binaries.write_dataflash, "drive.bin", {}),
    "tlog": (binaries.write_tlog, "drive.tlog", {}),
    "mf4": (binaries.write_mf4, "drive.mf4", {"reader.mf4.channels": MF4}),
    "gpmf": (binaries.write_gpmf, "drive.mp4", {}),
    "sbet": (binaries.write_sbet, "drive.sbet", {}),
    "camera_bag": (logs.write_bag_with_camera, "drive.bag", {}),
    "camera_mcap": (logs.write_mcap_with_camera, "drive.mcap", {}),
    "camera_sqlite": (logs.write_sqlite_with_camera, "drive.db3", {}),
}
"""By name what writes a log, its name, and what its reader is told."""
SMALL = 2e6
"""Bytes of the log that is read first: what is imported and reserved once is not of the large one."""


def measure(kind: str, small: Path, path: Path) -> dict[str, object]:
    """Read a small log and a large one in this process."""
    import recon

    told: dict[str, Any] = KINDS[kind][2]
    recon.read(small, **told)
    helpers = [one for task in Path("/proc/self/task").iterdir() for one in (task / "children").read_text().split()]
    processes = ["self", *helpers]
    for process in processes:
        Path("/proc", process, "clear_refs").write_text("5")  # the peak counts from here
    before, start = [_resident("VmRSS", process) for process in processes], time.process_time()
    recording = recon.read(path, **told)
    took, whole = time.process_time() - start, [_resident("VmHWM", process) for process in processes]
    peak, *beside = (high - low for high, low in zip(whole, before, strict=True))
    arrow = sum(table.nbytes for table in recording.values())
    return {"peak": peak, "beside": sum(beside), "arrow": arrow, "seconds": took, "whole": whole[0]}


def _resident(name: str, process: str) -> int:
    """A line of what Linux tells of a process, in bytes."""
    lines = Path("/proc", process, "status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(name))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"of {', '.join(KINDS)}; those without a camera")
    parser.add_argument("--size", type=float, nargs="+", default=[5e7, 5e8], help="bytes of the logs")
    parser.add_argument("--read", nargs=3, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.read:
        kind, *paths = chosen.read
        print(json.dumps(measure(kind, *map(Path, paths))))
        return
    print(
        "| log | of GB | Arrow, MB | peak, MB | times Arrow | in another process, MB | with all, MB | s of one core |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for kind in chosen.kinds or [name for name in KINDS if "camera" not in name]:
        for size in chosen.size:
            print(row(kind, size), flush=True)


def row(kind: str, size: float) -> str:
    """A line of the table."""
    write, name, _ = KINDS[kind]
    with tempfile.TemporaryDirectory() as scratch:
        folders = [Path(scratch, "small"), Path(scratch, "large")]
        for folder, bytes_ in zip(folders, (SMALL, size), strict=True):
            folder.mkdir()
            write(folder / name, bytes_)
        command = [sys.executable, __file__, "--read", kind, *(str(folder / name) for folder in folders)]
        found = json.loads(subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout)
        size = sum(file.stat().st_size for file in folders[1].rglob("*") if file.is_file())
    peak, arrow = found["peak"] / 1e6, found["arrow"] / 1e6
    numbers = f"{size / 1e9:.2f} | {arrow:.0f} | {peak:.0f} | {peak / arrow:.2f}"
    told = f"{found['beside'] / 1e6:.0f} | {found['whole'] / 1e6:.0f} | {found['seconds']:.1f}"
    return f"| {kind} | {numbers} | {told} |"


if __name__ == "__main__":
    main()
