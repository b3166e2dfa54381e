"""exporter.report: numbers in page, JSON and streams are the same; curves are the rows; a browser shows it all.

A chart is drawn on a grid of COLUMNS x ROWS, so that a point reads back within half a step of either.
"""

from __future__ import annotations

import json
import re
import time
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from browser import opened, pixels, printed, seen
from exporter_tables import SECOND, START_NS, drive, fixes, happened

import recon
from recon.manifest import RunInfo
from recon.numerics.rotation import from_euler
from recon.rows import Metric, metrics
from recon.schema import IMU, RESIDUALS, Change
from recon.tables import build, matrix, replace, time_ns, vector, with_meta
from recon_exporters._chart import COLUMNS, ROWS
from recon_exporters.report import ReportParams, declare_exporters, report

HUNDREDTHS = np.arange(0, 6001) / 100
MANIFEST = {
    "recon": "0.1.0",
    "pipeline": {"name": "own", "text": "steps:\n  - use: fuser.own"},
    "plan": [{"id": "fuser.own", "distribution": "d", "distribution_version": "1", "params": {"weight": 0.25}}],
    "inputs": [{"name": "a<b>.txt", "bytes": 12345678, "sha256": "ab" * 32}],
    "warnings": ["</script><b>beware", "twice", "twice"],
    "outputs": [],
    "environment": {"python": "3.11", "packages": {"numpy": "2.0"}},
}


