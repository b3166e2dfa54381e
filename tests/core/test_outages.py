from __future__ import annotations

import json
import re
import sys

import numpy as np
import pyarrow as pa
import pytest
import yaml

import recon
from recon.cli import main
from recon.cli.outages import _doubts, _lost
from recon.errors import ConfigError, NotEnoughData
from recon.outages import APART_S, measured, placed, simulate, statistics, study, without_fixes
from recon.overrides import Override
from recon.recording import Recording
from recon.registry import Registry
from recon.schema import GNSS, REFERENCE, TRAJECTORY
from recon.stages import Fuser
from recon.storage import write_recording
from recon.tables import build, matrix, replace, time_ns
from recon_simulators.drive import DriveParams, simulate_drive


@pytest.fixture(scope="module")
def drive():
    streams = simulate_drive(DriveParams(motion="city", duration=200.0, sensors="automotive", seed=4))
    return Recording({name: streams[name] for name in ("imu", "gnss", "reference")})


def test_outages_are_apart_and_repeat_with_the_seed(drive):
    spans = placed(drive["gnss"], 20.0, 10, np.random.default_rng(1))
    assert spans == placed(drive["gnss"], 20.0, 10, np.random.default_rng(1))
    assert spans != placed(drive["gnss"], 20.0, 10, np.random.default_rng(2))
    t_ns = time_ns(drive["gnss"])
    edges = np.array([t_ns[0], *np.ravel(spans), t_ns[-1]])
    assert (np.diff(edges)[::2] >= APART_S * 1e9 - 2).all()
    np.testing.assert_array_equal(np.diff(edges)[1::2], 20_000_000_000)


def test_an_outage_that_finds_no_room_is_refused(drive):
    with pytest.raises(NotEnoughData, match="outage of 300 s"):
        placed(drive["gnss"], 300.0, 10, np.random.default_rng(1))


@pytest.mark.parametrize("length_s", [10.0, 60.0, 90.0, 120.0, 1000.0])
def test_what_is_said_to_be_needed_is_enough_and_not_more(length_s):
    def fixes(span_s: float) -> pa.Table:
        return build(GNSS, time=np.array([0, round(1e9 * span_s)]), speed=np.zeros(2))

    with pytest.raises(NotEnoughData) as refused:
        placed(fixes(length_s), length_s, 1, np.random.default_rng(1))
    needed_s = float(re.search(r"needs ([\d.]+) s of GNSS", str(refused.value))[1])
    assert len(placed(fixes(needed_s + 0.01), length_s, 1, np.random.default_rng(1))) == 1  # it is told to 6 digits
    with pytest.raises(NotEnoughData):
        placed(fixes(needed_s - 0.01), length_s, 1, np.random.default_rng(1))


def test_fixes_go_from_every_receiver_and_nothing_else(drive):
    both = drive.updated({"gnss_2": drive["gnss"]})
    ((start, end),) = spans = placed(drive["gnss"], 30.0, 1, np.random.default_rng(1))
    cut = without_fixes(both, spans)
    for name in ("gnss", "gnss_2"):
        t_ns = time_ns(cut[name])
        assert not ((t_ns >= start) & (t_ns < end)).any()
        assert cut[name].num_rows == both[name].num_rows - 150  # 30 s at 5 Hz
    assert cut["imu"] is both["imu"]


def test_errors_are_those_at_the_end(drive):
    """A trajectory that drifts east by 1 cm/s from the start of the record."""
    truth = drive["reference"]
    t_s = (time_ns(truth) - time_ns(truth)[0]) * 1e-9
    drifting = replace(truth, pos=matrix(truth, "pos") + np.column_stack([0.01 * t_s, 0.0 * t_s, 0.0 * t_s]))
    drifting = drifting.drop_columns(["lat", "lon", "height"])
    spans = placed(drive["gnss"], 20.0, 2, np.random.default_rng(1))
    found = measured(drifting, truth.drop_columns(["lat", "lon", "height"]), spans)
    for one, (_, end) in zip(found, spans, strict=True):
        # The last row lies up to 10 ms before the end, which is 0.1 mm.
        assert one.horizontal == pytest.approx(0.01 * (end - time_ns(truth)[0]) * 1e-9, abs=2e-4)
        assert one.worst == one.horizontal
        assert one.heading == 0.0


def test_statistics_say_nothing_of_sigmas_where_errors_are_shared(drive):
    found, against, lost = simulate(drive, lambda recording, name: recording["reference"], [10.0], 2, 0)
    assert (against, lost) == ("reference", {})
    assert statistics(found[10.0], "all fixes")["within_2_sigma"] is None
    assert statistics(found[10.0], against)["horizontal"]["max"] == 0.0


def test_a_length_that_leaves_too_little_is_told_and_the_others_go_on(drive):
    def solve(recording, name):
        if name == "outages of 30 s":
            raise NotEnoughData("bends", needed="one", found="none")
        return recording["reference"]

    found, _, lost = simulate(drive, solve, [10.0, 30.0, 1e5], 2, 0)
    assert [len(found[length]) for length in (10.0, 30.0, 1e5)] == [2, 0, 0]
    assert lost[30.0].startswith("not enough bends")
    assert lost[1e5].startswith("not enough GNSS for an outage of 100000 s")
    data = {length: {"length_s": length, "lost": lost.get(length)} for length in found}
    assert _lost([*data.values()]) == [
        f"warning: there is no result with outages of {length:g} s: {lost[length]}" for length in (30.0, 1e5)
    ]
    with pytest.raises(NotEnoughData, match="bends"):
        simulate(drive, solve, [30.0, 1e5], 2, 0)


