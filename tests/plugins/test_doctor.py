"""The benchmark `tests/benchmarks/doctor.py` has its faults in 50 seeds and 200 clean drives; here are some of each."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from benchmarks import doctor as benchmark

import recon
from recon import GNSS, IMU, build
from recon.cli import main
from recon.errors import NotEnoughData
from recon.findings import findings_in
from recon.numerics.doctor import CODES
from recon.pipeline import Pipeline
from recon.rows import warnings_of
from recon_analyzers.doctor import DoctorParams, examine_log
from recon_simulators.drive import simulate_drive

NEEDS_MORE = {"height_datum", "gnss_sigma", "axes", "gravity_sign", "inverted_axis", "clock_drift"}
"""A second source of heights, two minutes of driving twice over, or bends: one of the routes is straight."""
MAPPINGS = Path(__file__).parent / "csv_mappings"


def by_code(found):
    return {one["code"]: one for one in found}


def contradicted(found):
    return {code: one["value"] for code, one in by_code(found).items() if one["status"] == "contradicted"}


@pytest.mark.parametrize("seed", range(100, 105))
def test_nothing_is_contradicted_on_a_clean_drive(seed):
    found = benchmark.findings(simulate_drive(benchmark.drive(seed, lined_up=seed % 3 == 0)))
    assert contradicted(found) == {}
    assert [one["code"] for one in found] == list(CODES)
    assert {one["code"] for one in found if one["status"] == "unknown"} <= NEEDS_MORE


@pytest.mark.parametrize("fault", benchmark.FAULTS, ids=lambda fault: fault.title)
def test_a_fault_is_named_with_its_value(fault):
    found = benchmark.findings(fault.drive(102))
    assert fault.found_in(found), by_code(found)[fault.code]


@pytest.mark.parametrize("seed", [102, 104, 107])
@pytest.mark.parametrize(("code", "value"), [("lat_lon", "swapped"), ("heading_kind", "anticlockwise from east")])
def test_swapped_places_and_a_course_from_east_are_told_apart(code, value, seed):
    """Both mirror the way against the courses; only swapped places change its length, which is no unit of speed."""
    fault = next(one for one in benchmark.FAULTS if one.code == code and one.told == value)
    streams = fault.drive(seed)
    vectors = [name for name in streams["gnss"].column_names if name.startswith("vel_")]  # most receivers tell none
    found = benchmark.findings({**streams, "gnss": streams["gnss"].drop_columns(vectors)})
    assert contradicted(found) == {code: value}


def test_a_contradiction_warns_and_shows_its_evidence():
    streams = benchmark.FAULTS[0].drive(101)
    told = examine_log(**streams, gnss_2=None, reference=None, metrics=None, params=DoctorParams())["metrics"]
    assert any(text.startswith("speed_unit: ") for text in warnings_of(told))
    evidence = by_code(findings_in(told))["speed_unit"]["evidence"]
    assert evidence["unit"] == "m/s^2"
    assert len(evidence["curves"]) == 3


def test_without_a_row_there_is_nothing_to_examine():
    none = np.zeros(0, dtype=np.int64)
    imu = build(IMU, time=none, accel=np.zeros((0, 3)), gyro=np.zeros((0, 3)))
    with pytest.raises(NotEnoughData):
        examine_log(imu=imu, gnss=None, gnss_2=None, reference=None, metrics=None, params=DoctorParams())


def test_latitudes_beyond_the_pole_are_named():
    gnss = build(GNSS.only("lat", "lon"), time=np.arange(40) * 10**9, lat=np.full(40, 139.7), lon=np.full(40, 35.6))
    told = examine_log(imu=None, gnss=gnss, gnss_2=None, reference=None, metrics=None, params=DoctorParams())
    assert contradicted(findings_in(told["metrics"])) == {"lat_lon": "swapped"}


def write_csv(path, imu_rows):
    lines = ["t,ax,ay,az,gx,gy,gz", *(",".join(f"{value:.5f}" for value in row) for row in imu_rows)]
    path.write_text("\n".join(lines) + "\n")


def csv_settings():
    mapping = {
        "imu": {
            "time": {"column": "t", "format": "relative"},
            "accel": {"columns": ["ax", "ay", "az"], "unit": "m/s^2"},
            "gyro": {"columns": ["gx", "gy", "gz"], "unit": "rad/s"},
        }
    }
    return ["--set", f"reader.csv.columns={json.dumps(mapping)}"]


@pytest.fixture
def standing(tmp_path):
    """A box that stands for a minute, on its side, counting g; a row is out of order."""
    rng = np.random.default_rng(3)
    t_s = np.arange(6000) * 0.01
    values = np.column_stack([t_s, 0.002 * rng.standard_normal((6000, 3)), 0.001 * rng.standard_normal((6000, 3))])
    values[:, 2] += 1.0
    values[3000, 0] = 7.0
    path = tmp_path / "box.csv"
    write_csv(path, values)
    return path


def test_the_command_tells_what_is_wrong_and_exits_with_0(standing, capsys):
    assert main(["doctor", str(standing), *csv_settings(), "--json"]) == 0
    found = by_code(json.loads(capsys.readouterr().out)["findings"])
    assert found["accel_unit"]["value"] == "g"
    assert found["axes"]["value"] == "+y up"
    assert found["reversals"]["value"] == 1.0
    assert set(found["axes"]) == {"code", "status", "value", "confidence", "statistic", "explanation", "yaml", "unit"}


def test_the_pipeline_that_it_writes_reads_the_log_in_the_right_unit(standing, tmp_path, capsys):
    fixed = tmp_path / "fixed.yaml"
    assert main(["doctor", str(standing), *csv_settings(), "--write", str(fixed)]) == 0
    assert "put right by" in capsys.readouterr().out
    steps = yaml.safe_load(fixed.read_text())["steps"]
    assert steps[0]["params"]["reader.csv"]["columns"]["imu"]["accel"]["unit"] == "g"
    assert main(["validate", str(fixed)]) == 0
    assert main(["doctor", str(standing), *csv_settings(), "--write", str(fixed)]) == 2  # never overwritten unasked


def test_a_log_that_is_put_right_is_contradicted_no_more():
    """Every axis, sign and clock at once."""
    from recon import matrix
    from recon.doctor import fix_of, merged
    from recon.numerics.doctor import Claims, Finding
    from recon.recording import Recording
    from recon.tables import replace, time_ns, times
    from recon.yaml_nodes import Node

    streams = simulate_drive(benchmark.drive(3, lined_up=True))
    imu = replace(streams["imu"], accel=-matrix(streams["imu"], "accel") / 9.80665)
    gnss = replace(streams["gnss"], time=times(time_ns(streams["gnss"]) + 18_000_000_000))
    found = benchmark.findings({"imu": imu, "gnss": gnss})
    assert contradicted(found) == {"accel_unit": "g", "gravity_sign": "down", "leap_seconds": 18.0}
    told = [Finding(**{key: one[key] for key in one if key != "evidence"}) for one in found]
    fixes = merged(fix_of(one, Claims(), "", "") for one in told)
    assert fixes == {
        "aligner.axes": {"accel_scale": 9.80665, "at_rest": "down"},
        "aligner.time_offset": {"shift": 18.0},
    }
    steps = Pipeline.of("right", "aligner.axes", "aligner.time_offset").steps
    params = {"aligner.axes": fixes["aligner.axes"], "aligner.time_offset": {"shift": "18 s"}}
    chosen = tuple(step.with_params(Node.of(params[step.use], step.where)) for step in steps)
    run = recon.run(Pipeline("right", chosen), Recording({"imu": imu, "gnss": gnss}))
    assert contradicted(benchmark.findings(dict(run.recording))) == {}


# --- what the READMEs of real logs measured -------------------------------------------------------------------------


def findings_of(paths, mapping=None, capsys=None, **changes):
    settings = []
    if mapping:
        columns = yaml.safe_load((MAPPINGS / mapping).read_text())
        columns["imu"]["accel"].update(changes)
        settings = ["--set", f"reader.csv.columns={json.dumps(columns)}"]
    assert main(["doctor", *map(str, paths), *settings, "--json"]) == 0
    return by_code(json.loads(capsys.readouterr().out)["findings"])


def test_the_crash_counts_km_h_faces_backwards_and_hears_gnss_late(capsys, logs):
    found = findings_of([logs / "physycom_crash" / "crash_01.txt"], capsys=capsys)
    assert (found["speed_unit"]["status"], found["speed_unit"]["value"]) == ("confirmed", "km/h")
    assert (found["forward_axis"]["status"], found["forward_axis"]["value"]) == ("contradicted", "-x")
    assert found["gnss_velocity_lag"]["status"] == "contradicted"
    assert 0.25 <= found["gnss_velocity_lag"]["value"] <= 0.45


@pytest.mark.parametrize(("at_rest", "status"), [("down", "confirmed"), ("up", "contradicted")])
def test_the_drive_in_dresden_has_acceleration_inverted_and_gnss_a_second_late(at_rest, status, capsys, logs):
    path = logs / "balzer82_dresden" / "2014-03-26-000-Data.csv"
    found = findings_of([path], "dresden_car.yaml", capsys, at_rest=at_rest)
    assert (found["gravity_sign"]["status"], found["gravity_sign"]["value"]) == (status, "down")
    assert found["gnss_velocity_lag"]["value"] == pytest.approx(1.05, abs=0.1)


def test_a_mapping_with_other_axes_and_another_sign_is_cured_as_a_whole_and_tried(tmp_path, capsys, logs):
    """As `recon inspect` proposes it: FRD. One axis of the wrong sign would fit as well, in a box on its head."""
    path, fixed = logs / "balzer82_dresden" / "2014-03-26-000-Data.csv", tmp_path / "fixed.yaml"
    columns = yaml.safe_load((MAPPINGS / "dresden_car.yaml").read_text())
    columns["imu"]["axes"] = "FRD"
    del columns["imu"]["accel"]["at_rest"]
    settings = ["--set", f"reader.csv.columns={json.dumps(columns)}", "--write", str(fixed), "--json"]
    assert main(["doctor", str(path), *settings]) == 0
    told = json.loads(capsys.readouterr().out)
    found = by_code(told["findings"])
    assert (found["gravity_sign"]["value"], found["axes"]["value"]) == ("down", "FLU")
    assert found["inverted_axis"]["status"] == "confirmed"
    assert found["gravity_sign"]["confidence"] <= 0.8
    assert "only z of the accelerometer" in found["gravity_sign"]["explanation"]
    imu = yaml.safe_load(fixed.read_text())["steps"][0]["params"]["reader.csv"]["columns"]["imu"]
    assert (imu["axes"], imu["accel"]["at_rest"]) == ("FLU", "down")
    assert "aligner.axes" not in fixed.read_text()
    before, after = told["trial"]["as it is"], told["trial"]["put right"]
    assert before["doubts"] > after["doubts"] == 0
    assert after["turning"] < 0.2 * before["turning"]


def test_a_late_speed_that_needs_no_cure_is_told_so(capsys, logs):
    found = findings_of([logs / "comma2k19_example" / "seg40"], capsys=capsys)["gnss_velocity_lag"]
    assert (found["status"], found["yaml"]) == ("contradicted", "")
    assert "Nothing has to be put right for fuser.map" in found["explanation"]


def test_the_axes_of_comma2k19_are_confirmed_as_logged(capsys, logs):
    found = findings_of([logs / "comma2k19_example" / "seg40"], capsys=capsys)
    assert (found["axes"]["status"], found["axes"]["value"]) == ("confirmed", "FRD")
    assert found["forward_axis"]["value"] == "+x"


def test_a_copter_that_ends_on_its_head_has_no_leap_seconds(capsys, logs):
    """Its accelerometer explains nothing of its speed, at no shift of the clocks."""
    found = findings_of([logs / "formats" / "ardupilot_bin" / "log171.bin"], capsys=capsys)
    assert found["leap_seconds"]["status"] == "unknown"
    assert found["mounting"]["value"] == pytest.approx(180.0, abs=5.0)


def test_the_scooter_saturates_at_8_g(capsys, logs):
    found = findings_of([logs / "accidetec_scooter" / "Crashtest.tsv"], "scooter.yaml", capsys)
    assert found["clipping"]["status"] == "contradicted"
    assert found["clipping"]["value"] == pytest.approx(78.5, abs=0.1)


def test_a_clock_that_jumps_has_no_lag():
    jump = next(fault for fault in benchmark.FAULTS if fault.title == "clock_drift, jump")
    found = by_code(benchmark.findings(jump.drive(102)))
    assert found["clock_drift"]["value"] == "jump"
    assert found["gnss_velocity_lag"]["status"] == found["gnss_position_lag"]["status"] == "unknown"


def test_every_parameter_that_a_reader_was_given_is_in_the_pipeline():
    from recon.cli.doctor import _repaired
    from recon.overrides import Override

    options = [Override.from_option(f"reader.physycom.{text}") for text in ("gravity=9.8 m/s^2", "speed_unit=m/s")]
    first = _repaired([], options).steps[0]
    assert first.params.plain() == {"reader.physycom": {"gravity": "9.8 m/s^2", "speed_unit": "m/s"}}


def test_shifts_of_a_zone_and_of_a_lag_add_up_in_the_pipeline():
    from recon.doctor import fix_in, merged, repaired, yaml_of

    texts = [yaml_of({"aligner.time_offset": {"shift": shift}}) for shift in (7200.0, 0.274)]
    pipeline = repaired(merged(map(fix_in, texts)), {})
    steps = Pipeline.from_text(pipeline.to_yaml()).steps
    assert steps[1].params.plain() == {"shift": "7200.274 s"}
    best = [step.use for step in Pipeline.from_file("best_accuracy").steps]
    assert [step.use for step in steps] == [best[0], "aligner.time_offset", *best[1:]]
