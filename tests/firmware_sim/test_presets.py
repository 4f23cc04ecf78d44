import json
import tomllib
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from plant_support import MATERIALS, SKIN, bench_record

from firmware_sim.bench import Bench
from firmware_sim.local_values import local_values
from firmware_sim.plant import Plant, PlantParameters
from firmware_sim.presets import DEFAULT, load_preset, parse_preset, preset_names
from firmware_sim.tissue import EXTRAS, Branch, Exponential, Tissue
from tissueid.identification import get_engine

SOUND = (files("firmware_sim.presets") / f"{DEFAULT}.toml").read_text(encoding="utf-8")
LINEAR_BAND = (72.0, 88.0)
WIENER_GAIN = (3.0, 12.0)


def fitted(engine, record):
    model = get_engine(engine)().fit(record)
    return model.report


@pytest.mark.parametrize("preset", SKIN)
@pytest.mark.parametrize("distribution", ["gaussian", "uniform"])
def test_skin_is_as_nonlinear_as_the_thesis_finds_it(preset, distribution):
    record = bench_record(preset, distribution)
    linear, wiener = (fitted(engine, record).vaf_percent for engine in ("lms", "wiener"))
    print(f"{preset}, {distribution}: linear {linear:.1f} %, Wiener {wiener:.1f} %")
    assert LINEAR_BAND[0] <= linear <= LINEAR_BAND[1]
    assert WIENER_GAIN[0] <= wiener - linear <= WIENER_GAIN[1]


@pytest.mark.parametrize("preset", SKIN)
def test_a_large_test_travels_millimetres_and_stays_off_the_stops(preset):
    position = bench_record(preset, "gaussian").output
    assert 4.5e-3 < np.ptp(position) < 8e-3
    assert position.min() > 5e-3
    assert position.max() < 20e-3


@pytest.mark.parametrize("preset", SKIN)
def test_a_small_test_finds_the_local_truth(preset):
    record = bench_record(preset, "small")
    report = fitted("lms", record)
    truth = local_values(preset, float(record.output.mean()))
    assert report.vaf_percent > 90.0
    for name in ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"):
        found = report.parameters[name].value
        print(f"{preset}: {name} {found:.4g}, truth {truth[name]:.4g}")
        assert found == pytest.approx(truth[name], rel=0.05)


@pytest.mark.parametrize("preset", [*MATERIALS, "calibration-spring", "linear-demo"])
def test_materials_are_nearly_linear_at_small_force(preset):
    assert fitted("lms", bench_record(preset, "small")).vaf_percent > 95.0


def test_acrylamide_stiffens_with_concentration_and_little_else_changes():
    values = [local_values(f"acrylamide-{c}", 0.0115) for c in (10, 20, 30)]
    stiffness = [v["stiffness_n_per_m"] for v in values]
    assert stiffness == sorted(stiffness)
    assert stiffness[2] > 2 * stiffness[0]
    for name in ("mass_kg", "damping_n_s_per_m"):
        assert len({v[name] for v in values}) == 1


def test_the_posterior_forearm_is_the_stiffest_site():
    stiffness = {}
    for preset in SKIN:
        tissue = load_preset(preset)
        rest = Plant(PlantParameters(), tissue).static_position(3.5 + 0.588399)
        stiffness[preset] = local_values(preset, rest)["stiffness_n_per_m"]
    order = sorted(stiffness, key=stiffness.__getitem__)
    assert set(order[-2:]) == {"left-posterior-forearm", "right-posterior-forearm"}


# -- local values -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("preset", preset_names())
@pytest.mark.parametrize("force", [1.0, 4.0])
def test_the_tangent_is_the_slope_of_the_static_curve(preset, force):
    tissue = load_preset(preset)
    p = Plant(PlantParameters(), tissue)
    low, here, high = (p.static_position(force + change) for change in (-1e-3, 0.0, 1e-3))
    truth = local_values(tissue.with_extras(tissue.extras - {"relaxation"}), here)
    assert truth["stiffness_n_per_m"] == pytest.approx(2e-3 / (high - low), rel=1e-3)


@pytest.mark.parametrize("preset", preset_names())
def test_local_values_are_json_and_say_where_they_hold(preset):
    truth = json.loads(json.dumps(local_values(preset, 0.0125)))
    assert truth["preset"] == preset
    assert truth["depth_m"] == pytest.approx(0.0125 - load_preset(preset).surface_m)
    assert truth["mass_kg"] > 0
    assert truth["stiffness_n_per_m"] > 0


def test_the_tangent_is_not_the_coefficient():
    truth = local_values(DEFAULT, 0.014)
    tissue = load_preset(DEFAULT)
    assert truth["coefficients"]["stiffness_n_per_m"] == tissue.stiffness.at(0.014 - tissue.surface_m)
    assert truth["relaxation"]["relaxed_stiffness_n_per_m"] > 2 * truth["coefficients"]["stiffness_n_per_m"]


def test_direction_and_relaxation_are_shown_from_both_sides():
    truth = local_values(DEFAULT, 0.014)
    both = truth["direction"]
    assert both["pushing_damping_n_s_per_m"] > truth["damping_n_s_per_m"] > both["pulling_damping_n_s_per_m"]
    relaxation = truth["relaxation"]
    assert relaxation["applies"] == "unrelaxed"
    assert relaxation["relaxed_stiffness_n_per_m"] < truth["stiffness_n_per_m"]
    assert truth["stiffness_n_per_m"] <= relaxation["unrelaxed_stiffness_n_per_m"]


