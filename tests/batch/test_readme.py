"""What the README shows of fleets is run: the batch file that is shipped, and the three queries."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import pytest

import recon
from recon.cli import main
from recon.yaml_nodes import load, load_file

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
QUERIES = re.findall(r"```sql\n(.*?)```", README, flags=re.DOTALL)
FLEET = ROOT / "pipelines" / "fleet.yaml"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fleet of simulated vehicles, a drive cut short, an empty file and one that is no drive, as the README says."""
    folder = tmp_path_factory.mktemp("fleet")
    for seed, name in enumerate(("A12/d1", "A12/d2", "B7/d1")):
        parameters = {"simulator.drive.duration": "120 s", "simulator.drive.seed": seed}
        recon.run("simulated_drive", out=folder / "drives" / name, **parameters)
    (folder / "drives/B7/notes.txt").write_text("tyres changed", encoding="utf-8")
    (folder / "drives/B7/empty.txt").touch()
    torn = shutil.copytree(folder / "drives/A12/d1", folder / "drives/B7/torn") / "streams/imu.parquet"
    torn.write_bytes(torn.read_bytes()[:20_000])
    (folder / "fleet.yaml").write_bytes(FLEET.read_bytes())
    assert main(["batch", str(folder / "fleet.yaml")]) == 6
    return folder


def rows(folder: Path, query: str, monkeypatch: pytest.MonkeyPatch) -> list[tuple]:
    duckdb = pytest.importorskip("duckdb")
    monkeypatch.chdir(folder)
    return duckdb.sql(query).fetchall()


def test_the_readme_shows_three_queries() -> None:
    assert len(QUERIES) == 3


def test_the_readme_shows_the_file_that_is_shipped() -> None:
    shown = load(re.search(r"```yaml\n(recon: 1\nbatch.*?)```", README, flags=re.DOTALL)[1], "README.md").plain()
    shipped = load_file(FLEET).plain()
    assert shown == {key: value for key, value in shipped.items() if key in shown}


def test_the_first_query_tells_outcomes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (done, *failed) = rows(folder, QUERIES[0], monkeypatch)
    assert done[:2] == ("ok", 3)
    assert done[2] == pytest.approx(3 * 120 / 3600, rel=0.01)  # a sample's length at each end is not driven
    assert sorted(failed) == [("unknown_format", 1, None, None), ("unreadable", 2, None, None)]


def test_the_second_query_tells_stops_by_vehicle(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = rows(folder, QUERIES[1], monkeypatch)
    assert sorted(row[0] for row in found) == ["A12", "B7"]
    assert all(row[3] == pytest.approx(100 * row[1] / row[2]) for row in found)


def test_the_third_query_tells_the_fastest_second(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = rows(folder, QUERIES[2], monkeypatch)
    top = {
        (vehicle, drive): recon.open(folder / f"fleet_results/vehicle={vehicle}/drive={drive}").summary()["top_speed"]
        for vehicle, drive, _ in found
    }
    assert len(found) == 3
    assert all(0.9 * top[row[0], row[1]] < row[2] / 3.6 < top[row[0], row[1]] + 0.01 for row in found)


def test_polars_and_pandas_read_what_duckdb_reads(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    pytest.importorskip("pandas")
    pytest.importorskip("polars")
    names: dict[str, Any] = {}
    exec(re.search(r"```python\n(import glob\n.*?)```", README, flags=re.DOTALL)[1], names)
    query = f"SELECT vehicle, drive, count(*) FROM '{names['trajectories']}' GROUP BY ALL ORDER BY ALL"
    expected = rows(folder, query, monkeypatch)
    assert [row[:2] for row in expected] == [("A12", "d1"), ("A12", "d2"), ("B7", "d1")]
    lazy = names["lazy"].group_by("vehicle", "drive").len().sort("vehicle", "drive").collect()
    assert lazy.rows() == expected
    sizes = names["table"].astype({"vehicle": str, "drive": str}).groupby(["vehicle", "drive"]).size()
    assert [(*key, count) for key, count in sizes.items()] == expected


def test_the_summary_names_hours_and_kilometres(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fleet", "summary", str(folder / "fleet_results")]) == 0
    shown = capsys.readouterr().out
    assert "6 of 2 vehicles: 3 done, 3 failed" in shown
    assert re.search(r"0\.1 h, \d\.\d km", shown)
