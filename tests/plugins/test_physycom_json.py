"""GNSS of the Physycom box as JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from physycom_logs import RECORDS, T0_UTC_NS, counts, read_text, refusal

from recon.tables import Streams, time_ns, vector


def read_json(folder: Path, data: Any) -> Streams:
    return read_text(folder, data if isinstance(data, str) else json.dumps(data))


def test_json_records_give_gnss(tmp_path: Path) -> None:
    streams = read_json(tmp_path, RECORDS)
    gnss = streams["gnss"]
    assert set(streams) == {"gnss", "metrics"}
    assert (time_ns(gnss) - T0_UTC_NS).tolist() == [k * 1_000_000_000 for k in range(12)]
    assert gnss.slice(0, 1).drop_columns(["time"]).to_pylist() == [
        {"lat": 44.5, "lon": 11.25, "height": 45.0, "speed": 10.0, "course": 1.5 * np.pi, "fix": 3}
    ]
    assert gnss.schema.field("fix").type == pa.int32()
    assert counts(streams) == (12, 12, 0)


def test_json_timestamps_lose_no_digit(tmp_path: Path) -> None:
    text = '[{"lat": 44.5, "lon": 11, "timestamp": 518716448.100103401, "speed": 0}]'
    assert time_ns(read_json(tmp_path, text)["gnss"])[0] - T0_UTC_NS == 100_103_401


def test_json_objects_are_ordered_by_the_numbers_of_their_keys(tmp_path: Path) -> None:
    data = {f"gnss_record_{k}": record for k, record in enumerate(RECORDS)}
    ordered = read_json(tmp_path, json.dumps(data, sort_keys=True))
    assert ordered["gnss"].equals(read_json(tmp_path, RECORDS)["gnss"])


def test_json_speed_may_hold_its_mean(tmp_path: Path) -> None:
    record = {**RECORDS[0], "speed": {"min": 30.0, "max": 40.0, "mean": 36.0}}
    assert vector(read_json(tmp_path, [record])["gnss"], "speed")[0] == 10.0


def test_json_optional_keys_may_be_absent_or_null(tmp_path: Path) -> None:
    plain = {key: RECORDS[0][key] for key in ("lat", "lon", "timestamp", "speed")}
    assert read_json(tmp_path, [plain])["gnss"].column_names == ["time", "speed", "lat", "lon"]
    gnss = read_json(tmp_path, [{**plain, "alt": None}, RECORDS[1]])["gnss"]
    assert gnss["height"].null_count == 1


@pytest.mark.parametrize(
    ("data", "says"),
    [
        pytest.param(json.dumps(RECORDS)[:-30], "no JSON", id="cut off"),
        pytest.param([], "no GNSS records", id="no records"),
        pytest.param({"a": 1}, "no GNSS records", id="another object"),
        pytest.param([RECORDS[0], 5], "record 2 is no JSON object", id="a number for a record"),
        pytest.param([RECORDS[0], {"lat": 1}], "record 2 has no 'timestamp'", id="missing key"),
        pytest.param([{**RECORDS[0], "lat": "north"}], "record 1: lat is 'north'", id="text for a number"),
        pytest.param([{**RECORDS[0], "lon": [1]}], "record 1: lon is", id="a list for a number"),
        pytest.param([{**RECORDS[0], "lat": 91}], "record 1: lat 91 lies outside", id="out of range"),
        pytest.param(RECORDS[::-1], "record 2: time", id="backwards"),
    ],
)
def test_bad_json_is_refused(tmp_path: Path, data: Any, says: str) -> None:
    text = data if isinstance(data, str) else json.dumps(data)
    assert says in refusal(tmp_path, text).message