def test_the_command_keeps_table_numbers_and_plot(tmp_path, capsys):
    pipeline, kept, out = tmp_path / "drive.yaml", tmp_path / "drive", tmp_path / "tunnels"
    step = {"use": "simulator.drive", "params": {"motion": "city", "duration": "120 s", "sensors": "automotive"}}
    pipeline.write_text(yaml.safe_dump({"recon": 1, "name": "drive", "steps": [step]}))
    assert main(["run", str(pipeline), "--out", str(kept)]) == 0
    capsys.readouterr()
    assert main(["outages", str(kept), "--lengths", "10", "--most", "2", "--out", str(out)]) == 0
    printed, shown = capsys.readouterr()
    assert shown == "[1/1] outages of 10 s\n"
    assert "against the log's own reference" in printed
    assert "'worst inside' the median of the largest" in printed
    assert sorted(path.name for path in out.iterdir()) == ["outages.json", "outages.md", "outages.png"]
    told = json.loads((out / "outages.json").read_text())
    assert told["warnings"] == {"outages of 10 s": []}
    # Two frequencies, good to a metre: ten seconds add little, and nothing that a sigma of 1.4 m does not cover.
    assert told["lengths"][0]["horizontal"]["max"] < 5.0
    for wrong in ("ten", "nan", "10,inf", "0", ""):
        assert main(["outages", str(kept), "--lengths", wrong]) == 2
        assert capsys.readouterr().err == f"error: --lengths '{wrong}' are no seconds; write 10,30,60\n"


def test_a_plot_that_cannot_be_drawn_is_refused_before_the_log_is_read(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert main(["outages", str(tmp_path / "no.txt"), "--out", str(tmp_path / "tunnels")]) == 3
    assert 'pip install "recon-dynamics[figures]"' in capsys.readouterr().err


def test_a_base_result_that_is_not_to_be_trusted_says_so_beside_the_errors():
    stray = "positions stray: do not trust them"
    told = _doubts(
        {"warnings": {"all fixes": [stray], "outages of 10 s": [], "outages of 30 s": [stray, "a box moved"]}}
    )
    assert told == [
        f"warning: the result with all fixes and outages of 30 s: {stray}",
        "warning: the result with outages of 30 s: a box moved",
        "warning: so what is told of all fixes and outages of 30 s is not to be trusted either",
    ]
    assert _doubts({"warnings": {"all fixes": []}}) == []


def test_a_drive_whose_every_turn_lies_in_an_outage_is_bridged(logs):
    """Straight ways of constant speed are all that is left between six outages of 30 s; the biases are 3 deg/s.

    GNSS errs by 5 m, white, five times a second, so its mean over 30 s by 0.4 m, and the way through the gap is nailed
    at both ends: 2 m are five times that.
    """
    recording = recon.read(logs / "navego_synthetic")
    spans = placed(recording["gnss"], 30.0, 10, np.random.default_rng([0, 30_000]))
    assert len(spans) == 6
    run = recon.run("best_accuracy", without_fixes(recording, spans))
    found = measured(run.trajectory.table, recording["reference"], spans)
    assert max(outage.worst for outage in found) < 2.0
    assert max(outage.heading for outage in found) < 0.5


def cheating(*, reference, params):
    return {"trajectory": reference}


CHEAT = Fuser(
    name="cheat", summary="The reference.", run=cheating, reads={"reference": REFERENCE.need("pos")},
    writes={"trajectory": TRAJECTORY},
)  # fmt: skip


def own_pipeline(*uses):
    steps = [{"use": "reader.auto", "id": "log"}, *({"use": use} for use in uses)]
    return recon.Pipeline.from_text(yaml.safe_dump({"name": "mine", "steps": steps}))


def test_parameters_of_the_first_step_reach_it_by_its_id(tmp_path):
    wrong = Override.from_option("log.nothing=1")
    with pytest.raises(ConfigError, match=r"reader\.auto has no parameter 'nothing'"):
        study([tmp_path / "none.txt"], own_pipeline("fuser.map"), [10.0], overrides=[wrong])


def test_exporters_of_the_pipeline_are_left_out_with_their_parameters(drive, tmp_path):
    write_recording(drive, tmp_path)
    registry = Registry.installed().with_records(CHEAT)
    unused = Override.from_option("exporter.csv.nothing=1")
    pipeline = own_pipeline("fuser.cheat", "exporter.csv")
    told = []
    found = study(
        [tmp_path],
        pipeline,
        [10.0],
        most=1,
        overrides=[unused],
        registry=registry,
        progress=lambda *at: told.append(at),
    )
    assert found.outages[10.0][0].horizontal == 0.0
    base = [] if found.against == "reference" else [found.against]
    over = [*base, "outages of 10 s"]
    assert told == [(at, len(over), name) for at, name in enumerate(over)]
