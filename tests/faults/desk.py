"""A desk with a simulated instrument that things befall, in a time of its own; and what really happened there."""

from __future__ import annotations

import errno
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from support import SAMPLES_PER_TICK, TICK_S, LoopbackLink

from firmware_sim.bench import Bench, Block
from firmware_sim.faults import ActiveFault, FaultInjector, PlannedFault
from firmware_sim.firmware import Firmware
from tissueid import wire
from tissueid.acquisition import SessionRecorder, guided, recover
from tissueid.errors import LinkLostError
from tissueid.instrument import SIGNALS, Limits, Run, SerialInstrument
from tissueid.instrument.link import broken_error, open_error
from tissueid.sessions import Session
from tissueid.wire import MessageType, State

Array = NDArray[np.float64]

LIMITS = Limits(max_force_n=8.0, min_position_m=0.002, max_position_m=0.03, max_temperature_c=80.0, max_seconds=12.0)
TRIP_MARGIN = 1.05
"""Force trips are set this far above the limit (docs/protocol.md, section 5)."""

LONGEST_WAIT_S = 2.0


class TruthBench(Bench):
    """A bench that keeps what really happened: the state of the plant as well as the codes, sample by sample."""

    firmware: Firmware

    def __init__(self, preset: str, seed: int) -> None:
        self._taken: list[tuple[int, int, bool, NDArray[np.void], Block]] = []
        self._agreed: list[dict[str, Any]] = []
        self.agreed: dict[str, Any] = {}
        super().__init__(preset, seed=seed)

    def block(self, commands_volts: Array, energised: bool) -> Block:
        traces: list[NDArray[np.void]] = []
        advance = self.plant.advance

        def watched(volts: Array) -> NDArray[np.void]:
            traces.append(advance(volts))
            return traces[-1]

        with patch.object(self.plant, "advance", watched):
            block = super().block(commands_volts, energised)
        self._agreed.append(self.agreed)
        self._taken.append((self.firmware.boot_id, self.firmware.sample_index, energised, traces[0], block))
        return block

    def restore(self, snapshot: Any) -> None:
        """What is played again did not happen."""
        super().restore(snapshot)
        self._taken.pop()
        self._agreed.pop()

    @property
    def samples(self) -> int:
        """How many have been taken, resets or not."""
        return sum(item[3].size for item in self._taken)

    def energised(self, first: int = 0) -> NDArray[np.bool_]:
        """Whether the amplifier was enabled, for the samples from ``first`` on, shape (n,)."""
        flags = [np.full(trace.size, energised) for _, _, energised, trace, _ in self._taken]
        return np.concatenate(flags)[first:]

    def truth(self, name: str) -> Array:
        """What an ideal observer saw, shape (n,)."""
        return np.concatenate([trace[name] for *_, trace, _ in self._taken])

    def limit(self, name: str) -> Array:
        """What was agreed on when each sample was taken, as ARM named it, shape (n,); NaN before anything was."""
        sizes = [trace.size for *_, trace, _ in self._taken]
        return np.repeat([float(agreed.get(name, np.nan)) for agreed in self._agreed], sizes)

    def codes(self, boot_id: int, first_index: int, count: int) -> NDArray[np.int16]:
        """What the converters gave after that start, shape (k, channels); k is less where it did not last so long."""
        blocks = [(index, block.codes) for boot, index, _, _, block in self._taken if boot == boot_id]
        inside = [
            codes[max(0, first_index - index) : max(0, first_index + count - index)]
            for index, codes in blocks
            if index < first_index + count and index + codes.shape[0] > first_index
        ]
        return np.concatenate([*inside, np.zeros((0, len(self.channels)), np.int16)])


