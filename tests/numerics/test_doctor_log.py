"""What the doctor reads off the times of a log."""

from __future__ import annotations

import numpy as np

from recon.numerics.doctor.log import pairs


def test_pairs_are_as_far_apart_as_asked_and_none_spans_a_gap():
    t_s = np.array([0.0, 1.0, 2.0, 3.0, 20.0, 21.0, 22.5])
    first, last = pairs(t_s, 2.0, 4.0)
    assert first.tolist() == [0, 1, 4]
    assert last.tolist() == [2, 3, 6]
    assert all(len(ends) == 0 for ends in pairs(np.zeros(0), 2.0, 4.0))
