"""The crash in a report: numbers with intervals and standards, the pulse as it was, the force from where it came."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from browser import opened
from handling_drives import START_NS, trajectory_of

from recon import Event, Metric, events, metrics
from recon.manifest import RunInfo
from recon.schema import IMU, METRICS, by_step
from recon.tables import build, matrix, replace
from recon_exporters._chart import COLUMNS, ROWS, Span
from recon_exporters._crash_drawing import Moment, time_line, vehicle
from recon_exporters._crash_page import _TITLES, _rests
from recon_exporters._crash_pulse import pulse_charts
from recon_exporters.report import ReportParams, report

G = 9.80665
CRASH_S = (20.0, 20.1)
PEAK = 15.0 * G
DELTA_V = 3.6 * PEAK * 0.1 * 2.0 / np.pi
"""km/h, of half a sine of 0.1 s."""


PLAN = [
    {
        "id": "analyzer.crash", "distribution": "recon-dynamics", "distribution_version": "0",
        "params": {"sensor_class": "automotive"},
    }
]  # fmt: skip


def ns(seconds: float) -> int:
    return START_NS + round(seconds * 1e9)


def pulse():
    """20 m/s and half a sine of 15 g for 0.1 s against the nose, at 100 Hz."""
    t_s = 0.01 * np.arange(3000)
    accel = np.zeros((3000, 3))
    during = (t_s >= CRASH_S[0]) & (t_s <= CRASH_S[1])
    accel[during, 0] = -PEAK * np.sin(np.pi * (t_s[during] - CRASH_S[0]) / 0.1)
    return trajectory_of(accel, np.zeros(3000), 20.0)


def judged(**changed: Any):
    rows = {
        "speed_before": Metric("speed_before", 72.0, "km/h", 0.5, 71.0, 73.0, "trajectory at time zero"),
        "delta_v_resultant_max": Metric(
            "delta_v_resultant_max", DELTA_V, "km/h", 0.2, DELTA_V - 0.4, DELTA_V + 0.4, "49 CFR 563", "<b>noise</b>"
        ),
        "time_of_max": Metric("time_of_max", 0.1, "s", 0.001, 0.098, 0.102),
        "pdof": Metric("pdof", 30.0, "deg", 2.0, 26.0, 34.0, "direction of delta-V, clockwise from the front"),
        "thiv": Metric("thiv", None, "km/h", method="EN 1317-1", note="not reached while the log goes on"),
    }
    rows |= changed
    return as_kept([row for row in rows.values() if row is not None], "analyzer.crash")


def as_kept(rows: list[Metric], step: str):
    table = metrics(rows)
    return build(by_step("metrics"), step=[step] * len(rows), **{c.name: table[c.name] for c in METRICS.columns})


def made(tmp_path, happened=None, learnt=None, **streams):
    about = RunInfo("r", {"recon": "0", "pipeline": {"name": "crash", "text": ""}, "plan": PLAN, "inputs": []})
    found = happened if happened is not None else [Event(ns(CRASH_S[0]), ns(CRASH_S[1]), "crash", DELTA_V, "km/h")]
    given = {"trajectory": pulse(), "events": events(found), "metrics": learnt if learnt is not None else judged()}
    report(streams={**given, **streams}, folder=tmp_path, about=about, params=ReportParams())
    return (tmp_path / "report.html").read_text(encoding="utf-8")


def section(page: str) -> str:
    found = re.search(r"<section><h2>The crash</h2>(.*?)</section>", page, re.S)
    return found[1] if found else ""


def curve(page: str, key: str, name: str) -> tuple[np.ndarray, np.ndarray]:
    figure = re.search(rf'data-key="{key}" data-t="(\S+) (\S+)" data-y="(\S+) (\S+)"(.*?)</figure>', page, re.S)
    assert figure is not None
    first, last, low, high = (float(figure[index]) for index in range(1, 5))
    path = re.search(rf'data-name="{name}" d="([^"]*)"', figure[5])
    assert path is not None
    points = np.array(re.findall(r"(-?\d+) (-?\d+)", path[1]), dtype=float)
    return first + points[:, 0] / COLUMNS * (last - first), high - points[:, 1] / ROWS * (high - low)


def test_the_page_says_first_what_happened(tmp_path):
    text = section(made(tmp_path))
    assert "At <b>72.0 km/h (95 %: 71.0 to 73.0 km/h)</b>" in text
    assert f"the velocity changed by <b>{DELTA_V:.1f} km/h" in text
    assert "</b> within 300&nbsp;ms, the force" in text
    assert "the force came from <b>30° (95 %: 26 to 34°)</b>, clockwise from straight ahead" in text


def test_a_speed_before_that_was_not_ahead_says_so(tmp_path):
    how, note = "trajectory at time zero", "horizontal, backwards"
    speed = Metric("speed_before", 14.0, "km/h", 0.5, 13.0, 15.0, how, note)
    assert "</b> backwards, the velocity changed by" in section(made(tmp_path, learnt=judged(speed_before=speed)))


def test_a_speed_before_that_is_supposed_says_so(tmp_path):
    speed = Metric(
        "speed_before", 57.5, "km/h", 2.5, 52.6, 62.4, "delta-V over 1 + restitution", "as if against <a wall>"
    )
    text = section(made(tmp_path, learnt=judged(speed_before=speed)))
    assert "km/h)</b> (as if against &lt;a wall&gt;), the velocity changed" in text


def test_the_numbers_are_said_to_be_of_a_place(tmp_path):
    text = section(made(tmp_path))
    assert "Accelerations are those of the point of the trajectory" in text
    assert "a sensor of the class <code>automotive</code>, its mounting" in text
    place = as_kept([Metric("place", method="imu", note="under the <seat>")], "reader.nhtsa")
    told = pa.concat_tables([judged(), place.cast(judged().schema)])
    text = section(made(tmp_path, learnt=told, trajectory=pulse().drop_columns(["accel_x", "accel_y", "accel_z"])))
    assert "those of the stream <code>imu</code> (under the &lt;seat&gt;)." in text


def test_why_other_changes_of_velocity_differ_stands_below_the_numbers(tmp_path):
    text = section(made(tmp_path))
    assert text.index("within 300 ms of time zero. The event <i>crash</i>") > text.index("49 CFR 563")


def test_a_sigma_has_as_many_places_as_its_value(tmp_path):
    text = section(
        made(tmp_path, learnt=judged(delta_v_resultant_max=Metric("delta_v_resultant_max", 12.2, "km/h", 0.1)))
    )
    assert re.search(r'value="12.2">12.20</data></td><td[^>]*><data value="0.1">0.10<', text)


def test_numbers_stand_with_interval_standard_and_all_digits(tmp_path):
    text = section(made(tmp_path))
    for value in (DELTA_V, DELTA_V - 0.4, DELTA_V + 0.4, 0.2, 72.0, 30.0):
        assert f'<data value="{value!r}">' in text
    for words in ("49 CFR 563", "EN 1317-1", "not reached while the log goes on", "&lt;b&gt;noise&lt;/b&gt;"):
        assert words in text


def test_every_metric_of_the_analysis_has_a_title_and_stands_once(tmp_path):
    rows = {name: Metric(name, 1.0 + i, "1", 0.1, 0.5, 1.5, f"method {i}.") for i, name in enumerate(_TITLES)}
    page = made(tmp_path, learnt=judged(**rows))
    for index, title in enumerate(_TITLES.values()):
        assert title in section(page)
        assert page.count(f"method {index}.") == 2  # the table, and the JSON at the end of the page
    assert json.loads((tmp_path / "report.json").read_text())["metrics"][0]["step"] == "analyzer.crash"
    unknown = {name: Metric(name, None, "1", method=f"method {i}.") for i, name in enumerate(_TITLES)}
    page = made(tmp_path, learnt=judged(**unknown))
    assert [page.count(f"method {index}.") for index in range(len(_TITLES))] == [2] * len(_TITLES)


def test_the_pulse_is_that_of_the_trajectory(tmp_path):
    """Half of a step of the drawing in time and value, and half a row's interval of 10 ms in which they lie."""
    page = made(tmp_path)
    t_s, force = curve(page, "pulse_accel", "forward, as recorded")
    inside = (t_s > 0.0) & (t_s < 0.1)
    assert force[inside] == pytest.approx(-15.0 * np.sin(np.pi * t_s[inside] / 0.1), abs=0.01)
    assert np.abs(force[t_s > 0.11]).max() < 0.01


