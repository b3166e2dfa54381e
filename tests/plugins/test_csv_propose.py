"""Mappings that are proposed for tables that no reader knows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from csv_logs import params_of

from recon_readers.csv import propose, read


def proposed(folder: Path, text: str, name: str = "log.csv") -> str:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    found = propose([path])
    assert found is not None
    params_of(found)
    return found


@pytest.mark.parametrize(
    ("unit", "size", "expected"),
    [("m/s^2", 9.8, "unit: m/s^2}"), ("g", 1.0, "unit: g}"), ("", 16384.0, "scale: 6.103515625e-05")],
)
def test_units_of_accelerometers_are_told_by_gravity(tmp_path: Path, unit: str, size: float, expected: str) -> None:
    text = "t,ax,ay,az\n" + "".join(f"{i / 100},0,{size / 50},{size}\n" for i in range(50))
    assert expected in proposed(tmp_path, text)


@pytest.mark.parametrize(("z", "axes"), [(9.8, "FLU"), (-9.8, "FRD")])
def test_axes_are_a_guess_to_be_checked(tmp_path: Path, z: float, axes: str) -> None:
    text = "t,ax,ay,az\n" + "".join(f"{i / 100},0,0,{z}\n" for i in range(50))
    assert f"axes: {axes}  # check" in proposed(tmp_path, text)


@pytest.mark.parametrize(
    ("first", "step", "expected"),
    [
        (1_700_000_000, 1, "format: unix}"),
        (1_700_000_000_000, 10, "format: unix, unit: ms}"),
        (1_700_000_000_000_000, 10_000, "format: unix, unit: us}"),
        (1_700_000_000_000_000_000, 10_000_000, "format: unix, unit: ns}"),
        (0, 10, "format: relative, unit: ms}"),
        (0, 0.01, "format: relative, unit: s}"),
    ],
)
def test_times_are_told_by_their_size(tmp_path: Path, first: float, step: float, expected: str) -> None:
    text = "t,ax,ay,az\n" + "".join(f"{first + i * step},0,0,9.8\n" for i in range(50))
    assert expected in proposed(tmp_path, text)


@pytest.mark.parametrize(("factor", "unit"), [(1.0, "m/s"), (3.6, "km/h"), (1 / 0.44704, "mph"), (1.943844, "kn")])
def test_the_unit_of_a_speed_is_told_by_the_positions(tmp_path: Path, factor: float, unit: str) -> None:
    speed = 10.0
    step = np.rad2deg(speed / 6_371_000.0)
    rows = "".join(f"{i},{44.5 + step * i:.8f},11.3,{speed * factor:.4f}\n" for i in range(100))
    assert f"unit: {unit}}}" in proposed(tmp_path, "time,latitude,longitude,speed\n" + rows)


@pytest.mark.parametrize(
    ("columns", "axes"),
    [
        (("vn", "ve", "vd"), "NED"),
        (("vel_e", "vel_n", "vel_u"), "ENU"),
        (("Velocity North (m/s)", "Velocity East (m/s)", "Velocity Down (m/s)"), "NED"),
    ],
)
def test_velocities_along_the_axes_of_the_earth_are_no_speeds(
    tmp_path: Path, columns: tuple[str, str, str], axes: str
) -> None:
    rows = "".join(f"{i},{44.5 + 1e-4 * i:.8f},11.3,{i % 7},{i % 5},0.5\n" for i in range(100))
    found = proposed(tmp_path, f"time,latitude,longitude,{','.join(columns)}\n{rows}")
    assert f"axes: {axes}}}  # by the names" in found
    gnss = read(path=tmp_path / "log.csv", params=params_of(found))["gnss"]
    assert "speed" not in gnss.column_names
    first, second = 5 % 7, 5 % 5
    east, north = (second, first) if axes == "NED" else (first, second)
    up = -0.5 if axes == "NED" else 0.5
    assert [gnss[f"vel_{axis}"][5].as_py() for axis in "enu"] == [east, north, up]


def test_names_that_yaml_would_misread_are_quoted(tmp_path: Path) -> None:
    header = 'Time (s),"Acceleration: x, (m/s^2)","Acceleration: y, (m/s^2)","Acceleration: z, (m/s^2)"\n'
    text = header + "".join(f"{i / 100},0,0,9.8\n" for i in range(50))
    found = proposed(tmp_path, text)
    assert read(path=tmp_path / "log.csv", params=params_of(found))["imu"].num_rows == 50


def test_nothing_is_proposed_where_nothing_tells_the_time(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("a,b\n1,2\n3,1\n2,2\n", encoding="utf-8")
    assert propose([tmp_path / "a.csv"]) is None
