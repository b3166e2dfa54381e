"""reader.sbet: records of 17 doubles become a reference; what recon exports comes back. No real file was at hand."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from fuzz import log_files

import recon
import recon_readers.sbet
from recon import Streams
from recon.errors import ReadFailed
from recon.numerics.gnss_time import GPS_EPOCH_NS, NS, WEEK_NS
from recon.rows import warnings_of
from recon.tables import matrix, meta, time_ns, vector
from recon.testing.drives import drive
from recon_readers.sbet import SbetParams


def read(folder: Path, data: bytes, **params: object) -> Streams:
    path = folder / "sbet.out"
    path.write_bytes(data)
    return recon_readers.sbet.read(path, SbetParams(**params))


def test_a_wander_frame_is_turned_back(tmp_path: Path) -> None:
    streams, truth = read(tmp_path, log_files.sbet()), log_files.trajectory()
    reference = streams["reference"]
    np.testing.assert_allclose(vector(reference, "lat"), vector(truth, "lat"), rtol=0, atol=1e-13)
    np.testing.assert_allclose(matrix(reference, "vel"), matrix(truth, "vel"), rtol=0, atol=1e-12)
    same = np.abs(np.sum(matrix(reference, "q") * matrix(truth, "q"), axis=1))
    np.testing.assert_allclose(same, 1.0, rtol=0, atol=1e-12)
    (told,) = [row for row in streams["metrics"].to_pylist() if row["name"] == "wander_frame"]
    assert told["method"] == "x to the north, azimuth of north minus wander"
    assert told["note"] == "velocities agree with positions"


@pytest.mark.parametrize("column", [0, 4, 11])
def test_numbers_that_are_none_warn_nobody(tmp_path: Path, column: int) -> None:
    """Of times, velocities and the accelerations that are not read; two infinities have no difference."""
    records = np.frombuffer(log_files.sbet(), dtype="<f8").reshape(-1, 17).copy()
    records[20:22, column] = np.inf
    records[23:25, column] = -np.inf, np.inf
    path = tmp_path / "drive.sbet"
    path.write_bytes(records.tobytes())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rows = recon.read(path)["reference"].num_rows
    assert rows == len(records) - (4 if column < 11 else 0)


def test_where_nothing_moves_the_axes_are_assumed(tmp_path: Path) -> None:
    records = np.frombuffer(log_files.sbet()).reshape(-1, 17).copy()
    records[:, 1:7] = records[0, 1:7] * (1, 1, 1, 0, 0, 0)
    (told,) = [r for r in read(tmp_path, records.tobytes())["metrics"].to_pylist() if r["name"] == "wander_frame"]
    assert told["note"] == "assumed: the vehicle hardly moves"
    assert told["method"] == "x to the east, azimuth of north minus wander"


def test_what_recon_exports_comes_back(tmp_path: Path) -> None:
    kept = {"trajectory": drive()["trajectory"]}
    recon.run(recon.Pipeline.of("keep"), recon.Recording(kept), tmp_path / "run", exports=["sbet"])
    path = tmp_path / "run" / "exports" / "sbet" / "sbet_trajectory.out"
    first = int(time_ns(kept["trajectory"])[0])
    week = (first + 18 * NS - GPS_EPOCH_NS) // WEEK_NS
    reference = recon.read(path, **{"reader.sbet.week": week})["reference"]
    truth = kept["trajectory"]
    assert np.abs(time_ns(reference) - time_ns(truth)).max() <= 1  # a double holds s of a week to 0.1 ns
    np.testing.assert_allclose(matrix(reference, "vel"), matrix(truth, "vel"), rtol=0, atol=1e-12)
    same = np.abs(np.sum(matrix(reference, "q") * matrix(truth, "q"), axis=1))
    np.testing.assert_allclose(same, 1.0, rtol=0, atol=1e-12)


def test_the_week_is_asked_for(tmp_path: Path) -> None:
    alone = read(tmp_path, log_files.sbet())
    assert meta(alone["reference"])["clock"] == "relative"
    assert "set reader.sbet.week" in warnings_of(alone["metrics"])[0]
    dated = read(tmp_path, log_files.sbet(), week=1930)["reference"]
    utc = read(tmp_path, log_files.sbet(), week=1930, time_scale="UTC")["reference"]
    assert time_ns(utc)[0] == GPS_EPOCH_NS + 1930 * WEEK_NS + 100_000 * NS
    assert time_ns(utc)[0] - time_ns(dated)[0] == 18 * NS


def test_a_cut_record_and_records_of_nonsense_are_left_out(tmp_path: Path) -> None:
    data = log_files.sbet()
    damaged = data[: 136 * 10] + b"\xff" * 136 + data[136 * 11 : -50]
    streams = read(tmp_path, damaged)
    assert streams["reference"].num_rows == log_files.GNSS_ROWS - 2
    told = {row["name"]: row["value"] for row in streams["metrics"].to_pylist()}
    assert (told["records_left_out"], told["bytes_left_out"]) == (1.0, 86.0)


def test_what_is_no_sbet_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ReadFailed, match="only 0 of 7 records hold what SBET does"):
        read(tmp_path, np.random.default_rng(1).bytes(1000))
