"""Configurations and probes: what goes together, and what is refused."""

import pytest
from coded import coded, holding, is_german, says
from pydantic import ValidationError

from tissueid.configuration import (
    CONFIGURATIONS,
    PROBES,
    Probe,
    has_depth,
    is_attached,
    spring_of,
    travel_word,
)
from tissueid.device import DESKTOP, HANDHELD, angle_deg
from tissueid.errors import UnusableInputError
from tissueid.messages import joined
from tissueid.plan_options import validation_reason
from tissueid.test_settings import TestSettings, orientation, placement


def test_each_configuration_has_a_probe_of_its_own():
    for name in CONFIGURATIONS:
        spring = 500.0 if name == "surface" else 0.0
        chosen = TestSettings(configuration=name, external_spring_n_per_m=spring)
        assert chosen.tip.configuration == name
        assert chosen.as_notes()["external_spring_n_per_m"] == spring
        assert chosen.as_notes()["probe_name"] in PROBES


def test_the_probes_of_the_thesis():
    assert (PROBES["indenter-4.4mm"].diameter_m, PROBES["indenter-4.4mm"].thickness_m) == (4.4e-3, 1e-3)
    assert (PROBES["indenter-4.3mm"].diameter_m, PROBES["indenter-4.3mm"].corner_radius_m) == (4.3e-3, 0.4e-3)
    assert (PROBES["indenter-5mm"].diameter_m, PROBES["indenter-5mm"].corner_radius_m) == (5e-3, 1.3e-3)
    extension = PROBES["extension-5x16mm"]
    assert (extension.width_m, extension.length_m, extension.corner_radius_m) == (5e-3, 16e-3, 2e-3)
    assert says(extension.words, "probe.corner", radius=2.0)
    assert all(probe.source for probe in PROBES.values())


@pytest.mark.parametrize(
    ("name", "probe", "spring", "check"),
    [
        ("poking", None, 0.0, coded("configuration.unknown", name="poking", known=joined(CONFIGURATIONS))),
        ("indentation", "thumb", 0.0, coded("configuration.unknown_probe", name="thumb", known=joined(PROBES))),
        ("extension", "indenter-5mm", 0.0, coded("configuration.wrong_probe", fitting="extension-5x16mm")),
        ("surface", None, 0.0, coded("configuration.no_spring")),
        ("indentation", None, 800.0, coded("configuration.not_here", name="indentation")),
        ("surface", None, -1.0, holding("option.least", limit=0.0)),
        ("surface", None, float("nan"), holding("option.finite")),
        ("surface", None, 1e6, holding("option.most", limit=20000.0)),
    ],
)
def test_names_that_do_not_fit_together_are_refused_in_one_line(name, probe, spring, check):
    with pytest.raises(UnusableInputError, check=check) as refusal:
        TestSettings(configuration=name, probe=probe, external_spring_n_per_m=spring)
    assert "\n" not in str(refusal.value)
    assert is_german(refusal.value.message)


def test_how_the_probe_meets_the_tissue_is_noted_where_it_is_known():
    assert set(TestSettings().as_notes()) & {"coupling", "orientation_deg", "initial_length_m"} == set()
    assert TestSettings(configuration="extension").as_notes()["coupling"] == "none"
    notes = TestSettings(
        configuration="extension", coupling="adhesive", orientation_deg=orientation("horizontal"), initial_length_m=0.01
    ).as_notes()
    assert (notes["coupling"], notes["orientation_deg"], notes["initial_length_m"]) == ("adhesive", 90.0, 0.01)
    assert is_attached(notes)
    assert not is_attached(TestSettings().as_notes())
    sliding = TestSettings(configuration="surface", external_spring_n_per_m=800.0, normal_preload_n=1.0).as_notes()
    assert sliding["normal_preload_n"] == 1.0
    assert is_attached(TestSettings(coupling="tape").as_notes())
    assert placement({}) == placement(TestSettings().as_notes()) != placement(notes)


@pytest.mark.parametrize(
    ("name", "others", "check"),
    [
        ("indentation", {"orientation_deg": 0.0}, coded("configuration.not_here", name="indentation")),
        ("surface", {"initial_length_m": 0.01}, coded("configuration.not_here", name="surface")),
        ("surface", {"coupling": "tape"}, coded("configuration.not_here", name="surface")),
        ("extension", {"normal_preload_n": 1.0}, coded("configuration.not_here", name="extension")),
        ("extension", {"coupling": "velcro"}, holding("option.choice")),
        ("extension", {"orientation_deg": 181.0}, holding("option.most", limit=180)),
        ("extension", {"orientation_deg": float("nan")}, holding("option.finite")),
        ("extension", {"initial_length_m": 1e-4}, holding("option.least", limit=0.001)),
        ("extension", {"initial_length_m": float("inf")}, holding("option.finite")),
        ("surface", {"normal_preload_n": 0.0}, holding("option.greater", limit=0)),
        ("surface", {"normal_preload_n": 16.0}, holding("option.most", limit=15)),
    ],
)
def test_what_a_configuration_does_not_have_is_refused(name, others, check):
    spring = 800.0 if name == "surface" else 0.0
    with pytest.raises(UnusableInputError, check=check) as refusal:
        TestSettings(configuration=name, external_spring_n_per_m=spring, **others)
    assert "\n" not in str(refusal.value)
    assert is_german(refusal.value.message)


def test_an_orientation_is_an_angle_or_a_direction():
    assert (orientation("vertical"), orientation("-30"), orientation("45.5")) == (0.0, -30.0, 45.5)
    with pytest.raises(UnusableInputError, check=coded("configuration.direction", text="up")):
        orientation("up")


@pytest.mark.parametrize("shape", [{"diameter_m": 4e-3, "width_m": 5e-3, "length_m": 16e-3}, {}])
def test_a_probe_has_one_shape(shape):
    with pytest.raises(ValidationError) as caught:
        Probe(name="odd", **shape)
    assert says(validation_reason(caught.value), "configuration.probe_shape")


def test_only_indentation_has_depth():
    assert [has_depth(name) for name in CONFIGURATIONS] == [True, False, False]
    assert travel_word("surface") == "displacement"


def test_a_spring_in_a_file_is_a_number_or_none():
    assert spring_of({"external_spring_n_per_m": 800.0}) == 800.0
    for nonsense in ("800", -5.0, float("nan"), 1e9):
        assert spring_of({"external_spring_n_per_m": nonsense}) == 0.0
    assert spring_of({}) == 0.0


def test_the_handheld_is_lighter_and_weaker():
    assert (HANDHELD.coil_resistance_ohm, HANDHELD.moving_mass_kg, HANDHELD.stroke_m) == (9.5, 0.0395, 0.032)
    ratio = HANDHELD.force_constant_n_per_a / DESKTOP.force_constant_n_per_a
    assert ratio == pytest.approx(0.35 / 0.53 * 9.5 / 12.0)
    assert DESKTOP.weight_n() == pytest.approx(0.588, abs=1e-3)
    assert DESKTOP.weight_n(0.0) == 0.0


def test_angles():
    assert angle_deg((1.0, 0.0), (0.0, 2.0)) == pytest.approx(90.0)
    assert angle_deg((9.8, 0.0), (9.8, 0.0)) == 0.0
    assert angle_deg((0.0, 0.0), (1.0, 0.0)) == 0.0
