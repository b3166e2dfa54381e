"""GPS time and UTC: known pairs, and there and back."""

from __future__ import annotations

import numpy as np
import pytest

from recon.numerics.gnss_time import GPS_EPOCH_NS, NS, WEEK_NS, gps_to_utc, leap_seconds, utc_to_gps


def utc(text: str) -> int:
    return int(np.datetime64(text, "ns").astype(np.int64))


@pytest.mark.parametrize(
    ("week", "second", "text"),
    [
        (0, 0, "1980-01-06T00:00:00"),  # IS-GPS-200: the epoch
        (1930, 18, "2017-01-01T00:00:00"),  # Bulletin C 52: 18 s from here on
        (2377, 345600 + 18, "2025-07-31T00:00:00"),
    ],
)
def test_week_and_second_give_utc(week: int, second: int, text: str) -> None:
    gps_ns = np.array([GPS_EPOCH_NS + week * WEEK_NS + second * NS])
    assert gps_to_utc(gps_ns)[0] == utc(text)
    assert utc_to_gps(np.array([utc(text)]))[0] == gps_ns[0]


def test_a_leap_second_counts_from_its_end() -> None:
    new = utc("2017-01-01T00:00:00")
    assert leap_seconds(new + 17 * NS) == 17  # 23:59:60
    assert leap_seconds(new + 18 * NS) == 18


def test_times_rise_evenly_over_a_leap_second() -> None:
    gps_ns = utc("2017-01-01T00:00:10") + np.arange(20) * NS
    assert set(np.diff(gps_to_utc(gps_ns)).tolist()) == {NS}
    assert len(gps_to_utc(gps_ns[:0])) == 0