def test_off_the_tissue_only_the_moving_part_is_left():
    truth = local_values(DEFAULT, 0.008)
    assert not truth["in_contact"]
    assert (truth["mass_kg"], truth["stiffness_n_per_m"]) == (0.060, 0.0)


def test_local_values_refuse_where_the_tissue_cannot_be():
    with pytest.raises(ValueError, match=r"0 to 0\.032 m, not 0\.04"):
        local_values(DEFAULT, 0.04)
    with pytest.raises(ValueError, match="wiener-demo saturates"):
        local_values("wiener-demo", 0.0199)
    with pytest.raises(ValueError, match="known: "):
        local_values("moon", 0.012)


# -- files ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("preset", preset_names())
def test_every_figure_has_a_source(preset):
    text = (files("firmware_sim.presets") / f"{preset}.toml").read_text(encoding="utf-8")
    tissue = load_preset(preset)
    assert tissue.title
    assert all(source.startswith(("thesis ", "chosen: ")) for source in tissue.sources.values())
    assert text.count("source =") == len(tissue.sources) >= 4


def test_the_sites_and_materials_of_the_thesis_are_there():
    assert {
        "left-anterior-forearm",
        "right-anterior-forearm",
        "left-posterior-forearm",
        "right-posterior-forearm",
        "left-distal-forearm",
        "upper-arm",
    } == set(SKIN)
    assert {*MATERIALS, "calibration-spring", "linear-demo", "wiener-demo", "hammerstein-demo"} <= set(preset_names())


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(ValueError, match="unknown tissue preset 'knee'") as caught:
        load_preset("knee")
    assert "\n" not in str(caught.value)
    assert all(name in str(caught.value) for name in preset_names())


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('kind = "dpn"', 'kind = "jelly"', "unknown kind 'jelly'; known: linear, dpn, wiener, hammerstein"),
        ('kind = "dpn"', "", "kind must be a text"),
        ('kind = "dpn"', 'kind = "wiener"', "extras belong to the kinds linear and dpn, not to wiener"),
        ('kind = "dpn"', 'kind = "linear"', "rates and offsets belong to the kind dpn"),
        ('extras = ["contact"', 'extras = ["magic"', "unknown extra 'magic'; known: contact"),
        ("extras = [", "extras = [1, ", "extras must be a list of names"),
        ("surface_m = { value = 0.010", "surface_m = { value = 0.050", "surface_m must lie on the stroke"),
        ("surface_m = { value = 0.010", 'surface_m = { value = "deep"', "must be a number, not 'deep'"),
        ("surface_m = { value = 0.010", "surface_m = { valeu = 0.010", "surface_m must be { value = ..., source"),
        ("[mass]", "[weight]", "mass.kg is missing"),
        ("[stiffness]", "[stiffness]\ncolour = 3", "unknown key stiffness.colour"),
        ("[stiffness]", "[stiffness", "left-posterior-forearm: Expected"),
        ("[[relaxation]]", "[relaxation]", "relaxation must be a list of tables"),
        ("[[relaxation]]", "[[relaxation]]\nstrength = 1", "unknown key relaxation.0.strength"),
        ("thesis Figure 3.8", "somewhere", "must begin with 'thesis ' or 'chosen: '"),
    ],
)
def test_an_unsound_file_is_refused_in_one_line(old, new, complaint):
    assert old in SOUND
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the complaint is compared below
        parse_preset(DEFAULT, SOUND.replace(old, new, 1))
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)


def test_sound_toml_stays_sound():
    assert tomllib.loads(SOUND)["kind"] == "dpn"


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"mass": Exponential(-1.0)}, "must not be negative"),
        ({"mass": Exponential(0.001)}, "needs a mass of 0.002 kg or more"),
        ({"branches": (Branch(0.1, 0.1),) * 4}, "at most 3 relaxation branches, not 4"),
        ({"branches": (Branch(0.1, 0.0),)}, "a fraction of 0 or more and a positive time"),
        ({"direction_ratio": 1.0}, "a ratio between -1 and 1"),
        ({"recruitment_depth_m": 0.0}, "needs a positive depth"),
        ({"kind": "wiener", "extras": frozenset()}, "the static curve needs a positive scale and rate"),
    ],
)
def test_a_tissue_must_make_sense(change, complaint):
    with pytest.raises(ValueError, match=complaint):
        replace(load_preset(DEFAULT), **change)


def test_extras_can_be_switched_one_by_one():
    tissue = load_preset(DEFAULT)
    arrays = {extra: tissue.with_extras(tissue.extras - {extra}).to_array() for extra in EXTRAS}
    arrays["all"] = tissue.to_array()
    assert len({a.tobytes() for a in arrays.values()}) == len(EXTRAS) + 1
    bare = tissue.with_extras(())
    assert not any(bare.has(extra) for extra in EXTRAS)
    assert bare.active_branches() == ()
    with pytest.raises(ValueError, match="unknown extra 'glue'"):
        tissue.with_extras(["glue"])
    with pytest.raises(ValueError, match="unknown extra 'glue'"):
        tissue.has("glue")


def test_a_bench_can_move_its_tissue():
    bench = Bench("calibration-spring", surface_m=0.004)
    assert isinstance(bench.tissue, Tissue)
    assert bench.plant.state[1] == pytest.approx(0.004588399, abs=1e-8)
