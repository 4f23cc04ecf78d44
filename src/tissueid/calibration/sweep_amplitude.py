"""How hard a sweep may shake the spring at a position: from a gentle test there to the greatest swing that has room."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.playing import Phase, Progress, play
from tissueid.acquisition.waiting import meanwhile
from tissueid.calibration.spring_points import MEMORY_S, RATE_HZ, held_record
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.identification.engines.lms import Lms
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.instrument import SAMPLE, Instrument, Limits
from tissueid.stimuli import Stimulus
from tissueid.stimuli.kinds.noise import Noise

GENTLE_V = 3.0
"""Greatest voltage of the gentle test: it swings the spring by some tenths of a millimetre."""
GENTLE_S = 1.0
REST_S = 0.1
"""No voltage before the gentle test: the device begins every run softly, and that is over by then."""
END_MARGIN_M = 0.5e-3
"""How far from the limits of the stroke the swing is kept: what a linear forecast may be off by."""
LEAST_SWING_M = 0.3e-3
"""A position without so much room to both sides is not measured."""
CAUTION = 0.9
"""Share of the room, of the force limit and of the amplifier's range that is used."""
_LEAST_ANSWER = 0.5
"""Variance that a linear model of the gentle test must account for, relative, or nothing can be forecast."""


def noise(volts: float, seconds: float, seed: int, sample_rate_hz: float) -> Stimulus:
    """Gaussian noise to 200 Hz about no voltage, ``volts`` at most."""
    ends = {"voltage_min_v": -volts, "voltage_max_v": volts}
    return Noise(**ends, seconds=seconds, seed=seed, sample_rate=sample_rate_hz).build()


def gentle_answer(
    instrument: Instrument,
    limits: Limits,
    seed: int,
    progress: Callable[[Progress], None],
    cancelled: Callable[[], bool],
) -> tuple[float, SecondOrderFit]:
    """About which position the probe shakes, m, and how its position answers a voltage, from a gentle test.

    Raises:
        UnusableInputError: it does not answer: the spring is not fixed, or something holds the coil.
        CancelledError, LimitError, InstrumentError: the coil is released.
    """
    rate = instrument.device.sample_rate_hz
    quiet = round(REST_S * rate)
    command = np.concatenate([np.zeros(quiet), noise(GENTLE_V, GENTLE_S, seed, rate).values])
    blocks: list[NDArray[np.void]] = []

    def take(samples: NDArray[np.void], fraction: float) -> None:
        blocks.append(samples)
        progress(Progress(Phase.PLACE, fraction, samples))

    run = play(instrument, command, limits, on_samples=take, cancelled=cancelled)
    samples = np.concatenate([*blocks, np.zeros(0, SAMPLE)])
    volts, position = np.full(command.size, np.nan), np.full(command.size, np.nan)
    place = samples["index"].astype(np.int64) - run.first_index
    volts[place], position[place] = samples["voltage"], samples["position"]
    record = held_record(volts[quiet:], position[quiet:], rate, "V")
    model = meanwhile(instrument, lambda: Lms(memory=MEMORY_S, hold="zero-order").fit(record), cancelled)
    if not model.second_order.vaf_percent >= 100.0 * _LEAST_ANSWER:
        raise UnusableInputError(
            "the probe does not follow the coil: see that the spring is fixed to the probe and runs free"
        )
    return float(np.nanmean(position)), model.second_order


def strength(
    answer: SecondOrderFit, stimulus: Stimulus, room_m: float, device: DeviceDescription, limits: Limits
) -> float:
    """By how much a stimulus of one volt is to be multiplied so that it swings the probe by ``room_m`` at most."""
    every = max(1, round(stimulus.sample_rate_hz / RATE_HZ))
    held = stimulus.values[: stimulus.values.size // every * every].reshape(-1, every).mean(axis=1)
    peak = float(np.max(np.abs(answer.simulate(held))))
    strongest = min(
        limits.max_force_n * device.voltage_for_force(1.0), device.amplifier_limit_v / device.amplifier_gain
    )
    return CAUTION * min(room_m / peak, strongest)


def room(position_m: float, limits: Limits) -> float:
    """How far the probe may swing to either side of a position, m; negative where it stands too near an end."""
    return min(position_m - limits.min_position_m, limits.max_position_m - position_m) - END_MARGIN_M
