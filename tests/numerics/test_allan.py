from __future__ import annotations

import numpy as np
import pytest

from recon.numerics.allan import Noise, fit, overlapping, sizes, uncertainty


def nist_numbers():
    """The 1000 numbers of NIST SP 1065, section 12.4: a congruential generator."""
    n = [1234567890]
    for _ in range(999):
        n.append(16807 * n[-1] % 2147483647)
    return np.array(n)[:, None] / 2147483647.0


@pytest.mark.parametrize(("size", "deviation"), [(1, 2.922319e-1), (10, 9.159953e-2), (100, 3.241343e-2)])
def test_the_handbook_of_nist_is_reproduced(size, deviation):
    """NIST SP 1065, table 31, overlapping Allan deviation, to the seven digits that it gives."""
    assert overlapping(nist_numbers(), [size])[0, 0] == pytest.approx(deviation, rel=2e-7)


def test_an_offset_changes_nothing():
    y = nist_numbers()
    # 1e6 leaves ten digits of y, and a deviation is the mean of many.
    np.testing.assert_allclose(overlapping(y + 1e6, [1, 10]), overlapping(y, [1, 10]), rtol=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_the_terms_that_were_put_in_are_found(seed):
    rate, count = 100.0, 200_000
    rng = np.random.default_rng(seed)
    white, walk = 2e-3, 5e-4
    y = white * np.sqrt(rate) * rng.standard_normal((count, 1))
    y += np.cumsum(walk / np.sqrt(rate) * rng.standard_normal((count, 1)), axis=0)
    size = sizes(count)
    found = fit(size / rate, overlapping(y, size)[:, 0], uncertainty(count, size))
    # Points at the shortest times are worth 2e5 samples; the walk rests on some 20 independent pieces of 100 s.
    assert found.white == pytest.approx(white, rel=0.01)
    assert found.walk == pytest.approx(walk, rel=0.35)
    assert found.quantisation == 0.0


def test_what_is_not_there_does_not_show():
    y = np.random.default_rng(7).standard_normal((20_000, 1))
    size = sizes(20_000)
    found = fit(size / 1.0, overlapping(y, size)[:, 0], uncertainty(20_000, size))
    assert found.walk == found.quantisation == 0.0
    assert found.white == pytest.approx(1.0, rel=0.02)


def test_the_model_adds_variances():
    noise = Noise(white=3.0, instability=0.0, walk=4.0 * np.sqrt(3.0), quantisation=0.0)
    assert noise.deviation(1.0) == pytest.approx(5.0)


def test_too_few_samples_have_no_sizes():
    assert len(sizes(5)) == 0
