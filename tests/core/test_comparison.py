"""`recon compare` and recon.comparison: runs side by side, and laid over each other."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

import recon
from recon import Recording, matrix, replace
from recon.cli import main
from recon.comparison import compare, names_of, overlay
from recon.errors import DataError
from recon.numerics.rotation import from_euler, from_rotvec, multiply
from recon.rows import Metric, metrics
from recon.storage import write_recording
from recon.tables import meta
from recon.testing.drives import drive

TRUTH = drive()["reference"].slice(0, 1500)
STEPS = "steps:\n  - use: reader.auto\n"


def made(folder: Path, name: str, *, shift: float = 0.0, bias: float = 1.0, trajectory: bool = True) -> recon.Run:
    """A run whose trajectory is the truth, some m to the east."""
    table = replace(TRUTH, pos=matrix(TRUTH, "pos") + np.array([shift, 0.0, 0.0]))
    learnt = metrics([Metric("bias", bias, "m/s^2"), Metric("bias", 7.0, "m/s^2"), Metric("warning", note="beware")])
    streams = {"trajectory" if trajectory else "reference": table, "gnss": drive()["gnss"], "metrics": learnt}
    log = folder / f"{name}-log"
    write_recording(Recording(streams), log)
    pipeline = folder / "own.yaml"
    pipeline.write_text(STEPS, encoding="utf-8")
    return recon.run(pipeline, log, folder / name)


def test_what_differs_stands_side_by_side(tmp_path):
    found = compare([made(tmp_path, "a"), made(tmp_path, "b", shift=3.0, bias=2.0)])
    assert found.runs == ("a", "b")
    results = {row.name: row for row in found.results}
    bias = next(row for name, row in results.items() if name.endswith(".bias"))
    assert (bias.unit, bias.values, bias.differs) == ("m/s^2", (1.0, 2.0), True)
    again = next(row for name, row in results.items() if name.endswith(".bias 2"))
    assert (again.values, again.differs) == ((7.0, 7.0), False)
    assert not any(name.endswith("warning") for name in results)
    assert [row.name for row in found.settings] == ["inputs"]


def test_trajectories_are_held_against_the_first(tmp_path):
    (distance,) = compare([made(tmp_path, "a"), made(tmp_path, "b", shift=3.0)]).distances
    assert distance.run == "b"
    assert distance.found is not None
    horizontal = distance.found.position["horizontal"]
    assert horizontal is not None
    assert horizontal.rmse == pytest.approx(3.0, abs=1e-9)  # positions of some 100 m in doubles


def test_another_mounting_is_told_apart_from_errors_of_attitude(tmp_path, capsys):
    def turned(name, q):
        recording = Recording({"trajectory": replace(TRUTH, q=q)})
        write_recording(recording, tmp_path / f"{name}-log")
        return recon.run(recon.Pipeline.of("own", "reader.auto"), tmp_path / f"{name}-log", tmp_path / name)

    q_nv = matrix(TRUTH, "q")
    wrong = np.random.default_rng(1).normal(0.0, np.radians(0.5), (len(q_nv), 3))
    phone = multiply(multiply(q_nv, from_euler(0.7, 0.0, 0.0)), from_rotvec(wrong))
    runs = [turned("a", q_nv), turned("phone", phone), turned("lost", multiply(q_nv, from_rotvec(60.0 * wrong)))]
    mounted, lost = (distance.found for distance in compare(runs).distances)
    assert mounted.mounting.yaw == pytest.approx(np.degrees(0.7), abs=0.1)  # 1500 errors of 0.5 deg: five sigmas
    assert mounted.mounting.left.rmse == pytest.approx(0.5 * np.sqrt(3.0), rel=0.1)
    assert mounted.attitude["heading"].rmse == pytest.approx(np.degrees(0.7), rel=0.05)
    assert lost.mounting.note == ""
    assert main(["compare", *(str(run.folder) for run in runs)]) == 0
    told = [line for line in capsys.readouterr().out.splitlines() if "stands turned" in line]
    assert len(told) == 1
    assert told[0].startswith("  phone: its body stands turned by 40.1 deg all the time (yaw 40.1, pitch")


def test_errors_of_all_runs_against_one_reference_stand_side_by_side(tmp_path, capsys):
    runs = [made(tmp_path, "a", shift=1.0), made(tmp_path, "b", shift=3.0)]
    assert compare(runs).errors == ()
    errors = compare(runs, TRUTH).errors
    assert [error.run for error in errors] == ["a", "b"]
    assert [error.found.position["horizontal"].rmse for error in errors] == pytest.approx([1.0, 3.0], abs=1e-9)
    truth = made(tmp_path, "truth", trajectory=False)
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b"), "--reference", str(truth.folder)]) == 0
    told = [line.split() for line in capsys.readouterr().out.splitlines()]
    head = next(row for row, words in enumerate(told) if words[:2] == ["rms", "error"])
    assert told[head][-2:] == ["a", "b"]
    assert told[head + 1] == ["position,", "horizontal", "[m]", "1.000", "3.000"]


def test_a_reference_that_a_run_holds_is_used(tmp_path):
    held, other = made(tmp_path, "a", trajectory=False), made(tmp_path, "b", shift=2.0)
    first, second = compare([held, other]).errors
    assert (first.found, first.reason) == (None, "no trajectory")
    assert second.found.position["horizontal"].rmse == pytest.approx(2.0, abs=1e-9)


def test_a_run_without_a_trajectory_has_no_distance(tmp_path):
    first, second = made(tmp_path, "a"), made(tmp_path, "b", trajectory=False)
    (distance,) = compare([first, second]).distances
    assert (distance.found, distance.reason) == (None, "no trajectory")
    assert list(overlay([first, second])) == ["trajectory", "gnss"]
    with pytest.raises(DataError, match="none of the runs"):
        overlay([second])


def test_one_run_is_no_comparison(tmp_path, capsys):
    with pytest.raises(DataError, match="two runs"):
        compare([made(tmp_path, "a")])
    assert main(["compare", str(tmp_path / "a")]) == 2
    assert "a comparison needs two runs" in capsys.readouterr().err


def test_runs_of_one_name_are_told_apart_by_their_folders(tmp_path):
    for part in ("x", "y"):
        (tmp_path / part).mkdir()
    assert names_of([made(tmp_path / "x", "a"), made(tmp_path / "y", "a")]) == ("x/a", "y/a")


def test_an_overlay_holds_every_trajectory_as_it_is(tmp_path):
    runs = [made(tmp_path, "a"), made(tmp_path, "b", shift=3.0)]
    found = overlay(runs)
    assert list(found) == ["trajectory", "trajectory_2", "gnss"]
    assert [meta(found[name])["run"] for name in ("trajectory", "trajectory_2")] == ["a", "b"]
    assert np.array_equal(matrix(found["trajectory_2"], "pos"), matrix(runs[1].recording["trajectory"], "pos"))


def test_the_command_tells_people_and_writes_an_overlay(tmp_path, capsys):
    made(tmp_path, "a"), made(tmp_path, "b", shift=3.0, bias=2.0)
    out = tmp_path / "both"
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b"), "--out", str(out)]) == 0
    told = capsys.readouterr().out
    assert "b: position, horizontal [m]" in told
    assert "3.000" in told
    assert (out / "exports" / "plots" / "track.png").is_file()
    assert list(recon.open(out).recording) == ["trajectory", "trajectory_2", "gnss"]


def test_without_what_draws_plots_there_is_still_an_overlay(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    made(tmp_path, "a"), made(tmp_path, "b", shift=3.0)
    out = tmp_path / "both"
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b"), "--out", str(out)]) == 0
    assert "plots   none: they need matplotlib" in capsys.readouterr().out
    assert not (out / "exports").exists()


def test_what_was_found_is_told_before_an_export_fails(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    made(tmp_path, "a"), made(tmp_path, "b", shift=3.0)
    pair = [str(tmp_path / "a"), str(tmp_path / "b")]
    assert main(["compare", *pair, "--out", str(tmp_path / "both"), "--export", "plots"]) == 3
    assert "b: position, horizontal [m]" in capsys.readouterr().out


def test_the_command_tells_programs(tmp_path, capsys):
    made(tmp_path, "a"), made(tmp_path, "b", shift=3.0)
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b"), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert (data["runs"], data["overlay"]) == (["a", "b"], None)
    assert data["distances"][0]["found"]["position"]["total"]["max"] == pytest.approx(3.0, abs=1e-9)


def test_an_export_without_a_folder_is_refused(tmp_path, capsys):
    assert main(["compare", str(tmp_path), str(tmp_path), "--export", "plots"]) == 2
    assert "an export needs a folder" in capsys.readouterr().err
