"""reader.rtklib: every form of time and place that RTKLIB writes, and its sigmas."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fuzz import log_files

import recon
import recon_readers.rtklib
from recon import Streams
from recon.errors import ReadFailed
from recon.numerics.geodesy import geodetic_to_ecef
from recon.parameters import NoParams
from recon.tables import has, matrix, meta, time_ns, vector


def read(folder: Path, text: bytes | str) -> Streams:
    path = folder / "solution.pos"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return recon_readers.rtklib.read(path, NoParams())


TITLE = "%  GPST   latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)\n"
TAIL = "1  12 0.01 0.02 0.03\n"


def test_a_drive_comes_back_as_it_was_written(tmp_path: Path) -> None:
    gnss, truth = read(tmp_path, log_files.rtklib())["gnss"], log_files.gnss()
    np.testing.assert_array_equal(time_ns(gnss), time_ns(truth))
    for name, half_digit in (("lat", 0.51e-9), ("lon", 0.51e-9), ("height", 0.51e-4)):
        np.testing.assert_allclose(vector(gnss, name), vector(truth, name), rtol=0, atol=half_digit)
    assert matrix(gnss, "pos_std")[0].tolist() == [0.0202, 0.0101, 0.0303]  # east, north, up
    assert matrix(gnss, "vel_std")[0].tolist() == [0.02, 0.01, 0.03]
    course = np.arctan2(*matrix(gnss, "vel")[:, :2].T)
    np.testing.assert_allclose(np.mod(course, 2 * np.pi), vector(truth, "course"), atol=1e-5)  # 1e-5 m/s of 1 m/s


@pytest.mark.parametrize("time", ["2025/08/28 17:30:39.749", "2381 408639.749"])
def test_gps_time_becomes_utc_from_a_date_or_a_week(tmp_path: Path, time: str) -> None:
    gnss = read(tmp_path, f"{TITLE}{time} 40.1 -105.1 1601.4 {TAIL}")["gnss"]
    assert time_ns(gnss)[0] == np.datetime64("2025-08-28T17:30:21.749", "ns").astype(np.int64)  # 18 leap seconds


def test_japanese_time_is_nine_hours_ahead(tmp_path: Path) -> None:
    gnss = read(tmp_path, TITLE.replace("GPST", "JST") + f"2025/08/29 02:30:21.749 40.1 -105.1 1601.4 {TAIL}")["gnss"]
    assert time_ns(gnss)[0] == np.datetime64("2025-08-28T17:30:21.749", "ns").astype(np.int64)


def test_degrees_minutes_seconds_and_ecef_give_the_same_place(tmp_path: Path) -> None:
    lat, lon, height = -33.512345678, -70.123456789, 520.5
    sexagesimal = f"-33 30 44.4444408 -70 7 24.4444404 {height}"
    x, y, z = geodetic_to_ecef(lat, lon, height)
    forms = {
        TITLE.replace("(deg)", "(d'\")"): sexagesimal,
        TITLE.replace("latitude(deg) longitude(deg)  height(m)", "x-ecef(m) y-ecef(m) z-ecef(m)"): f"{x} {y} {z}",
    }
    for title, place in forms.items():
        gnss = read(tmp_path, f"{title}2025/08/28 17:30:39.749 {place} {TAIL}")["gnss"]
        found = [vector(gnss, name)[0] for name in ("lat", "lon", "height")]
        assert found == pytest.approx([lat, lon, height], abs=1e-9)


def test_a_baseline_has_no_place_on_the_earth(tmp_path: Path) -> None:
    title = TITLE.replace("latitude(deg) longitude(deg)  height(m)", "e-baseline(m) n-baseline(m) u-baseline(m)")
    gnss = read(tmp_path, f"{title}2025/08/28 17:30:39.749 1.5 2.5 -0.5 {TAIL}")["gnss"]
    assert matrix(gnss, "pos").tolist() == [[1.5, 2.5, -0.5]]
    assert not has(gnss, "lat")


def test_commas_may_part_the_columns(tmp_path: Path) -> None:
    row = "2025/08/28 17:30:39.749,40.1,-105.1,1601.4,1,12,0.01,0.02,0.03\n".replace(" ", ",", 1)
    assert vector(read(tmp_path, TITLE + row)["gnss"], "height")[0] == 1601.4


def test_heights_above_the_geoid_are_told_by_the_header(tmp_path: Path) -> None:
    row = f"2025/08/28 17:30:39.749 40.1 -105.1 1601.4 {TAIL}"
    assert meta(read(tmp_path, TITLE + row)["gnss"])["height_datum"] == "ellipsoid"
    geodetic = "% (lat/lon/height=WGS84/geodetic,Q=1:fix)\n" + TITLE
    assert meta(read(tmp_path, geodetic + row)["gnss"])["height_datum"] == "mean_sea_level"


def test_a_file_without_its_header_names_what_it_needs(tmp_path: Path) -> None:
    with pytest.raises(ReadFailed, match="no comment names its columns") as caught:
        read(tmp_path, f"% nothing\n2025/08/28 17:30:39.749 40.1 -105.1 1601.4 {TAIL}")
    assert "out-outhead" in caught.value.hint


def test_damaged_rows_are_left_out_and_counted(tmp_path: Path) -> None:
    lines = log_files.rtklib().splitlines(keepends=True)
    lines[8], lines[12] = lines[8].replace(b".", b"?", 3), lines[12][:40] + b"\n"
    streams = read(tmp_path, b"".join(lines))
    assert streams["gnss"].num_rows == log_files.GNSS_ROWS - 2
    (skipped,) = [row for row in streams["metrics"].to_pylist() if row["name"] == "lines_skipped"]
    assert (skipped["value"], skipped["note"]) == (2.0, "damaged, the first in line 9")


def test_the_real_solution_agrees_with_the_receiver(logs: Path) -> None:
    """The walk's solution against NAV-PVT of the same receiver: the same times, places within its sigmas."""
    folder = logs / "rtklibexplorer_walk"
    solution, receiver = (recon.read(folder / name)["gnss"] for name in ("gnss_1730_sf.pos", "gnss_1730.ubx"))
    assert solution.num_rows == receiver.num_rows == 536
    assert np.abs(time_ns(solution) - time_ns(receiver)).max() < 1_000_000
    metres = np.column_stack([(vector(solution, n) - vector(receiver, n)) * 1.1e5 for n in ("lat", "lon")])
    assert np.median(np.abs(metres)) < 0.05
    (fixed,) = [
        row["value"] for row in recon.read(folder / "gnss_1730_sf.pos")["metrics"].to_pylist() if row["name"] == "fixed"
    ]
    assert fixed == pytest.approx(349 / 536)
