"""A minute of comma2k19 with its GNSS cut to one fix a second and with an outage, against the reference of the camera.

The u-blox receiver's 10 Hz are thinned to 1 Hz, and 20 s are left without any; where both begin is varied. Speed and
course are all that it tells of velocity. The truth is the published pose of the camera, some decimetres to a metre from
the place that the fixes tell; its yaw in the vehicle is not known, so the mean difference of heading is taken off.
GTSAM is given what is known of a phone: no lever arm, and the reference's first attitude.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
from peers.drives import Drive, Estimate, World
from peers.scores import in_outage

from recon.numerics.geodesy import Anchor, geodetic_to_enu
from recon.numerics.rotation import Floats, to_euler
from recon.numerics.rotation_series import slerp
from recon.numerics.signals import interpolate, wrap_angle
from recon.parameters import NoParams
from recon.tables import matrix, select_rows, time_ns, vector
from recon_fusers.map import MapParams
from recon_readers.comma2k19 import read

from .cases import Size
from .rivals import OURS, peers, usual_noise
from .scoring import Row, estimate_of, fused
from .tables import plain_table, shown, statistic

SEGMENT: Final = Path("comma2k19_example", "seg40")
OUTAGE_S: Final = 20.0
_STARTS_S: Final = (12.0, 18.0, 24.0, 30.0)
_PHASES_S: Final = (0.0, 0.3, 0.6)
_NOT_KNOWN: Final = 10.0
"""m/s, sigma of the vertical velocity, which is not told."""


def variants(size: Size) -> list[tuple[float, float]]:
    """Start of the outage and of the thinning, in s: as many as drives are asked for, at most all."""
    return [(start, phase) for start in _STARTS_S for phase in _PHASES_S][: size.drives]


def bridged(logs: Path, variant: tuple[float, float]) -> dict[str, Row]:
    """Errors of fuser.map and of GTSAM: worst horizontal one inside the outage, and heading over the minute."""
    streams = read(logs / SEGMENT, NoParams())
    imu = streams["imu"]
    start_ns = int(time_ns(imu)[0])
    gnss = _cut(streams["gnss"], start_ns, *variant)
    anchor = Anchor(*(float(vector(gnss, name)[0]) for name in ("lat", "lon", "height")))
    truth = estimate_of(streams["reference"], anchor, start_ns)
    made = fused({"imu": imu, "gnss": gnss}, MapParams())
    estimates = {OURS: estimate_of(made["trajectory"], anchor, start_ns)}
    drive = _told(imu, gnss, anchor, truth)
    estimates |= {name: solve(drive) for name, solve in peers().items() if name == "gtsam_batch"}
    return {name: _errors(estimate, truth, drive.fix_t_s) for name, estimate in estimates.items()}


def _cut(gnss: pa.Table, start_ns: int, start_s: float, phase_s: float) -> pa.Table:
    """The first fix of each second, none during the outage."""
    t_s = (time_ns(gnss) - start_ns) * 1e-9
    second = np.floor(t_s - phase_s)
    first = np.flatnonzero(np.diff(second, prepend=second[0] - 1.0) > 0.0)
    lost = (t_s[first] >= start_s) & (t_s[first] < start_s + OUTAGE_S)
    return select_rows(gnss, first[~lost])


def _told(imu: pa.Table, gnss: pa.Table, anchor: Anchor, truth: Estimate) -> Drive:
    """What GTSAM is given."""
    start_ns = int(time_ns(imu)[0])
    t_s, fix_t_s = (np.asarray((time_ns(table) - start_ns) * 1e-9) for table in (imu, gnss))
    used = (fix_t_s >= t_s[0]) & (fix_t_s <= t_s[-1])
    lat, lon, height, speed, course = (vector(gnss, name)[used] for name in ("lat", "lon", "height", "speed", "course"))
    return Drive(
        t_s=t_s,
        gyro_s=matrix(imu, "gyro"),
        accel_s=matrix(imu, "accel"),
        fix_t_s=fix_t_s[used],
        fix_pos_n=geodetic_to_enu(lat, lon, height, anchor),
        fix_vel_n=np.column_stack([speed * np.sin(course), speed * np.cos(course), np.zeros_like(speed)]),
        noise=usual_noise(MapParams(), _NOT_KNOWN),
        world=World.at(anchor.lat, anchor.height),
        start_q_ns=truth.q_ns[0],
        lever_s=np.zeros(3),
        rear_s=np.zeros(3),
        mount_q_vs=np.array([1.0, 0.0, 0.0, 0.0]),
    )


def _errors(estimate: Estimate, truth: Estimate, fix_t_s: Floats) -> Row:
    """At the times of the truth that the estimate spans."""
    t_s = truth.t_s[(truth.t_s >= estimate.t_s[0]) & (truth.t_s <= estimate.t_s[-1])]
    apart = interpolate(t_s, estimate.t_s, estimate.pos_n) - interpolate(t_s, truth.t_s, truth.pos_n)
    outage = in_outage(t_s, fix_t_s)
    turned = to_euler(slerp(t_s, estimate.t_s, estimate.q_ns))[0] - to_euler(slerp(t_s, truth.t_s, truth.q_ns))[0]
    mean = np.angle(np.exp(1j * turned).mean())
    return {
        "worst": float(np.hypot(apart[outage, 0], apart[outage, 1]).max()),
        "heading": float(np.degrees(np.sqrt((wrap_angle(turned - mean) ** 2).mean()))),
    }


def real_table(found: list[dict[str, Row]]) -> str:
    """Median and largest over the variants."""
    rows = []
    for name in found[0]:
        of = [one[name] for one in found]
        cells = [shown(statistic(how, of, column), 2) for column in ("worst", "heading") for how in ("median", "max")]
        rows.append([f"{name} ({len(of)})", *cells])
    heads = ["", "worst H in the outage m: median", "largest", "heading deg: median", "largest"]
    return plain_table(heads, rows)
