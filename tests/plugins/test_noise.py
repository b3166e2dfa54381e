"""Random processes: their sigma and their spectrum."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from recon_simulators.noise import gauss_markov, in_band


@pytest.mark.parametrize("seed", range(10))
def test_a_gauss_markov_process_is_stationary_and_forgets_with_its_time(seed: int) -> None:
    process = gauss_markov((5000, 2), 4.0, 30.0, np.random.default_rng(seed))
    kept = np.exp(-1.0 / 120.0)
    innovations = np.vstack((process[:1], (process[1:] - kept * process[:-1]) / np.sqrt(1.0 - kept**2)))
    # Independent standard normals: the sum of squares lies between the chi-square quantiles 1e-6 and 1 - 1e-6.
    low, high = (float(chi2.ppf(p, innovations.size)) for p in (1e-6, 1.0 - 1e-6))
    assert low < np.sum(innovations**2) < high


def test_a_process_without_memory_is_white() -> None:
    np.testing.assert_array_equal(
        gauss_markov((9, 3), 1.0, 0.0, np.random.default_rng(1)), np.random.default_rng(1).standard_normal((9, 3))
    )


@pytest.mark.parametrize(("rate_hz", "band_hz"), [(100.0, (8.0, 45.0)), (1000.0, (8.0, 45.0)), (50.0, (8.0, 45.0))])
def test_noise_in_a_band_has_sigma_one_and_its_power_there(rate_hz: float, band_hz: tuple[float, float]) -> None:
    seconds = 2000.0
    noise = in_band((int(rate_hz * seconds), 1), rate_hz, band_hz, np.random.default_rng(0))
    high = min(band_hz[1], 0.45 * rate_hz)
    # 2 B T independent values, 57 000 at least: sigma is known to 0.3 %.
    assert np.std(noise) == pytest.approx(1.0, rel=5.0 / np.sqrt(4.0 * (high - band_hz[0]) * seconds))
    power = np.abs(np.fft.rfft(noise[:, 0])) ** 2
    frequency = np.fft.rfftfreq(len(noise), 1.0 / rate_hz)
    # A second-order Butterworth band holds 1 / (1 + x^4) over |x| < 1 against all x: 0.87 / 1.11 = 78 %.
    inside = power[(frequency > band_hz[0]) & (frequency < high)].sum() / power.sum()
    assert inside > 0.75


def test_a_band_beyond_the_sampling_is_white() -> None:
    np.testing.assert_array_equal(
        in_band((9, 3), 10.0, (8.0, 45.0), np.random.default_rng(1)), np.random.default_rng(1).standard_normal((9, 3))
    )