class Page(HTMLParser):
    """Numbers, figures and paths of a report."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.numbers: list[float] = []
        self.figures: dict[str, dict[str, Any]] = {}
        self.here: dict[str, Any] = {}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        facts = dict(attrs)
        if tag == "data":
            self.numbers.append(float(facts["value"] or "nan"))
        if tag == "figure" and "data-key" in facts:
            self.here = {"t": _numbers(facts["data-t"]), "y": _numbers(facts["data-y"]), "curves": {}, "bands": []}
            self.figures.setdefault(facts["data-key"] or "", self.here)
        if tag == "path" and facts.get("class") == "curve" and self.here:
            self.here["curves"].setdefault(facts["data-name"], facts["d"])
        if tag == "path" and facts.get("class") == "band" and (facts["d"] or "") != "M0 0H26V10H0Z":
            self.here["bands"].append(facts["d"])

    def curve(self, key: str, name: str) -> tuple[np.ndarray, np.ndarray, float, float]:
        """Times in s and values of a curve, and half of the steps in which they are drawn."""
        figure = self.figures[key]
        points = np.array(re.findall(r"(-?\d+) (-?\d+)", figure["curves"][name]), dtype=float)
        (begin, end), (low, high) = figure["t"], figure["y"]
        t_s = begin + points[:, 0] / COLUMNS * (end - begin)
        return t_s, high - points[:, 1] / ROWS * (high - low), 0.5 * (end - begin) / COLUMNS, 0.5 * (high - low) / ROWS


def _numbers(text: str | None) -> list[float]:
    return [float(part) for part in (text or "").split()]


def run_of(t_s: np.ndarray = HUNDREDTHS) -> dict[str, Any]:
    """All streams of a small run."""
    std = np.full((len(t_s), 3), 0.5)
    speed = 10.0 + np.sin(t_s)
    q = from_euler(0.3 * t_s, 0.05 * np.sin(t_s), np.zeros(len(t_s)))
    vel = np.column_stack((speed, 0.0 * speed, 0.0 * speed))
    trajectory = drive(t_s, vel=vel, q=q, pos_std=std, vel_std=0.1 * std, att_std_yaw=np.full(len(t_s), 0.02))
    trajectory = replace(trajectory, accel=np.column_stack((np.cos(t_s), 0.0 * t_s, 0.0 * t_s)))
    at = START_NS + np.arange(60) * SECOND
    residuals = build(
        RESIDUALS, time=at, sensor=["gnss"] * 60, component=["pos_e"] * 60, value=np.linspace(-3.0, 30.0, 60),
        sigma=np.full(60, 2.0), weight=np.ones(60), accepted=np.arange(60) < 50,
    )  # fmt: skip
    learnt = metrics(
        [Metric("mount_yaw", 1.23456789, "deg", sigma=0.0123, note="of <the> box"), Metric("rows", 6001.0)]
    )
    fixed = fixes([*range(20), *range(30, 60)], lat=44.5 + 1e-5 * np.arange(50), speed=np.full(50, 10.0))
    events = happened((5.0, 8.0)), happened((40.0, 40.1), kind="crash", value=60.0, unit="m/s^2")
    return {
        "trajectory": trajectory, "gnss": fixed, "residuals": residuals, "metrics": learnt,
        "events": pa.concat_tables(events), "reference": drive(t_s, vel=vel, q=q),
    }  # fmt: skip


def export(folder: Path, streams: dict[str, Any] | None = None, manifest: Any = MANIFEST) -> tuple[str, dict[str, Any]]:
    made = run_of() if streams is None else streams
    page, data = report(streams=made, folder=folder, about=RunInfo("My <run>", manifest), params=ReportParams())
    assert (page, data) == (folder / "report.html", folder / "report.json")
    return page.read_text(encoding="utf-8"), json.loads(data.read_text(encoding="utf-8"))


def test_the_record_keeps_the_rules_of_its_role():
    (record,) = declare_exporters()
    assert record.faults() == []


def test_the_json_in_the_page_is_the_one_beside_it(tmp_path):
    text, data = export(tmp_path)
    (inside,) = re.findall(r'<script type="application/json" id="facts">(.*?)</script>', text, re.DOTALL)
    assert json.loads(inside) == data


def test_numbers_in_the_page_are_those_of_the_json(tmp_path):
    text, data = export(tmp_path)
    known: set[float] = set()

    def collect(part: Any) -> None:
        if isinstance(part, dict):
            part = list(part.values())
        if isinstance(part, list):
            for one in part:
                collect(one)
        elif isinstance(part, int | float) and not isinstance(part, bool):
            known.update((float(part), 100.0 * part))

    collect(data)
    numbers = Page(text).numbers
    assert len(numbers) > 40
    assert set(numbers) <= known
    assert {1.23456789, 0.0123, 12345678.0, 60.0} <= set(numbers)


def test_numbers_in_the_json_are_those_of_the_streams(tmp_path):
    streams = run_of()
    _, data = export(tmp_path, streams)
    assert [row["value"] for row in data["metrics"]] == streams["metrics"]["value"].to_pylist()
    assert [row["kind"] for row in data["events"]] == ["standstill", "crash"]
    assert [row["t_s"] for row in data["events"]] == pytest.approx([5.0, 40.0], abs=1e-9)
    assert [(gap["stream"], gap["duration"]) for gap in data["outages"]] == [("gnss", 11.0)]
    (figures,) = data["residuals"]
    value = np.linspace(-3.0, 30.0, 60)[:50]
    assert (figures["accepted"], figures["rejected"]) == (50, 10)
    assert figures["rms"] == pytest.approx(np.sqrt(np.mean(value**2)))
    assert figures["beyond_2_sigma"] == np.mean(np.abs(value) > 4.0)
    assert {row["name"]: row["median"] for row in data["sigmas"]}["heading"] == pytest.approx(np.degrees(0.02))
    assert data["errors"]["position"]["total"]["max"] == 0.0


def test_gnss_that_comes_late_or_is_lost_until_the_end_is_an_outage(tmp_path):
    streams = run_of()
    _, data = export(tmp_path, {**streams, "gnss": streams["gnss"].slice(5, 10)})
    assert [(gap["t_s"], gap["duration"]) for gap in data["outages"]] == [(0.0, 5.0), (14.0, 46.0)]


def test_gnss_that_is_late_is_said_to_be_drawn_so(tmp_path):
    delays = [Metric("gnss_delay", 0.3, "s", 0.07), Metric("gnss_velocity_delay", 0.1, "s", 0.02)]
    assert (
        "Its speeds come 0.400 s (± sigma 0.070 s) late"
        in export(tmp_path, {**run_of(), "metrics": metrics(delays)})[0]
    )
    unsure = [Metric("gnss_delay", 0.1, "s", 0.07)]
    assert "late, which" not in export(tmp_path, {**run_of(), "metrics": metrics(unsure)})[0]


def test_curves_read_back_as_the_rows_of_the_stream(tmp_path):
    streams = run_of()
    page = Page(export(tmp_path, streams)[0])
    for key, wanted in (
        ("speed", 10.0 + np.sin(HUNDREDTHS)),
        ("accel_x", np.cos(HUNDREDTHS)),
        ("height", vector(streams["trajectory"], "height")),
        ("pos_std", np.full(6001, 0.5)),
        ("heading", 90.0 - np.degrees(0.3 * HUNDREDTHS)),
    ):
        t_s, values, half_t, half_y = page.curve(key, "east" if key == "pos_std" else "trajectory")
        rows = np.rint(t_s * 100).astype(int)
        slope = np.abs(np.gradient(wanted, 0.01)).max()
        assert np.abs(t_s - rows / 100).max() <= half_t * 1.001
        assert np.abs(values - wanted[rows]).max() <= half_y * 1.001 + slope * 1e-9
        assert {0, 6000} <= set(rows.tolist())


def test_bands_are_two_sigma_to_either_side(tmp_path):
    figure = Page(export(tmp_path)[0]).figures["height"]
    (band,) = figure["bands"]
    points = np.array(re.findall(r"(-?\d+) (-?\d+)", band), dtype=float)
    (low, high), half = figure["y"], len(points) // 2
    heights = high - points[:, 1] / ROWS * (high - low)
    # one span of the thinned drive rises by 0.1 m/s * 60 s / 2000 = 3 mm, which the band takes in on either side
    assert np.abs((heights[:half] - heights[half:][::-1]) - 2.0).max() < 0.003 + (high - low) / ROWS


def test_a_line_is_interrupted_where_rows_are_missing(tmp_path):
    t_s = np.concatenate((np.arange(0, 10, 0.01), np.arange(15, 30, 0.01)))
    curve = Page(export(tmp_path, run_of(t_s))[0]).figures["speed"]["curves"]["trajectory"]
    assert curve.count("M") == 2


def test_a_page_says_how_it_was_thinned_and_a_short_run_is_not(tmp_path):
    assert "thinned for the eye" in export(tmp_path)[0]
    assert "thinned for the eye" not in export(tmp_path, run_of(np.arange(0, 2000) / 100))[0]


def test_a_crash_is_drawn_from_close_by_with_every_row(tmp_path):
    text, _ = export(tmp_path)
    closer = text[text.index("Crashes, closer") :]
    t_s, _, half, _ = Page(closer).curve("speed", "trajectory")
    rows = np.rint(t_s * 100).astype(int)
    assert np.abs(t_s - rows / 100).max() <= half * 1.001
    assert set(range(3900, 4310)) <= set(rows.tolist())


def test_what_is_drawn_from_close_by_ends_with_the_run(tmp_path):
    streams = run_of(np.arange(0, 4151) / 100)
    text, _ = export(tmp_path, {name: streams[name] for name in ("trajectory", "events")})
    closer = text[text.index("Crashes, closer") :]
    assert {float(last) for last in re.findall(r'data-t="\S+ (\S+)"', closer)} == {41.5}


def test_texts_of_a_log_are_text_in_the_page(tmp_path):
    text, data = export(tmp_path)
    assert "</script><b>" not in text
    assert "<the>" not in text
    assert "&lt;/script&gt;&lt;b&gt;beware" in text
    assert data["warnings"][0] == "</script><b>beware"
    assert "twice (2 times)" in text


@pytest.mark.parametrize("missing", ["trajectory", "gnss", "residuals", "metrics", "events", "reference"])
def test_a_run_without_a_stream_is_reported_too(tmp_path, missing):
    streams = {name: table for name, table in run_of().items() if name != missing}
    _, data = export(tmp_path, streams)
    assert missing not in data["streams"]


def test_of_an_imu_alone_what_was_logged_is_drawn(tmp_path):
    from recon.testing.drives import drive as tested

    imu = tested()["imu"].slice(0, 1000)
    t_s, values, _, half = Page(export(tmp_path, {"imu": imu})[0]).curve("imu_gyro", "z")
    assert len(t_s) == 1000
    assert np.abs(values - np.degrees(vector(imu, "gyro_z"))).max() <= 1.001 * half


def test_a_run_of_nothing_is_reported_too(tmp_path):
    text, _ = export(tmp_path, {}, {})
    assert "The run holds no rows." in text


def test_without_a_place_on_the_earth_the_track_is_in_the_local_frame(tmp_path):
    streams = {"trajectory": drive(np.arange(0, 30, 0.1), lat=None, lon=None, height=None)}
    text, _ = export(tmp_path, streams)
    assert "no place on the Earth is known" in text
    assert "data-world" not in text
    assert "<b>Heading, clockwise from the north of the local frame</b>" in text
    assert "<b>Heading, clockwise from north</b>" in export(tmp_path)[0]


def test_further_trajectories_are_drawn_under_the_names_of_their_runs(tmp_path):
    other = with_meta(drive(np.arange(0, 60, 0.1)), run="other run")
    page = Page(export(tmp_path, {**run_of(), "trajectory_2": other})[0])
    assert set(page.figures["speed"]["curves"]) == {"trajectory", "other run", "reference", "gnss"}


def test_equal_runs_give_equal_bytes(tmp_path):
    (tmp_path / "b").mkdir()
    assert export(tmp_path)[0] == export(tmp_path / "b")[0]


def test_an_hour_at_100_hz_is_small_and_quick(tmp_path):
    """Under 7 MB and 3 s: what the users were promised; it takes a tenth of both on a machine of 2024."""
    streams = run_of(np.arange(360_000) / 100)
    del streams["reference"]
    started = time.perf_counter()
    text, _ = export(tmp_path, streams)
    assert time.perf_counter() - started < 3.0
    assert len(text.encode()) < 7e6


# --- in a browser ---------------------------------------------------------------------------------------------------

ACT = """
<script>
  const svg = document.querySelector('.panel[data-key=speed] > svg'), box = svg.getBoundingClientRect();
  const at = (kind, x) => svg.dispatchEvent(new PointerEvent(kind,
    {clientX: box.left + x / 1000 * box.width, clientY: box.top + 20, bubbles: true, pointerId: 1, isPrimary: true}));
  svg.setPointerCapture = () => {};
  at("pointermove", 62 + 886 / 2);
  const told = document.createElement("aside");
  told.append(svg.parentNode.querySelector("output").textContent, "|",
    document.querySelector(".now").getAttribute("visibility"), "|");
  at("pointerdown", 62 + 886 / 4);
  at("pointerup", 62 + 886 / 2);
  told.append(svg.querySelector(".data").getAttribute("viewBox"));
  document.body.append(told);
