from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from recon.edr import SPEED
from recon.errors import ReadFailed
from recon.rows import warnings_of
from recon.tables import Streams
from recon_readers.edr_csv import EdrCsvParams, read, sniff

REPORT = """Times (sec),"Speed, Vehicle Indicated (MPH [km/h])","Accelerator (%)","Service Brake (On, Off)"
-5.0,34 [55],20,Off
-0.5,30 [48],0,On
0.0,28 [45],0,On

Time (msec),"Delta-V, longitudinal (MPH [km/h])","Delta-V, lateral (MPH [km/h])"
0,0 [0],0 [0]
10,-1 [-2],0 [0]
20,-3 [-5],1 [1]
"""


def read_text(folder: Path, text: str, **params: Any) -> Streams:
    path = folder / "report.csv"
    path.write_text(text, encoding="utf-8")
    return read(path=path, params=EdrCsvParams(**params))


def values(streams: Streams, stream: str, element: str) -> list[tuple[float, float, str]]:
    rows = streams[stream].to_pylist()
    return [(row["t"], row["value"], row["unit"]) for row in rows if row["element"] == element]


def test_a_pasted_report_is_read_in_the_unit_in_brackets(tmp_path: Path) -> None:
    found = read_text(tmp_path, REPORT)
    speed = values(found, "recorded_pre_crash", "Speed, vehicle indicated")
    assert speed == [(-5.0, 55.0, "km/h"), (-0.5, 48.0, "km/h"), (0.0, 45.0, "km/h")]
    change = values(found, "recorded_crash", "Delta-V, longitudinal")
    assert [t for t, _, _ in change] == pytest.approx([0.0, 0.01, 0.02])
    assert [value for _, value, _ in change] == [0.0, -2.0, -5.0]
    assert values(found, "recorded_crash", "Delta-V, lateral")[2][1] == 1.0


def test_other_numbers_keep_their_name_and_unit_and_texts_are_counted(tmp_path: Path) -> None:
    found = read_text(tmp_path, REPORT)
    assert values(found, "recorded_pre_crash", "Accelerator")[0] == (-5.0, 20.0, "%")
    left_out = [row["method"] for row in found["metrics"].to_pylist() if row["name"] == "edr_left_out"]
    assert left_out == ["Service Brake"]


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_every_separator_and_unit_is_known(tmp_path: Path, separator: str) -> None:
    header = ["Time (ms)", "Delta-V longitudinal (mph)", "Long. acceleration (m/s^2)"]
    lines = [header, ["0", "0", "0"], ["10", "-10", "-98.0665"]]
    found = read_text(tmp_path, "\n".join(separator.join(line) for line in lines))
    # A mile is 1.609344 km.
    assert values(found, "recorded_crash", "Delta-V, longitudinal")[1][1] == pytest.approx(-16.09344)
    assert values(found, "recorded_crash", "Longitudinal acceleration")[1] == (0.01, pytest.approx(-10.0), "g")


def test_a_table_that_recon_exported_is_read_back(tmp_path: Path) -> None:
    text = 'event,t [s],element,unit,value,sigma\n2,0.01,"Delta-V, longitudinal","km/h",-3,0.1\n'
    (row,) = read_text(tmp_path, text)["recorded_crash"].to_pylist()
    assert (row["event"], row["t"], row["value"]) == (2, 0.01, -3.0)


def test_the_number_of_the_event_may_be_told(tmp_path: Path) -> None:
    assert set(read_text(tmp_path, REPORT, event=2)["recorded_crash"]["event"].to_pylist()) == {2}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no table of an event data recorder"),
        ("a,b\n1,2\n", "holds no table of an event data recorder"),
        ("Time (ms),Delta-V longitudinal (furlong)\n0,1\n", "which is no unit like km/h"),
        ("event,t [s],element,unit,value\n1,x,a,b,2\n", "is no value of an element"),
    ],
)
def test_what_is_no_table_is_refused_in_a_sentence(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ReadFailed, match=message):
        read_text(tmp_path, text)


def test_its_tables_are_told_from_others() -> None:
    assert sniff(Path("a.csv"), REPORT.encode()).confidence > 0.9
    assert sniff(Path("a.csv"), b"time,ax,ay,az\n0,1,2,3\n").confidence == 0.0


def test_decimal_commas_are_read_and_what_may_be_thousands_is_told(tmp_path: Path) -> None:
    text = "Times (sec);Speed (km/h);Engine (rpm)\n-1;50,5;1,200\n-0,5;48;900\n0;47,25;850\n"
    streams = read_text(tmp_path, text)
    assert values(streams, "recorded_pre_crash", SPEED.name) == [
        (-1.0, 50.5, "km/h"), (-0.5, 48.0, "km/h"), (0.0, 47.25, "km/h")
    ]  # fmt: skip
    assert [value for _, value, _ in values(streams, "recorded_pre_crash", "Engine")] == [900.0, 850.0]
    assert warnings_of(streams["metrics"]) == ["Engine is no number in 1 lines, the first line 2: they are left out"]


def test_lines_without_a_time_are_told(tmp_path: Path) -> None:
    streams = read_text(tmp_path, REPORT.replace("-0.5,30 [48],0,On", "-0.5 s,30 [48],0,On") + "printed in 2020,,\n")
    assert warnings_of(streams["metrics"]) == [
        "1 lines have numbers and no time, the first line 3: they are left out"
    ]  # fmt: skip
