"""The table of units: conversions, displayed units, and units in names."""

import math

import numpy as np
import pytest

from tissueid.units import SHOWN, display_unit, fine_unit, split_name, unit_for


@pytest.mark.parametrize(
    ("si", "shown", "scale"),
    [
        ("m", "mm", 1e3),
        ("kg", "g", 1e3),
        ("H", "mH", 1e3),
        ("A", "A", 1.0),
        ("N/A", "N per A", 1.0),
        ("m/A", "mm/A", 1e3),
        ("degC", "°C", 1.0),
        ("ohm", "Ω", 1.0),
        ("m s-2", "m/s²", 1.0),
        ("m/s^2", "m/s²", 1.0),
        ("m/s", "m/s", 1.0),
        ("rad/s", "Hz", 0.5 / math.pi),
        ("rad", "°", 180.0 / math.pi),
        ("N s/m", "N·s/m", 1.0),
        ("N s/m²", "N·s/m²", 1.0),
        ("N s²/m²", "N·s²/m²", 1.0),
        ("1", "", 1.0),
        ("", "", 1.0),
        ("µm", "µm", 1.0),
        ("furlong", "furlong", 1.0),
    ],
)
def test_display_units(si, shown, scale):
    assert display_unit(si) == (shown, scale)


def test_small_values_have_a_prefix():
    assert unit_for("m", 5e-5) == fine_unit("m") == ("µm", 1e6)
    assert unit_for("m", 5e-4) == unit_for("m", 0.0) == ("mm", 1e3)
    assert unit_for("A", 0.05) == ("mA", 1e3)
    assert unit_for("V", 0.5) == ("V", 1.0)
    assert unit_for("N", 1e-6) == fine_unit("N") == ("N", 1.0)


def test_each_unit_converts_back():
    for unit in SHOWN.values():
        one = float(unit.to_si(np.ones(1))[0]) - unit.offset
        assert one * unit.scale == pytest.approx(1.0)


def test_names_end_in_their_unit():
    assert split_name("mass_kg") == ("mass", "kg")
    assert split_name("damping_n_s_per_m") == ("damping", "N s/m")
    assert split_name("memory") == ("memory", "s")
    assert split_name("damping_ratio") == ("damping_ratio", "")