</script>"""


def test_the_page_opens_without_an_error_and_answers_the_pointer(tmp_path):
    text, _ = export(tmp_path)
    page = tmp_path / "acted.html"
    page.write_text(text.replace("</body>", ACT + "</body>"), encoding="utf-8")
    document, console = opened(page, tmp_path / "profile")
    assert console == []
    assert 'data-ready="1"' in document
    (told,) = re.findall(r"<aside>(.*?)</aside>", document)
    output, visible, view = told.split("|")
    assert visible == "visible"
    speed = float(re.findall(r"trajectory (-?[\d.]+)", output)[0])
    assert output.startswith("30.00 s")
    assert speed == pytest.approx(10.0 + np.sin(30.0), abs=0.03)  # a neighbour of 15 ms and the grid's step
    assert [float(part) for part in view.split()] == pytest.approx([COLUMNS / 4, 0, COLUMNS / 4, ROWS])


KEYS = """<script>
  const chart = document.querySelector(".panel > svg"), heard = document.createElement("aside");
  const press = key => {
    chart.dispatchEvent(new KeyboardEvent("keydown", {key, cancelable: true}));
    heard.append(chart.parentNode.querySelector("output").textContent.split("   ")[0], ", ",
      chart.querySelector(".data").getAttribute("viewBox"), "|");
  };
  chart.focus();
  heard.append(document.activeElement === chart, "|");
  ["ArrowRight", "+", "ArrowLeft", "End", "Escape"].forEach(press);
  chart.blur();
  heard.append(chart.parentNode.querySelector("output").textContent);
  document.body.append(heard);
