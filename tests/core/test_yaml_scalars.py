from __future__ import annotations

import math

import pytest

from recon.yaml_scalars import plain_scalar, reads_as_text


# The examples and the tag resolution table of YAML 1.2.2, section 10.3.2, and what YAML 1.1 reads otherwise.
@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("null", None), ("Null", None), ("NULL", None), ("~", None), ("nULL", "nULL"),
        ("true", True), ("True", True), ("TRUE", True), ("false", False), ("tRUE", "tRUE"),
        ("yes", "yes"), ("no", "no"), ("on", "on"), ("off", "off"), ("y", "y"), ("N", "N"),
        ("0", 0), ("-19", -19), ("+12", 12), ("012", 12), ("0o17", 15), ("0x3A", 58), ("-0x3A", "-0x3A"),
        ("0b11", "0b11"), ("1_000", "1_000"), ("12:30", "12:30"), ("12:30:45", "12:30:45"),
        ("9223372036854775807", 2**63 - 1), ("-9223372036854775808", -(2**63)),
        ("0.", 0.0), ("-0.0", -0.0), (".5", 0.5), ("+12e03", 12000.0), ("-2E+05", -200000.0), ("1e-3", 0.001),
        ("1e3", 1000.0), (".", "."), ("1.2.3", "1.2.3"), ("e3", "e3"), ("1e", "1e"), ("١", "١"),
        ("2017-08-03", "2017-08-03"), ("2017-08-03T12:22:10Z", "2017-08-03T12:22:10Z"),
        ("12 Hz", "12 Hz"), ("=", "="), ("inf", "inf"), ("nan", "nan"),
    ],
)  # fmt: skip
def test_scalars_follow_the_core_schema_of_yaml_1_2(text, value):
    found = plain_scalar(text)
    assert found == value
    assert type(found) is type(value)
    assert reads_as_text(text) is isinstance(value, str)


@pytest.mark.parametrize("text", [".inf", "-.Inf", "1e999", "9223372036854775808", "9" * 5000])
def test_numbers_that_no_double_or_64_bit_integer_holds_are_infinite(text):
    assert abs(plain_scalar(text)) == math.inf
    assert not reads_as_text(text)
