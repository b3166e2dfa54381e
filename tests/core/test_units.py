import math
import pickle
import subprocess
import sys
from contextlib import suppress
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recon.unit_table import UNITS
from recon.units import UnitError, convert, duration_text, format_quantity, parse_quantity, parse_unit, si_unit

# One rounding of the ratio and one of the product: each at most half a unit in the last place.
TWO_ROUNDINGS = 2.0**-52


@pytest.mark.parametrize(
    "same",
    [
        ("m/s^2", "m/s**2", "m/s²", "m*s^-2", "m s^-2", "m·s^-2", "m / (s*s)", "m/s/s", " m / s ^ 2 ", "m s^(-2)"),
        ("deg/sqrt(h)", "deg/h^0.5", "deg/h^(1/2)", "deg*h^-0.5", "deg h^(-1/2)", "sqrt(deg^2/h)"),
        ("1/s", "Hz", "s^-1", "(1/s)"),
        ("m^(1/3)", "(m)^(1 / 3)"),
    ],
)
def test_spellings_of_one_unit_are_equal(same):
    first = parse_unit(same[0])
    for text in same[1:]:
        unit = parse_unit(text)
        assert unit.dimension == first.dimension
        assert unit.scale == pytest.approx(first.scale, rel=4 * TWO_ROUNDINGS)  # up to four roundings in the roots
        assert unit.text == text


def test_a_product_is_read_from_left_to_right():
    assert parse_unit("m/s*kg").dimension == parse_unit("m*kg/s").dimension
    assert parse_unit("m/s kg").dimension == parse_unit("m*kg/s").dimension


def test_a_dimension_lists_the_exponents_of_the_base_units():
    assert parse_unit("deg/sqrt(h)").dimension == (0, 0, Fraction(-1, 2), 0, 0, 1)


@pytest.mark.parametrize(
    ("unit", "si"),
    [
        ("1/min", "Hz"),
        ("g", "m/s^2"),
        ("km/h", "m/s"),
        ("deg", "rad"),
        ("dps", "rad/s"),
        ("deg/sqrt(h)", "rad/s^0.5"),
        ("mg/sqrt(Hz)", "m/s^1.5"),
        ("uT", "T"),
        ("mbar", "Pa"),
        ("mV", "V"),
        ("degC", "K"),
        ("%", "1"),
        ("km^2", "m^2"),
        ("kg/m/h", "kg/(m*s)"),
        ("1/km", "1/m"),
        ("m^(1/3)", "m^(1/3)"),
    ],
)
def test_si_units_have_one_canonical_text_which_reads_back(unit, si):
    assert si_unit(unit) == si
    assert parse_unit(si).dimension == parse_unit(unit).dimension
    assert parse_unit(si).scale == 1.0


@pytest.mark.parametrize(
    ("text", "into", "value"),
    [
        ("12 Hz", "Hz", 12.0),
        ("12Hz", "Hz", 12.0),
        ("  12  Hz ", "Hz", 12.0),
        ("1e-3 m", "m", 0.001),
        ("-.5 m", "m", -0.5),
        ("+5. m", "m", 5.0),
        ("10 min", "s", 600.0),
        ("250 ms", "s", 0.25),
        ("36 km/h", "m/s", 10.0),
        ("2 g", "m/s^2", 19.6133),
        ("90 deg", "rad", math.pi / 2),
        ("180 deg", "deg", 180.0),
        ("25 degC", "K", 298.15),
        ("25 °C", "degC", 25.0),
        ("298.15 K", "degC", 25.0),
        ("50 %", "1", 0.5),
        ("0.5", "1", 0.5),
        ("0.5 1", "%", 50.0),
        ("4 1/s", "Hz", 4.0),
    ],
)
def test_quantities_become_numbers(text, into, value):
    assert parse_quantity(text, into=into) == value


def test_angular_random_walk_of_a_datasheet():
    # 0.24 deg/sqrt(h) = 0.24 pi / 180 / 60 rad/sqrt(s); four roundings on the way that is written here
    expected = 0.24 * math.pi / 180 / 60
    assert parse_quantity("0.24 deg/sqrt(h)", into="rad/sqrt(s)") == pytest.approx(expected, rel=4 * TWO_ROUNDINGS)


def test_decimal_units_give_the_double_that_the_decimal_number_has():
    assert all(parse_quantity(f"{number} ms", into="s") == float(f"{number}e-3") for number in range(10000))


@pytest.mark.parametrize(
    ("text", "into", "message"),
    [
        ("12", "Hz", "a unit is missing: write for example '12 Hz'"),
        ("0.5", "%", "a unit is missing: write for example '0.5 %'"),
        ("12 m", "Hz", "'12 m' is a length (m); needs a unit like Hz"),
        ("5 deg/s", "Hz", "'5 deg/s' is an angular rate (deg/s); needs a unit like Hz"),
        ("5 m^3", "Hz", "'5 m^3' is in m^3; needs a unit like Hz"),
        ("5 %", "Hz", "'5 %' is a plain number; needs a unit like Hz"),
        ("5 m", "1", "'5 m' is a length (m); needs a plain number"),
        ("5 kg", "g", "'5 kg' is a mass (kg); needs a unit like g"),
        ("5 hz", "Hz", "unknown unit 'hz'; did you mean 'Hz'?"),
        ("5 minutes", "s", "unknown unit 'minutes'; did you mean 'min'?"),
        ("5 foo/s", "Hz", "unknown unit 'foo' in 'foo/s'"),
        ("5 m/s2", "m/s^2", "the unit 'm/s2' cannot be read at '2'; write a power as m^2"),
        ("5 m s-2", "m/s^2", "the unit 'm s-2' cannot be read at '-2'; write a power as m^2"),
        ("1_000 m", "m", "'1_000 m' is not a number with a unit; write for example '12 m'"),
        ("1,5 m", "m", "'1,5 m' is not a number with a unit; write for example '12 m'"),
        ("1.2.3 m", "m", "'1.2.3 m' is not a number with a unit; write for example '12 m'"),
        ("inf m", "m", "'inf m' is not a number with a unit; write for example '12 m'"),
        ("nan", "1", "'nan' is not a number with a unit; write for example '12'"),
        ("", "m", "'' is not a number with a unit; write for example '12 m'"),
        ("1e999 m", "m", "'1e999 m' is too large for a number"),
        ("1e308 km", "m", "'1e308 km' is too large for a number"),
    ],
)
def test_what_is_no_quantity_gets_one_clear_sentence(text, into, message):
    with pytest.raises(UnitError) as caught:
        parse_quantity(text, into=into)
    assert str(caught.value) == message


