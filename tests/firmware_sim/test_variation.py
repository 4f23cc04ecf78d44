"""Skin that varies between people, placings and tests: what is drawn, what it moves, and what stays as it was."""

import numpy as np
import pytest
from plant_support import VOLTS_PER_NEWTON
from support import connect_scenario

from firmware_sim.__main__ import main
from firmware_sim.bench import Bench
from firmware_sim.presets import load_preset
from firmware_sim.scenario import Scenario, load_scenario
from firmware_sim.variation import Variation, compressed_share
from tissueid.acquisition.stimulus_choice import usual_noise
from tissueid.identification import get_engine
from tissueid.instrument import CLINICAL
from tissueid.records import Record
from tissueid.stimuli.kinds.noise import Noise

SITES = ("skin-anterior", "skin-posterior", "skin-distal")
PRELOAD = 1000
CHANNELS = {channel.name: (k, channel) for k, channel in enumerate(Bench().channels)}


def guided(bench, **options):
    """Force and position of a guided test on a bench."""
    bench.begin_test()
    volts = VOLTS_PER_NEWTON * usual_noise(bench.sample_rate_hz, **options).values
    codes = bench.block(volts, energised=True).codes[PRELOAD:]
    current, position = (CHANNELS[name][1].decode(codes[:, CHANNELS[name][0]]) for name in ("current", "position"))
    return Record(3.0 * current, position, bench.sample_rate_hz)


def skin_parameters(record, surface_m):
    report = get_engine("wiener")(scaling=1000.0, surface_position_m=surface_m).fit(record).report
    return {name: value.value for name, value in report.parameters.items()}


# -- draws ------------------------------------------------------------------------------------------------------


def test_without_variation_nothing_changes():
    plain, switched_off = Bench("skin-posterior", seed=3), Bench("skin-posterior", seed=3, variation=Variation(3, 0.0))
    volts = 10.0 + 5.0 * np.sin(np.arange(400.0))
    for bench in (plain, switched_off):
        bench.begin_test()
        assert bench.tissue == load_preset("skin-posterior")
        assert not bench.effects
    assert np.array_equal(plain.block(volts, True).codes, switched_off.block(volts, True).codes)
    assert Scenario().bench().tissue == Bench().tissue


def test_a_run_has_the_same_noise_whenever_it_starts():
    """Check that a reproduction does not depend on the load of the computer."""
    codes = []
    for waited in (200, 740):
        bench = Bench("left-posterior-forearm", seed=3)
        runs = []
        for _ in range(2):
            bench.block(np.zeros(waited), energised=False)
            bench.begin_test()
            runs.append(
                bench.block(10.0 + 5.0 * np.sin(np.arange(400.0)), energised=True).codes[:, :4]
            )  # the coil cools
            bench.place_fixture(0.010)
        codes.append(runs)
    np.testing.assert_array_equal(*codes)
    assert not np.array_equal(*codes[0])


def test_draws_belong_to_their_seeds():
    preset = load_preset("skin-anterior")

    def met(seed=1, subject=None, placing=0, test=0, size=1.0):
        return Variation(seed, size, subject).tissue(preset, placing, test, 0.0)

    assert met() == met()
    others = [met(seed=2), met(subject=1), met(subject=2), met(placing=1), met(test=1), met(size=2.0)]
    assert len({tissue.to_array().tobytes() for tissue in [met(), *others]}) == 7
    alone = [met(seed=seed, subject=5, size=0.0) for seed in (1, 2)]
    assert alone[0] == alone[1] != preset


def test_people_keep_to_what_a_tissue_can_be():
    for site in SITES:
        preset = load_preset(site)
        for subject in range(40):
            met = Variation(subject, 1.0, subject).tissue(preset, 0, 1, 1.0)
            assert 0.0 < met.direction_ratio < 1.0
            assert met.stiffness.at(0.0) > 0.0
            assert met.recruited_mass_kg + 0.06 < 0.13


