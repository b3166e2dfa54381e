"""How long a result takes to write and to read, and how large it is, by the kind of file.

    python tests/benchmarks/storage.py [--rows 100000] [--repeats 3]

The stream `trajectory` of a simulated drive, all of its columns. The road of the thesis is text written and read line
by line, with 15 digits lest numbers change; `delimited text` is the same text through Arrow. Each way is read back and
compared: all but text keep every bit. Medians; the last column is the ratio of both times to the thesis' road.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv

import recon
from recon.recording import Recording
from recon.storage import read_recording, write_recording
from recon.tables import matrix


def numbers_of(table: pa.Table) -> np.ndarray:
    """All columns but time as (n, k), and time in s as the first."""
    seconds = np.asarray(table["time"].cast(pa.int64())) * 1e-9
    others = [np.asarray(table[name]) for name in table.column_names if name != "time"]
    return np.column_stack([seconds, *others])


def write_lines(numbers: np.ndarray, path: Path) -> None:
    """Text, a line at a time."""
    with path.open("w", encoding="ascii") as file:
        for row in numbers:
            file.write("\t".join(f"{value:.15g}" for value in row) + "\n")


def read_lines(path: Path) -> np.ndarray:
    """Text, a line at a time."""
    with path.open(encoding="ascii") as file:
        return np.array([[float(word) for word in line.split("\t")] for line in file])


def write_hdf5(numbers: np.ndarray, path: Path) -> None:
    """A data set for each column, as exporter.hdf5 compresses them."""
    import h5py

    with h5py.File(path, "w") as file:
        for index, column in enumerate(numbers.T):
            file.create_dataset(
                str(index), data=column, compression="gzip", compression_opts=1, shuffle=True, chunks=True
            )


def read_hdf5(path: Path) -> np.ndarray:
    """All data sets."""
    import h5py

    with h5py.File(path) as file:
        return np.column_stack([file[str(index)][:] for index in range(len(file))])


def stored(kind: str) -> tuple[Callable[[pa.Table, Path], object], Callable[[Path], object]]:
    """recon's own storage."""
    return (
        lambda table, path: write_recording(Recording({"trajectory": table}), path, kind),
        lambda path: read_recording(path)["trajectory"],
    )


def timed(work: Callable[[], object], repeats: int) -> float:
    """Median time of some calls, s."""
    taken = []
    for _ in range(repeats):
        begun = time.perf_counter()
        work()
        taken.append(time.perf_counter() - begun)
    return float(np.median(taken))


def size_of(path: Path) -> float:
    """MB of a file or of all files in a folder."""
    files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
    return sum(file.stat().st_size for file in files) / 1e6


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=100_000)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    made = recon.run("simulated_drive", **{"simulator.drive.duration": f"{options.rows / 100} s"}).recording
    fused = recon.run("best_accuracy", made).recording["trajectory"].slice(0, options.rows)
    assert np.isfinite(matrix(fused, "pos")).all()
    numbers = numbers_of(fused)
    plain = pa.table({str(index): column for index, column in enumerate(numbers.T)})
    ways = {
        "text, line by line": (lambda path: write_lines(numbers, path), read_lines),
        "delimited text": (
            lambda path: pa.csv.write_csv(plain, path), lambda path: pa.csv.read_csv(path)
        ),
        "HDF5, gzip": (lambda path: write_hdf5(numbers, path), read_hdf5),
        "MCAP": (lambda path: stored("mcap")[0](fused, path), stored("mcap")[1]),
        "Parquet": (lambda path: stored("parquet")[0](fused, path), stored("parquet")[1]),
    }  # fmt: skip
    print(f"{'':20s}  {'write, s':>8}  {'read, s':>8}  {'MB':>7}  {'times faster':>12}")
    slowest = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for name, (write, read) in ways.items():
            repeats = 1 if "line by" in name else options.repeats
            paths = iter([Path(folder) / f"{name}-{number}" for number in range(repeats)])
            written = timed(lambda: write(next(paths)), repeats)  # noqa: B023 - called at once
            path = Path(folder) / f"{name}-0"
            taken = timed(lambda: read(path), repeats)  # noqa: B023
            slowest = slowest or written + taken
            print(
                f"{name:20s}  {written:8.3f}  {taken:8.3f}  {size_of(path):7.1f}  {slowest / (written + taken):12.0f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
