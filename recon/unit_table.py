"""The units that there are: names, sizes, dimensions and prefixes, and what their products measure. Data alone.

References: BIPM, The International System of Units, 9th edition, tables 2 to 8 (gravity: 3rd CGPM, 1901); NIST SP 811
appendix B.8 for ft, in, mi, gauss and Gal.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Final, TypeAlias

Dimension: TypeAlias = tuple[Fraction, ...]
"""Exponents of m, kg, s, A, K and rad."""

BASE: Final = ("m", "kg", "s", "A", "K", "rad")
Product: TypeAlias = tuple[Fraction, Dimension]
"""Size and dimension."""

_PREFIXES = {"n": "1e-9", "u": "1e-6", "m": "1e-3", "c": "1e-2", "h": "1e2", "k": "1e3", "M": "1e6", "G": "1e9"}
_PI = Fraction(math.pi)
CELSIUS_ZERO: Final = 273.15
"""K"""

# name: (SI units in one, exponents of m, kg, s, A, K, rad; prefixes that it takes)
_TABLE: dict[str, tuple[Fraction | int | str, tuple[int, ...], str]] = {
    "1": (1, (0, 0, 0, 0, 0, 0), ""),
    "%": ("0.01", (0, 0, 0, 0, 0, 0), ""),
    "percent": ("0.01", (0, 0, 0, 0, 0, 0), ""),
    "ppm": ("1e-6", (0, 0, 0, 0, 0, 0), ""),
    "m": (1, (1, 0, 0, 0, 0, 0), "numck"),
    "ft": ("0.3048", (1, 0, 0, 0, 0, 0), ""),
    "in": ("0.0254", (1, 0, 0, 0, 0, 0), ""),
    "mi": ("1609.344", (1, 0, 0, 0, 0, 0), ""),
    "nmi": (1852, (1, 0, 0, 0, 0, 0), ""),
    "kg": (1, (0, 1, 0, 0, 0, 0), ""),
    "s": (1, (0, 0, 1, 0, 0, 0), "num"),
    "min": (60, (0, 0, 1, 0, 0, 0), ""),
    "h": (3600, (0, 0, 1, 0, 0, 0), ""),
    "day": (86400, (0, 0, 1, 0, 0, 0), ""),
    "Hz": (1, (0, 0, -1, 0, 0, 0), "mkMG"),
    "kph": (Fraction(5, 18), (1, 0, -1, 0, 0, 0), ""),
    "mph": ("0.44704", (1, 0, -1, 0, 0, 0), ""),
    "kn": (Fraction(1852, 3600), (1, 0, -1, 0, 0, 0), ""),
    "knot": (Fraction(1852, 3600), (1, 0, -1, 0, 0, 0), ""),
    "g": ("9.80665", (1, 0, -2, 0, 0, 0), "num"),
    "Gal": ("0.01", (1, 0, -2, 0, 0, 0), "um"),
    "rad": (1, (0, 0, 0, 0, 0, 1), "num"),
    "deg": (_PI / 180, (0, 0, 0, 0, 0, 1), "m"),
    "arcmin": (_PI / 10800, (0, 0, 0, 0, 0, 1), ""),
    "arcsec": (_PI / 648000, (0, 0, 0, 0, 0, 1), "m"),
    "rev": (2 * _PI, (0, 0, 0, 0, 0, 1), ""),
    "rpm": (2 * _PI / 60, (0, 0, -1, 0, 0, 1), ""),
    "dps": (_PI / 180, (0, 0, -1, 0, 0, 1), "m"),
    "T": (1, (0, 1, -2, -1, 0, 0), "num"),
    "G": ("1e-4", (0, 1, -2, -1, 0, 0), "um"),
    "gauss": ("1e-4", (0, 1, -2, -1, 0, 0), ""),
    "Pa": (1, (-1, 1, -2, 0, 0, 0), "hkM"),
    "bar": (100000, (-1, 1, -2, 0, 0, 0), "m"),
    "atm": (101325, (-1, 1, -2, 0, 0, 0), ""),
    "K": (1, (0, 0, 0, 0, 1, 0), "m"),
    "degC": (1, (0, 0, 0, 0, 1, 0), ""),
    "A": (1, (0, 0, 0, 1, 0, 0), "num"),
    "V": (1, (2, 1, -3, -1, 0, 0), "um"),
}

UNITS: Final[dict[str, Product]] = {
    prefix + name: (Fraction(_PREFIXES.get(prefix, 1)) * Fraction(size), tuple(Fraction(power) for power in powers))
    for name, (size, powers, prefixes) in _TABLE.items()
    for prefix in ("", *prefixes)
}
NAMED_SI: Final = {UNITS[name][1]: name for name in ("Hz", "Pa", "T", "V")}
QUANTITY_NAMES: Final = {
    "m": "a length",
    "kg": "a mass",
    "s": "a time",
    "A": "an electric current",
    "K": "a temperature",
    "rad": "an angle",
    "Hz": "a frequency",
    "m/s": "a speed",
    "m/s^2": "an acceleration",
    "m/s^3": "a jerk",
    "rad/s": "an angular rate",
    "rad/s^2": "an angular acceleration",
    "rad/s^0.5": "an angular random walk",
    "m/s^1.5": "a velocity random walk",
    "T": "a magnetic flux density",
    "Pa": "a pressure",
    "V": "a voltage",
}
