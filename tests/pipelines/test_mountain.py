"""The pipeline mountain, as a user runs it: a drive on hills, and a GeoTIFF of the place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import recon
from recon.tables import vector

rasterio = pytest.importorskip("rasterio", reason="rasterio is not installed: pip install recon-dynamics[terrain]")


def map_of(reference, path: Path) -> Path:
    """Heights of the ground below the way, in cells of 10 m; the way is the nearest one."""
    from rasterio.transform import from_origin
    from scipy.interpolate import NearestNDInterpolator

    rows = slice(None, None, 25)
    lat, lon, height = (vector(reference, name)[rows] for name in ("lat", "lon", "height"))
    cell = 1e-4
    west, north = lon.min() - 20 * cell, lat.max() + 20 * cell
    columns, lines = (int(np.ceil(np.ptp(axis) / cell)) + 40 for axis in (lon, lat))
    east, south = west + (np.arange(columns) + 0.5) * cell, north - (np.arange(lines) + 0.5) * cell
    nearest = NearestNDInterpolator(np.column_stack([lat, lon]), height)
    grid = nearest(*np.meshgrid(south, east, indexing="ij")).astype(np.float32)
    with rasterio.open(
        path, "w", driver="GTiff", height=lines, width=columns, count=1, dtype="float32", crs="EPSG:4326",
        transform=from_origin(west, north, cell, cell),
    ) as file:  # fmt: skip
        file.write(grid, 1)
    return path


def test_a_map_of_the_place_halves_the_error_of_the_height(tmp_path):
    drive = recon.run(
        "simulated_drive",
        **{
            "simulator.drive.motion": "country",
            "simulator.drive.duration": "240 s",
            "simulator.drive.imu_rate": "50 Hz",
            "simulator.drive.seed": 5,
            "simulator.drive.route": 5,
        },
    ).recording
    raster = map_of(drive["reference"], tmp_path / "heights.tif")
    given = {"filter.terrain.raster": str(raster), "filter.terrain.height_std": "1 m", "fuser.map.ground_level": "0 m"}
    error = {}
    for name, overrides in (("best_accuracy", {}), ("mountain", given)):
        found = recon.run(name, drive, tmp_path / name, **overrides)
        error[name] = recon.evaluate(found).position["vertical"].rmse
        if name == "mountain":
            assert {"ground_known", "ground_level"} <= set(found.metrics["name"].to_pylist())
    # GNSS heights err slowly by metres; the map by what a cell of 10 m hides on slopes of a few percent.
    assert error["mountain"] < 0.5 * error["best_accuracy"]
