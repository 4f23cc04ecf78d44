"""The guided test: place, preload at the mean load, stochastic stimulus, release (thesis 2.4.2, 7.1.1)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.recorder import SessionRecorder
from tissueid.device import DeviceDescription
from tissueid.errors import CancelledError, TissueIDError, UnusableInputError
from tissueid.instrument import CLINICAL, SAMPLE, Instrument, Limits, Run, check_stimulus
from tissueid.stimuli.base import Stimulus, to_voltage

POLL_S = 0.05
CONTACT_FORCES_N = (0.10, 0.05)
"""Net forces while the surface is sought: the weight of the coil is carried by the coil itself, but for these."""
PLACE_S = 1.2
_SETTLED_S = 0.2
_STILL_M = 50e-6
_STROKE_MARGIN_M = 1.0e-3
GRAVITY_M_S2 = 9.80665


class Phase(Enum):
    """Where a guided test stands."""

    PLACE = "place"
    PRELOAD = "preload"
    STIMULUS = "stimulus"
    RELEASE = "release"


@dataclass(frozen=True)
class Progress:
    """What a running test tells: its phase, how much of the run is played (0 to 1), and the newest samples."""

    phase: Phase
    fraction: float
    samples: NDArray[np.void]


@dataclass(frozen=True)
class GuidedTest:
    """One test to be run: the stimulus with its preload, where, and how far it may go."""

    stimulus: Stimulus
    site: str
    kind: str = "stochastic"
    configuration: str = "indentation"
    limits: Limits = CLINICAL
    repeat_of: int | None = None


def _ignore(_: Progress) -> None:
    """Nobody wants to know."""


def _never() -> bool:
    return False


def play(
    instrument: Instrument,
    command_v: NDArray[np.float64],
    limits: Limits,
    *,
    started: Callable[[Run], None] | None = None,
    on_samples: Callable[[NDArray[np.void], float], None],
    cancelled: Callable[[], bool] = _never,
) -> None:
    """Play one stimulus, shape (n,), V, and hand over its samples as they come, with the fraction played.

    Whatever goes wrong, the coil is released before the error leaves this function.

    Raises:
        CancelledError: ``cancelled`` said so.
        LimitError, InstrumentError: as the instrument says.
    """
    instrument.load(command_v)
    try:
        instrument.arm(limits)
        run = instrument.start()
        if started is not None:
            started(run)
        last = run.first_index
        while last < run.end_index:
            samples = instrument.poll(POLL_S)
            if samples.size:
                last = int(samples["index"][-1]) + 1
                inside = (samples["index"] >= run.first_index) & (samples["index"] < run.end_index)
                on_samples(samples[inside], min(1.0, (last - run.first_index) / run.samples))
            if cancelled():
                raise CancelledError("cancelled; the coil is released and what was recorded is kept")
    except BaseException:
        instrument.release()
        raise


def find_surface(
    instrument: Instrument,
    limits: Limits = CLINICAL,
    *,
    progress: Callable[[Progress], None] = _ignore,
    cancelled: Callable[[], bool] = _never,
) -> float:
    """The position, m, where the tissue begins: from two light contacts with the coil's weight carried by itself.

    Raises:
        UnusableInputError: the probe does not rest on anything within its stroke, or does not keep still.
    """
    device = instrument.device
    weight = device.moving_mass_kg * GRAVITY_M_S2
    levels = np.array([device.voltage_for_force(force - weight) for force in CONTACT_FORCES_N])
    samples_per_level = round(PLACE_S / levels.size * device.sample_rate_hz)
    blocks: list[NDArray[np.void]] = []

    def take(samples: NDArray[np.void], fraction: float) -> None:
        blocks.append(samples)
        progress(Progress(Phase.PLACE, fraction, samples))

    command = np.repeat(levels, samples_per_level)
    play(instrument, command, limits, on_samples=take, cancelled=cancelled)
    position = np.concatenate([*blocks, np.zeros(0, SAMPLE)])["position"]
    if position.size < command.size:
        raise UnusableInputError("samples were lost while the probe was placed; check the link and try again")
    late = position.reshape(levels.size, -1)[:, -round(_SETTLED_S * device.sample_rate_hz) :]  # (levels, settled)
    if np.isnan(late).any():
        raise UnusableInputError("samples were lost while the probe was placed; check the link and try again")
    # A straight line through the two depths, taken back to no force at all.
    slope = (late[0].mean() - late[1].mean()) / (CONTACT_FORCES_N[0] - CONTACT_FORCES_N[1])
    surface = float(late[1].mean() - CONTACT_FORCES_N[1] * slope)
    if not _STROKE_MARGIN_M < surface < device.stroke_m - _STROKE_MARGIN_M:
        raise UnusableInputError(
            f"the probe is at the end of its stroke ({surface * 1e3:.1f} mm): place it on the tissue and try again"
        )
    # Creep of the tissue is a slope; what shakes about it is a hand.
    time = np.arange(late.shape[1])
    creep = np.polynomial.polynomial.polyfit(time, late.T, 1)  # (2, levels)
    shaking = (late - creep[0][:, None] - creep[1][:, None] * time).std(axis=1)
    if float(shaking.max()) > _STILL_M:
        raise UnusableInputError("the probe does not keep still: hold the reference surface firmly and try again")
    return surface


def check_test(test: GuidedTest, device: DeviceDescription) -> NDArray[np.float64]:
    """The command of a test, shape (n,), V; refused before anybody is touched when it could not be played.

    Raises:
        LimitError: too strong, too long, or beyond the amplifier.
        UnusableInputError: another sample rate than the device's.
    """
    if test.stimulus.sample_rate_hz != device.sample_rate_hz:
        raise UnusableInputError(
            f"the stimulus has {test.stimulus.sample_rate_hz:g} samples a second, "
            f"the instrument {device.sample_rate_hz:g}"
        )
    command = to_voltage(test.stimulus.values, device, test.stimulus.unit)
    check_stimulus(command, device, test.limits)
    return command


def run_guided_test(
    instrument: Instrument,
    test: GuidedTest,
    recorder: SessionRecorder,
    *,
    surface_m: float | None = None,
    progress: Callable[[Progress], None] = _ignore,
    cancelled: Callable[[], bool] = _never,
) -> int:
    """Run one guided test into the recorder; returns its number.

    A test that ends early is closed as aborted with what was recorded, and the error goes on to the caller.
    ``surface_m`` is where the tissue begins; without it the probe is placed first.

    Raises:
        CancelledError, LimitError, InstrumentError, JournalError, UnusableInputError.
    """
    device = instrument.device
    command = check_test(test, device)
    if surface_m is None:
        surface_m = find_surface(instrument, test.limits, progress=progress, cancelled=cancelled)
    number = 0
    gaps_before = len(instrument.gaps)

    def started(run: Run) -> None:
        nonlocal number
        number = recorder.begin_test(
            run,
            kind=test.kind,
            configuration=test.configuration,
            site=test.site,
            sample_rate_hz=device.sample_rate_hz,
            preload_s=test.stimulus.preload_s,
            surface_position_m=surface_m,
            stimulus=test.stimulus.description,
            seed=test.stimulus.seed,
            repeat_of=test.repeat_of,
            notes={f"limit_{name}": value for name, value in asdict(test.limits).items()},
        )

    def take(samples: NDArray[np.void], fraction: float) -> None:
        recorder.add(samples)
        preload = fraction * test.stimulus.seconds < test.stimulus.preload_s
        progress(Progress(Phase.PRELOAD if preload else Phase.STIMULUS, fraction, samples))

    def close(status: str, **notes: str) -> None:
        for gap in instrument.gaps[gaps_before:]:
            recorder.event("gap", first_index=gap.first_index, count=gap.count)
        recorder.end_test(status, **notes)

    try:
        play(instrument, command, test.limits, started=started, on_samples=take, cancelled=cancelled)
    except (TissueIDError, KeyboardInterrupt) as error:
        if number:
            close("aborted", reason=str(error) or "interrupted")
        raise
    close("completed")
    progress(Progress(Phase.RELEASE, 1.0, np.zeros(0, SAMPLE)))
    return number