def test_delta_v_counts_from_time_zero_and_ends_at_its_integral(tmp_path):
    """The trapezoid of ten steps takes 0.8 % off the integral of half a sine: pi^2 / (12 * 10^2)."""
    t_s, gained = curve(made(tmp_path), "pulse_delta_v", "horizontal")
    assert t_s[0] == pytest.approx(0.0, abs=1e-4)
    assert gained[0] == pytest.approx(0.0, abs=0.02)
    assert gained[-1] == pytest.approx(DELTA_V, rel=0.01)
    _, forward = curve(made(tmp_path), "pulse_delta_v", "forward")
    assert forward[-1] == pytest.approx(-DELTA_V, rel=0.01)


@pytest.mark.parametrize(("pdof", "hour", "x", "y"), [(0, 12, 0, -1), (90, 3, 1, 0), (180, 6, 0, 1), (-90, 9, -1, 0)])
def test_the_arrow_comes_from_where_the_force_came(pdof, hour, x, y):
    """The front is up: a force from the front comes from above, one from the right of the driver from the right."""
    drawn = vehicle(float(pdof), None, None)
    arrow = re.search(r'class="force" d="M(\S+) (\S+)L(\S+) (\S+)"', drawn)
    assert arrow is not None
    begin, end = np.array([float(part) for part in arrow.groups()]).reshape(2, 2)
    way = (begin - end) / np.linalg.norm(begin - end)
    assert way == pytest.approx([x, y], abs=0.01)
    assert np.linalg.norm(begin - 150.0) > np.linalg.norm(end - 150.0)
    assert f"{hour} o'clock" in drawn