class FaultyLink(LoopbackLink):
    """A loopback link through which faults happen. ``moments`` are looked at after everything that the device does.

    ``sent`` counts what the host has sent by its type, ``running`` the samples of a run so far.
    """

    def __init__(self, firmware: Firmware, seed: int) -> None:
        super().__init__(firmware)
        self.faults = FaultInjector(firmware, self, seed=seed)
        self.to_host, self.to_device = self.faults.line.to_host, self.faults.line.to_device
        self.moments: list[tuple[Callable[[FaultyLink], bool], Callable[[], None]]] = []
        self.heard_s = self.longest_wait_s = 0.0
        self._owed = 0.0
        self.sent: Counter[int] = Counter()
        self.running = 0
        self._heard, self._said = wire.FrameDecoder(), wire.FrameDecoder()
        self.answered: dict[bytes, None] = {}

    def read(self, timeout_s: float) -> bytes:
        try:
            data = super().read(timeout_s)
        except LinkLostError as error:
            raise broken_error(self.name, OSError(errno.ENODEV, "")) from error
        for frame in self._heard.feed(data):
            # An answer that the host had not heard before gets it further; what else comes may not.
            if frame.type in (MessageType.ACK, MessageType.HELLO_ACK) and frame.payload not in self.answered:
                self.answered[frame.payload] = None
                self.progress()
        return data

    def tick(self) -> None:
        self.now += TICK_S
        self._owed += SAMPLES_PER_TICK * self.faults.clock_rate
        samples, self._owed = int(self._owed), self._owed % 1.0
        self.firmware.advance(samples, self.now)
        self.faults.advance(samples, self.now)
        self.running = self.running + samples if self.firmware.state is State.RUNNING else 0
        self.longest_wait_s = max(self.longest_wait_s, self.now - self.heard_s)
        self._look()

    def write(self, data: bytes) -> None:
        if not self.plugged:
            raise broken_error(self.name, OSError(errno.ENODEV, ""))
        super().write(data)
        for frame in self._said.feed(data):
            self.sent[frame.type] += 1
            if frame.type == MessageType.ARM:
                self.firmware.bench.agreed = wire.unpack(wire.ARM, frame.payload)[0]
        self.faults.start_due(self.now)
        self._look()

    def unplug(self) -> None:
        self.plugged = False

    def replug(self) -> None:
        self.plugged = True

    def progress(self) -> None:
        """The host got somewhere, or gave up with an error."""
        self.heard_s = self.now

    def run_for(self, seconds: float) -> None:
        """Nothing is awaited during this time."""
        before = self.longest_wait_s
        super().run_for(seconds)
        self.longest_wait_s = before
        self.progress()

    def _look(self) -> None:
        for item in [item for item in self.moments if item[0](self)]:
            self.moments.remove(item)
            item[1]()


class WatchedInstrument(SerialInstrument):
    """The driver itself; whatever gets it further is noted by its link."""

    def __init__(self, link: FaultyLink) -> None:
        link.progress()
        super().__init__(link, clock=link.clock)

    def poll(self, timeout_s: float) -> NDArray[np.void]:
        samples = super().poll(timeout_s)
        if samples.size:
            self.link.progress()
        return samples


class WatchedRecorder(SessionRecorder):
    """A recorder that remembers what it was given: of each test its run, the device's start, and the samples."""

    firmware: Firmware

    def begin_test(self, run: Run, **attributes: Any) -> int:
        number = super().begin_test(run, **attributes)
        self.given = getattr(self, "given", {})
        self.given[number] = Given(run, self.firmware.boot_id)
        return number

    def add(self, samples: NDArray[np.void]) -> None:
        super().add(samples)
        self.given[self.tests_begun].blocks.append(samples.copy())


@dataclass
class Given:
    """What a recorder was given of one test."""

    run: Run
    boot_id: int
    blocks: list[NDArray[np.void]] = field(default_factory=list)


