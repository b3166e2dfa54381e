"""`recon doctor`: findings as a terminal shows them."""

from __future__ import annotations


def test_findings_of_the_doctor_go_on_below_themselves_in_a_terminal() -> None:
    from recon.cli.doctor import _in_short

    some = [{"code": "gaps", "value": 0.0, "explanation": "No hole in 300 s of the IMU. More."}]
    assert _in_short(some, None) == ["  gaps  0  No hole in 300 s of the IMU."]
    assert _in_short(some, 24) == ["  gaps  No hole in 300 s\n        of the IMU."]
