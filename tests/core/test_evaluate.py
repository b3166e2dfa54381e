"""`recon evaluate` and `recon.evaluate`: errors against a reference, told to people and to programs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import get_args

import numpy as np
import pyarrow as pa
import pytest

import recon
from recon import TRAJECTORY, Event, Recording, build, events, matrix, replace, select_rows, time_ns, with_meta
from recon.cli import main
from recon.errors import DataError
from recon.evaluation import consistency_of, evaluate, match
from recon.numerics.evaluation import Alignment
from recon.numerics.geodesy import SPHERE, Anchor, enu_to_geodetic, geodetic_to_enu
from recon.numerics.rotation import from_euler, multiply, rotate
from recon.storage import write_recording
from recon.testing.drives import ANCHOR, drive

TRUTH = drive()["reference"]
T_S = (time_ns(TRUTH) - time_ns(TRUTH)[0]) * 1e-9
POS, VEL, Q = (matrix(TRUTH, group) for group in ("pos", "vel", "q"))
ROUNDING = 1e-9
"""m, m/s, deg: positions of some 100 m, and of 6e6 m where anchors differ, in doubles."""
PIPELINE = """\
steps:
  - use: reader.auto
"""


def wrong_by(pos: object = 0.0, vel: object = 0.0, yaw: float = 0.0) -> pa.Table:
    """The truth with errors in m, m/s and rad."""
    q = multiply(from_euler(yaw, 0.0, 0.0), Q)
    return replace(TRUTH, pos=POS + pos, vel=VEL + vel, q=q)


def about(anchor: Anchor, table: pa.Table = TRUTH, earth: str = "wgs84") -> pa.Table:
    """The same motion seen from another anchor, position and velocity by way of two places a second apart."""
    place = enu_to_geodetic(matrix(table, "pos"), ANCHOR)
    facts = {"anchor": {"lat": anchor.lat, "lon": anchor.lon, "height": anchor.height}, "earth": earth}
    ellipsoid = {"ellipsoid": SPHERE} if earth == "sphere" else {}
    return with_meta(replace(table, pos=geodetic_to_enu(*place, anchor, **ellipsoid)), **facts)


# --- figures --------------------------------------------------------------------------------------------------------


def test_the_truth_against_itself_has_no_error():
    found = evaluate(TRUTH, TRUTH)
    assert (found.rows, found.compared, found.align) == (len(T_S), len(T_S), "none")
    figures = [*found.position.values(), *found.velocity.values(), *found.attitude.values()]
    assert all(figure is not None and figure.max == 0.0 for figure in figures)
    assert [(part.length, part.unit) for part in found.relative] == [(1.0, "s"), (10.0, "s"), (100.0, "m")]
    assert all(part.translation.max < ROUNDING for part in found.relative)


def test_errors_are_told_by_their_directions():
    found = evaluate(wrong_by([3.0, 4.0, -12.0], [0.0, 0.6, 0.8], yaw=0.02), TRUTH)
    position = {name: figure.rmse for name, figure in found.position.items() if figure}
    assert position == pytest.approx({"horizontal": 5.0, "vertical": 12.0, "total": 13.0}, abs=ROUNDING)
    velocity = {name: figure.max for name, figure in found.velocity.items() if figure}
    assert velocity == pytest.approx({"horizontal": 0.6, "vertical": 0.8, "total": 1.0}, abs=ROUNDING)
    attitude = {name: figure.median for name, figure in found.attitude.items() if figure}
    turn = np.degrees(0.02)
    assert attitude == pytest.approx({"roll": 0.0, "pitch": 0.0, "heading": turn, "total": turn}, abs=ROUNDING)


def test_segments_tell_a_scale_error_in_percent_of_the_way():
    found = evaluate(replace(TRUTH, pos=1.01 * POS), TRUTH)
    over_metres = found.relative[-1]
    # a chord of a bend is shorter than the way, and so is what a scale of 1.01 adds to it: at most 1 %
    assert over_metres.percent is not None
    assert 0.5 < over_metres.percent <= 1.0 + ROUNDING
    assert over_metres.rotation.max < 1e-5  # an arc cosine's worth of rounding, in deg


def test_outages_are_looked_at_one_by_one():
    start, stop = time_ns(TRUTH)[[1000, 2000]]
    drift = np.zeros((len(T_S), 3))
    drift[1000:2001, 0] = np.linspace(0.0, 8.0, 1001)
    lost = events(
        [Event(int(start), int(stop), "outage"), Event(0, 1, "outage"), Event(int(start), int(stop), "crash")]
    )
    before, inside = evaluate(wrong_by(drift, 0.1 * drift, yaw=0.01), TRUTH, lost).outages
    assert (before.horizontal, before.velocity, before.heading) == (None, None, None)
    assert inside.horizontal is not None
    assert inside.horizontal.count == 1001
    assert inside.horizontal.max == pytest.approx(8.0, abs=ROUNDING)
    # of k / 1000 for k = 0 ... 1000 the mean square is (2 + 1 / 1000) / 6
    assert inside.horizontal.rmse == pytest.approx(8.0 * np.sqrt(2.001 / 6.0), abs=ROUNDING)
    assert inside.velocity is not None
    assert inside.velocity.max == pytest.approx(0.8, abs=ROUNDING)
    assert inside.heading is not None
    assert inside.heading.rmse == pytest.approx(np.degrees(0.01), abs=ROUNDING)


@pytest.mark.parametrize("align", [how for how in get_args(Alignment) if how != "none"])
def test_an_alignment_that_is_asked_for_takes_a_turn_away_and_is_told(align):
    turn = from_euler(0.5, 0.0, 0.0)
    moved = replace(TRUTH, pos=rotate(turn, POS) + 7.0, vel=rotate(turn, VEL), q=multiply(turn, Q))
    assert evaluate(moved, TRUTH).position["horizontal"].rmse > 7.0
    found = evaluate(moved, TRUTH, align=align)
    assert found.align == align
    for figures in (found.position, found.velocity, found.attitude):
        # "se3" of a drive on a road: its heights of some m tell the tilt from some 100 m to rounding times 1e3
        assert figures["total"].max < 1e-7
    assert set(found.consistency.values()) == {None}


def test_an_alignment_that_cannot_be_is_a_data_error():
    still = replace(TRUTH, pos=np.zeros_like(POS))
    with pytest.raises(DataError, match=r"cannot be aligned by 'yaw': .* the vehicle stands"):
        evaluate(still, still, align="yaw")


# --- places and times -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("earth", ["wgs84", "sphere"])
def test_another_anchor_makes_no_difference(earth):
    found = evaluate(TRUTH, about(Anchor(44.9, 12.1, 300.0), earth=earth))
    assert found.position["total"].max < 2e-8  # Earth-fixed coordinates are rounded to 1e-9 m, and turned twice
    assert found.notes == ()


def test_velocity_and_attitude_turn_with_the_anchor():
    far = about(Anchor(44.9, 12.1, 300.0))
    # the velocity of the truth in the axes of the far anchor, by positions a step apart
    apart = matrix(about(Anchor(44.9, 12.1, 300.0), wrong_by(VEL)), "pos") - matrix(far, "pos")
    found = evaluate(replace(TRUTH, vel=VEL), replace(far, vel=apart))
    assert found.velocity["total"].max < 2e-8
    # attitude: the axes of the two anchors differ by about the angle between the places
    assert 0.5 < found.attitude["total"].max < 1.0


def test_what_only_one_knows_of_its_place_is_noted():
    (note,) = evaluate(TRUTH, with_meta(TRUTH, anchor=None)).notes
    assert note.startswith("only one of the two knows its place")


def test_heights_and_times_of_other_scales_are_noted():
    found = evaluate(TRUTH, with_meta(TRUTH, height_datum="mean_sea_level", time_scale="GPS"))
    assert [note.partition(" ")[0] for note in found.notes] == ["height_datum", "time_scale"]


def test_the_coarser_one_gives_the_times_and_its_matched_rows_are_counted():
    coarse = select_rows(TRUTH, np.arange(0, len(T_S), 100))
    half = TRUTH.slice(0, len(T_S) // 2)
    found = evaluate(half, coarse)
    assert found.clock == "reference"
    assert found.compared == coarse.num_rows
    assert found.rows == int((time_ns(coarse) <= time_ns(half)[-1]).sum())
    assert found.of_s == pytest.approx(T_S[len(T_S) // 2 - 1], rel=1e-12)


def test_no_common_time_is_a_data_error_that_names_the_spans():
    late = replace(TRUTH, time=recon.times(time_ns(TRUTH) + 3_600_000_000_000))
    with pytest.raises(DataError, match="no time in common") as raised:
        evaluate(TRUTH, late)
    assert "the trajectory runs from 2023-11-14T22:13:20.000" in raised.value.hint
    with pytest.raises(DataError, match="the reference has no row"):
        evaluate(TRUTH, TRUTH.slice(0, 0))


def test_a_reference_of_positions_alone_gives_their_errors_alone():
    places = build(TRAJECTORY, time=time_ns(TRUTH), pos=POS)
    found = evaluate(wrong_by([3.0, 4.0, 0.0]), places)
    assert found.position["horizontal"].rmse == pytest.approx(5.0, abs=ROUNDING)
    assert set(found.velocity.values()) == set(found.attitude.values()) == {None}
    assert found.relative == ()


# --- sigmas ---------------------------------------------------------------------------------------------------------


def test_sigmas_that_are_honest_are_found_so_and_others_not():
    rng = np.random.default_rng(8)
    error = 0.5 * rng.standard_normal(POS.shape)
    for claimed, honest in ((0.5, True), (0.25, False)):
        claim = np.full(POS.shape, claimed)
        found = evaluate(replace(wrong_by(error), pos_std=claim), TRUTH).consistency
        assert found["position"].honest is honest
        # 3 * 6000 numbers: the mean square errs by 1 %; 5 of these
        assert found["position"].nees == pytest.approx(0.25 / claimed**2, rel=0.06)
        assert found["velocity"] is found["attitude"] is None


def test_sigmas_of_the_reference_are_added():
    rng = np.random.default_rng(9)
    run = replace(wrong_by(3.0 * rng.standard_normal(POS.shape)), pos_std=np.full(POS.shape, 3.0))
    reference = replace(wrong_by(4.0 * rng.standard_normal(POS.shape)), pos_std=np.full(POS.shape, 4.0))
    found = consistency_of(match(run, reference))["position"]
    assert found is not None
    assert found.honest
    assert found.nees == pytest.approx(1.0, rel=0.06)  # as above


# --- Python and the command line ------------------------------------------------------------------------------------


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A finished run, `wrong`, by 5 m against its own reference."""
    monkeypatch.chdir(tmp_path)
    made = Recording({"trajectory": wrong_by([3.0, 4.0, 0.0]), "reference": TRUTH})
    write_recording(made, tmp_path / "made")
    recon.run(recon.Pipeline.from_text(PIPELINE, "keep.yaml"), tmp_path / "made", tmp_path / "wrong")
    return tmp_path / "wrong"


