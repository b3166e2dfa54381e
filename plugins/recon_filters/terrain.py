"""The ground along the way, from a map of heights that the user has: GeoTIFF, SRTM's .hgt, whatever GDAL reads.

At every position of GNSS the height between the four cells around, bilinear, and the slopes to the east and the north:

    slope_e = (h(x + c) - h(x - c)) / 2c          c the size of a cell on the ground

The stream `ground` is what fuser.map holds the trajectory to: its level is taken from the heights of GNSS, so the datum
of the map does not matter. Nothing is fetched: the file must be there. Where the map has no height the fix is left out.

References
    Horn (1981), "Hill shading and the reflectance map", Proc. IEEE 69(1) (slopes of a grid).
    Farr et al. (2007), "The Shuttle Radar Topography Mission", Rev. Geophysics 45 (its errors: some 3 m beside what
    whole regions have in common).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pyarrow as pa

from recon import (
    GNSS,
    GROUND,
    Array,
    DataError,
    Filter,
    Metric,
    Params,
    Streams,
    build,
    hookimpl,
    meta,
    metrics,
    quantity,
    setting,
    time_ns,
    vector,
    with_meta,
)
from recon.extras import needs

if TYPE_CHECKING:
    from numpy.typing import NDArray

_CELLS: Final = 4
"""Cells around the way that are read with it."""
_TILE: Final = 512
"""Cells along each side of what is read at a time."""
_FACTS: Final = ("time_scale", "clock")
_DEGREE_M: Final = 111_320.0
"""m on a meridian."""
_NEARBY: Final = 1e-4
"""deg, over which the size of a cell is found."""


class TerrainParams(Params):
    """Which map, and how far it is believed."""

    raster: str = setting(doc="File with the heights of the ground: GeoTIFF, .hgt or another that GDAL reads.")
    height_std: float = quantity(3.0, "m", gt=0, doc="Error of its heights beside what is common to the whole drive.")


def terrain(*, gnss: pa.Table, params: TerrainParams) -> Streams:
    """Heights and slopes of the ground at the positions of GNSS.

    gnss : lat, lon deg
    raises : DataError where the map does not cover the way, PluginError where rasterio is not installed
    """
    lat, lon = vector(gnss, "lat", gaps=True), vector(gnss, "lon", gaps=True)
    known = np.flatnonzero(np.isfinite(lat) & np.isfinite(lon))
    if not len(known):
        raise DataError("gnss holds no position to look up in the map")
    height, slope_e, slope_n = _looked_up(Path(params.raster), lat[known], lon[known])
    found = np.isfinite(height + slope_e + slope_n)
    if not found.any():
        raise DataError(
            f"{Path(params.raster).name} tells no height at any of the {len(known)} positions of gnss",
            "does the map cover the place of the drive?",
        )
    row = known[found]
    table = build(
        GROUND,
        time=time_ns(gnss)[row],
        lat=lat[row],
        lon=lon[row],
        height=height[found],
        slope_e=slope_e[found],
        slope_n=slope_n[found],
        height_std=np.full(len(row), params.height_std),
    )
    share = Metric("ground_known", float(found.mean()), "1", note=f"of the positions, in {Path(params.raster).name}")
    facts = {name: meta(gnss).get(name) for name in _FACTS}
    return {"ground": with_meta(table, **facts), "metrics": metrics([share])}


def _looked_up(raster: Path, lat: Array, lon: Array) -> tuple[Array, Array, Array]:
    """Height m, slopes to the east and the north; (n,) each, NaN where the map does not tell."""
    with needs("filter.terrain", "rasterio", extra="terrain"):
        import rasterio
        from rasterio.errors import RasterioError
        from rasterio.warp import transform
        from rasterio.windows import Window
    try:
        with rasterio.open(raster) as file:
            if file.crs is None:
                raise DataError(f"{raster.name} does not say where on the Earth it lies", "give a GeoTIFF or an .hgt")
            grid_of = partial(_cells, file, transform)
            column, row = grid_of(lat, lon)
            found = np.full((3, len(lat)), np.nan)
            for part in _tiles(row, column, file.shape):
                first = np.floor([row[part].min(), column[part].min()]).astype(int) - _CELLS
                count = np.ceil([row[part].max(), column[part].max()]).astype(int) + _CELLS - first
                window = Window(first[1], first[0], count[1], count[0])
                grid = file.read(1, window=window, boundless=True, masked=True).astype(np.float64).filled(np.nan)
                found[:, part] = _sampled(grid, first, grid_of, lat[part], lon[part])
    except (RasterioError, OSError) as error:
        why = str(error) if raster.exists() else "there is no such file"
        raise DataError(
            f"{raster} cannot be read as a map of heights: {why}",
            "name the map of your place by --set filter.terrain.raster=FILE; none is fetched",
        ) from error
    height, slope_e, slope_n = found
    return height, slope_e, slope_n


def _tiles(row: Array, column: Array, shape: tuple[int, int]) -> Iterator[NDArray[np.intp]]:
    """Positions (k,) in the same square of cells, square by square; none of those beside the map.

    So a long drive needs no more memory than a short one, nor does a fix that is far off.

    row, column : (n,) cells; shape : of the map
    """
    on_map = np.flatnonzero((row > -1.0) & (row < shape[0]) & (column > -1.0) & (column < shape[1]))
    squares = np.floor(np.column_stack((row, column))[on_map] / _TILE)
    slot = np.unique(squares, axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(slot, kind="stable")
    yield from (part for part in np.split(on_map[order], np.cumsum(np.bincount(slot))[:-1]) if len(part))


def _cells(file: Any, transform: Any, lat: Array, lon: Array) -> tuple[Array, Array]:
    """Column and row (n,) of places, counted between the middles of the cells."""
    x, y = transform("EPSG:4326", file.crs, lon.tolist(), lat.tolist())
    to_cells = ~file.transform
    x, y = np.asarray(x), np.asarray(y)
    column = to_cells.a * x + to_cells.b * y + to_cells.c
    row = to_cells.d * x + to_cells.e * y + to_cells.f
    return column - 0.5, row - 0.5


def _sampled(
    grid: Array, first: NDArray[np.intp], grid_of: Callable[[Array, Array], tuple[Array, Array]], lat: Array, lon: Array
) -> tuple[Array, Array, Array]:
    """Height and slopes over a cell; grid : heights, whose first cell is (row, column) `first` of the file."""

    def height(north_m: float, east_m: float) -> Array:
        across = _DEGREE_M * np.cos(np.radians(lat))
        column, row = grid_of(lat + north_m / _DEGREE_M, lon + east_m / across)
        return _between(grid, row - first[0], column - first[1])

    step = np.subtract(grid_of(lat[:1] + _NEARBY, lon[:1]), grid_of(lat[:1], lon[:1]))
    cell = _NEARBY * _DEGREE_M / float(np.hypot(*step)[0])
    slope_e = (height(0.0, 0.5 * cell) - height(0.0, -0.5 * cell)) / cell
    slope_n = (height(0.5 * cell, 0.0) - height(-0.5 * cell, 0.0)) / cell
    return height(0.0, 0.0), slope_e, slope_n


def _between(grid: Array, row: Array, column: Array) -> Array:
    """Bilinear between the four cells around; NaN beside the grid."""
    rows, columns = grid.shape
    inside = (row >= 0.0) & (row <= rows - 1) & (column >= 0.0) & (column <= columns - 1)
    i = np.clip(np.floor(row).astype(int), 0, max(rows - 2, 0))
    j = np.clip(np.floor(column).astype(int), 0, max(columns - 2, 0))
    down, right = row - i, column - j
    upper = (1.0 - right) * grid[i, j] + right * grid[i, j + 1]
    lower = (1.0 - right) * grid[i + 1, j] + right * grid[i + 1, j + 1]
    return np.where(inside, (1.0 - down) * upper + down * lower, np.nan)


@hookimpl
def declare_filters() -> Iterable[Filter]:
    """Declare filter.terrain."""
    yield Filter(
        name="terrain",
        summary="The ground along the way, from a map of heights that the user has.",
        params=TerrainParams,
        reads={"gnss": GNSS.need("lat", "lon")},
        writes={"ground": GROUND},
        run=terrain,
        version=2,
        references=("Horn 1981", "Farr et al. 2007"),
    )