@pytest.mark.parametrize(
    "text",
    [
        *("", " ", "m/", "/m", "*m", "m//s", "m--s", "(m", "m)", "()", "2 m", "sqrt", "sqrt m", "m\0"),
        *("m^", "m^x", "m^1/2", "m^(1/0)", "m^13", "((((km^9)^9)^9)^9)", "(" * 10_000, "m*" * 10_000 + "m"),
        "м",  # the Cyrillic letter
    ],
)
def test_what_is_no_unit_is_refused(text):
    with pytest.raises(UnitError):
        parse_unit(text)


def test_celsius_is_a_scale_alone_and_a_difference_in_a_product():
    assert convert(0.0, "degC", "K") == 273.15
    assert convert(0.0, "(degC)", "K") == 273.15
    assert convert(1.0, "mV/degC", "mV/K") == 1.0


def test_arrays_convert_like_their_elements_and_stay_as_they_are():
    degrees = np.linspace(-720.0, 720.0, 1440).reshape(-1, 3)
    before = degrees.copy()
    radians = convert(degrees, "deg", "rad")
    assert np.array_equal(degrees, before)
    assert not np.shares_memory(convert(degrees, "deg", "deg"), degrees)
    assert radians.shape == degrees.shape
    assert radians[7, 2] == convert(float(degrees[7, 2]), "deg", "rad")
    # numpy's own conversion rounds the ratio and the product once each, and so does ours
    np.testing.assert_allclose(radians, np.deg2rad(degrees), rtol=2 * TWO_ROUNDINGS, atol=0)


def test_missing_samples_stay_missing():
    assert np.isnan(convert(np.array([np.nan]), "degC", "K")).all()


def test_convert_refuses_another_dimension():
    with pytest.raises(
        UnitError, match=r"cannot convert: one unit is an angular rate \(deg/s\), the other a frequency"
    ):
        convert(1.0, "deg/s", "Hz")


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("0.24 deg/sqrt(h)", "deg/sqrt(h)"),
        ("120 ug/sqrt(Hz)", "ug/sqrt(Hz)"),
        ("36 km/h", "km/h"),
        ("12 Hz", "Hz"),
        ("10 min", "min"),
        ("25 degC", "degC"),
        ("0.1 %", "%"),
        ("-3.7 deg", "deg"),
    ],
)
def test_a_number_written_by_a_person_comes_back_as_it_was_written(text, unit):
    assert format_quantity(parse_quantity(text, into=si_unit(unit)), unit) == text


def test_a_plain_number_is_written_without_a_unit():
    assert format_quantity(0.5, "1") == "0.5"


def test_a_value_that_the_unit_cannot_hit_is_written_in_si():
    # near 273.15 doubles lie 2^-44 apart, so that no temperature in degC is exactly 0.1 K
    assert format_quantity(0.1, "degC") == "0.1 K"


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_what_is_not_finite_cannot_be_written(value):
    with pytest.raises(UnitError):
        format_quantity(value, "m")


@given(st.floats(allow_nan=False, allow_infinity=False), st.sampled_from([*UNITS, "deg/sqrt(h)", "km/h", "1/min"]))
def test_formatting_keeps_every_bit(value, unit):
    assert parse_quantity(format_quantity(value, unit), into=si_unit(unit)) == value


@given(st.text(alphabet="12 .e+-*/^()msqrtdegHzkµ°²%_", max_size=30))
def test_any_text_is_read_or_refused_in_one_way(text):
    with suppress(UnitError):
        assert math.isfinite(parse_quantity(text, into="m"))


@pytest.mark.parametrize("text", ["1" * 100_000 + "_", "1" + " " * 100_000 + "x", "1 " + "m " * 100_000])
def test_long_text_is_refused_at_once(text):
    # a regular expression that looks back again from every place would take minutes
    with pytest.raises(UnitError) as caught:
        parse_quantity(text, into="m")
    assert len(str(caught.value)) < 200


def test_units_cross_process_borders():
    unit = parse_unit("deg/sqrt(h)")
    assert pickle.loads(pickle.dumps(unit)) == unit


def test_importing_units_loads_nothing_heavy():
    code = "import sys, recon.units; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    assert "recon.units" in loaded
    assert not {"numpy", "pyarrow", "pydantic", "rich", "scipy"} & set(loaded)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.0024, "0.0024 s"),
        (90.0, "90 s"),
        (120.0, "2 min"),
        (7199.0, "120 min"),
        (9000.0, "2.5 h"),
        (259_200.0, "3 days"),
        (1e9, "31.7 years"),
    ],
)
def test_a_duration_is_told_in_a_unit_that_people_use(seconds, text):
    assert duration_text(seconds) == text
