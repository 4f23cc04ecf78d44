"""An instrument inside this process: the twin behind the same interface as a real device. No cable, no waiting."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tissueid.device import SIMULATED_SERIAL, DeviceDescription
from tissueid.errors import FirmwareFaultError, InstrumentError, TissueIDError, UnusableInputError
from tissueid.instrument.answers import describe_faults
from tissueid.instrument.correction import Corrections, check_corrections, corrected, most_cautious
from tissueid.instrument.interface import SAMPLE, SIGNALS, Gap, Observer, Run
from tissueid.instrument.judge import Judge
from tissueid.instrument.limits import Limits, check_command, check_limits, check_stimulus
from tissueid.instrument.playback import Playback
from tissueid.instrument.tissues import TISSUES, Effects, SimulatedTissue
from tissueid.instrument.twin_file import TwinFile, device_of
from tissueid.twin.catalogue import effect
from tissueid.twin.figures import Instrument
from tissueid.twin.player import Player
from tissueid.twin.simulation import Acting, Start, values_by_name
from tissueid.wire import Fault

BLOCK = 20
_NOISE = {"voltage": 2.0e-3, "current": 3.0e-4, "position": 5.0e-7}
"""Standard deviation of the sensor noise, SI: about one converter step."""

_COIL_C = 25.0
_OUT_OF_REACH_M = 1.0
"""Where a surface lies that the probe never meets."""

_SETTLING = 4000
"""Samples in which the probe comes to rest."""

MODEL = "desktop indenter (in-process simulation)"


class SimulatedInstrument:
    """The twin as an instrument: every poll delivers the next 20 samples at once.

    ``tissue`` is what the twin of the nominal instrument meets, or a twin out of a file, with the effects that it has.
    Sensor noise, and what differs from one test to the next, follow from ``seed``; with None they are new every time.

    Raises:
        UnusableInputError: no such tissue.
    """

    def __init__(self, tissue: str | TwinFile = "forearm", *, seed: int | None = 0) -> None:
        if isinstance(tissue, str) and tissue not in TISSUES:
            raise UnusableInputError(f"no simulated tissue {tissue!r}; there are: {', '.join(TISSUES)}")
        self._random = np.random.default_rng(seed)
        self._varying: SimulatedTissue | None = None
        serial_number = f"{SIMULATED_SERIAL}{seed or 0}"
        if isinstance(tissue, str):
            self.device = replace(DeviceDescription(), model=MODEL, serial_number=serial_number)
            self._varying = TISSUES[tissue]
            surface_m = self._varying.placed(self._random)
            figures, effects = self._varying.drawn(self._random)
            player = Player(
                Instrument(),
                replace(figures, surface_m=surface_m),
                Start(0.0, surface_m),
                _acting(effects),
                sample_rate_hz=self.device.sample_rate_hz,
            )
        else:
            named = tissue.twin
            self.device = replace(device_of(tissue), serial_number=serial_number)
            player = Player(
                # How it was held in the session is nothing of the instrument's: here it stands upright.
                replace(named.instrument, weight_n=self.device.weight_n()),
                named.tissue,
                Start(0.0, named.tissue.surface_m),
                named.acting,
                sample_rate_hz=named.sample_rate_hz,
            )
        self._player = player
        self.nominal = self.device
        self._judge = Judge(self.nominal, winding=False)
        self._corrections: Corrections = {}
        self.gaps: list[Gap] = []
        self.observer: Observer | None = None
        self._command = np.zeros(0)
        self._following = 0
        self._hold_v = 0.0
        self._playback = Playback(self._command, self.device.sample_rate_hz)
        self._limits: Limits | None = None
        self._run: Run | None = None
        self._index = 0
        self._energised = False
        self._settle()

    def use_calibration(self, device: DeviceDescription, corrections: Corrections) -> None:
        """From now on go by ``device``, and correct what is read.

        Raises:
            InstrumentError: a test is armed or running, or there is no such channel.
        """
        if self._limits is not None or self._run is not None:
            raise InstrumentError("a calibration is put in force between two tests, not while one runs")
        self._corrections = check_corrections(corrections, SIGNALS)
        self.device = device

    def load(self, command_v: NDArray[np.float64]) -> None:
        """Take a stimulus, shape (n,), V."""
        self._command = np.asarray(command_v, np.float64)
        self._following = 0

    @property
    def late_blocks(self) -> int:
        """Blocks of set-points of the newest run that came after their time."""
        return self._playback.late_blocks

    @property
    def held_samples(self) -> int:
        """Samples of the newest run whose set-point was missing."""
        return self._playback.held_samples

    @property
    def setpoint_margin_s(self) -> float | None:
        """None: there is no cable that a block could be late on."""
        return None

    def follow(self, samples: int, hold_v: float) -> None:
        """While the next run goes on, ``samples`` set-points will be sent after what was loaded.

        Raises:
            InstrumentError: nothing is loaded.
        """
        if not self._command.size:
            raise InstrumentError("load what comes before the set-points first")
        self._following, self._hold_v = samples, hold_v

    def send(self, offset: int, command_v: NDArray[np.float64]) -> None:
        """Set-points, shape (k,), V, for the run's samples from ``offset`` on.

        Raises:
            LimitError: they would break a limit.
            InstrumentError: nobody asked for these.
        """
        end = offset + command_v.size
        if self._limits is None or not self._playback.first <= offset < end <= self._playback.planned:
            raise InstrumentError(f"set-points {offset} to {end} are none that were asked for: follow and arm first")
        for figures in most_cautious(self.nominal, self.device):
            check_command(command_v, figures, self._limits)
        self._playback.take(offset, command_v)

    def narrowed(self, limits: Limits) -> Limits:
        """These limits: it has none of its own."""
        return limits

    def arm(self, limits: Limits) -> None:
        """Agree on the limits.

        Raises:
            LimitError: the stimulus would break them.
        """
        check_limits(limits, self.nominal)
        for figures in most_cautious(self.nominal, self.device):
            check_stimulus(self._command, figures, limits, self._following)
            if self._following:
                check_command(np.array([self._hold_v]), figures, limits)
        self._judge.arm(np.array([_COIL_C]), limits)
        self._limits = limits
        self._playback = Playback(self._command, self.device.sample_rate_hz, self._following, self._hold_v)
        self._following = 0
        self._energised = False

    def start(self) -> Run:
        """Play the stimulus from the next poll on.

        Raises:
            InstrumentError: not armed.
        """
        if self._limits is None:
            raise InstrumentError("load and arm before starting")
        self._run = Run(self._index, self._playback.planned)
        self._energised = True
        if self._varying is not None:
            figures, effects = self._varying.drawn(self._random)
            self._player.vary(figures, _acting(effects))
        return self._run

    def poll(self, timeout_s: float) -> NDArray[np.void]:
        """The next block, shape (20,) of SAMPLE, without waiting.

        Raises:
            LimitError, InstrumentError: a limit was broken, or the samples cannot be; the coil is released.
        """
        del timeout_s
        samples = np.zeros(BLOCK, SAMPLE)
        samples["index"] = self._index + np.arange(BLOCK)
        if self._energised:
            samples["command"], samples["flags"] = self._playback.block(BLOCK)
            self._energised = not self._playback.over
        signals = self._player.play(samples["command"])
        for name, values in zip(("voltage", "current", "position"), signals, strict=True):
            samples[name] = values + _NOISE[name] * self._random.standard_normal(BLOCK)
        samples["temperature"] = _COIL_C
        samples["acceleration_x"] = 9.81
        self._index += BLOCK
        read, samples = samples, corrected(samples, self._corrections)
        if self._limits is not None and self._run is not None:
            try:
                calibrated = None if self.device is self.nominal else (samples, self.device)
                self._judge.take(read, self._limits, self._run, calibrated)
            except TissueIDError:
                self.release()
                raise
            if self._playback.starved:
                self.release()
                raise FirmwareFaultError(f"the instrument released the coil: {describe_faults(Fault.STARVED)}")
            if self._index >= self._run.end_index:
                self._run = None
                self._limits = None
        if self.observer is not None:
            self.observer(samples)
        return samples

    def finish(self) -> int:
        """End the run here by its soft release; returns how many of its samples were played."""
        played = self._playback.finish()
        if self._run is None:
            self._limits = None
        else:
            self._run = Run(self._run.first_index, played)
        return played

    def move_stage(self, position_m: float | None) -> bool:
        """Move what lies under the probe along the stroke, m; None takes it out of reach. True: it is there.

        Raises:
            InstrumentError: a test is armed or running, or the position lies outside the stroke.
        """
        if self._limits is not None or self._run is not None:
            raise InstrumentError("the stage moves only while the coil is free: end the test first")
        stroke = self.device.stroke_m
        if position_m is not None and not 0.0 <= position_m <= stroke:
            raise InstrumentError(f"the stage cannot go there: positions are 0 to {stroke * 1e3:g} mm")
        self._player.meet(_OUT_OF_REACH_M if position_m is None else position_m)
        self._settle()
        return True

    def _settle(self) -> None:
        """Let the probe come to rest on the tissue, as a clinician would before looking at the screen."""
        self._player.play(np.zeros(_SETTLING))

    def release(self) -> None:
        """Free the coil: from the next sample on the command is zero."""
        self._run = None
        self._limits = None
        self._energised = False

    def close(self) -> None:
        """Release."""
        self.release()


def _acting(effects: Effects) -> tuple[Acting, ...]:
    """Effects by name as the chain takes them."""
    return tuple(Acting(effect(name), values_by_name(effect(name), values)) for name, values in effects.items())
