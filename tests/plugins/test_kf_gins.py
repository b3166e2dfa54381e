"""reader.kf_gins: increments become rates, forward right down becomes forward left up. No real file was at hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fuzz import log_files

import recon
from recon import Recording
from recon.errors import ReadFailed
from recon.numerics.gnss_time import GPS_EPOCH_NS, NS, WEEK_NS
from recon.numerics.rotation import to_euler
from recon.rows import warnings_of
from recon.tables import matrix, meta, time_ns, vector


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, content in log_files.kf_gins().items():
        (tmp_path / name).write_bytes(content)
    return tmp_path


def test_increments_become_the_rates_they_were_made_of(folder: Path) -> None:
    imu, truth = recon.read(folder)["imu"], log_files.imu(1200).slice(1)
    assert imu.num_rows == truth.num_rows  # of the first increment the step is not known
    # 12 decimals of an increment over 10 ms, and times of 6 decimals
    np.testing.assert_allclose(matrix(imu, "accel"), matrix(truth, "accel"), rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(matrix(imu, "gyro"), matrix(truth, "gyro"), rtol=1e-4, atol=1e-9)
    first = GPS_EPOCH_NS + log_files.WEEK * WEEK_NS + (100_000 - 18) * NS
    assert time_ns(imu)[0] == first + 10_000_000  # in the middle of the step, as it was made
    assert meta(imu)["axes"] == "FRD"


def test_positions_and_reference_come_back(folder: Path) -> None:
    recording, truth = recon.read(folder), log_files.gnss()
    for name in ("gnss", "reference"):
        np.testing.assert_allclose(vector(recording[name], "lat"), vector(truth, "lat"), rtol=0, atol=0.51e-9)
        assert np.diff(time_ns(recording[name])).tolist() == np.diff(time_ns(truth)).tolist()
    assert matrix(recording["gnss"], "pos_std")[0].tolist() == [0.02, 0.01, 0.03]  # east, north, up
    yaw = to_euler(matrix(recording["reference"], "q"))[0]
    course = vector(truth, "course")
    np.testing.assert_allclose(np.cos(yaw), np.sin(course), rtol=0, atol=np.radians(0.51e-5))


def test_a_file_alone_asks_for_the_week(folder: Path) -> None:
    alone = recon.read(folder / "imu.txt")
    assert meta(alone["imu"])["clock"] == "relative"
    assert "set reader.kf_gins.week" in warnings_of(alone["metrics"])[0]
    dated = recon.read(folder / "imu.txt", **{"reader.kf_gins.week": log_files.WEEK})
    assert dated["imu"].equals(recon.read(folder)["imu"])


def test_each_file_is_known_by_what_it_holds(folder: Path) -> None:
    def streams(recording: Recording) -> list[str]:
        return sorted(set(recording) - {"metrics"})

    found = {name: streams(recon.read(folder / name)) for name in log_files.kf_gins()}
    assert found == {"imu.txt": ["imu"], "gnss.pos": ["gnss"], "truth.nav": ["reference"]}


def test_velocities_may_follow_the_positions(tmp_path: Path) -> None:
    row = "100000.0 30.5 114.5 20.0 0.01 0.02 0.03 1.0 2.0 -0.5 0.1 0.2 0.3\n"
    (tmp_path / "gnss.pos").write_text("".join(row.replace("100000", f"10000{n}") for n in range(4)))
    gnss = recon.read(tmp_path / "gnss.pos")["gnss"]
    assert matrix(gnss, "vel")[0].tolist() == [2.0, 1.0, 0.5]
    assert matrix(gnss, "vel_std")[0].tolist() == [0.2, 0.1, 0.3]


def test_time_goes_on_into_the_next_week(tmp_path: Path) -> None:
    rows = [f"{second:.1f} 30.5 114.5 20.0 0.01 0.02 0.03\n" for second in (604_799.0, 604_799.5, 0.0, 0.5)]
    (tmp_path / "gnss.pos").write_text("".join(rows))
    gnss = recon.read(tmp_path / "gnss.pos", **{"reader.kf_gins.week": 1930})["gnss"]
    assert set(np.diff(time_ns(gnss)).tolist()) == {500_000_000}


def test_a_gap_has_no_rate(folder: Path) -> None:
    lines = (folder / "imu.txt").read_bytes().splitlines(keepends=True)
    (folder / "imu.txt").write_bytes(b"".join(lines[:400] + lines[500:]))
    imu = recon.read(folder / "imu.txt")["imu"]
    assert imu.num_rows == 1200 - 100 - 2  # the first row and the one behind the gap have no step
    assert np.abs(matrix(imu, "accel")).max() < 50


def test_damaged_rows_are_left_out_and_counted(folder: Path) -> None:
    lines = (folder / "gnss.pos").read_bytes().splitlines(keepends=True)
    lines[5] = lines[5].replace(b".", b"x", 2)
    (folder / "gnss.pos").write_bytes(b"".join(lines))
    recording = recon.read(folder / "gnss.pos")
    assert recording["gnss"].num_rows == log_files.GNSS_ROWS - 1
    assert any("the first in line 6" in text for text in warnings_of(recording["metrics"]))


def test_another_table_is_no_table_of_kf_gins(tmp_path: Path) -> None:
    rates = "".join(f"{0.01 * n:.2f} 0.1 0.2 0.3 0.0 0.1 9.8\n" for n in range(20))  # rates, not increments
    for text in ("1 2 3 4 5 6 7\n5 3 4 1 2 3 4\n", rates):
        (tmp_path / "other.txt").write_text(text)
        with pytest.raises(ReadFailed, match="no reader knows this file"):
            recon.read(tmp_path / "other.txt")


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: b"",
        lambda data: b"\n\n",
        lambda data: b'"' + data.replace(b"\n", b'"\n"'),
        lambda data: data.decode().encode("utf-16"),
        lambda data: data.replace(b".", b","),
        lambda data: data.replace(b"\n", b" 1.0\n"),
    ],
    ids=["empty", "blank", "quoted", "UTF-16", "decimal comma", "another column"],
)
def test_a_table_of_the_folder_that_is_not_known_is_named(folder: Path, spoil: object) -> None:
    (folder / "imu.txt").write_bytes(spoil((folder / "imu.txt").read_bytes()))  # type: ignore[operator]
    (folder / "readme.txt").write_text("What was driven\n10 minutes of town\nby night\n")
    recording = recon.read(folder)
    assert "imu" not in recording
    (told,) = [text for text in warnings_of(recording["metrics"]) if "is not read" in text]
    assert told.startswith("imu.txt is not read, for it is no table of KF-GINS")
