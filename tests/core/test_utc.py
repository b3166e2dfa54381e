from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recon.utc import iso_ns, start_ns, zone_ns

MORNING = 1_714_550_400_000_000_000  # 2024-05-01T08:00:00Z, by date -u +%s


@pytest.mark.parametrize(
    ("text", "after_ns"),
    [
        ("2024-05-01T08:00:00Z", 0),
        ("2024-05-01 08:00:00", 0),
        ("20240501T080000Z", 0),
        ("2024-W18-3T08:00:00Z", 0),
        ("2024-05-01T10:00:00+02:00", 0),
        ("2024-05-01T08:00:00.5Z", 500_000_000),
        ("2024-05-01T08:00:00,5Z", 500_000_000),
        ("20240501T080000.123456789Z", 123_456_789),
        ("2024-05-01T04:30:00.000000001-03:30", 1),
        ("2024-05-01T08:00:00.1234567899", 123_456_789),
    ],
)
def test_every_digit_counts(text, after_ns):
    assert iso_ns(text) == MORNING + after_ns


@given(st.integers(-(2**62), 2**62))
def test_what_numpy_writes_is_read_back_to_the_nanosecond(ns):
    assert iso_ns(str(np.datetime64(ns, "ns"))) == ns


@pytest.mark.parametrize("text", ["2024-05-01T08:00.5Z", "20240501T0800,5", "2024-05-01T08.5"])
def test_fractions_of_minutes_and_hours_are_refused(text):
    """ISO 8601 allows them; taken for fractions of a second they would be wrong by up to an hour."""
    with pytest.raises(ValueError):
        iso_ns(text)


def test_a_zone_is_taken_where_the_text_names_none():
    assert iso_ns("2024-05-01T10:00:00.25", zone_ns("+02:00")) == MORNING + 250_000_000
    assert iso_ns("2024-05-01T08:00:00Z", zone_ns("+02:00")) == MORNING


@pytest.mark.parametrize("text", ["", "yesterday", "2024-13-01T00:00:00Z", "100s", "08:00:00"])
def test_what_is_no_time_is_a_value_error(text):
    with pytest.raises(ValueError):
        iso_ns(text)


@pytest.mark.parametrize(("text", "hours"), [("+00:00", 0.0), ("+0200", 2.0), ("-03:30", -3.5)])
def test_zones_are_signed_hours_and_minutes(text, hours):
    assert zone_ns(text) == hours * 3_600_000_000_000


@pytest.mark.parametrize("text", ["", "Z", "02:00", "+2:00", "+02:60", "+02:00 "])
def test_what_is_no_zone_is_a_value_error(text):
    with pytest.raises(ValueError, match="cannot be read"):
        zone_ns(text)


@pytest.mark.parametrize("text", ["9019-11-26T00:00:00Z", "0001-01-01", "2117-01-01"])
def test_a_start_with_which_sums_would_overflow_is_refused(text):
    with pytest.raises(ValueError, match="too far from 1970"):
        start_ns(text)
    assert start_ns("2024-05-01T08:00:00Z") == MORNING
