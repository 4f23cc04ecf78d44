"""Simulated instrument in this process: the digital twin behind the interface of a real device."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tissueid.device import SIMULATED_SERIAL, DeviceDescription
from tissueid.errors import InstrumentError, UnusableInputError
from tissueid.formatting import clean
from tissueid.instrument.host_played import BLOCK, HostPlayedInstrument
from tissueid.instrument.interface import stage_while_running
from tissueid.instrument.tissues import COMPRESSING_N, COMPRESSING_S, TISSUES, Effects, SimulatedTissue
from tissueid.instrument.twin_file import TwinFile, device_of
from tissueid.messages import Verbatim, joined
from tissueid.twin.catalogue import effect
from tissueid.twin.chain_parameters import InstrumentParameters
from tissueid.twin.player import Player
from tissueid.twin.simulation import ActiveEffect, Start, values_by_name

_NOISE = {"voltage": 2.0e-3, "current": 3.0e-4, "position": 5.0e-7}
"""Standard deviation of the sensor noise, SI: about one converter code."""

_COIL_C = 25.0
_OUT_OF_REACH_M = 1.0
"""Position of a surface that the probe never touches, m."""

_SHOWN = 80
"""Characters of a name that a message repeats."""

_SETTLING = 4000
"""Samples until the probe is at rest: 2 s."""

MODEL = "desktop indenter (in-process simulation)"

Wait = Callable[[float], object]
"""Function that waits for a number of seconds; it may return earlier."""


class SimulatedInstrument(HostPlayedInstrument):
    """The digital twin as an instrument. Every poll returns the next ``BLOCK`` samples.

    Polls do not wait, unless ``play_in_real_time`` was called.

    Args:
        tissue: name of a tissue under the nominal instrument (``TISSUES``), or a named twin with its effects.
        seed: of sensor noise and of the variation between tests; None: different every time.
        subject: number of the person under the probe; None: the person of the tissue.
        variation: size of the variation between tests, with a lasting compression by the first one; None: the
            variation of the tissue, without compression.

    Raises:
        UnusableInputError: the tissue is unknown, or a twin is to vary.
    """

    def __init__(
        self,
        tissue: str | SimulatedTissue | TwinFile = "forearm",
        *,
        seed: int | None = 0,
        subject: int | None = None,
        variation: float | None = None,
    ) -> None:
        if isinstance(tissue, str) and tissue not in TISSUES:
            raise UnusableInputError(
                "simulation.unknown_tissue",
                "no simulated tissue {name}; available: {known}",
                name=Verbatim(clean(tissue)[:_SHOWN]),
                known=joined(map(Verbatim, TISSUES)),
            )
        if isinstance(tissue, TwinFile) and (subject is not None or variation is not None):
            raise UnusableInputError("simulation.twin_varies", "a twin has no subject and no variation")
        self._random = np.random.default_rng(seed)
        self._varying: SimulatedTissue | None = None
        self._compressing = variation is not None
        self._pressed = 0
        self._placed_m = 0.0
        serial_number = f"{SIMULATED_SERIAL}{seed or 0}"
        if not isinstance(tissue, TwinFile):
            device = replace(DeviceDescription(), model=MODEL, serial_number=serial_number)
            self._varying = TISSUES[tissue] if isinstance(tissue, str) else tissue
            if subject is not None:
                self._varying = self._varying.of_subject(subject)
            if variation is not None:
                self._varying = self._varying.varied(variation)
            surface_m = self._placed_m = self._varying.placed(self._random)
            figures, effects = self._varying.drawn(self._random)
            player = Player(
                InstrumentParameters(),
                replace(figures, surface_m=surface_m),
                Start(0.0, surface_m),
                _acting(effects),
                sample_rate_hz=device.sample_rate_hz,
            )
        else:
            named = tissue.twin
            device = replace(device_of(tissue), serial_number=serial_number)
            player = Player(
                # The orientation in the session does not apply here: the simulated instrument points down.
                replace(named.instrument, weight_n=device.weight_n()),
                named.tissue,
                Start(0.0, named.tissue.surface_m),
                named.acting,
                sample_rate_hz=named.sample_rate_hz,
            )
        self._player = player
        super().__init__(device, winding=False, temperature_c=np.array([_COIL_C]))
        self._wait: Wait | None = None
        self._clock: Callable[[], float] = time.monotonic
        self._started_s = 0.0
        self._settle()

    def play_in_real_time(self, wait: Wait, clock: Callable[[], float] = time.monotonic) -> None:
        """Let each poll return at the time of its last sample, so that a person can follow a test.

        ``wait`` is called at each poll with the time by which its samples are early, s, 0 for late ones. ``clock``
        returns a monotonic time, s.
        """
        self._wait, self._clock = wait, clock
        self._started_s = clock() - self._index / self.device.sample_rate_hz

    def _run_begins(self) -> None:
        self._started_s = self._clock() - self._index / self.device.sample_rate_hz
        if self._varying is not None:
            figures, effects = self._varying.drawn(self._random)
            if self._compressing:
                pressed_s = self._pressed / self.nominal.sample_rate_hz
                share = 1.0 - math.exp(-pressed_s / COMPRESSING_S)
                figures, deeper_m = self._varying.compressed(figures, share)
                self._player.set_surface(self._placed_m + deeper_m)
            self._player.set_parameters(figures, _acting(effects))

    def _exchange(self, samples: NDArray[np.void]) -> None:
        signals = self._player.play(samples["command"])
        self._pressed += int(np.count_nonzero(self.nominal.force_constant_n_per_a * signals[1] > COMPRESSING_N))
        for name, values in zip(("voltage", "current", "position"), signals, strict=True):
            samples[name] = values + _NOISE[name] * self._random.standard_normal(BLOCK)
        samples["temperature"] = _COIL_C
        samples["acceleration_x"] = 9.81

    def poll(self, timeout_s: float) -> NDArray[np.void]:
        """Return the next block, shape (20,) of SAMPLE; in real time, wait for its last sample.

        Raises:
            LimitError, InstrumentError: a check of the samples failed; the coil is released.
        """
        samples = super().poll(timeout_s)
        if self._wait is not None:
            early = self._started_s + self._index / self.device.sample_rate_hz - self._clock()
            self._wait(max(0.0, early))
        return samples

    def move_stage(self, position_m: float | None) -> bool:
        """Move the surface under the probe to a position, m; None moves it out of reach. Return True.

        Raises:
            InstrumentError: a test is armed or running, or the position is outside the stroke.
        """
        if self.state.limits is not None:
            raise stage_while_running()
        stroke = self.device.stroke_m
        if position_m is not None and not 0.0 <= position_m <= stroke:
            raise InstrumentError(
                "instrument.stage_range",
                "the stage cannot move to {position:g} mm: positions are 0 to {stroke:g} mm",
                position=1e3 * position_m,
                stroke=1e3 * stroke,
            )
        self._placed_m = _OUT_OF_REACH_M if position_m is None else position_m
        self._pressed = 0
        self._player.set_surface(self._placed_m)
        self._settle()
        return True

    def _settle(self) -> None:
        """Let the probe come to rest on the tissue."""
        self._player.play(np.zeros(_SETTLING))


def _acting(effects: Effects) -> tuple[ActiveEffect, ...]:
    """Return effects by name as the player takes them."""
    return tuple(ActiveEffect(effect(name), values_by_name(effect(name), values)) for name, values in effects.items())
