"""Amplitude of a sweep at a position, from the prediction of a gentle test there."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.background_work import run_while_polling
from tissueid.acquisition.playback import Phase, Progress, play
from tissueid.calibration.spring_points import MEMORY_S, RATE_HZ, held_record
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.identification.engines.lms import Lms
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.instrument import SAMPLE, Instrument, Limits
from tissueid.messages import Message
from tissueid.stimuli import Stimulus
from tissueid.stimuli.kinds.noise import Noise

GENTLE_V = 3.0
"""Maximum voltage of the gentle test, V: a swing of some tenths of a millimetre."""
GENTLE_S = 1.0
"""Duration of the gentle test, s."""
REST_S = 0.1
"""Time at 0 V before the gentle test, s: longer than the soft start of the device."""
STROKE_MARGIN_M = 0.5e-3
"""Distance of the swing from the stroke limits, m: the error of a linear prediction."""
MIN_SWING_M = 0.3e-3
"""Minimum swing to either side at a position that is measured, m."""
USED_SHARE = 0.9
"""Share of the available swing, force limit and amplifier range that is used."""
_MIN_VAF = 0.5
"""Minimum relative variance accounted for by a linear model of the gentle test."""


def noise(volts: float, seconds: float, seed: int, sample_rate_hz: float) -> Stimulus:
    """Return Gaussian noise to 200 Hz with zero mean and at most ``volts``."""
    ends = {"voltage_min_v": -volts, "voltage_max_v": volts}
    return Noise(**ends, seconds=seconds, seed=seed, sample_rate=sample_rate_hz).build()


def gentle_test_model(
    instrument: Instrument,
    limits: Limits,
    seed: int,
    progress: Callable[[Progress], None],
    cancelled: Callable[[], bool],
) -> tuple[float, SecondOrderFit]:
    """Run a gentle test; return the mean position, m, and a second-order model from voltage to position.

    Raises:
        UnusableInputError: the probe does not respond: the spring is not fixed, or the coil is blocked.
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
    model = run_while_polling(instrument, lambda: Lms(memory=MEMORY_S, hold="zero-order").fit(record), cancelled)
    if not model.second_order.vaf_percent >= 100.0 * _MIN_VAF:
        raise UnusableInputError(
            Message(
                "sweep.no_response",
                "the probe does not follow the coil: check that the spring is fixed to the probe and moves freely",
            )
        )
    return float(np.nanmean(position)), model.second_order


def noise_amplitude(
    answer: SecondOrderFit, stimulus: Stimulus, room_m: float, device: DeviceDescription, limits: Limits
) -> float:
    """Return the factor, V, for a stimulus of one volt at which the probe swings by at most ``room_m``."""
    every = max(1, round(stimulus.sample_rate_hz / RATE_HZ))
    held = stimulus.values[: stimulus.values.size // every * every].reshape(-1, every).mean(axis=1)
    peak = float(np.max(np.abs(answer.simulate(held))))
    strongest = min(
        limits.max_force_n * device.voltage_for_force(1.0), device.amplifier_limit_v / device.amplifier_gain
    )
    return USED_SHARE * min(room_m / peak, strongest)


def max_swing(position_m: float, limits: Limits) -> float:
    """Return the largest swing to either side of a position, m; negative if too close to an end of the stroke."""
    return min(position_m - limits.min_position_m, limits.max_position_m - position_m) - STROKE_MARGIN_M