</script>"""


def test_the_charts_are_read_and_looked_at_closer_by_keys_alone(tmp_path):
    """A minute: an arrow is a hundredth of what is shown, from its middle on."""
    text, _ = export(tmp_path)
    page = tmp_path / "keys.html"
    page.write_text(text.replace("</body>", KEYS + "</body>"), encoding="utf-8")
    document, console = opened(page, tmp_path / "profile")
    assert console == []
    (told,) = re.findall(r"<aside>(.*?)</aside>", document)
    focused, *steps, end = told.split("|")
    assert (focused, end) == ("true", "")
    read = [
        (float(at.removesuffix(" s")), [float(part) for part in view.split()])
        for at, view in (step.split(", ") for step in steps)
    ]
    half, closer = COLUMNS / 2, COLUMNS * (30.6 / 60.0 - 0.25)
    assert read == [
        (30.6, [0, 0, COLUMNS, ROWS]),
        (30.6, pytest.approx([closer, 0, half, ROWS])),
        (30.3, pytest.approx([closer, 0, half, ROWS])),
        (60.0, pytest.approx([half, 0, half, ROWS])),
        (60.0, pytest.approx([0, 0, COLUMNS, ROWS])),
    ]


def test_the_picture_shows_track_curves_and_rejected_residuals(tmp_path):
    streams = run_of()
    del streams["reference"]  # which would cover the trajectory
    export(tmp_path, streams)
    picture = seen(tmp_path / "report.html", tmp_path / "profile", 1100, 3600)
    map_part, charts = picture[200:1000], picture[1000:]
    # a line colours a pixel or more of each row or column that it crosses, a dot the four in its middle or so
    assert pixels(map_part, "#0072b2") > 300
    assert pixels(charts, "#0072b2") > 5 * 800
    assert pixels(charts, "#e69f00") > 2 * 50
    assert pixels(charts, "#d55e00") > 9 * 10


def test_on_a_phone_the_edge_is_dark_behind_which_a_chart_goes_on(tmp_path):
    export(tmp_path)
    for width, inner, dark in ((500, 500 - 14, True), (1280, (1280 + 1060) // 2 - 30, False)):
        picture = seen(tmp_path / "report.html", tmp_path / f"profile{width}", width, 3600).astype(int)
        edge = picture[:, inner - 2]
        grey = (np.ptp(edge, axis=1) < 4) & (edge[:, 0] > 170) & (edge[:, 0] < 215)
        assert (grey.sum() > 1000) == dark  # six charts and tables or so, of a hundred rows and more each


@pytest.mark.parametrize("log", ["comma2k19_example/seg40", "physycom_crash/crash_01.txt"])
def test_the_report_of_a_real_log_opens_with_the_numbers_of_its_streams(log, logs, tmp_path):
    run = recon.run("best_accuracy", logs / log, tmp_path / "run", exports=["report"])
    page = tmp_path / "run" / "exports" / "report" / "report.html"
    document, console = opened(page, tmp_path / "profile")
    assert console == []
    assert 'data-ready="1"' in document
    found = Page(page.read_text(encoding="utf-8"))
    t_s, values, half_t, half_y = found.curve("speed", "trajectory")
    own_s = (time_ns(run.recording["trajectory"]) - run.recording.span_ns()[0]) * 1e-9
    speed = np.linalg.norm(matrix(run.recording["trajectory"], "vel"), axis=1)
    around = np.searchsorted(own_s, t_s[:, None] + np.array([-1.001, 1.001]) * half_t)
    for value, (first, last) in zip(values, around, strict=True):
        assert np.abs(speed[first:last] - value).min() <= 1.001 * half_y
    assert set(run.summary().values()) - {float(len(run.warnings))} <= set(found.numbers)


def test_it_prints_on_paper(tmp_path):
    export(tmp_path)
    assert printed(tmp_path / "report.html", tmp_path / "profile").count(b"/Type /Page\n") >= 3


def test_rejected_residuals_are_seen_on_paper(tmp_path):
    """A square at the end of a line without a length is drawn on the screen and missing in a PDF."""
    text, _ = export(tmp_path)
    (drawn,) = re.findall(r'data-name="rejected" d="([^"]*)"', text)
    assert drawn.count("M") == drawn.count("h1") == 10


def test_events_metrics_and_residuals_are_told_in_words(tmp_path):
    text, data = export(tmp_path, {**run_of(), "events": happened((5.0, 8.0), kind="harsh_braking")})
    page = text[: text.index("<script")]
    assert "harsh braking" in page
    assert "Residuals of GNSS position east" in page
    assert '<span title="mount_yaw">Mount yaw</span>' in page
    assert not re.findall(r">[^<]*(?:harsh_braking|pos_e|mount_yaw)", page)
    assert [event["kind"] for event in data["events"]] == ["harsh_braking"]


def test_it_asks_for_nothing_from_the_network(tmp_path):
    """No address is loaded by the page itself; the street map is asked for by a click."""
    text, _ = export(tmp_path)
    assert re.findall(r'(?:src|href)="(?!data:)[^"]*"', text) == []
    assert "@import" not in text
    assert "url(" not in text
    assert time_ns(run_of()["gnss"])[0] == START_NS


@pytest.mark.parametrize(
    ("quantity", "words"), [("acceleration", "Acceleration"), ("specific_force", "Specific force")]
)
def test_a_chart_of_a_sensor_says_whether_gravity_is_in_it(quantity, words, tmp_path):
    imu = build(
        Change(quantities={"accel": quantity}).apply(IMU),
        time=START_NS + np.arange(9) * 10_000_000,
        accel=np.ones((9, 3)),
        gyro=np.zeros((9, 3)),
    )
    text, _ = export(tmp_path, {"imu": imu})
    assert f"<b>{words}, as logged (imu)</b>" in text
