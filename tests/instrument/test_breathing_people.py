"""Breathing adds to the record of a simulated person and changes no identified parameter, in both simulations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from firmware_sim.bench import Bench
from firmware_sim.variation import Variation
from tissueid.acquisition.guided import place, play
from tissueid.acquisition.stimulus_choice import usual_noise
from tissueid.identification import get_engine
from tissueid.instrument import CLINICAL, SimulatedInstrument, join_blocks, open_instrument
from tissueid.instrument.tissues import TISSUES
from tissueid.records import Record
from tissueid.twin.catalogue import effect
from tissueid.twin.chain_parameters import InstrumentParameters
from tissueid.twin.player import Player
from tissueid.twin.simulation import ActiveEffect, Start, values_by_name

VOLTS = 4.0 * usual_noise(2000.0).values
PRELOAD = 1000


def acting_of(effects):
    return [ActiveEffect(effect(name), values_by_name(effect(name), values)) for name, values in effects.items()]


def of_process(variation):
    """Return the second test of a simulated forearm: force (N) and position (m)."""
    instrument = open_instrument(
        "simulated://forearm?seed=0" + ("" if variation is None else f"&variation={variation}")
    )
    for _ in range(2):
        place(instrument)
        blocks = []
        play(instrument, VOLTS, CLINICAL, on_samples=lambda samples, _, kept=blocks: kept.append(samples))
    samples = join_blocks(blocks)[PRELOAD : VOLTS.size]
    return Record(3.0 * samples["current"], samples["position"], 2000.0)


def of_firmware(variation):
    """Return a test of the independent simulation."""
    bench = Bench("left-posterior-forearm", seed=1, variation=variation and Variation(1, variation))
    bench.begin_test()
    codes = bench.block(VOLTS, energised=True).codes[PRELOAD:]
    values = {channel.name: channel.decode(codes[:, k]) for k, channel in enumerate(bench.channels)}
    return Record(3.0 * values["current"], values["position"], 2000.0)


@pytest.mark.parametrize("simulation", [of_process, of_firmware], ids=["process", "firmware"])
def test_breathing_does_not_change_the_mass(simulation):
    without, breathing = simulation(None), simulation(1.0)
    for engine, lost in (("lms", 12.0), ("dpn", 12.0), ("wiener", 12.0)):
        plain, found = (get_engine(engine)().fit(record).report for record in (without, breathing))
        for name, tolerance in (
            ("mass_kg", 0.13 if engine == "wiener" else 0.03),
            ("natural_frequency_rad_per_s", 0.03),
        ):
            expected = plain.parameters[name].value
            assert found.parameters[name].value == pytest.approx(expected, rel=tolerance), (engine, name)
        assert plain.vaf_percent - lost < found.vaf_percent < plain.vaf_percent
        if engine == "wiener":
            assert found.parameters["c3_n"].value == pytest.approx(plain.parameters["c3_n"].value, abs=1.5)


@pytest.mark.parametrize("amplitude", [1e-6, 1e-5, 1e-4])
def test_a_little_breathing_changes_the_mass_a_little(amplitude):
    """Check that the identified mass is continuous in the amplitude of breathing: at most 2 % at 0.1 mm."""
    masses = []
    for breath_m in (0.0, amplitude):
        still = replace(TISSUES["forearm"], breath_m=breath_m, compression_m=0.0)
        instrument = SimulatedInstrument(replace(still.varied(1.0), variation=TISSUES["baseline"].variation), seed=0)
        place(instrument)
        blocks = []
        play(instrument, VOLTS, CLINICAL, on_samples=lambda samples, _, kept=blocks: kept.append(samples))
        samples = join_blocks(blocks)[PRELOAD : VOLTS.size]
        report = get_engine("lms")().fit(Record(3.0 * samples["current"], samples["position"], 2000.0)).report
        masses.append(report.parameters["mass_kg"].value)
    assert abs(masses[1] / masses[0] - 1.0) < 3e-3 + 200.0 * amplitude


def test_the_motion_of_the_next_test_does_not_hit_the_probe():
    """Check that the probe stays on the skin where a simulated instrument draws another breath."""
    simulated = TISSUES["anterior-forearm"].varied(1.0)
    random = np.random.default_rng(1)
    _, effects = simulated.drawn(random)
    surface_m = simulated.tissue.surface_m
    under_way = Player(
        InstrumentParameters(), simulated.tissue, Start(0.0, surface_m), acting_of(effects), sample_rate_hz=2000.0
    )
    under_way.play(np.zeros(4000))
    for _ in range(10):
        _, effects = simulated.drawn(random)
        before = under_way.state.position_m
        under_way.set_parameters(simulated.tissue, acting_of(effects))
        _, _, position = under_way.play(np.zeros(2000))
        assert np.abs(position - before).max() < 4.0 * simulated.breath_m
