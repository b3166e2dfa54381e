"""What a live run shows in the Rerun viewer: the way so far in 3D and on the map, speed, heading and their doubt."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from recon.extras import needs
from recon.numerics.rotation import heading_from_yaw, to_euler
from recon.tables import Streams, matrix, time_ns, vector

_WAY, _VEHICLE = 0xE69F00FF, 0x0072B2FF
_PIECE_NS: Final = 60_000_000_000
"""Of the way that is one line: drawn anew as it grows, where a line for each second would be thousands in an hour."""
_PLOTS: Final = {"speed": "speed, m/s", "heading": "heading, deg", "sigma": "sigma of the position, m"}


class LiveView:
    """A recording of Rerun. file : where it is kept; None for a viewer that is started.

    raises : PluginError where rerun-sdk is not installed
    """

    def __init__(self, file: Path | None) -> None:
        with needs("a live view", "rerun-sdk", extra="rerun"):
            import rerun as rr
            import rerun.blueprint as rrb
        self._rr = rr
        self._stream = rr.RecordingStream("recon live")
        if file is None:
            self._stream.spawn()
        else:
            self._stream.save(file)
        plots = [rrb.TimeSeriesView(origin=f"plots/{name}", name=title) for name, title in _PLOTS.items()]
        self._piece = 0
        self._pos, self._place = np.zeros((0, 3)), np.zeros((0, 2))
        views = rrb.Vertical(rrb.Spatial3DView(origin="world", name="way"), rrb.MapView(origin="map", name="map"))
        layout = rrb.Horizontal(views, rrb.Vertical(*plots))
        follow = rrb.TimePanel(timeline="time", play_state="following", state="collapsed")
        self._stream.send_blueprint(rrb.Blueprint(layout, follow, collapse_panels=True))

    def show(self, told: Streams) -> None:
        """Draw what a step of a session told."""
        if "trajectory" in told and told["trajectory"].num_rows:
            self._grow(told["trajectory"])
        if "latest" in told:
            self._now(told)

    def _grow(self, way: pa.Table) -> None:
        rr, stream = self._rr, self._stream
        end_ns = int(time_ns(way)[-1])
        if end_ns // _PIECE_NS != self._piece:
            self._piece, self._pos, self._place = end_ns // _PIECE_NS, self._pos[-1:], self._place[-1:]
        thinned = way.take(np.unique(np.linspace(0, way.num_rows - 1, 20).astype(int)))
        place = np.column_stack((vector(thinned, "lat", gaps=True), vector(thinned, "lon", gaps=True)))
        self._pos, self._place = np.vstack((self._pos, matrix(thinned, "pos"))), np.vstack((self._place, place))
        stream.set_time("time", timestamp=np.datetime64(end_ns, "ns"))
        stream.log(f"world/way/{self._piece}", rr.LineStrips3D([self._pos], colors=_WAY))
        if np.isfinite(self._place).all():
            stream.log(f"map/way/{self._piece}", rr.GeoLineStrings(lat_lon=[self._place], colors=_WAY))

    def _now(self, told: Streams) -> None:
        rr, stream, row = self._rr, self._stream, told["latest"]
        stream.set_time("time", timestamp=np.datetime64(int(time_ns(row)[0]), "ns"))
        pos, q = matrix(row, "pos")[0], matrix(row, "q")[0]
        stream.log("world/vehicle", rr.Transform3D(translation=pos, quaternion=rr.Quaternion(xyzw=[*q[1:], q[0]])))
        stream.log("world/vehicle/box", rr.Boxes3D(half_sizes=[[2.2, 0.9, 0.7]], colors=_VEHICLE))
        stream.log("plots/speed", rr.Scalars(float(np.linalg.norm(matrix(row, "vel")[0]))))
        stream.log("plots/heading", rr.Scalars(float(np.degrees(heading_from_yaw(to_euler(q)[0])))))
        stream.log("plots/sigma", rr.Scalars(float(np.hypot(*matrix(row, "pos_std")[0, :2]))))
        place = [float(vector(row, name, gaps=True)[0]) for name in ("lat", "lon")]
        if np.isfinite(place).all():
            stream.log("map/vehicle", rr.GeoPoints(lat_lon=[place], radii=rr.Radius.ui_points(8.0), colors=_VEHICLE))

    def close(self) -> None:
        """Have everything written."""
        self._stream.flush()
        self._stream.disconnect()