def test_variation_is_for_skin():
    with pytest.raises(ValueError, match="of kind wiener"):
        Bench("wiener-demo", variation=Variation())
    with pytest.raises(ValueError, match="between 0 and 3"):
        Variation(size=4.0)
    with pytest.raises(ValueError, match="variation and subject are for skin"):
        load_scenario(None, preset="linear-demo", subject=1)
    with pytest.raises(ValueError, match="variation"):
        load_scenario(None, variation=-1.0)


def test_the_command_takes_variation_and_subject(capsys):
    assert main(["--variation", "--subject", "3", "--coil-profile"]) == 0
    assert main(["--preset", "wiener-demo", "--variation", "--coil-profile"]) == 2
    assert "variation and subject are for skin" in capsys.readouterr().err


# -- compression ------------------------------------------------------------------------------------------------


def test_compression_comes_with_load_and_goes_with_rest():
    pressed = compressed_share(0.0, 4.5, 4.5)
    assert pressed > 0.9
    assert pressed > compressed_share(pressed, 0.0, 120.0) > 0.7
    assert compressed_share(pressed, 0.0, 3600.0) < 0.01


def test_layers_below_a_compressed_surface_stay_where_they_are():
    preset = load_preset("skin-posterior")
    variation = Variation(4, 1.0)
    before, after = (variation.tissue(preset, 0, 1, share) for share in (0.0, 1.0))
    sunk = after.surface_m - before.surface_m
    assert 0.05e-3 < sunk < 1e-3
    position = 0.017
    assert after.stiffness.at(position - after.surface_m) == pytest.approx(
        before.stiffness.at(position - before.surface_m)
    )
    assert after.damping.at(position - after.surface_m) < before.damping.at(position - before.surface_m)


def test_a_bench_is_compressed_by_its_first_test_only_and_recovers_where_it_is_placed_again():
    bench = Bench("skin-posterior", seed=2, variation=Variation(2))
    preset = load_preset("skin-posterior")
    surfaces = []
    for _ in range(3):
        bench.begin_test()
        surfaces.append(bench.tissue.surface_m)
        bench.block(np.full(9000, 20.0), energised=True)
    assert surfaces[1] - surfaces[0] > 0.1e-3
    assert abs(surfaces[2] - surfaces[1]) < 0.1e-3
    bench.place_fixture(preset.surface_m)
    assert bench.tissue == Variation(2).tissue(preset, 1, 0, 0.0)
    bench.place_fixture(None)
    bench.begin_test()
    assert bench.tissue.name == "free air"


def test_a_repeated_block_gives_the_same_codes_and_the_same_next_test():
    bench = Bench("skin-distal", seed=5, variation=Variation(5))
    bench.begin_test()
    before = bench.snapshot()
    first = bench.block(np.full(300, 20.0), energised=True)
    bench.restore(before)
    again = bench.block(np.full(300, 20.0), energised=True)
    assert np.array_equal(first.codes, again.codes)
    other = Bench("skin-distal", seed=5, variation=Variation(5))
    other.begin_test()
    other.block(np.full(300, 20.0), energised=True)
    for one in (bench, other):
        one.begin_test()
    assert bench.tissue == other.tissue


@pytest.mark.parametrize(("variation", "differs"), [(0.0, False), (1.0, True)])
def test_every_run_over_the_wire_meets_other_skin(variation, differs):
    found = []
    with connect_scenario(load_scenario(None, preset="skin-posterior", variation=variation)) as instrument:
        for _ in range(2):
            instrument.load(np.full(2000, 16.0))
            instrument.arm(CLINICAL)
            run = instrument.start()
            blocks = [instrument.poll(0.1)]
            while not blocks[-1].size or blocks[-1]["index"][-1] < run.end_index:
                blocks.append(instrument.poll(0.1))
            samples = np.concatenate(blocks)
            found.append(samples[samples["index"] < run.end_index]["position"][-200:].mean())
    assert (abs(found[1] - found[0]) > 10e-6) == differs


# -- what a study finds -----------------------------------------------------------------------------------------


