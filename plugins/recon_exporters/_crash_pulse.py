"""The pulse of a crash over milliseconds after time zero: accelerations as recorded and as CFC 60, and delta-V.

delta-V = integral of the acceleration along axes of the vehicle from time zero (49 CFR 563; SAE J211-1 for CFC 60)

What a clipped sensor lost is restored, where the speed before and after tells it (recon.clipping).

The curves have no band: the fuser's sigmas of changes of velocity rest on other assumptions than the intervals of the
numbers below them, and are up to 2.6 times as wide.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.clipping import lost
from recon.numerics.channel_class import channel_class
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.integration import cumulative
from recon.numerics.signals import median_rate
from recon.tables import Array, has, measured_axes, schema_of, time_ns
from recon_exporters._chart import Span, Window, figure
from recon_exporters._panels import Curve, Panel

BEFORE_NS: Final = 50_000_000
AFTER_NS: Final = 350_000_000
_PADDING_NS: Final = 500_000_000
_CFC: Final = 60
_GAP_S: Final = 0.05
"""No line joins samples of a pulse that are further apart."""
_NAMES: Final = (("forward", "x"), ("to the left", "y"))


def pulse_charts(streams: Mapping[str, pa.Table], crash: Span, spans: list[Span]) -> str:
    """Figures of the pulse; "" where nothing tells the acceleration of the vehicle along its own axes."""
    felt = _felt(streams)
    if felt is None:
        return ""
    window = Window(crash.start_ns - BEFORE_NS, crash.start_ns + AFTER_NS, crash.start_ns)
    shown = [span for span in spans if span.kind in ("crash", "saturation")]
    return "".join(figure(panel, window, shown, _GAP_S) for panel in _panels(felt, crash.start_ns, streams))


def _felt(streams: Mapping[str, pa.Table]) -> pa.Table | None:
    """The trajectory where it has accelerations, else an imu that was turned into the vehicle."""
    trajectory, imu = streams.get("trajectory"), streams.get("imu")
    if trajectory is not None and has(trajectory, "accel"):
        return trajectory
    turned = imu is not None and has(imu, "accel_x") and schema_of(imu)["accel_x"].frame == "vehicle"
    return imu if turned else None


def _panels(felt: pa.Table, zero_ns: int, streams: Mapping[str, pa.Table]) -> Iterator[Panel]:
    t_ns, recorded, axes = _around(felt, zero_ns)
    if len(t_ns) < 3:
        return
    cut = lost(t_ns, recorded, streams.get("imu"), streams.get("events"), felt, streams.get("knots"))
    restored = cut is not None and len(cut.doubt) > 0
    accel = recorded + cut.likely if cut is not None else recorded
    smooth = channel_class(accel, _CFC, median_rate(t_ns))
    name = f"restored, CFC {_CFC}" if restored else f"CFC {_CFC}"
    force = [
        *(Curve(f"{n}, as recorded", f"raw {r}", t_ns, recorded[:, i] / STANDARD_GRAVITY) for i, (n, r) in axes),
        *(Curve(f"{n}, {name}", r, t_ns, smooth[:, i] / STANDARD_GRAVITY) for i, (n, r) in axes),
    ]
    yield Panel("pulse_accel", "Acceleration, time after time zero", "g", "crash", force, levels=(0.0,))
    after = t_ns >= zero_ns
    if after.sum() > 1:
        t_ns, gained = t_ns[after], _gained(t_ns[after], accel[after])
        curves = [Curve(name, role, t_ns, gained[:, i]) for i, (name, role) in axes]
        if len(axes) > 1:
            curves.append(Curve("horizontal", "reference", t_ns, np.hypot(gained[:, 0], gained[:, 1])))
        yield Panel("pulse_delta_v", "Delta-V, time after time zero", "km/h", "crash", curves, levels=(0.0,))


def _around(felt: pa.Table, zero_ns: int) -> tuple[NDArray[np.int64], Array, list[tuple[int, tuple[str, str]]]]:
    """Times (n,) ns and accelerations (n, 3) m/s^2 of the vehicle, and which horizontal axes were measured.

    Some more than is shown, for the filter's ends.
    """
    t_ns = time_ns(felt)
    first, last = np.searchsorted(t_ns, [zero_ns - BEFORE_NS - _PADDING_NS, zero_ns + AFTER_NS + _PADDING_NS])
    accel, unmeasured = measured_axes(felt.slice(int(first), int(last - first)), "accel")
    known = np.isfinite(accel).all(axis=1)
    axes = [axis for axis in enumerate(_NAMES) if f"accel_{'xy'[axis[0]]}" not in unmeasured]
    return t_ns[first:last][known], accel[known], axes


def _gained(t_ns: NDArray[np.int64], accel: Array) -> Array:
    """Change of velocity since the first row (n, 3) km/h."""
    return np.asarray(3.6 * cumulative((t_ns - t_ns[0]) * 1e-9, accel, "trapezoid"))
