"""The order of time in a log: which rows can be used, and where the log pauses."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from recon_readers._time_order import PAUSE_NS, in_order, median_ns, never_falling, pauses, repeating, rising, slots

SECOND = 1_000_000_000
YEAR = 31_557_600 * SECOND


def test_the_median_of_times_since_1970_is_known_to_the_nanosecond() -> None:
    times_ns = 1_700_000_020_003_000_001 + np.array([5, 0, 1])
    assert median_ns(times_ns) == 1_700_000_020_003_000_002


def usable(seconds: list[float], missing: list[int] | None = None) -> list[int]:
    t_ns = (np.array(seconds) * SECOND).astype(np.int64)
    none = np.zeros(len(t_ns), dtype=bool)
    none[missing or []] = True
    return np.flatnonzero(in_order(t_ns, none)).tolist()


def longest(t_ns: NDArray[np.int64]) -> int:
    """The same by trying all selections."""
    rows = range(len(t_ns))
    return max(size for size in (0, *rows, len(t_ns)) for found in combinations(rows, size) if rises(t_ns[list(found)]))


def rises(t_ns: NDArray[np.int64]) -> bool:
    return bool((np.diff(t_ns) >= 0).all())


def test_a_first_time_that_is_far_goes_however_often_it_repeats() -> None:
    rows, told = rising(np.array([0, 0, 0, *range(YEAR, YEAR + 5 * SECOND, SECOND)]), "imu")
    assert np.arange(8)[rows].tolist() == [3, 4, 5, 6, 7]
    assert [(each.name, each.value) for each in told] == [("rows_left_out", 2.0), ("rows_left_out", 1.0)]


def test_times_that_rise_are_all_used() -> None:
    assert usable([1, 2, 2, 3]) == [0, 1, 2, 3]
    assert usable([]) == []
    assert usable([5]) == [0]


def test_a_row_without_a_time_is_not_used() -> None:
    assert usable([1, 0, 3, 4], missing=[1]) == [0, 2, 3]
    assert usable([1, 2], missing=[0, 1]) == []


@pytest.mark.parametrize("value", [100.0, 3.2e8, -3.2e8, 0.5])
def test_one_stray_row_goes_alone(value: float) -> None:
    rows = [float(row) for row in range(1, 100)]
    rows[40] = value
    assert usable(rows) == [row for row in range(99) if row != 40]


@pytest.mark.parametrize("row", [0, 98])
def test_a_lone_row_at_an_end_goes_if_it_is_far_away(row: int) -> None:
    rows = [float(number) for number in range(1, 100)]
    rows[row] += 3599.0 * (1 if row else -1)
    assert len(usable(rows)) == 99
    rows[row] += 1.0 * (1 if row else -1)
    assert usable(rows) == [number for number in range(99) if number != row]


def test_of_two_ways_the_one_that_keeps_what_is_above_is_taken() -> None:
    assert usable([1, 2, 4, 3, 5]) == [0, 1, 2, 4]
    assert usable([5, 4, 3]) == [0]


@pytest.mark.parametrize("seed", range(20))
def test_no_longer_selection_rises(seed: int) -> None:
    t_ns = np.random.default_rng(seed).integers(0, 8, 10)
    found = in_order(t_ns, np.zeros(10, dtype=bool))
    assert rises(t_ns[found])
    assert found.sum() == longest(t_ns)


def test_a_million_rows_after_a_stray_one_are_searched_in_seconds() -> None:
    t_ns = np.arange(1_000_000) * 1000
    t_ns[0] = YEAR
    assert in_order(t_ns, np.zeros(len(t_ns), dtype=bool)).sum() == 999_999


def test_unusable_times_are_replaced_by_one_beside_them() -> None:
    t_ns = np.array([9, 1, 2, 9, 3])
    assert never_falling(t_ns, np.array([False, True, True, False, True])).tolist() == [1, 1, 2, 2, 3]
    assert never_falling(t_ns, np.zeros(5, dtype=bool)).tolist() == [0] * 5


def test_a_pause_is_an_hour_in_a_dense_log_and_longer_in_a_sparse_one() -> None:
    dense = np.cumsum([0, *[SECOND] * 9, PAUSE_NS, SECOND, PAUSE_NS + 1, SECOND])
    assert pauses(dense).tolist() == [11]
    sparse = np.cumsum([0, *[PAUSE_NS] * 9, 99 * PAUSE_NS, PAUSE_NS, 101 * PAUSE_NS])
    assert pauses(sparse).tolist() == [11]
    assert pauses(dense[:1]).tolist() == []


def test_a_row_of_the_time_of_an_earlier_row_of_its_sensor_repeats() -> None:
    t_ns = np.array([1, 1, 1, 2])
    accel, gyro = np.array([True, False, True, True]), np.array([False, True, False, True])
    assert repeating(t_ns, [accel, gyro]).tolist() == [False, False, True, False]


def test_rows_of_one_time_share_a_slot() -> None:
    begins, slot = slots(np.array([5, 5, 7, 8, 8, 8]))
    assert begins.tolist() == [True, False, True, True, False, False]
    assert slot.tolist() == [0, 0, 1, 2, 2, 2]
