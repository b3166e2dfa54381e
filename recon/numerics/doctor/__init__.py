"""What a log says of its own conventions: units, axes, clocks, samples, the receiver, noise.

No convention is believed because it is written somewhere: each is held against the physics of driving, against another
sensor, or against itself. Modules by family: units; axes, mounting; clocks, lags, drift; samples; receiver; noise;
`motion` is what units and axes rest on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from recon.numerics.doctor import axes, clocks, drift, lags, mounting, noise, receiver, samples, units
from recon.numerics.doctor.finding import Curve, Finding, Picture, Status, unknown
from recon.numerics.doctor.log import Claims, Gnss, Imu, Log
from recon.numerics.doctor.motion import Motion, motion_of
from recon.numerics.doctor.pictures import picture_of
from recon.numerics.smoothing.lag import UNKNOWN

__all__ = ["CODES", "Claims", "Curve", "Finding", "Gnss", "Imu", "Log", "Picture", "Status", "examine"]

CODES: Final = (
    *("speed_unit", "accel_unit", "gyro_unit", "gravity_sign", "forward_axis", "axes", "inverted_axis", "mounting"),
    *("gnss_position_lag", "gnss_velocity_lag", "clock_drift", "leap_seconds", "time_zone", "heading_kind"),
    *("height_datum", "lat_lon", "gaps", "jitter", "duplicates", "reversals", "clipping", "quantisation"),
    *("dead_channel", "gnss_sigma", "noise_class"),
)
_OF_GNSS: Final = ("speed_unit", "heading_kind", "lat_lon", "gnss_sigma")
"""What GNSS alone is asked."""
_MOVING: Final = 1.0
"""m/s."""


def examine(log: Log, classes: Sequence[tuple[str, float, float]]) -> tuple[list[Finding], str]:
    """A finding for each of CODES, in their order; and where x, y, z of imu point, "" where the box is not lined up.

    classes : of sensors, as `noise.noise_class` takes them
    """
    imu = log.imu if log.imu is not None and len(log.imu.t_s) > 1 else None
    gnss = log.gnss if log.gnss is not None and len(log.gnss.t_s) > 1 else None
    found = dict(samples.sample_findings(imu, gnss, log.claims, _moving(imu, gnss)))
    for one in _of_receiver(gnss, log):
        found[one.code] = one
    if gnss is not None:  # what it tells of the IMU is asked of it as it should be
        gnss = receiver.clockwise(receiver.placed(gnss, found["lat_lon"]), found["heading_kind"])
    both = _of_both(imu, gnss, log.claims, classes)
    for one in both.found:
        found[one.code] = one
    if imu is not None:
        found = {code: _shown(one, imu, both.motion) for code, one in found.items()}
    return [found.get(code) or unknown(code, _lacking(code, imu, gnss)) for code in CODES], both.letters


def _of_receiver(gnss: Gnss | None, log: Log) -> list[Finding]:
    found = [receiver.height_datum(log.heights, log.claims)]
    if gnss is not None:
        places = receiver.lat_lon(gnss)
        found += [places, receiver.heading_kind(receiver.placed(gnss, places)), receiver.gnss_sigma(gnss)]
    return found


def _shown(one: Finding, imu: Imu, motion: Motion | None) -> Finding:
    """With its evidence, where it contradicts and has none yet."""
    if one.status != "contradicted" or one.picture is not None:
        return one
    picture = picture_of(one, imu, motion)
    return one if picture is None else one.shown_by(picture)


class _Both(NamedTuple):
    found: list[Finding]
    motion: Motion | None
    letters: str


def _of_both(imu: Imu | None, gnss: Gnss | None, claims: Claims, classes: Sequence[tuple[str, float, float]]) -> _Both:
    if imu is None:
        return _Both([units.speed_unit(gnss, None, claims)] if gnss is not None else [], None, "")
    found = [units.accel_unit(imu, claims)]
    usual = replace(imu, accel=units.normal(imu))
    motion: Motion | None = None
    clock = clocks.Clocks(0.0, UNKNOWN, clocks.blocks_of(usual))
    if gnss is not None:
        clock = clocks.clocks_of(usual, gnss)
        motion = motion_of(imu, gnss, clock.whole_s)
        run = drift.clock_drift(clock, gnss)
        late = [lags.velocity_lag(clock, usual, gnss), lags.position_lag(clock, gnss)]
        if run.value == drift.JUMP:
            late = [
                unknown(one.code, "One of the clocks jumps, see clock_drift: no lag holds throughout.") for one in late
            ]
        found += [
            units.speed_unit(gnss, motion, claims),
            *late,
            run,
            clocks.leap_seconds(clock),
            clocks.time_zone(clock, imu, gnss),
        ]
    made = axes.axes_of(imu, motion)
    found += [
        units.gyro_unit(imu, motion, claims),
        axes.gravity_sign(made, claims),
        axes.forward_axis(made),
        axes.handedness(made, claims),
        axes.inverted_axis(made),
        mounting.mounting(made, motion, imu),
    ]
    fix_s = gnss.t_s - clock.whole_s if gnss is not None else np.zeros(0)
    speed = gnss.over_ground if gnss is not None else np.zeros(0)
    found.append(noise.noise_class(clock.blocks, fix_s, speed, classes, claims))
    return _Both(
        found, motion, axes.letters_of(made.rot_sv) if made and made.rot_sv is not None and made.lined_up else ""
    )


def _moving(imu: Imu | None, gnss: Gnss | None) -> np.ndarray | None:
    """(n,) rows of the IMU at which GNSS moves; None where nothing is known."""
    if imu is None or gnss is None:
        return None
    known = np.isfinite(gnss.over_ground)
    if known.sum() < 2:
        return None
    speed = np.interp(imu.t_s, gnss.t_s[known], gnss.over_ground[known], 0.0, 0.0)
    return np.asarray(speed > _MOVING)


def _lacking(code: str, imu: Imu | None, gnss: Gnss | None) -> str:
    if gnss is None and code in _OF_GNSS:
        return "The log holds no GNSS, or a single fix of it."
    if imu is None:
        return "The log holds no IMU."
    return (
        "The log holds no GNSS to compare the IMU with." if gnss is None else "The log does not hold what this needs."
    )
