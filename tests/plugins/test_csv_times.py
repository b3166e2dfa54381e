"""Times of tables in every format, to the nanosecond."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from csv_logs import IMU, NS, ns, read_text
from metric_rows import rows_named

from recon.rows import warnings_of
from recon.tables import meta, time_ns
from recon_readers.csv import CsvParams


@pytest.mark.parametrize(
    ("time", "fields", "expected"),
    [
        ("{column: 1, format: unix}", "1711303746.530951712999", "2024-03-24T18:09:06.530951712"),
        ("{column: 1, format: unix, unit: ms}", "1395837505119.146001", "2014-03-26T12:38:25.119146001"),
        ("{column: 1, format: unix, unit: us}", "1395837505119146.001", "2014-03-26T12:38:25.119146001"),
        ("{column: 1, format: unix, unit: ns}", "1691185677581023001", "2023-08-04T21:47:57.581023001"),
        ("{column: 1, format: unix}", "1.395837505E9", "2014-03-26T12:38:25"),
        ("{column: 1, format: unix, scale: GPS}", "1756402240.961", "2025-08-28T17:30:22.961"),
        ("{column: 1, format: relative}", "2.784654166E-2", "1970-01-01T00:00:00.027846541"),
        ("{column: 1, format: relative}", "0.0000000001234567890123", "1970-01-01T00:00:00"),
        ("{column: 1, format: relative, unit: ms, start: 2026-06-08T12:00:00Z}", "1500", "2026-06-08T12:00:01.5"),
        ("{column: 1, format: relative, start: 2026-06-08T12:00:00+02:00}", "-0.5", "2026-06-08T09:59:59.5"),
        ("{column: 1, format: iso}", "2017-08-03T12:22:10.123456789Z", "2017-08-03T12:22:10.123456789"),
        ("{column: 1, format: iso}", "2017-08-03 12:22:10.5+02:00", "2017-08-03T10:22:10.5"),
        ("{column: 1, format: iso}", "2017-08-03T12:22:10-0530", "2017-08-03T17:52:10"),
        ("{column: 1, format: iso, zone: '+02:00'}", "2017-08-03 12:22:10", "2017-08-03T10:22:10"),
        ("{column: 1, format: iso, zone: '+02:00'}", "2017-08-03 12:22:10Z", "2017-08-03T12:22:10"),
        ("{column: 1, format: day_first}", "14/05/2016 11:17:09", "2016-05-14T11:17:09"),
        ("{column: 1, format: month_first}", "05/14/2016 11:17:09.25", "2016-05-14T11:17:09.25"),
        ("{columns: [1, 2], format: iso}", "2025/08/28,17:30:39.749", "2025-08-28T17:30:39.749"),
        ("{columns: [1, 2], format: iso, scale: GPS}", "2025/08/28,17:30:39.749", "2025-08-28T17:30:21.749"),
        ("{columns: [1, 2], format: gps_week}", "2381,408639.75", "2025-08-28T17:30:21.75"),
        ("{columns: [1, 2], format: gps_week, unit: ms}", "2381,408639750", "2025-08-28T17:30:21.75"),
        ("{column: 1, format: time_of_day, start: 2026-06-08}", "14:54:08.1", "2026-06-08T14:54:08.1"),
        ("{column: 1, format: time_of_day, start: 2026-06-08}", "145408.1", "2026-06-08T14:54:08.1"),
    ],
)
def test_every_format_of_time_comes_out_as_utc_to_the_nanosecond(
    tmp_path: Path, time: str, fields: str, expected: str
) -> None:
    accel = [3, 4, 5] if fields.count(",") else [2, 3, 4]
    mapping = f"imu: {{time: {time}, accel: {{columns: {accel}, unit: g}}}}"
    imu = read_text(tmp_path, f"{fields},0,0,1\n", mapping)["imu"]
    assert str(time_ns(imu)[0].view("datetime64[ns]")) == str(np.datetime64(expected, "ns"))
    assert meta(imu).get("time_scale") == ("UTC" if meta(imu)["clock"] == "absolute" else None)


@pytest.mark.parametrize(
    ("gps", "seconds"),
    [
        ("1980-01-06T00:00:00", 0),
        ("1981-07-01T00:00:00", 0),  # 1981-06-30T23:59:60 UTC, the leap second itself
        ("1981-07-01T00:00:01", 1),
        ("2016-12-31T23:59:59", 17),
        ("2017-01-01T00:00:17", 17),
        ("2017-01-01T00:00:18", 18),
        ("2026-01-01T00:00:00", 18),
    ],
)
def test_leap_seconds_are_those_of_bulletin_c(tmp_path: Path, gps: str, seconds: int) -> None:
    mapping = "imu: {time: {column: 1, format: iso, scale: GPS}, accel: {columns: [2, 3, 4], unit: g}}"
    streams = read_text(tmp_path, f"{gps},0,0,1\n", mapping)
    assert ns(gps) - time_ns(streams["imu"])[0] == seconds * NS
    assert rows_named(streams, "leap_seconds")[0]["value"] == seconds


def test_times_of_day_go_on_after_midnight(tmp_path: Path) -> None:
    mapping = "imu: {time: {column: 1, format: time_of_day}, accel: {columns: [2, 3, 4], unit: g}}"
    imu = read_text(tmp_path, "23:59:59.9,0,0,1\n00:00:00.1,0,0,1\n00:00:00.3,0,0,1\n", mapping)["imu"]
    assert np.diff(time_ns(imu)).tolist() == [200_000_000, 200_000_000]


def test_a_wrong_unit_of_time_is_a_warning(tmp_path: Path) -> None:
    mapping = IMU.replace("relative", "unix")
    streams = read_text(tmp_path, "t,ax,ay,az\n13958,0,0,1\n13959,0,0,1\n", mapping)
    assert "outside 1980 to 2100" in warnings_of(streams["metrics"])[0]


def test_a_start_beyond_the_clock_of_a_log_is_refused() -> None:
    time = {"column": "t", "format": "relative", "start": "9019-01-01"}
    with pytest.raises(ValueError, match="is no ISO 8601 time of a log"):
        CsvParams(columns={"wheel": {"time": time, "speed": {"column": "v", "unit": "m/s"}}})
