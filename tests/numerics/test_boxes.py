import numpy as np
import pytest

from recon.numerics.box_clocks import Inertial
from recon.numerics.boxes import place
from recon.numerics.rotation import conjugate, from_euler, rotate
from recon.numerics.signals import differentiate

LEVER = np.array([1.2, -0.4, 0.6])
RATE = 50.0
START_NS = 1_700_000_000_000_000_000


def rigid_motion(rng, duration=400.0):
    """Turn rates rad/s and specific force m/s^2 of a vehicle that rolls, pitches, turns, brakes: t_s, (n, 3) each."""
    t_s = np.arange(0.0, duration, 1.0 / (4.0 * RATE))

    def slow(values, seconds):
        kernel = np.hanning(int(seconds * 4.0 * RATE))
        return np.convolve(values, kernel / kernel.sum(), "same")

    starts = np.searchsorted(np.cumsum(rng.uniform(2.0, 8.0, int(duration))), t_s)
    pushes, bends = rng.uniform(-2.5, 2.5, starts.max() + 1), rng.uniform(-0.4, 0.4, starts.max() + 1)
    moving = t_s > 20.0
    noise = rng.standard_normal((3, len(t_s)))
    gyro = np.stack([0.3 * slow(noise[0], 0.6), 0.3 * slow(noise[1], 0.5), slow(bends[starts], 0.8)], axis=1)
    gyro *= moving[:, None]
    heave = 1.5 * slow(noise[2], 0.2)
    accel = np.stack([slow(pushes[starts], 1.0), 12.0 * gyro[:, 2], heave], axis=1) * moving[:, None] + [0, 0, 9.81]
    return t_s, gyro, accel


def two_boxes(seed, gyro_noise, accel_noise):
    """What two boxes on one rigid body measure, the second turned and LEVER away."""
    rng = np.random.default_rng(seed)
    t_s, gyro, accel = rigid_motion(rng)
    swung = accel + np.cross(differentiate(t_s, gyro), LEVER) + np.cross(gyro, np.cross(gyro, LEVER))
    back = conjugate(from_euler(0.7, -0.1, 0.2))
    boxes = []
    for rates, forces in ((gyro, accel), (rotate(back, gyro), rotate(back, swung))):
        rows = rates[::4], forces[::4]
        noisy = [y + s * rng.standard_normal(y.shape) for y, s in zip(rows, (gyro_noise, accel_noise), strict=True)]
        boxes.append(Inertial(START_NS + np.rint(t_s[::4] * 1e9).astype(np.int64), *noisy))
    return boxes


@pytest.mark.parametrize(("gyro_noise", "accel_noise"), [(0.01, 0.05), (0.001, 0.3)])
def test_noise_does_not_draw_the_lever_arm_to_zero(gyro_noise, accel_noise):
    found = [place(*two_boxes(seed, gyro_noise, accel_noise)) for seed in range(6)]
    apart = np.array([(placement.lever - LEVER) / placement.lever_sigma for placement in found])
    assert np.abs(apart).max() < 3.5
    assert abs(apart.mean(axis=0)[0]) < 1.5
    assert max(placement.lever_sigma.max() for placement in found) < 0.03