def test_the_fan_is_as_wide_as_the_interval():
    narrow, wide, all_round = vehicle(0.0, -10.0, 10.0), vehicle(0.0, -170.0, 100.0), vehicle(0.0, -200.0, 200.0)
    assert " 0 0 1 " in re.search(r'class="fan" d="([^"]*)"', narrow)[1]
    assert " 0 1 1 " in re.search(r'class="fan" d="([^"]*)"', wide)[1]
    assert '<circle class="fan"' in all_round
    assert "fan" not in vehicle(0.0, None, None).replace("The fan", "")


def test_the_time_line_holds_what_is_near_in_its_order(tmp_path):
    happened = [
        Event(ns(18.0), ns(19.9), "harsh_braking", 5.0, "m/s^2"),
        Event(ns(CRASH_S[0]), ns(CRASH_S[1]), "crash", DELTA_V, "km/h"),
        Event(ns(23.5), ns(29.0), "standstill"),
        Event(ns(1.0), ns(2.0), "standstill"),
    ]
    text = section(made(tmp_path, happened))
    words = ["harsh braking begins", "time zero, 72.0 km/h", "largest delta-V", "end of event"]
    assert [text.index(word) for word in words] == sorted(text.index(word) for word in words)


def test_a_vehicle_comes_to_rest_when_its_speed_does_and_not_when_that_is_certain(tmp_path):
    """A slammed door parts the standstill; without a trajectory nothing but the standstill is known."""
    happened = [Event(ns(CRASH_S[0]), ns(CRASH_S[1]), "crash", DELTA_V, "km/h")]
    happened += [Event(ns(begin), ns(end), "standstill") for begin, end in ((1.0, 2.0), (23.5, 24.0), (25.0, 29.0))]
    motion = pulse()
    vel = matrix(motion, "vel")
    vel[np.arange(len(vel)) > 2200] = 0.02  # from 22 s on
    vel[2450:2455] = 0.05
    text = section(made(tmp_path, happened, trajectory=replace(motion, vel=vel)))
    assert "2.0 s  comes to rest" in text
    assert (text.count("comes to rest"), text.count("standstill")) == (1, 0)
    assert [*_rests({}, Span(ns(20.0), ns(20.1), "crash"), [Span(ns(23.5), ns(24.0), "standstill")])] == [
        Moment(3.5, "standstill begins")
    ]


