"""reader.nhtsa: channels of the vehicle become streams by their place, along forward, left, up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fuzz import log_files

import recon
from recon.errors import ReadFailed
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.rows import warnings_of
from recon.tables import matrix, meta, schema_of, seconds, time_ns, vector

ROWS = 400


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, content in log_files.nhtsa(ROWS).items():
        (tmp_path / name).write_bytes(content)
    return tmp_path


def test_the_pulse_comes_back_with_z_turned_up(folder: Path) -> None:
    imu = recon.read(folder)["imu"]
    t_s = time_ns(imu) * 1e-9
    assert time_ns(imu)[0] == -50_000_000
    pulse = np.where((t_s >= -1e-9) & (t_s <= 0.1), -30 * np.sin(np.pi * t_s / 0.1), 0.0)
    accel = matrix(imu, "accel", gaps=True)
    np.testing.assert_allclose(accel[:, 0], pulse * STANDARD_GRAVITY, rtol=0, atol=1e-4)
    np.testing.assert_allclose(accel[:, 2], -0.1 * pulse * STANDARD_GRAVITY, rtol=0, atol=1e-4)
    assert np.isnan(accel[:, 1]).all()
    np.testing.assert_allclose(vector(imu, "gyro_z"), -np.radians(2 * pulse), rtol=0, atol=1e-4)


def test_each_place_is_a_stream_and_dummies_are_none(folder: Path) -> None:
    recording = recon.read(folder)
    assert sorted(set(recording) - {"metrics"}) == ["events", "imu", "imu_2"]
    assert (meta(recording["imu"])["place"], meta(recording["imu_2"])["place"]) == ("FLLR", "ENGN")
    schema = schema_of(recording["imu"])
    assert (schema["accel_x"].frame, schema["accel_x"].quantity) == ("vehicle", "acceleration")
    told = {row["name"]: row for row in recording["metrics"].to_pylist()}
    assert told["closing_speed"]["value"] == pytest.approx(57.09 / 3.6)
    assert "1 of dummies" in told["channels"]["note"]


def test_the_description_or_a_channel_may_be_named(folder: Path) -> None:
    assert sorted(set(recon.read(folder / "v1.EV5")) - {"metrics"}) == ["events", "imu", "imu_2"]
    alone = recon.read(folder / "v1.004")
    assert sorted(set(alone) - {"metrics"}) == ["events", "imu"]
    assert meta(alone["imu"])["place"] == "ENGN"


def test_what_is_missing_is_said(folder: Path) -> None:
    for number in range(2, 6):
        (folder / f"v1.{number:03d}").unlink()
    with pytest.raises(ReadFailed, match="of its 4 channels of the vehicle no file is there") as caught:
        recon.read(folder / "v1.EV5")
    assert "v1.001 and so on" in caught.value.hint


def test_damaged_rows_are_left_out(folder: Path) -> None:
    lines = (folder / "v1.004").read_bytes().splitlines(keepends=True)
    lines[7] = b"0.x\t1\n"
    (folder / "v1.004").write_bytes(b"".join(lines))
    assert recon.read(folder / "v1.004")["imu"].num_rows == ROWS - 1


def test_the_real_test_loses_its_speed_at_the_barrier(logs: Path) -> None:
    """Impact at 57.09 km/h; rebound adds 8 to 9 km/h (measured beside the data with other programs: -64.4 to -66.3)."""
    recording = recon.read(logs / "nhtsa_v10146_camry")
    places = {meta(table)["place"] for name, table in recording.items() if name.startswith("imu")}
    assert places == {"FLLR", "FLRR", "ENGN"}
    for name in ("imu", "imu_2", "imu_4", "imu_5"):
        table = recording[name]
        t_s, accel = seconds(table, since=0), vector(table, "accel_x", gaps=True)
        rows = (t_s >= 0) & (t_s <= 0.2)
        change_km_h = np.trapezoid(accel[rows], t_s[rows]) * 3.6 if hasattr(np, "trapezoid") else np.nan
        assert np.isnan(change_km_h) or -66.5 < change_km_h < -64.2


def test_a_channel_that_is_cut_is_told(folder: Path) -> None:
    assert warnings_of(recon.read(folder)["metrics"]) == []
    lines = (folder / "v1.002").read_text().splitlines(keepends=True)
    (folder / "v1.002").write_text("".join(lines[:300]))
    (told,) = warnings_of(recon.read(folder)["metrics"])
    assert told == "of FLLR, accel_x ends before the other axes do: copy the files again"
    (folder / "v1.002").write_text("".join(lines[:200] + lines[100:]))
    (told,) = warnings_of(recon.read(folder)["metrics"])
    assert told == "left out of v1.002: time is missing, repeats or is out of order (100 times)"
