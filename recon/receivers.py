"""Further receivers of a vehicle, gnss_2 and so on, beside gnss: their fixes and what is told of them.

Antennas and clocks are found against the solution of gnss alone (recon.numerics.smoothing.receivers), then all fixes
are solved together. A receiver that cannot be placed is left out, and named.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import pyarrow as pa

from recon.errors import DataError
from recon.fixes import Observed, Trust, about, observe
from recon.numerics.smoothing import Estimate
from recon.numerics.smoothing.receivers import Receiver, find_receiver, joined, solved_with
from recon.rows import Metric, warning

_GIVEN_SIGMA: Final = 0.01
"""m, of an offset that was measured by hand."""
_FOREIGN: Final = 1.0
"""m/s; a receiver whose velocities are further off is none of this vehicle, or its clock is far off."""


@dataclass(frozen=True)
class Together:
    """The solution of all receivers. kinds : what velocities are, by name of the stream, gnss first."""

    found: Estimate
    observed: Observed
    kinds: dict[str, str]
    learnt: list[Metric]


def with_further(
    found: Estimate,
    observed: Observed,
    further: Mapping[str, pa.Table],
    antennas: Mapping[str, tuple[float, float, float] | None],
    start_ns: int,
    trust: Trust,
    reported: bool,
) -> Together:
    """The solution with further receivers, too.

    found, observed : of gnss alone; start_ns, trust, reported : as of `observe`
    further : by name; antennas : by name, offset from the antenna of gnss, (3,) m, vehicle, None : found
    """
    placed, learnt = _placed(found, observed, further, antennas, start_ns, trust, reported)
    alone = Together(found, observed, {"gnss": observed.kind}, learnt)
    if not placed:
        return alone
    fixes, which, row = joined(found, [receiver for receiver, _ in placed.values()])
    rows = [observed.row, *(other.row for _, other in placed.values())]
    all_rows = np.concatenate(rows)[np.cumsum([0, *map(len, rows[:-1])])[which] + row]
    try:
        together = solved_with(found, fixes)
    except np.linalg.LinAlgError as error:
        return replace(alone, learnt=[*learnt, warning(f"{', '.join(placed)} left out: {error}")])
    rot_vs = found.solved.state.rot_vs
    return Together(
        together,
        replace(observed, fixes=fixes, row=all_rows, receiver=which),
        {**alone.kinds, **{name: other.kind for name, (_, other) in placed.items()}},
        learnt + [metric for name, (receiver, _) in placed.items() for metric in _told(name, receiver, rot_vs)],
    )


def _placed(
    found: Estimate,
    observed: Observed,
    further: Mapping[str, pa.Table],
    antennas: Mapping[str, tuple[float, float, float] | None],
    start_ns: int,
    trust: Trust,
    reported: bool,
) -> tuple[dict[str, tuple[Receiver, Observed]], list[Metric]]:
    """The receivers that can be placed, and a warning for each other one."""
    placed, left_out = {}, []
    for name, table in further.items():
        offset_v = antennas[name]
        offset_s = None if offset_v is None else found.solved.state.rot_vs.T @ np.asarray(offset_v)
        try:
            other = observe(about(table, observed.anchor), start_ns, trust, reported)
            slow = other.drift * found.solved.noise.drift / observed.drift
            receiver = find_receiver(found, other.fixes, slow, offset_s, _GIVEN_SIGMA)
        except (DataError, ValueError) as error:
            why = error.message if isinstance(error, DataError) else error  # its hint is for a drive without GNSS
            left_out.append(warning(f"{name} is left out: {why}"))
            continue
        off = _velocity_error(receiver)
        if off > _FOREIGN:
            why = f"its velocities are {off:.1f} m/s from those of the drive; is it of another one?"
            left_out.append(warning(f"{name} is left out: {why}"))
        else:
            placed[name] = receiver, other
    return placed, left_out


def _velocity_error(receiver: Receiver) -> float:
    """Usual sigma of horizontal velocities, m/s; 0 where none is told."""
    sigma = receiver.fixes.vel_sigma[:2, ~receiver.fixes.small_only]
    told = sigma[np.isfinite(sigma)]
    return float(np.median(told)) if len(told) else 0.0


def _told(name: str, receiver: Receiver, rot_vs: np.ndarray) -> list[Metric]:
    """Antenna, clock and errors of a receiver."""
    how, spread = "against the motion of gnss", np.sqrt(np.diag(rot_vs @ np.diag(receiver.offset_sigma**2) @ rot_vs.T))
    antenna = [
        Metric(f"{name}_antenna_{axis}", float(v), "m", float(s), method=how, note="vehicle, from the antenna of gnss")
        for axis, v, s in zip("xyz", rot_vs @ receiver.offset_s, spread, strict=True)
    ]
    across = receiver.fixes.pos_sigma[0]
    lasting = float(np.median(across[np.isfinite(across)])) if np.isfinite(across).any() else float("nan")
    return [
        *antenna,
        Metric(f"{name}_lag", receiver.lag, "s", receiver.lag_sigma, method=how, note="of its clock, in mid-drive"),
        Metric(f"{name}_drift", receiver.drift * 1e6, "us/s", receiver.drift_sigma * 1e6, method=how),
        Metric(f"{name}_velocity_error", _velocity_error(receiver), "m/s", note="sigma of each axis"),
        Metric(f"{name}_velocity_shared", receiver.shared, "1", note="correlation of its errors with those of gnss"),
        Metric(f"{name}_position_error", lasting, "m", note="sigma of a fix as if white, what lasts counted in full"),
    ]