def test_sites_differ_as_in_table_3_1():
    """Scaled mass and damping, C1, C2 and the VAFs of Chen 2010, Table 3.1, in the default guided test."""
    thesis = {
        "skin-anterior": (78.1, 82.6, 0.0194, 4.84, 7.42e-3, 0.191),
        "skin-posterior": (86.5, 89.1, 0.0259, 5.22, 9.77e-3, 0.154),
        "skin-distal": (76.1, 81.3, 0.0235, 7.00, 4.71e-3, 0.442),
    }
    rate = {}
    for site, (linear, wiener, *wanted) in thesis.items():
        record = guided(Bench(site, seed=1))
        assert record.output.min() > 0.012  # on the skin throughout
        fits = {name: get_engine(name)().fit(record).report.vaf_percent for name in ("lms", "wiener")}
        assert fits["lms"] == pytest.approx(linear, abs=5.0)
        assert fits["wiener"] == pytest.approx(wiener, abs=5.0)
        found = skin_parameters(record, 0.010)
        names = ("scaled_mass_s2", "scaled_damping_s", "c1_m", "c2_per_n")
        for name, value, factor in zip(names, wanted, (1.2, 1.25, 1.1, 1.75), strict=True):
            assert value / factor < found[name] < factor * value, (site, name)
        rate[site] = found["c2_per_n"]
    assert rate["skin-distal"] > 1.4 * rate["skin-anterior"] > 1.4 * rate["skin-posterior"]


def test_repeats_vary_and_the_first_test_differs():
    """Coefficients of variation of Table 7.1, and C1 of the later tests less that of the first (Fig. 7.4)."""
    table = {"damping_ratio": 0.044, "natural_frequency_rad_per_s": 0.013, "c1_m": 0.031, "c2_per_n": 0.093}
    spreads, shifts = [], []
    for seed in (1, 2):
        bench = Bench("skin-posterior", seed=seed, variation=Variation(seed, 1.0, seed))
        found = []
        for _ in range(4):
            record = guided(bench, seconds=2.0)
            found.append(skin_parameters(record, bench.tissue.surface_m))
            bench.block(np.zeros(1000), energised=False)
        values = np.array([[one[name] for name in table] for one in found])
        spreads.append(values.std(axis=0, ddof=1) / values.mean(axis=0))
        shifts.append(values[1:, 2].mean() - values[0, 2])
    for name, found, thesis in zip(table, np.mean(spreads, axis=0), table.values(), strict=True):
        # Two subjects: their mean is itself off by a third.
        assert thesis / 2.2 < found < 2.2 * thesis, name
    assert -1e-3 < np.mean(shifts) < 0.0


def test_a_lower_cutoff_raises_stiffness_by_depth_and_leaves_damping():
    """Depth partitions of two tests, 50 Hz at 500 Hz and 200 Hz at 2 kHz (Chen 2010, Fig. 5.10)."""
    profiles = []
    for rate, cutoff in ((2000.0, 200.0), (500.0, 50.0)):
        noise = Noise(seed=2, force_min_n=0.5, force_max_n=10.5, sample_rate=rate, cutoff_hz=cutoff).build().values
        preload = round(0.5 * rate)
        bench = Bench("skin-anterior-relaxing", seed=2, sample_rate_hz=rate)
        force = np.concatenate([np.full(preload, noise.mean()), noise])
        codes = bench.block(VOLTS_PER_NEWTON * force, energised=True).codes[preload:]
        current, position = (CHANNELS[name][1].decode(codes[:, CHANNELS[name][0]]) for name in ("current", "position"))
        profiles.append(get_engine("depth")(correct=False).fit(Record(3.0 * current, position, rate)).local)
    fast, slow = profiles
    depths = np.linspace(max(p.position.min() for p in profiles), min(p.position.max() for p in profiles), 5)

    def ratio(name):
        low, high = (np.interp(depths, p.position, getattr(p, name)) for p in (fast, slow))
        return float(np.exp(np.mean(np.log(high / low))))

    assert ratio("stiffness") > 1.05
    assert ratio("damping") == pytest.approx(1.0, abs=0.2)
