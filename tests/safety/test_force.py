"""A probe that moves against a push is pushed harder than at standstill: the firmware foresees it, and lowers it."""

import numpy as np
import pytest
from safety.rigs import RATE, without_host
from support import LoopbackLink

from firmware_sim.bench import Bench
from firmware_sim.device_models import MODELS
from firmware_sim.firmware import Firmware
from firmware_sim.guard import Guard
from firmware_sim.identity import Identity
from tissueid.errors import TissueIDError
from tissueid.instrument import Limits, SerialInstrument
from tissueid.wire import Fault, Flag

TRIP = 1.05
"""A force above this share of its limit is a fault (docs/protocol.md, section 5)."""


class Squares:
    """Square waves at the force limit, on a device by its name, with the host's own judge switched off."""

    def __init__(self, monkeypatch, model, tissue, half_s, first, limit_n, coil="ideal"):
        without_host(monkeypatch)
        figures = MODELS[model].plant
        bench = Bench(tissue, seed=1, parameters=figures, frame_mass_kg=MODELS[model].frame_mass_kg, coil=coil)
        self.firmware = Firmware(bench, Identity(max_force_n=MODELS[model].max_force_n))
        link = LoopbackLink(self.firmware)
        instrument = SerialInstrument(link, clock=link.clock)
        level = limit_n * figures.resistance_ohm / figures.force_constant_n_per_a
        turns = np.arange(round(1.5 * RATE)) // round(half_s * RATE)
        self.asked_v = level * first * np.where(turns % 2, -1.0, 1.0)
        self._watch(bench)
        instrument.load(self.asked_v)
        instrument.arm(Limits(max_force_n=limit_n))
        run = instrument.start()
        blocks = []
        try:
            while not blocks or blocks[-1]["index"][-1] < run.end_index + 200:
                blocks.append(instrument.poll(0.05))
        except TissueIDError:
            pass
        samples = np.concatenate(blocks)
        self.samples = samples[(samples["index"] >= run.first_index) & (samples["index"] < run.end_index)]
        self.share = max(self._amperes) * figures.force_constant_n_per_a / limit_n
        """The greatest force of the plant itself, not as it is measured, over the limit."""

    def _watch(self, bench):
        self._amperes = []
        play, restore = bench.block, bench.restore

        def block(commands, energised):
            played = play(commands, energised)
            trace = seen.pop()
            self._amperes.append(float(np.abs(trace["current"]).max()) if energised else 0.0)
            return played

        def again(snapshot):
            self._amperes.pop()
            restore(snapshot)

        seen, advance = [], bench.plant.advance
        bench.plant.advance = lambda volts: seen.append(advance(volts)) or seen[-1]
        bench.block, bench.restore = block, again


WAVES = [
    # The worst of 672 waves of 1 to 50 ms on three tissues, of each device, and of either direction.
    ("desktop", "buna", 0.02, 1, 4.0),
    ("desktop", "buna", 0.02, -1, 4.0),
    ("desktop", "left-posterior-forearm", 0.02, 1, 12.0),
    ("desktop", "left-posterior-forearm", 0.01, -1, 12.0),
    ("handheld", "buna", 0.02, 1, 3.0),
    ("handheld", "left-posterior-forearm", 0.01, -1, 3.0),
]


@pytest.mark.parametrize("coil", ["ideal", "finite"])
@pytest.mark.parametrize(("model", "tissue", "half_s", "first", "limit_n"), WAVES)
def test_motion_against_the_push_does_not_raise_the_force_beyond_its_limit(
    monkeypatch, model, tissue, half_s, first, limit_n, coil
):
    waves = Squares(monkeypatch, model, tissue, half_s, first, limit_n, coil)
    assert waves.share < 1.025
    assert Fault.OVER_FORCE not in waves.firmware.faults


def test_without_foresight_the_same_waves_go_beyond_it(monkeypatch):
    monkeypatch.setattr(Guard, "with_reduced_force", lambda _self, command_v, *_: command_v)
    waves = Squares(monkeypatch, "desktop", "buna", 0.02, 1, 4.0)
    assert 1.1 < waves.share < 1.13
    assert waves.firmware.faults == Fault.OVER_FORCE


def test_what_was_lowered_is_marked_and_recorded_as_it_was_played(monkeypatch):
    waves = Squares(monkeypatch, "desktop", "buna", 0.02, 1, 4.0)
    assert waves.firmware.faults == Fault.NONE
    played, asked = waves.samples["command"], waves.asked_v
    limited = (waves.samples["flags"] & Flag.LIMITED) > 0
    softened = (waves.samples["flags"] & Flag.SOFT_START) > 0
    step_v = 60 / 32768
    assert 100 < limited.sum() < 1500
    assert np.all(np.abs(played[limited]) < np.abs(asked[limited]))
    assert np.all(np.abs(played[limited]) > 0.8 * np.abs(asked[limited]))
    assert np.all(np.sign(played[limited]) == np.sign(asked[limited])), "lowered, and not turned round"
    np.testing.assert_allclose(played[~limited & ~softened], asked[~limited & ~softened], atol=step_v)


def test_a_steady_push_at_the_limit_is_played_as_it_is(monkeypatch):
    waves = Squares(monkeypatch, "desktop", "left-posterior-forearm", 5.0, 1, 4.0)
    assert waves.firmware.faults == Fault.NONE
    assert not np.any(waves.samples["flags"][200:] & Flag.LIMITED)
    assert waves.share < 1.01


@pytest.mark.parametrize("position_m", [np.nan, np.inf, -1e300])
def test_nonsense_of_a_position_never_raises_a_command(position_m):
    bench = Bench("buna", seed=1)
    guard = Firmware(bench).guard
    guard.newest_m[:] = 0.01, 0.01, position_m
    command = np.linspace(-16.0, 16.0, 33)
    block = bench.block(command, energised=False)
    armed = type("Armed", (), {"max_force_n": 4.0})()
    with np.errstate(invalid="ignore", over="ignore"):
        lowered = guard.with_reduced_force(command, block, armed)
    assert np.all(np.abs(lowered) <= np.abs(command))
    assert np.all(lowered * command >= 0.0)
