"""Attached, layered and stretched tissue, probes and lotions (thesis 2.1, 3.4, 7.2 to 7.4)."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from plant_support import PRELOAD, VOLTS_PER_NEWTON, plant, preloaded, small_force, standard_force

from firmware_sim.__main__ import main
from firmware_sim.bench import Bench
from firmware_sim.layers import MAX_LAYERS, Layer
from firmware_sim.local_values import local_values
from firmware_sim.lotions import with_lotion
from firmware_sim.plant import SAMPLE_RATE_HZ, SUBSTEPS, Plant, PlantParameters
from firmware_sim.presets import DEFAULT, load_preset, parse_preset
from firmware_sim.probe import PROBES, REFERENCE, Probe, read_probe
from firmware_sim.scenario import load_scenario
from tissueid.identification import get_engine
from tissueid.records import Record
from tissueid.stimuli.kinds.noise import Noise

ATTACHED = load_preset("forearm-attached")
LAYERED = load_preset("forearm-layered")
STRIPS = {
    (site, name): load_preset(f"extension-{site}").stretched(angle)
    for site in ("anterior", "posterior")
    for name, angle in (("vertical", 0.0), ("horizontal", 90.0))
}
HORIZONTAL = PlantParameters(gravity_force_n=0.0)
# Last position and standard deviations of speed and current in the first 1.5 s of the uniform standard test, before any
# of these tissues existed.
BEFORE = {
    "acrylamide-20": (0.011643300382297717, 0.16277217366050198, 1.119224351427775),
    "buna": (0.010499479272800238, 0.06433455684036375, 1.1210294622377985),
    "calibration-spring": (0.013054917847754493, 0.18445635638199306, 1.1218515856395168),
    "hammerstein-demo": (0.01154700720379552, 0.07044856967808572, 1.1233936440770018),
    "latex": (0.014764911386666064, 0.13346282991745523, 1.1190538306849451),
    "linear-demo": (0.010752303027770057, 0.07726960610413733, 1.1218753267372576),
    "sliding-forearm": (0.01393150336939787, 0.11352115974170156, 1.1198265562748375),
    "wiener-demo": (0.014043067643975914, 0.24047566704005308, 1.1033819137588043),
}


def force(low_n, high_n, seconds=2.0, seed=1):
    noise = Noise(
        distribution="uniform", seed=seed, force_min_n=low_n, force_max_n=high_n, seconds=seconds, clipped=0.05
    )
    return preloaded(noise.build().values)


@cache
def record(tissue, mean_n, half_n=0.75, parameters=PlantParameters()):  # noqa: B008 - frozen
    bench = Bench(tissue, seed=3, parameters=parameters)
    codes = bench.block(small_force(mean_n, half_n) * VOLTS_PER_NEWTON, energised=True).codes[PRELOAD:]
    values = {c.name: c.decode(codes[:, k]) for k, c in enumerate(bench.channels)}
    return Record(3.0 * values["current"], values["position"], SAMPLE_RATE_HZ)


def stiffness_at(tissue, force_n):
    at = Plant(HORIZONTAL, tissue).static_position(force_n)
    return local_values(tissue, at)["stiffness_n_per_m"]


@pytest.mark.parametrize("preset", BEFORE)
def test_earlier_presets_give_what_they_gave(preset):
    trace = plant(preset).advance(standard_force("uniform")[:3000] * VOLTS_PER_NEWTON)
    found = trace["position"][-1], trace["velocity"].std(), trace["current"].std()
    assert found == pytest.approx(BEFORE[preset], rel=1e-11)


# -- integration ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("tissue", "low", "high"),
    [
        (ATTACHED, -5.0, 8.0),
        (STRIPS["anterior", "vertical"], -3.0, 10.0),
        (STRIPS["anterior", "horizontal"], -3.0, 10.0),
        (LAYERED, -3.5, 10.5),
        (load_preset(DEFAULT).with_probe(PROBES["indenter-5mm"]), -3.5, 10.5),
        (LAYERED.with_probe(Probe(8e-3, 1e-3)), -3.5, 10.5),
    ],
    ids=["attached", "along", "across", "layered", "probe", "layered probe"],
)
def test_halving_the_step_changes_nothing(tissue, low, high):
    volts = force(low, high, 0.5) * VOLTS_PER_NEWTON
    coarse, fine = (Plant(PlantParameters(), tissue, substeps=k * SUBSTEPS).advance(volts) for k in (1, 2))
    for name in ("position", "velocity", "current"):
        error = coarse[name] - fine[name]
        rms, peak = error.std() / fine[name].std(), np.abs(error).max() / np.ptp(fine[name])
        print(f"{tissue.name}: {name} {rms:.1e} / {peak:.1e}")
        assert max(rms, peak) < 1e-4


@pytest.mark.parametrize("tissue", [ATTACHED, LAYERED, STRIPS["posterior", "vertical"]], ids=lambda t: t.name)
def test_the_tangent_is_the_slope_of_the_elastic_force(tissue):
    for depth in (-2e-3, -1e-3, 5e-4, 2e-3):
        slope = (tissue.elastic_force(depth + 1e-7) - tissue.elastic_force(depth - 1e-7)) / 2e-7
        assert tissue.tangent_stiffness(depth) == pytest.approx(slope, rel=1e-5)


@pytest.mark.parametrize("probe", ["indenter-4.3mm", "indenter-5mm"])
@pytest.mark.parametrize("preset", ["acrylamide-10", "acrylamide-20", "acrylamide-30", "latex"])
def test_the_stiffness_of_materials_is_a_sigmoid_of_depth_and_that_of_skin_is_not(preset, probe):
    depths = np.linspace(0.4e-3, 6e-3, 29)  # beyond the corner of the probe
    material, skin = (
        np.diff([tissue.with_probe(PROBES[probe]).tangent_stiffness(depth) for depth in depths])
        for tissue in (load_preset(preset), load_preset(DEFAULT))
    )
    assert np.all(material > 0.0)
    assert material[-1] < 0.35 * material.max()  # it levels off
    assert np.all(np.diff(skin) > 0.0)


# -- sliding ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lotion", [None, "chanel"])
@pytest.mark.parametrize("normal_n", [0.5, 1.0, 4.0])
def test_friction_is_dry_and_proportional_to_the_normal_preload(normal_n, lotion):
    """In a slow cycle the force on the way there and that on the way back differ by twice the friction."""
    scenario = load_scenario(
        None, preset="sliding-preloaded-skin", normal_preload_n=normal_n, lotion=lotion, tilt_deg=90.0
    )
    (friction,) = scenario.acting
    assert friction.level == pytest.approx((0.3 if lotion is None else 0.7 * 0.3) * normal_n)
    half = np.linspace(-6.0, 6.0, 6000)
    bench = scenario.bench()
    trace = bench.plant.advance(np.concatenate([np.linspace(0.0, -6.0, 3000), half, half[::-1]]) * VOLTS_PER_NEWTON)
    there, back = (trace[first : first + 6000] for first in (3000, 9000))
    middle = 0.5 * (there["position"].mean() + back["position"].mean())
    forces = [
        3.0 * np.interp(middle, *zip(*sorted(zip(w["position"], w["current"], strict=True)), strict=True))
        for w in (there, back)
    ]
    speed = np.ptp(there["position"]) / 3.0
    viscous = 2.0 * speed * (scenario.tissue.damping.coefficient + 3.5)
    assert forces[0] - forces[1] == pytest.approx(2.0 * friction.level + viscous, rel=0.02)


def test_without_a_normal_preload_nothing_rubs():
    scenario = load_scenario(None, preset="sliding-preloaded-skin")
    assert scenario.acting == ()
    assert scenario.tissue == load_preset("sliding-preloaded-skin")
    with pytest.raises(ValueError, match="a normal preload is for a tissue that has friction"):
        load_scenario(None, preset="sliding-forearm", normal_preload_n=1.0)


# -- attached tissue --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("distance", "ratio"), [(0.5e-3, 1.1), (1e-3, 1.4), (2e-3, 2.2), (2.5e-3, 3.0)])
def test_attached_tissue_stiffens_faster_when_pulled(distance, ratio):
    pushed, pulled = (local_values(ATTACHED, ATTACHED.surface_m + way * distance) for way in (1.0, -1.0))
    assert pulled["stiffness_n_per_m"] > ratio * pushed["stiffness_n_per_m"]
    assert ATTACHED.elastic_force(-distance) < 0.0


def test_attached_tissue_is_smooth_at_its_surface_and_never_left():
    assert ATTACHED.tangent_stiffness(-1e-9) == pytest.approx(ATTACHED.tangent_stiffness(1e-9), rel=1e-5)
    trace = Plant(PlantParameters(), ATTACHED).advance(force(-8.0, 8.0, 1.0) * VOLTS_PER_NEWTON)
    assert trace["touching"].min() == 1.0
    assert trace["position"].min() < ATTACHED.surface_m - 1e-3


@pytest.mark.parametrize("mean_n", [-4.0, -2.5, 1.5, 4.0])
def test_a_small_test_finds_both_sides_of_attached_tissue(mean_n):
    measured = record(ATTACHED, mean_n)
    report = get_engine("lms")().fit(measured).report
    truth = local_values(ATTACHED, float(measured.output.mean()))
    assert (measured.output.mean() < ATTACHED.surface_m) == (mean_n < 0.0)
    for name in ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"):
        assert report.parameters[name].value == pytest.approx(truth[name], rel=0.05), name


# -- extension --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("site", "stiff", "soft"), [("anterior", "vertical", "horizontal"), ("posterior", "horizontal", "vertical")]
)
def test_a_direction_is_preferred_at_high_force_only(site, stiff, soft):
    low, high = (stiffness_at(STRIPS[site, stiff], n) / stiffness_at(STRIPS[site, soft], n) for n in (0.5, 8.0))
    assert low == pytest.approx(1.0, abs=0.05)
    assert high > 1.3


def test_a_direction_between_lies_between():
    strip = STRIPS["anterior", "vertical"]
    stiffness = [stiffness_at(strip.stretched(angle), 6.0) for angle in (0.0, 30.0, 60.0, 90.0)]
    assert stiffness == sorted(stiffness, reverse=True)
    assert stiffness_at(strip.stretched(-30.0), 6.0) == stiffness[1]


@pytest.mark.parametrize("force_n", [0.5, 2.0, 4.0, 8.0])
def test_skin_is_stiffer_in_extension_and_latex_much_softer(force_n):
    skin = min(stiffness_at(strip, force_n) for strip in STRIPS.values())
    assert skin > max(stiffness_at(load_preset(f"left-{site}-forearm"), force_n) for site in ("anterior", "posterior"))
    lycra, latex = (stiffness_at(load_preset(f"extension-{name}"), force_n) for name in ("lycra", "latex"))
    assert skin > lycra > 3.0 * latex


def test_strain_and_not_displacement_counts():
    strip = STRIPS["anterior", "vertical"]
    longer = strip.stretched(length_m=0.020)
    assert longer.elastic_force(2e-3) == pytest.approx(strip.elastic_force(1e-3))
    assert longer.mass_at(0.0) == pytest.approx(2.0 * strip.mass_at(0.0))
    assert strip.stretched(length_m=0.010).to_array().tobytes() == strip.to_array().tobytes()


# -- layers -----------------------------------------------------------------------------------------------------


def compressions(force_n):
    return [
        layer.thickness_m * force_n / (layer.stiffness_n_per_m * layer.thickness_m + force_n)
        if layer.thickness_m
        else force_n / layer.stiffness_n_per_m
        for layer in LAYERED.layers
    ]


@pytest.mark.parametrize("force_n", [1e-3, 0.1, 1.0, 10.0, 100.0])
def test_the_compressions_of_the_layers_add_up(force_n):
    assert LAYERED.layer_values(sum(compressions(force_n)))[0] == pytest.approx(force_n, rel=1e-9)


def test_layers_bottom_out_in_order_of_softness():
    half = []
    for k, layer in enumerate(LAYERED.layers[:-1]):
        forces = np.geomspace(1e-3, 100.0, 400)
        share = np.array([compressions(f)[k] for f in forces]) / layer.thickness_m
        half.append(forces[np.argmax(share > 0.5)])
        assert share[-1] > 0.95
    assert np.argmin(half) == 1  # the fat, and not the dermis above it


def test_layers_recruit_springs_dampers_and_masses():
    depths = np.linspace(0.0, 7.5e-3, 40)
    values = np.array([LAYERED.layer_values(depth) for depth in depths])
    stiffness = np.array([LAYERED.tangent_stiffness(depth) for depth in depths])
    assert np.all(np.diff(stiffness) > 0.0)
    assert stiffness[-1] > 50.0 * stiffness[0]
    assert values[-1, 1] > 3.0 * values[0, 1]
    assert np.all(np.diff(values[:, 2]) > 0.0)
    assert values[-1, 2] > 0.3 * sum(layer.mass_kg for layer in LAYERED.layers)
    for depth in (1e-3, 4e-3, 7e-3):
        slope = (LAYERED.layer_values(depth + 1e-7)[2] - LAYERED.layer_values(depth - 1e-7)[2]) / 2e-7
        assert LAYERED.layer_values(depth)[3] == pytest.approx(slope, rel=1e-5)


def test_layers_without_losses_keep_their_energy():
    still = replace(
        LAYERED,
        extras=frozenset(),
        damping=replace(LAYERED.damping, coefficient=0.0),
        layers=tuple(replace(layer, damping_n_s_per_m=0.0) for layer in LAYERED.layers),
    )
    free = Plant(PlantParameters(gravity_force_n=0.0, bearing_damping_n_s_per_m=0.0), still)
    free.coil_open = True
    free.state[1] = still.surface_m + 4e-3
    trace = free.advance(np.zeros(2000))
    depth = trace["position"] - still.surface_m
    work = np.concatenate([[0.0], np.cumsum([still.elastic_force(y) for y in np.arange(-9e-3, 9e-3, 1e-6)])]) * 1e-6
    stored = np.interp(depth, np.arange(-9e-3, 9e-3 + 5e-7, 1e-6)[: work.size], work)
    mass = 0.060 + np.array([still.mass_at(y) for y in depth])
    energy = stored + 0.5 * mass * trace["velocity"] ** 2
    assert np.ptp(energy) < 2e-3 * np.ptp(stored)


@pytest.mark.parametrize(
    ("layers", "complaint"),
    [
        ((Layer(100.0),) * (MAX_LAYERS + 1), "at most 4 layers, not 5"),
        ((Layer(0.0),), "a positive stiffness"),
        ((Layer(100.0), Layer(200.0)), "needs a positive thickness"),
        ((Layer(100.0, thickness_m=1e-3),), "the last layer is the base"),
    ],
)
def test_layers_must_make_sense(layers, complaint):
    with pytest.raises(ValueError, match=complaint):
        replace(LAYERED, layers=layers)


# -- probes -----------------------------------------------------------------------------------------------------


def test_the_reference_probe_changes_nothing():
    for tissue in (load_preset(DEFAULT), LAYERED):
        assert tissue.with_probe(read_probe("indenter-4.4mm")) is tissue
    assert REFERENCE.factor(3e-3) == 1.0


@pytest.mark.parametrize("probe", [PROBES["indenter-4.3mm"], PROBES["indenter-5mm"], Probe(10e-3, 2e-3)])
def test_the_growing_contact_is_that_of_a_rounded_punch(probe):
    edge = 0.5 * probe.diameter_m
    for depth in np.geomspace(1e-5, 8e-3, 30):
        s = probe.corner_depth_m
        mean = edge - probe.corner_radius_m * s / (depth**1.5 + s**1.5) ** (2 / 3)
        assert mean == pytest.approx(probe.contact_integral(depth) / depth, rel=0.075)
    # The force on a half-space is 2 E* times this integral: its slope is the contact radius, between flat and edge.
    slope = (probe.contact_integral(1.01e-4) - probe.contact_integral(0.99e-4)) / 2e-6
    assert edge - probe.corner_radius_m < slope < edge


def test_stiffness_damping_and_mass_grow_with_the_probe():
    tissue = load_preset(DEFAULT)
    found = [local_values(tissue.with_probe(Probe(d)), 0.013)["coefficients"] for d in (3e-3, 4.4e-3, 6e-3, 8e-3)]
    for name in ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"):
        values = [one[name] for one in found]
        assert values == sorted(values)
    ratio = found[2]["stiffness_n_per_m"] / found[1]["stiffness_n_per_m"]
    assert 6 / 4.4 < ratio < (6 / 4.4) ** 2
    sharp, round_ = (tissue.with_probe(Probe(6e-3, corner)).elastic_force(5e-4) for corner in (0.0, 1.5e-3))
    assert round_ < 0.85 * sharp


def test_a_small_test_finds_the_values_under_another_probe():
    tissue = load_preset("acrylamide-20").with_probe(Probe(8e-3, 1e-3))
    measured = record(tissue, 3.0)
    report = get_engine("lms")().fit(measured).report
    truth = local_values(tissue, float(measured.output.mean()))
    for name in ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"):
        assert report.parameters[name].value == pytest.approx(truth[name], rel=0.03), name


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("stick", "one of indenter-4.4mm, indenter-4.3mm, indenter-5mm, or DIAMETER:CORNER in mm, not 'stick'"),
        ("0.5", "between 1 and 20 mm, not 0.5 mm"),
        ("nan", "between 1 and 20 mm, not nan mm"),
        ("5:3", "corner radius of a probe must be between 0 and 2.25 mm, not 3 mm"),
    ],
)
def test_an_impossible_probe_is_refused(text, complaint):
    with pytest.raises(ValueError, match="probe") as caught:
        read_probe(text)
    assert complaint in str(caught.value)


# -- lotions ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("lotion", "sign"), [("chanel", 1.0), ("vaseline", -1.0)])
def test_a_lotion_changes_the_stiffness_at_every_depth_and_nothing_else(lotion, sign):
    bare = load_preset("right-anterior-forearm")
    for tissue in (bare, LAYERED):
        for depth in (5e-4, 2e-3, 4e-3):
            was, now = (t.tangent_stiffness(depth) for t in (tissue, with_lotion(tissue, lotion)))
            assert sign * (now - was) > 0.0
    assert with_lotion(bare, lotion).damping == bare.damping
    assert with_lotion(bare, lotion).mass == bare.mass


@pytest.mark.parametrize("lotion", ["chanel", "vaseline"])
def test_along_the_surface_stiffness_and_damping_fall_and_the_spring_stays(lotion):
    bare = load_preset("sliding-preloaded-skin")
    smooth = with_lotion(bare, lotion)
    assert bare.external_spring_n_per_m < smooth.stiffness.coefficient < bare.stiffness.coefficient
    assert smooth.damping.coefficient < bare.damping.coefficient


# -- options ----------------------------------------------------------------------------------------------------


def test_the_options_reach_the_plant(capsys):
    def stiffness(*options):
        assert main([*options, "--local-values", "0.0115"]) == 0
        return json.loads(capsys.readouterr().out)["stiffness_n_per_m"]

    strip = ["--preset", "extension-anterior"]
    assert stiffness(*strip) == stiffness(*strip, "--orientation", "0") > stiffness(*strip, "--orientation", "90")
    assert stiffness(*strip) > stiffness(*strip, "--initial-length", "15")
    skin = ["--preset", "upper-arm"]
    assert stiffness(*skin, "--probe", "8") > stiffness(*skin, "--probe", "indenter-4.4mm") == stiffness(*skin)
    assert stiffness(*skin, "--lotion", "vaseline") < stiffness(*skin)
    bench = load_scenario(None, preset="upper-arm", probe="8:1", lotion="chanel").bench()
    assert bench.tissue == with_lotion(load_preset("upper-arm"), "chanel").with_probe(Probe(8e-3, 1e-3))


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"preset": "buna", "lotion": "chanel"}, "a lotion is for skin"),
        ({"preset": "sliding-forearm", "lotion": "chanel"}, "a lotion is for skin"),
        ({"lotion": "soap"}, "there is no lotion 'soap'; there are: chanel, vaseline"),
        ({"orientation_deg": 30.0}, "belong to tissues in extension"),
        ({"preset": "extension-anterior", "probe": "8"}, "a round probe is for indentation"),
        ({"preset": "wiener-demo", "probe": "8"}, "belong to the kinds linear and dpn"),
        ({"preset": "extension-anterior", "orientation_deg": 270.0}, "orientation_deg"),
    ],
)
def test_options_that_do_not_fit_the_preset_are_refused(options, complaint):
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the complaint is compared below
        load_scenario(None, **options)
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("preset", "old", "new", "complaint"),
    [
        ("forearm-attached", 'extras = ["relaxation"', 'extras = ["contact", "relaxation"', "it has no contact"),
        ("forearm-attached", "damping_rate_per_m", "dumping_rate_per_m", "pulled.damping_rate_per_m must be"),
        ("forearm-layered", "n_per_m = { value = 1500.0", "k = { value = 1500.0", "layers.0.n_per_m is missing"),
        ("forearm-layered", "[[layers]]", "[[layers]]\ncolour = 1", "unknown key layers.0.colour"),
        ("extension-anterior", "fibre_deg = { value = 0.0", 'fibre_deg = { value = "up"', "must be a number"),
    ],
)
def test_an_unsound_part_is_refused_in_one_line(preset, old, new, complaint):
    from importlib.resources import files

    text = (files("firmware_sim.presets") / f"{preset}.toml").read_text(encoding="utf-8")
    assert old in text
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the complaint is compared below
        parse_preset(preset, text.replace(old, new, 1))
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)


def test_effects_of_tissue_refuse_layers():
    from firmware_sim.effects import EFFECTS

    effect = EFFECTS["added_mass"].model_validate({"level": EFFECTS["added_mass"].typical})
    with pytest.raises(ValueError, match="without layers"):
        Bench(LAYERED, effects=[effect])
    Bench(ATTACHED, effects=[effect])