def test_a_run_is_compared_with_its_own_reference(run):
    for finished in (run, recon.open(run)):
        assert recon.evaluate(finished).position["horizontal"].rmse == pytest.approx(5.0, abs=ROUNDING)


def test_a_run_is_compared_with_what_is_named(run, tmp_path):
    other = Recording({"trajectory": wrong_by([3.0, 0.0, 0.0])})
    write_recording(other, tmp_path / "other")
    for reference in (other, tmp_path / "other"):
        assert recon.evaluate(run, reference).position["horizontal"].rmse == pytest.approx(4.0, abs=ROUNDING)
    with pytest.raises(DataError, match="no stream 'reference' or 'trajectory'"):
        recon.evaluate(run, Recording({}))


def test_people_get_a_table(run, capsys):
    assert main(["evaluate", "wrong"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("wrong against the stream 'reference' of wrong\n")
    assert f"  matched  {len(T_S)} of {len(T_S)} rows of the trajectory (100.0 %)\n" in out
    assert "  aligned  not at all\n" in out
    (line,) = [line for line in out.splitlines() if "position, horizontal [m]" in line]
    assert line.split()[-5:] == ["5.000"] * 5
    assert "\x1b" not in out


def test_programs_get_all_of_it_as_json(run, capsys):
    assert main(["evaluate", "wrong", "--json", "--align", "yaw", "--reference", "wrong"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["run"], told["against"], told["align"]) == ("wrong", "stream 'reference' of wrong", "yaw")
    assert told["position"]["horizontal"]["rmse"] < 1e-7
    assert told["consistency"] == {"position": None, "velocity": None, "attitude": None}
    assert {part["unit"] for part in told["relative"]} == {"s", "m"}


def test_an_alignment_is_told_to_people(run, capsys):
    assert main(["evaluate", "wrong", "--align", "start"]) == 0
    assert "  aligned  by 'start': the errors are what is left\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["wrong", "--align", "scale"], 2, "'scale' is not one of"),
        (["nothing"], 4, "nothing"),
        (["wrong", "--reference", "nothing"], 4, "nothing"),
        (["wrong", "--reference", "empty.txt"], 4, "empty.txt"),
        (["lonely"], 4, "this run holds no reference"),
    ],
)
def test_what_cannot_be_compared_is_refused_with_its_exit_code(run, tmp_path, capsys, words, code, message):
    (tmp_path / "empty.txt").touch()
    write_recording(Recording({"trajectory": TRUTH}), tmp_path / "alone")
    recon.run(recon.Pipeline.from_text(PIPELINE, "keep.yaml"), tmp_path / "alone", tmp_path / "lonely")
    assert main(["evaluate", *words]) == code
    ended = capsys.readouterr()
    assert ended.out == ""
    assert message in ended.err
