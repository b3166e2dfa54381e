"""A simulated barometer shows the height of the vehicle, as far as its air lets it."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from recon.numerics.barometer import height_pressure, pressure_height
from recon.numerics.signals import interpolate
from recon.tables import time_ns, vector
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams


def drive(duration=120.0, **given):
    return simulate_drive(DriveParams(motion="city", duration=duration, imu_rate=50.0, baro_rate=10.0, **given))


def error(streams):
    """Height that the barometer tells less the true one, m."""
    baro, truth = streams["baro"], streams["reference"]
    true = interpolate(time_ns(baro), time_ns(truth), vector(truth, "height"))
    return (pressure_height(vector(baro, "pressure")) - true)[np.isfinite(true)]


def test_pressure_and_height_are_inverses():
    height = np.linspace(-400.0, 9000.0, 50)
    assert_allclose(pressure_height(height_pressure(height)), height, atol=1e-8)


def test_a_perfect_barometer_shows_the_height():
    # The truth is interpolated between samples 20 ms apart, in which slopes change by less than a millimetre.
    assert_allclose(error(drive(baro_noise=0.0, baro_walk=0.0, baro_scale=0.0)), 0.0, atol=1e-3)


def test_noise_and_walk_have_their_size():
    noise = error(drive(baro_walk=0.0, baro_scale=0.0, baro_noise=0.5))
    assert_allclose(noise.std(), 0.5, rtol=4.0 / np.sqrt(2.0 * len(noise)))
    walk = error(drive(baro_noise=0.0, baro_scale=0.0, baro_walk=0.1))
    assert_allclose(np.diff(walk).std(), 0.1 / np.sqrt(10.0), rtol=4.0 / np.sqrt(2.0 * len(walk)))


def test_windows_and_tunnels_move_it_for_a_while():
    jumps = error(drive(400.0, baro_noise=0.0, baro_walk=0.0, baro_scale=0.0, baro_jump_rate=30.0 / 3600.0))
    assert np.abs(jumps).max() >= 3.0 - 1e-3
    assert (np.abs(jumps) < 1e-3).mean() > 0.2


def test_without_a_rate_there_is_none():
    assert "baro" not in simulate_drive(DriveParams(motion="city", duration=60.0, imu_rate=20.0))
