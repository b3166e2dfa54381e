"""The table of units against the SI brochure and NIST SP 811."""

from __future__ import annotations

import math

import pytest

from recon.unit_table import QUANTITY_NAMES
from recon.units import parse_unit, si_unit

# One rounding of the ratio and one of the product: each at most half a unit in the last place.
TWO_ROUNDINGS = 2.0**-52
DEGREE = math.pi / 180


# Sizes from the SI brochure and NIST SP 811, written out by hand.
SIZES = [
    ("km", "m", 1000.0),
    ("cm", "m", 0.01),
    ("mm", "m", 0.001),
    ("ft", "m", 0.3048),
    ("in", "m", 0.0254),
    ("mi", "m", 1609.344),
    ("nmi", "m", 1852.0),
    ("ms", "s", 1e-3),
    ("us", "s", 1e-6),
    ("µs", "s", 1e-6),
    ("ns", "s", 1e-9),
    ("min", "s", 60.0),
    ("h", "s", 3600.0),
    ("day", "s", 86400.0),
    ("kHz", "Hz", 1000.0),
    ("1/min", "Hz", 1 / 60),
    ("g", "m/s^2", 9.80665),
    ("mg", "m/s^2", 9.80665e-3),
    ("ug", "m/s^2", 9.80665e-6),
    ("mGal", "m/s^2", 1e-5),
    ("mrad", "rad", 1e-3),
    ("deg", "rad", DEGREE),
    ("arcmin", "rad", DEGREE / 60),
    ("arcsec", "rad", DEGREE / 3600),
    ("rev", "rad", 2 * math.pi),
    ("rpm", "rad/s", math.pi / 30),
    ("dps", "rad/s", DEGREE),
    ("mdps", "rad/s", DEGREE / 1000),
    ("°/s", "rad/s", DEGREE),
    ("deg/h", "rad/s", DEGREE / 3600),
    ("km/h", "m/s", 1 / 3.6),
    ("kph", "m/s", 1 / 3.6),
    ("mph", "m/s", 0.44704),
    ("kn", "m/s", 1852 / 3600),
    ("knot", "m/s", 1852 / 3600),
    ("mT", "T", 1e-3),
    ("µT", "T", 1e-6),  # micro sign, U+00B5
    ("μT", "T", 1e-6),  # Greek mu, U+03BC
    ("nT", "T", 1e-9),
    ("gauss", "T", 1e-4),
    ("mG", "T", 1e-7),
    ("hPa", "Pa", 100.0),
    ("kPa", "Pa", 1000.0),
    ("bar", "Pa", 1e5),
    ("mbar", "Pa", 100.0),
    ("atm", "Pa", 101325.0),
    ("mV", "V", 1e-3),
    ("%", "1", 0.01),
    ("percent", "1", 0.01),
    ("ppm", "1", 1e-6),
    ("deg/sqrt(h)", "rad/s^0.5", DEGREE / 60),
    ("ug/sqrt(Hz)", "m/s^1.5", 9.80665e-6),
    ("m/s/sqrt(h)", "m/s^1.5", 1 / 60),
    ("mg/degC", "m/(s^2*K)", 9.80665e-3),
]


@pytest.mark.parametrize(("unit", "si", "size"), SIZES)
def test_units_have_the_sizes_of_the_standards(unit, si, size):
    assert parse_unit(unit).scale == pytest.approx(size, rel=TWO_ROUNDINGS, abs=0)
    assert parse_unit(unit).dimension == parse_unit(si).dimension


@pytest.mark.parametrize("si", QUANTITY_NAMES)
def test_names_of_quantities_stand_under_the_canonical_text_of_their_unit(si):
    assert si_unit(si) == si
