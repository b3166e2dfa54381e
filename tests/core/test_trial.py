from __future__ import annotations

from pathlib import Path

from recon.pipeline import Pipeline
from recon.registry import Registry
from recon.trial import Trial, try_out


def test_a_drive_that_fuser_map_trusts_is_better_than_one_that_it_doubts():
    doubted, trusted = Trial(doubts=1, turning=0.1, pushing=0.1), Trial(turning=0.2, pushing=0.2)
    assert trusted.better_than(doubted)
    assert not doubted.better_than(trusted)


def test_where_both_are_trusted_neither_error_may_grow_by_more_than_a_tenth():
    before = Trial(turning=1.0, pushing=1.0)
    assert Trial(turning=0.3, pushing=1.05).better_than(before)
    assert not Trial(turning=0.3, pushing=1.2).better_than(before)
    assert Trial(turning=None, pushing=0.9).better_than(before)


def test_what_cannot_be_run_is_no_better_and_says_why(tmp_path: Path):
    registry, log = Registry.installed(), tmp_path / "empty.txt"
    log.write_text("")
    found = try_out(Pipeline.from_file("best_accuracy"), [log], registry=registry)
    assert found.error
    assert found.as_data()["error"] == found.error
    assert not found.better_than(Trial(doubts=3))
    assert Trial(doubts=3).better_than(found)
