"""How sure the reader of Physycom logs is of a file, and why."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from physycom_logs import GOOD, HEAD, RECORDS, T0, WORDS, motion, text_of

from recon.tables import Array
from recon_readers.physycom import sniff


def confidence(text: str | bytes) -> float:
    found = sniff(Path("any.name"), (text.encode() if isinstance(text, str) else text)[:65536])
    assert found.reason
    return found.confidence


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(text_of(motion(2000)), id="fullinertial, cut at 64 KiB"),
        pytest.param(text_of(motion(20, place=False), header=WORDS[10].replace(" ", "\t")), id="header without #"),
        pytest.param(HEAD + GOOD, id="acc"),
        pytest.param(json.dumps(RECORDS), id="array"),
        pytest.param(json.dumps({"gnss_record_0": RECORDS[0]}), id="object"),
        pytest.param(json.dumps(RECORDS * 1000), id="JSON, cut at 64 KiB"),
    ],
)
def test_it_is_sure_of_its_own_headers_and_keys(text: str) -> None:
    assert confidence(text) == 0.9


@pytest.mark.parametrize("rows", [motion(20), motion(20, place=False)])
def test_it_is_fairly_sure_of_rows_with_plausible_times(rows: Array) -> None:
    assert 0.5 <= confidence(text_of(rows, header="")) < 0.9


@pytest.mark.parametrize(
    "text",
    [
        pytest.param("", id="empty"),
        pytest.param(b"\x89PNG\r\n\x1a\n\0\0", id="binary"),
        pytest.param("time,ax,ay,az\n1,2,3,4\n", id="commas"),
        pytest.param("1 2 3\n4 5 6\n", id="another width"),
        pytest.param("9 2 3 4\n4 5 6 7\n", id="times that fall"),
        pytest.param('{"type": "FeatureCollection"}', id="GeoJSON"),
        pytest.param('[{"lat": 1, "lon": 2}]', id="JSON without times"),
        pytest.param((HEAD + GOOD).encode("utf-16"), id="utf-16"),
        pytest.param("4000000000 1 2 3\n", id="beyond 2100"),
        pytest.param("timestamp ax ay az mood\n1 2 3 4 5\n", id="a header with another column"),
        pytest.param(GOOD.replace("\t", "|"), id="bars"),
        pytest.param('[{"lat": 1, "lon": 2, "speed": 3, "timestamp": "noon"}]', id="JSON with other times"),
    ],
)
def test_it_disclaims_other_files(text: str | bytes) -> None:
    assert confidence(text) == 0.0


@pytest.mark.parametrize("first", ["0", "3600", "1600000000"])
def test_a_clock_that_was_not_set_leaves_it_less_sure(first: str) -> None:
    assert 0.5 <= confidence((HEAD + GOOD).replace(str(T0), first)) < 0.9
    rows = text_of(motion(20, place=False), header="").replace(str(T0), first)
    assert 0.5 <= confidence(rows) < 0.9
    # Four columns of numbers may be anything.
    assert 0.0 < confidence(GOOD.replace(str(T0), first)) < 0.5


@pytest.mark.parametrize(
    "fault",
    [
        pytest.param(lambda lines: [*lines[:9], "abc\t" * 10, *lines[10:]], id="text"),
        pytest.param(lambda lines: [*lines[:9], "1\t2", *lines[10:]], id="short row"),
        pytest.param(lambda lines: [*lines[:9], lines[9] + "\t5", *lines[10:]], id="long row"),
        pytest.param(lambda lines: [*lines[:9], lines[3], *lines[10:]], id="time backward"),
        pytest.param(lambda lines: [*lines[:9], lines[9].replace(str(T0), "900000000"), *lines[10:]], id="time late"),
        pytest.param(lambda lines: [*lines[:9], lines[9].replace(str(T0), "\t"), *lines[10:]], id="no time"),
    ],
)
@pytest.mark.parametrize("header", [None, ""])
def test_a_fault_in_one_row_does_not_shake_it(fault: Any, header: str | None) -> None:
    lines = text_of(motion(60, place=False), header=header).splitlines()
    assert confidence("\n".join(fault(lines)) + "\n") >= 0.8


def test_a_header_alone_is_recognised_whatever_follows() -> None:
    assert confidence(HEAD) == 0.9
    assert confidence(HEAD + GOOD.replace(".", ",")) == 0.9
    assert confidence(HEAD + "1" * 70_000) == 0.9


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("time,ax,ay,az\n1,2,3,4\n", "commas part the columns, not tabs or spaces"),
        ("1;2;3;4\n" * 300, "semicolons part the columns, not tabs or spaces"),
        ("1|2|3|4\n" * 300, "vertical bars part the columns, not tabs or spaces"),
        ((HEAD + GOOD).encode("utf-16"), "this is UTF-16 text: save it as ASCII or UTF-8"),
        ("7" * 70_000, "a row of 1 column, where tabs or spaces part 4, 10 or 14 columns"),
        ("9 2 3 4\n4 5 6 7\n", "its first column is no time that rises"),
    ],
)
def test_its_reason_says_why_it_disclaims_a_file(text: str | bytes, reason: str) -> None:
    head = (text.encode() if isinstance(text, str) else text)[:65536]
    assert sniff(Path("any.name"), head).reason == reason
