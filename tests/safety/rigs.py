"""A host and a firmware on a virtual cable, either of them with its safety switched off."""

import numpy as np
import pytest
from support import LoopbackLink

from firmware_sim.bench import Bench
from firmware_sim.firmware import WATCHDOG_S, Firmware
from firmware_sim.guard import Guard
from firmware_sim.kernel import TEMPERATURE
from tissueid.errors import TissueIDError
from tissueid.instrument import Limits, SerialInstrument
from tissueid.instrument.sample_monitor import SampleMonitor
from tissueid.wire import Fault, Flag

RATE = 2000
WIDE = Limits(max_force_n=14.9, max_temperature_c=84.0, max_seconds=60.0)
"""As far as the device goes, so that only what a test is about ends it."""


def rig(bench: Bench | None = None, *, watchdog_s: float = WATCHDOG_S) -> SerialInstrument:
    """A driver on a simulated firmware; its link is ``instrument.link``."""
    link = LoopbackLink(Firmware(bench or Bench(seed=1)))
    instrument = SerialInstrument(link, clock=link.clock)
    link.firmware.watchdog_s = watchdog_s  # which a handshake may not say
    return instrument


def without_host(monkeypatch: pytest.MonkeyPatch) -> None:
    """A host that checks nothing, neither before sending nor on what arrives."""
    for name in (
        "run_machine.check_stimulus",
        "run_machine.check_command",
        "run_machine.check_limits",
        "sample_monitor.SampleMonitor.check",
    ):
        monkeypatch.setattr(f"tissueid.instrument.{name}", lambda *_: None)
    monkeypatch.setattr(SampleMonitor, "arm", lambda *_: None)


def without_firmware(monkeypatch: pytest.MonkeyPatch) -> None:
    """A firmware that agrees to any limits and trips on none. Its watchdog is switched off by ``watchdog_s``."""
    monkeypatch.setattr(Guard, "judge", lambda *_: (0, Fault.NONE))
    for name in ("within", "permits"):
        monkeypatch.setattr(f"firmware_sim.limits.ArmedLimits.{name}", lambda *_: True)


def volts(value: float, seconds: float) -> np.ndarray:
    """A level, with a rise of a quarter of a second before it."""
    level = np.full(round(seconds * RATE), float(value))
    rise = np.minimum(np.arange(level.size) / (0.25 * RATE), 1.0)
    return level * rise


def shaken(seconds: float, mean_v: float = 12.0, seed: int = 3) -> np.ndarray:
    """A push that changes all the time, up to some 20 Hz."""
    noise = np.convolve(np.random.default_rng(seed).standard_normal(round(seconds * RATE)), np.ones(50) / 7.0, "same")
    return np.clip(mean_v + 4.0 * noise, 0.0, 2 * mean_v) * np.minimum(np.arange(noise.size) / 500, 1.0)


def run_until_it_ends(instrument, command, limits=WIDE, upset=None, after=1500):
    """Play until something ends it: the samples, the sample at which ``upset`` happened, and the error."""
    bench = instrument.link.firmware.bench
    instrument.load(command)
    instrument.arm(limits)
    run = instrument.start()
    blocks, onset = [], None
    with pytest.raises(TissueIDError) as caught:
        while not blocks or blocks[-1]["index"][-1] < run.first_index + command.size + 400:
            if upset is not None and onset is None and blocks and blocks[-1]["index"][-1] - run.first_index > after:
                upset(bench)
                onset = instrument.link.firmware.sample_index
            if (samples := instrument.poll(0.05)).size:
                blocks.append(samples)
    samples = np.concatenate(blocks)
    return samples[samples["index"] >= run.first_index], onset, caught.value


def last_energised(samples: np.ndarray) -> int:
    """The index of the last sample with the amplifier enabled."""
    return int(samples["index"][(samples["flags"] & Flag.ENERGISED) > 0][-1])


def true_winding_c(instrument: SerialInstrument) -> float:
    """Return the true temperature of the winding, whatever its sensor reads."""
    return float(instrument.link.firmware.bench.plant.state[TEMPERATURE])
