from __future__ import annotations

import json
import re

import numpy as np
import pytest
import yaml
from fuzz import log_files

from recon.allan import SHAKEN, analyse, fuser_params
from recon.cli import main
from recon.errors import DataError, NotEnoughData
from recon.pipeline import Pipeline
from recon.tables import matrix, replace, time_ns
from recon_fusers.map import MapParams
from recon_simulators.drive import DriveParams, simulate_drive


@pytest.fixture(scope="module")
def resting():
    return simulate_drive(DriveParams(motion="rest", duration=600.0, sensors="consumer_mems", seed=2))


def test_the_noise_of_the_preset_is_found_in_the_units_of_data_sheets(resting):
    found = analyse(resting["imu"], None)
    told = fuser_params(found)
    assert float(told["gyro_noise"].split()[0]) == pytest.approx(0.007, rel=0.02)
    assert float(told["accel_noise"].split()[0]) == pytest.approx(180.0, rel=0.02)


def test_a_box_that_was_shaken_is_told_from_one_at_rest(resting):
    """A vibration of 20 Hz and 0.3 m/s^2 shows at half its period, far above any noise of the sensor."""
    quiet, _ = analyse(resting["imu"], None).unexplained()
    assert quiet < SHAKEN
    accel = matrix(resting["imu"], "accel")
    accel[:, 2] += 0.3 * np.sin(2.0 * np.pi * 20.0 * (time_ns(resting["imu"]) - time_ns(resting["imu"])[0]) * 1e-9)
    ratio, tau_s = analyse(replace(resting["imu"], accel=accel), None).unexplained()
    assert ratio > SHAKEN
    assert 0.01 < tau_s < 0.05


def test_the_yaml_is_what_fuser_map_reads(resting, tmp_path, capsys):
    text = "\n".join(f"      {key}: {value}" for key, value in fuser_params(analyse(resting["imu"], None)).items())
    pipeline = Pipeline.from_text(f"steps:\n  - use: fuser.map\n    params:\n{text}\n")
    params = MapParams.model_validate(pipeline.steps[0].params.plain(), context={"in_text": True})
    assert params.gyro_noise == pytest.approx(np.radians(0.007), rel=0.02)


def test_large_terms_are_shown_without_an_exponent():
    from recon.cli.allan import _shown

    assert [_shown(value) for value in (42_041.7, 1.9367, 5.59e-5, None)] == ["42042", "1.94", "5.59e-05", "-"]


def test_of_a_drive_the_longest_stop_is_taken():
    streams = simulate_drive(DriveParams(motion="city", duration=150.0, rest=60.0, sensors="consumer_mems"))
    found = analyse(streams["imu"], streams["gnss"])
    assert found.start_s < 5.0
    assert found.stop_s < 65.0


def test_a_box_that_never_rests_is_refused():
    streams = simulate_drive(DriveParams(motion="nonstop", duration=120.0, rest=5.0, sensors="consumer_mems"))
    with pytest.raises((DataError, NotEnoughData)):
        analyse(streams["imu"], streams["gnss"])


def test_the_command_prints_terms_and_draws(tmp_path, capsys):
    pipeline, kept, plot = tmp_path / "rest.yaml", tmp_path / "rest", tmp_path / "allan.png"
    step = {"use": "simulator.drive", "params": {"motion": "rest", "duration": "120 s"}}
    pipeline.write_text(yaml.safe_dump({"recon": 1, "name": "rest", "steps": [step]}))
    assert main(["run", str(pipeline), "--out", str(kept)]) == 0
    capsys.readouterr()
    assert main(["allan", str(kept), "--plot", str(plot)]) == 0
    assert "angle random walk" in capsys.readouterr().out
    assert plot.read_bytes()[:4] == b"\x89PNG"
    drawn = plot.with_suffix(".svg")
    assert main(["allan", str(kept), "--plot", str(drawn)]) == 0
    capsys.readouterr()
    written = set(re.findall(r"<!-- ([\d.]+) -->", drawn.read_text(encoding="utf-8")))
    assert {"0.01", "0.1", "1", "0.02", "0.05", "100", "200", "500"} <= written  # numbers, not powers of ten
    assert main(["allan", str(kept), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [one["axis"] for one in told["terms"]] == [f"{s}_{a}" for s in ("gyro", "accel") for a in "xyz"]


def test_a_log_without_an_imu_is_refused_in_words(tmp_path, capsys):
    log = tmp_path / "walk.nmea"
    log.write_bytes(log_files.nmea())
    assert main(["allan", str(log)]) == 4
    told = capsys.readouterr().err
    assert "there is no IMU in it, only gnss" in told
    assert "of a box that stood still" in told
