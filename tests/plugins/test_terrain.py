"""The ground along the way, from maps made on the spot."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from numpy.testing import assert_allclose

from recon.errors import DataError
from recon.schema import GNSS
from recon.tables import build, meta, replace, time_ns, vector, with_meta
from recon_filters.terrain import TerrainParams, terrain

rasterio = pytest.importorskip("rasterio", reason="rasterio is not installed: pip install recon-dynamics[terrain]")

LAT, LON = 44.5, 11.34
EAST, NORTH = 0.05, -0.02
"""Rise of the ground per metre."""
M_DEG = 111_320.0


def plane(lat, lon):
    """Heights m of a sloping plain."""
    return 80.0 + EAST * (lon - LON) * M_DEG * np.cos(np.radians(LAT)) + NORTH * (lat - LAT) * M_DEG


def write(path, driver="GTiff", size=401, cell=1.0 / 3600.0, hole=None, dtype="float32"):
    """A raster about the place: cells of one arc second."""
    from rasterio.transform import from_origin

    west, north = LON - cell * size / 2.0, LAT + cell * size / 2.0
    middles = (np.arange(size) + 0.5) * cell
    heights = plane((north - middles)[:, None], (west + middles)[None]).astype(dtype)
    if hole is not None:
        heights[hole] = -9999.0
    with rasterio.open(
        path, "w", driver=driver, height=size, width=size, count=1, dtype=dtype, crs="EPSG:4326", nodata=-9999.0,
        transform=from_origin(west, north, cell, cell),
    ) as file:  # fmt: skip
        file.write(heights, 1)
    return str(path)


@pytest.fixture
def gnss():
    way = np.linspace(-0.02, 0.02, 50)
    table = build(GNSS, time=np.arange(50) * 10**9, lat=LAT + way, lon=LON - 0.7 * way)
    return with_meta(table, time_scale="UTC", clock="absolute")


def test_heights_and_slopes_of_a_plain_are_exact(gnss, tmp_path):
    found = terrain(gnss=gnss, params=TerrainParams(raster=write(tmp_path / "map.tif")))["ground"]
    assert time_ns(found).tolist() == time_ns(gnss).tolist()
    # Heights are kept as float32: 100 m to 8e-6 m, and their differences over 31 m to 1e-6; the cosine of the latitude
    # changes by 0.035 % over the way.
    assert_allclose(vector(found, "height"), plane(vector(gnss, "lat"), vector(gnss, "lon")), atol=1e-4)
    assert_allclose(vector(found, "slope_e"), EAST, rtol=1e-3)
    assert_allclose(vector(found, "slope_n"), NORTH, rtol=1e-3)
    assert meta(found)["clock"] == "absolute"


def test_tiles_of_the_shuttle_mission_are_read_by_their_name(tmp_path):
    # SRTM: big-endian int16, 1201 x 1201 posts from 45 N, 11 E, the first row the northernmost.
    lat = 45.0 - np.arange(1201) / 1200.0
    lon = 11.0 + np.arange(1201) / 1200.0
    heights = np.round(plane(lat[:, None], lon[None])).astype(">i2")
    path = tmp_path / "N44E011.hgt"
    path.write_bytes(heights.tobytes())
    way = np.linspace(-0.01, 0.01, 20)
    gnss = build(GNSS, time=np.arange(20) * 10**9, lat=LAT + way, lon=LON + way)
    found = terrain(gnss=gnss, params=TerrainParams(raster=str(path)))["ground"]
    assert_allclose(vector(found, "height"), plane(LAT + way, LON + way), atol=0.51)  # whole metres


def test_a_fix_that_is_far_off_costs_no_memory(gnss, tmp_path):
    raster = write(tmp_path / "map.tif", cell=1.0 / 36000.0)
    near = np.linspace(-0.004, 0.004, 50)
    lat, lon = LAT + near, LON - 0.7 * near
    alone = terrain(gnss=replace(gnss, lat=lat, lon=lon), params=TerrainParams(raster=raster))["ground"]
    lat[7], lon[7] = -89.0, 179.0
    tracemalloc.start()
    found = terrain(gnss=replace(gnss, lat=lat, lon=lon), params=TerrainParams(raster=raster))["ground"]
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 50e6  # the square of cells from there to here would be of some TB
    assert found.column("height").to_pylist() == np.delete(vector(alone, "height"), 7).tolist()


def test_a_way_over_several_squares_of_the_map_has_no_seams(tmp_path):
    raster = write(tmp_path / "map.tif", size=1501, cell=1.0 / 36000.0)
    way = np.linspace(-0.02, 0.02, 500)
    gnss = build(GNSS, time=np.arange(500) * 10**9, lat=LAT + way, lon=LON + way)
    found = terrain(gnss=gnss, params=TerrainParams(raster=raster))["ground"]
    # As above; slopes are differences over 3.1 m, which float32 rounds by 3e-6.
    assert_allclose(vector(found, "height"), plane(LAT + way, LON + way), atol=1e-4)
    assert_allclose(vector(found, "slope_n"), NORTH, atol=1e-5)


def test_fixes_beside_the_map_or_in_its_holes_are_left_out(gnss, tmp_path):
    hole = write(tmp_path / "map.tif", hole=(slice(0, 200), slice(None)))
    found = terrain(gnss=gnss, params=TerrainParams(raster=hole))
    assert 0 < found["ground"].num_rows < 26
    (share,) = [row for row in found["metrics"].to_pylist() if row["name"] == "ground_known"]
    assert share["value"] == found["ground"].num_rows / 50


def test_a_map_of_another_place_is_a_sentence(gnss, tmp_path):
    away = replace(gnss, lat=vector(gnss, "lat") + 3.0)
    with pytest.raises(DataError, match="tells no height at any of the 50 positions"):
        terrain(gnss=away, params=TerrainParams(raster=write(tmp_path / "map.tif")))


def test_a_file_that_is_no_map_is_a_sentence(gnss, tmp_path):
    path = tmp_path / "map.tif"
    path.write_text("no map")
    with pytest.raises(DataError, match="cannot be read as a map of heights"):
        terrain(gnss=gnss, params=TerrainParams(raster=str(path)))
    with pytest.raises(DataError, match="there is no such file"):
        terrain(gnss=gnss, params=TerrainParams(raster=str(tmp_path / "none.tif")))
