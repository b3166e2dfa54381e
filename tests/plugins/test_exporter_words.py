"""What people read instead of our names."""

from __future__ import annotations

import pytest

from recon_exporters._words import unit_symbol, words


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("harsh_braking", "harsh braking"),
        ("gyro_bias_x", "gyroscope bias x"),
        ("residuals_square_gnss_pos_e", "residuals square GNSS position east"),
        ("vel_across", "velocity across"),
        ("edr_maximum_delta_v_lateral", "EDR maximum delta-V lateral"),
        ("accel_max", "largest acceleration"),
        ("delta_v_lat_max", "largest delta-V lateral"),
        ("oiv_long", "OIV longitudinal"),
        ("pos_std_lat", "position sigma latitude"),
        ("harsh_braking_per_100km", "harsh braking per 100 km"),
        ("something_of_a_plugin", "something of a plugin"),
        ("", ""),
    ],
)
def test_names_become_words(name, told):
    assert words(name) == told


@pytest.mark.parametrize(
    ("text", "symbol"),
    [("m/s^2", "m/s²"), ("s^2/m", "s²/m"), ("deg/s", "°/s"), ("m^-1", "m⁻¹"), ("km/h", "km/h"), ("1", ""), (None, "")],
)
def test_units_are_written_as_on_paper(text, symbol):
    assert unit_symbol(text) == symbol
