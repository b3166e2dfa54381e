"""How the clocks of IMU and GNSS run against each other: the lag of velocities, sought again in pieces of the log."""

from __future__ import annotations

from typing import Final

import numpy as np

from recon.numerics.doctor.clocks import Clocks, lag_of
from recon.numerics.doctor.finding import (
    Curve,
    Finding,
    Floats,
    Picture,
    confidence_of,
    confirmed,
    contradicted,
    unknown,
)
from recon.numerics.doctor.log import Gnss
from recon.numerics.smoothing.stops import Blocks

JUMP: Final = "jump"
_PIECE_S: Final = 120.0
_DRIFT: Final = 0.15
"""s over the whole log, from which a drift is told."""


def clock_drift(clocks: Clocks, gnss: Gnss) -> Finding:
    """Do the clocks run equally fast, without a jump?"""
    code = "clock_drift"
    if clocks.blocks is None:
        return unknown(code, "The IMU has too few rows to compare with GNSS.")
    own = gnss.later(-clocks.shift_s)
    t_s, lag_s, sigma_s = _pieces(clocks.blocks, own)
    if len(t_s) < 3:
        return unknown(code, "The log is too short, or holds too little driving, to see the clocks drift apart.")
    picture = Picture(
        "How late GNSS is, piece by piece", "s", (Curve("found in a piece of the log", t_s, lag_s, points=True),)
    )
    at, step, left_step = _jump(t_s, lag_s, sigma_s)
    rate, sigma, left_line = _line(t_s, lag_s, sigma_s)
    numbers = {"drift_ppm": 1e6 * rate, "sigma_ppm": 1e6 * sigma, "jump_s": step, "jump_at_s": at}
    if abs(step) > 0.4 and left_step < 0.6 * left_line:
        text = (
            f"One of the clocks jumps by {abs(step):.2f} s near {at:.0f} s: GNSS and IMU belong together before or "
            "after, not both. Cut the log there, or set the later stamps right."
        )
        return contradicted(code, JUMP, text, **numbers).shown_by(picture)
    if abs(rate) > 4.0 * sigma and abs(rate) * np.ptp(t_s) > _DRIFT:
        text = (
            f"The clocks of GNSS and IMU run apart by {1e3 * abs(rate) * 60:.1f} ms a minute ({1e6 * rate:+.0f} "
            f"parts in a million), {abs(rate) * np.ptp(t_s):.2f} s over this log."
        )
        return contradicted(code, round(1e6 * rate, 1), text, confidence_of(rate / sigma), **numbers).shown_by(picture)
    text = (
        f"The clocks of GNSS and IMU keep step: {1e6 * rate:+.0f} parts in a million, give or take {1e6 * sigma:.0f}."
    )
    return confirmed(code, round(1e6 * rate, 1), text, **numbers)


def _pieces(blocks: Blocks, gnss: Gnss) -> tuple[Floats, Floats, Floats]:
    """The lag in pieces that overlap by half: middle s, lag s, sigma s."""
    length = max(_PIECE_S, (blocks.t_s[-1] - blocks.t_s[0]) / 8.0)
    found = []
    for start in np.arange(blocks.t_s[0], blocks.t_s[-1] - 0.9 * length, 0.5 * length):
        inside = (blocks.t_s >= start) & (blocks.t_s < start + length)
        some = (gnss.t_s > start - 5.0) & (gnss.t_s < start + length + 5.0)
        if inside.sum() < 100 or some.sum() < 20:
            continue
        rows = slice(int(inside.argmax()), int(inside.argmax() + inside.sum()))
        piece = Blocks(
            blocks.size,
            blocks.t_s[rows],
            blocks.gyro[:, rows],
            blocks.accel[:, rows],
            blocks.vibration[rows],
            blocks.measured[rows],
        )
        lag = lag_of(piece, gnss.some(some), 4.0)
        if np.isfinite(lag.sigma):
            found.append((start + 0.5 * length, lag.seconds, float(np.hypot(lag.sigma, 0.02))))
    t_s, lag_s, sigma_s = np.array(found).reshape(-1, 3).T
    return t_s, lag_s, sigma_s


def _line(t_s: Floats, lag_s: Floats, sigma_s: Floats) -> tuple[float, float, float]:
    """Slope, its sigma (pieces overlap: two count as one), and the weighted sum of squares that is left."""
    weight = sigma_s**-2
    centre = weight @ t_s / weight.sum()
    x = t_s - centre
    information = float(weight @ x**2)
    slope = float(weight @ (x * lag_s)) / max(information, 1e-12)
    rest = lag_s - weight @ lag_s / weight.sum() - slope * x
    left = float(weight @ rest**2)
    scale = max(1.0, left / max(len(t_s) - 2, 1))
    return slope, float(np.sqrt(2.0 * scale / max(information, 1e-12))), left


def _jump(t_s: Floats, lag_s: Floats, sigma_s: Floats) -> tuple[float, float, float]:
    """Best time of one step with two pieces on either side, its height, and the weighted squares that are left."""
    weight, best = sigma_s**-2, (0.0, 0.0, np.inf)
    for cut in range(2, len(t_s) - 1):
        parts = [(slice(None, cut)), (slice(cut, None))]
        means = [weight[p] @ lag_s[p] / weight[p].sum() for p in parts]
        left = sum(float(weight[p] @ (lag_s[p] - m) ** 2) for p, m in zip(parts, means, strict=True))
        if left < best[2]:
            best = (float(0.5 * (t_s[cut - 1] + t_s[cut])), float(means[1] - means[0]), left)
    return best
