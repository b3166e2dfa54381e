"""The Earth's magnetic field at a place and date by the World Magnetic Model, and its declination.

Declination is the angle from true to magnetic north, positive to the east: true = magnetic + declination. The model
describes the field of the core; crust, buildings and the vehicle come on top. Its own error is about 0.3 to 0.5 deg in
declination at middle latitudes.

Evaluated by pygeomag (pure Python, MIT, brings the coefficients of 2010 to 2025). Each model holds for five years; no
date outside all of them is guessed.

References
    Chulliat et al. (2025), "The US/UK World Magnetic Model for 2025-2030", NOAA National Centers for Environmental
    Information; the same for 2010, 2015 (version 2) and 2020.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from recon.errors import DataError
from recon.tables import Array

FIRST_YEAR: Final = 2010
END_YEAR: Final = 2030
"""The models hold from the begin of the first to the begin of the last year."""

_HIGHEST_KM: Final = 850.0
"""Above the ellipsoid, to where the models are made."""


def magnetic_field_n(lat_deg: float, lon_deg: float, height_m: float, t_ns: int) -> Array:
    """Magnetic flux density: (3,) T, local East-North-Up.

    lat_deg, lon_deg : deg; t_ns : ns since 1970-01-01 UTC
    height_m : m above the ellipsoid; below -1 km and above 850 km the field of there
    raises : DataError where the date lies outside 2010 to 2029, or the place is none on Earth
    """
    year = decimal_year(t_ns)
    if not FIRST_YEAR <= year < END_YEAR:
        day = np.datetime64(t_ns, "ns").astype("datetime64[D]")
        raise DataError(
            f"the World Magnetic Model is known for {FIRST_YEAR} to {END_YEAR - 1}; the log is of {day}",
            "is the clock of the log right? else give the declination yourself",
        )
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 360.0 and np.isfinite(height_m)):
        raise DataError(
            f"no place on Earth: latitude {lat_deg:g} deg, longitude {lon_deg:g} deg, height {height_m:g} m"
        )
    from pygeomag import GeoMag  # slow import: only when used

    height_km = float(np.clip(1e-3 * height_m, -1.0, _HIGHEST_KM))
    found = GeoMag(base_year=int(year)).calculate(glat=lat_deg, glon=lon_deg, alt=height_km, time=year)
    return 1e-9 * np.array([found.y, found.x, -found.z], dtype=np.float64)


def declination(field_n: Array) -> float:
    """Angle from true to magnetic north, clockwise seen from above: rad in (-pi, pi].

    field_n : (3,) of any unit, local East-North-Up
    """
    return float(np.arctan2(field_n[0], field_n[1]))


def decimal_year(t_ns: int) -> float:
    """The year with its fraction: 2019.5 at noon of 2 July 2019. t_ns : ns since 1970-01-01 UTC."""
    time = np.datetime64(int(t_ns), "ns")
    year = time.astype("datetime64[Y]")
    start, end = year.astype("datetime64[ns]"), (year + 1).astype("datetime64[ns]")
    return 1970.0 + float(year.astype(np.int64)) + float((time - start) / (end - start))