class Desk:
    """One instrument, its cable, and whatever befalls them. Everything follows from the seed."""

    def __init__(self, seed: int = 0, preset: str = "left-posterior-forearm") -> None:
        self.bench = TruthBench(preset, seed)
        self.firmware = self.bench.firmware = Firmware(self.bench, seed=seed)
        self.link = FaultyLink(self.firmware, seed)
        self.begun: int | None = None
        """How many samples had been taken when the newest fault began."""

    def open(self) -> WatchedInstrument:
        """Open the instrument again.

        Raises:
            InstrumentError: it is not there.
        """
        if not self.link.plugged:
            raise open_error(self.link.name, OSError(errno.ENOENT, ""))
        self.link.answered.clear()
        return WatchedInstrument(self.link)

    def recorder(self, path: Path, instrument: SerialInstrument) -> WatchedRecorder:
        """A recorder for a sitting."""
        recorder = WatchedRecorder(path, instrument.device)
        recorder.firmware, recorder.given = self.firmware, {}
        return recorder

    def befall(self, fault: PlannedFault) -> ActiveFault:
        """A fault, now."""
        self.begun = self.bench.samples
        return self.link.faults.begin(fault, self.link.now)

    def befall_when(self, moment: Callable[[FaultyLink], bool], fault: PlannedFault) -> None:
        """A fault as soon as the device is there, with what is sent from now on."""
        self.link.sent.clear()
        self.link.moments.append((moment, lambda: void(self.befall(fault))))

    def settle(self, seconds: float = 1.5) -> None:
        """Let time pass without requests to the device."""
        self.link.run_for(seconds)

    def energised_since(self, first: int, last: int | None = None) -> float:
        """For how long the coil was energised from the sample ``first`` on, s."""
        return float(np.count_nonzero(self.bench.energised(first)[: None if last is None else last - first]) / 2000.0)

    def beyond_limits(self) -> list[str]:
        """Where the coil was energised although the plant was beyond what was agreed on for more than one sample."""
        bench, energised = self.bench, self.bench.energised()
        force = np.abs(bench.truth("current")) * bench.parameters.force_constant_n_per_a
        position, temperature = bench.truth("position"), bench.truth("temperature")
        within = {
            "force": force <= TRIP_MARGIN * bench.limit("max_force_n"),
            "position": (position >= bench.limit("min_position_m")) & (position <= bench.limit("max_position_m")),
            "temperature": temperature <= bench.limit("max_temperature_c"),
        }
        found = []
        for name, fine in within.items():
            # The sample that breaks a limit is seen before the next: two in a row are one too many.
            bad = ~fine[1:] & ~fine[:-1] & energised[1:] & energised[:-1]
            if bad.any():
                found.append(f"{name} for {np.count_nonzero(bad)} samples from {int(np.argmax(bad))} on")
        return found

    def invented(self, recorder: WatchedRecorder, session: Session) -> list[str]:
        """What of a session was not given to the recorder, or was not measured; and what was given and is not in it."""
        found = []
        channels = self.bench.channels
        for number, given in recorder.given.items():
            samples = np.concatenate([*given.blocks, np.zeros(0, given.blocks[0].dtype)]) if given.blocks else None
            kept = next((test for test in session.tests if test.number == number), None)
            if samples is None or kept is None:
                if samples is not None and samples.size:
                    found.append(f"test {number} is missing, {samples.size} samples were recorded")
                continue
            place = samples["index"].astype(np.int64) - given.run.first_index
            place = place[place < kept.samples]
            codes = self.bench.codes(given.boot_id, given.run.first_index, kept.samples)
            for column, name in enumerate(SIGNALS):
                signal = np.asarray(kept.signals[name])
                if not np.array_equal(signal[place], samples[name][: place.size], equal_nan=True):
                    found.append(f"test {number}: {name} is not what was recorded")
                known = np.flatnonzero(np.isfinite(signal))
                if known.size and known[-1] >= codes.shape[0]:
                    found.append(f"test {number}: {name} has samples that were never taken")
                    continue
                measured = codes[known, column] * channels[column].gain + channels[column].offset
                if not np.array_equal(signal[known], measured):
                    found.append(f"test {number}: {name} is not what was measured")
        return found

    def lost_in_a_power_cut(self, recorder: WatchedRecorder, folder: Path) -> list[str]:
        """What was acknowledged and would not come back if the host lost its power now."""
        acknowledged = recorder.samples_acknowledged
        left = folder / "cut.h5.journal"
        shutil.copyfile(recorder.journal.path, left)
        if not acknowledged:
            left.unlink()
            return []
        path, session = recover(left)
        path.unlink()
        inside = sum(test.samples for test in session.tests)
        return [] if inside >= acknowledged else [f"{acknowledged} samples were acknowledged, {inside} came back"]


def void(_: object) -> None:
    """Ignore the samples."""


@contextmanager
def virtual_time() -> Iterator[None]:
    """Run background work at once: its duration would depend on this machine."""
    with patch.object(guided, "run_while_polling", lambda _instrument, work, _cancelled=None: work()):
        yield