def test_labels_of_the_time_line_do_not_overlap_nor_do_their_lines_cross_them():
    drawn = time_line([Moment(0.01 * i, f"label number {i}") for i in range(8)], -5.0, 5.0)
    placed = [(float(x), float(y)) for x, y in re.findall(r'<text class="name" x="(\S+)" y="(\S+)">', drawn)]
    assert len({y for _, y in placed}) == 8
    lines = [(float(x), float(y)) for x, y in re.findall(r'<path class="tick" d="M(\S+) 29.0V(\S+)"/>', drawn)]
    assert len(lines) == 8
    assert not [(line, label) for line in lines for label in placed if label[1] < line[1] and label[0] < line[0]]


def test_with_several_crashes_the_page_is_about_the_severest(tmp_path):
    def twice(first, second):
        spans = ((10.0, 10.1, first), (*CRASH_S, second))
        return [
            Event(ns(start), ns(end), kind, value, "km/h", f"size {value}")
            for start, end, value in spans
            for kind in ("crash", "impact")
        ]

    page = section(made(tmp_path, twice(8.0, 34.0)))
    assert np.abs(curve(page, "pulse_accel", "forward, as recorded")[1]).max() == pytest.approx(15.0, rel=0.01)
    assert "All impacts" in page
    assert "size 8.0" in page
    page = section(made(tmp_path, twice(80.0, 34.0)))
    assert np.abs(curve(page, "pulse_accel", "forward, as recorded")[1]).max() < 0.01


def test_without_direction_or_trajectory_the_numbers_are_left(tmp_path):
    page = section(
        made(
            tmp_path,
            learnt=judged(pdof=None, speed_before=None),
            trajectory=pulse().drop_columns([f"accel_{a}" for a in "xyz"]),
        )
    )
    assert "principal direction" not in page
    assert "pulse_accel" not in page
    assert '<p class="verdict">The velocity changed by' in page
    assert f'<data value="{DELTA_V!r}">' in page


def test_a_run_without_a_crash_has_no_such_part(tmp_path):
    assert section(made(tmp_path, happened=[])) == ""
    assert section(made(tmp_path, learnt=as_kept([Metric("x", 1.0)], "a"))) == ""


def test_a_trip_is_not_shaded(tmp_path):
    page = made(tmp_path, [Event(ns(0.0), ns(29.0), "trip", 500.0, "m")])
    assert "<title>trip</title>" not in page
    assert "trip" in page


def test_a_browser_shows_it_without_complaint(tmp_path):
    made(tmp_path)
    text, console = opened(tmp_path / "report.html", tmp_path / "profile")
    assert console == []
    assert "The crash" in text


# --- a test in which nobody drove -----------------------------------------------------------------------------------


def test_the_pulse_of_an_imu_that_was_turned_into_the_vehicle_is_drawn_without_axes_that_nobody_measured():
    """Crash tests have accelerometers along the car and no trajectory."""
    accel = np.zeros((400, 3))
    accel[100:200, 0], accel[:, 1] = -PEAK, np.nan
    schema = IMU.only("accel", frame="vehicle")
    imu = build(schema, time=START_NS + np.arange(400) * 1_000_000, accel=accel)
    crash = Span(START_NS + 100_000_000, START_NS + 200_000_000, "crash")
    drawn = pulse_charts({"imu": imu}, crash, [crash])
    assert "forward, CFC 60" in drawn
    assert "to the left" not in drawn
    assert pulse_charts({"imu": build(IMU.only("accel"), time=START_NS + np.arange(400), accel=accel)}, crash, []) == ""
