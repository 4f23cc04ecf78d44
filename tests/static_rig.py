"""An instrument on the simulated bench that is not what it says of itself, and a person who does what is asked."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

from support import LoopbackLink

from firmware_sim.bench import Bench
from firmware_sim.converters import ChannelError
from firmware_sim.firmware import Firmware
from firmware_sim.identity import Identity
from firmware_sim.plant import STANDARD_GRAVITY, Plant, PlantParameters
from tissueid.instrument import SerialInstrument

MASS_KG = 0.063
TRUTH = PlantParameters(
    resistance_ohm=12.31,
    force_constant_n_per_a=2.93,
    moving_mass_kg=MASS_KG,
    gravity_force_n=MASS_KG * STANDARD_GRAVITY,
    ambient_degc=21.0,
)
ERRORS = {
    "current": ChannelError(0.012, 0.010),
    "voltage": ChannelError(-0.006, 0.020),
    "position": ChannelError(0.008, 150e-6),
    "temperature": ChannelError(0.0, 1.5),
    "accelerometer_x": ChannelError(0.03, 0.2),
}
EXPECTED = {
    # In what the channels call a volt and an ampere.
    "coil_resistance_ohm": 12.31 * 0.994 / 1.012,
    "force_constant_n_per_a": 2.93 / 1.012,
    "voltage_gain": 0.994,
    "position_gain": 1.008,
}


class PatientLink(LoopbackLink):
    """A loopback on which something can be moved between two ticks of the clock, by any caller."""

    def __init__(self, firmware: Firmware) -> None:
        super().__init__(firmware)
        self.to_do: list[Callable[[], None]] = []

    def tick(self) -> None:
        while self.to_do:
            self.to_do.pop(0)()
        super().tick()


def rig(seed: int = 1, *, stage: bool = True, errors: dict[str, ChannelError] | None = None, **bench: object):
    """A driver on the bench; its link is ``instrument.link``."""
    made = Bench(
        "calibration-spring",
        seed=seed,
        **{"parameters": TRUTH, "nominal": PlantParameters(), **bench},
        channel_errors=ERRORS if errors is None else errors,
    )
    link = PatientLink(Firmware(made, Identity(stage=stage), seed=seed))
    return SerialInstrument(link, clock=link.clock)


class Person:
    """Does on the bench what is asked for, and remembers it."""

    def __init__(self, instrument: SerialInstrument) -> None:
        self.asked: list[str] = []
        self._link = instrument.link
        self._bench = instrument.link.firmware.bench
        self._weight_n = self._bench.parameters.gravity_force_n

    def __call__(self, words: str) -> None:
        self.asked.append(words)
        self._link.to_do.append(lambda: self._do(words))
        while self._link.to_do:
            pass

    def _do(self, words: str) -> None:
        if "spring" in words:
            self._bench.place_fixture(0.016)
        elif "everything away" in words:
            self._bench.place_fixture(None)
        elif found := re.search(r"gauge block of ([\d.]+) mm", words):
            self._bench.place_fixture(0.030 - 1e-3 * float(found[1]))
        elif found := re.search(r"weight of ([\d.]+) g", words):
            self._pull(self._weight_n + 1e-3 * float(found[1]) * STANDARD_GRAVITY)
        elif "weight off" in words:
            self._pull(self._weight_n)
        elif "Turn" in words:
            self._bench.along = -1.0 if "over" in words else 1.0
            self._pull(self._weight_n * self._bench.along)

    def _pull(self, newtons: float) -> None:
        bench = self._bench
        bench.parameters = replace(bench.parameters, gravity_force_n=newtons)
        bench.plant = Plant(
            bench.parameters,
            bench.tissue,
            sample_rate_hz=bench.sample_rate_hz,
            substeps=bench.substeps,
            coil=bench.coil,
        )
