"""Coil and spring at each position of a sweep (Chen 2010, 2.4.1, Fig. 2.12), and the amplitude of the test there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.background_work import run_while_polling
from tissueid.acquisition.playback import Phase, Progress, play
from tissueid.calibration.status import CHANNELS
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.identification.engines.lms import Lms
from tissueid.identification.second_order import SecondOrder
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.instrument import Instrument, Limits, join_blocks
from tissueid.messages import Message
from tissueid.records import Estimate, Record
from tissueid.sessions import Test
from tissueid.stimuli import Stimulus
from tissueid.stimuli.kinds.noise import Noise

Array = NDArray[np.float64]

MIN_SECONDS, MAX_SECONDS = 0.5, 60.0
"""Minimum and maximum length of a test, s."""
MIN_RATE_HZ, MAX_RATE_HZ = 1000.0, 20_000.0
"""Sample rates, Hz: lower ones do not resolve coil and filter, higher ones only need more memory."""
_MAX_READING = {"voltage": 1e3, "current": 1e2, "position": 0.2}
"""Largest plausible readings, V, A and m."""
_MAX_SWEEPS = 100
"""Maximum number of repeats of a sweep."""


@dataclass(frozen=True, eq=False)
class SweepTest:
    """Readings (n,) of voltage, V, current, A, and position, m; NaN where a sample was not received.

    ``stage_m`` is the position of a motorised stage, NaN without one; ``rest_m`` the position of the probe there with
    the coil free; ``sweep`` counts the repeats of the whole sweep from 0. Infinite values are replaced by NaN.

    Raises:
        UnusableInputError: readings that are implausible, constant or mostly missing.
    """

    voltage: Array
    current: Array
    position: Array
    sample_rate_hz: float
    stage_m: float = float("nan")
    rest_m: float = float("nan")
    sweep: int = 0

    def __post_init__(self) -> None:
        if not MIN_RATE_HZ <= self.sample_rate_hz <= MAX_RATE_HZ:
            raise UnusableInputError(
                "sweep.sample_rate",
                "the sample rate of a sweep must be {lowest:g} to {highest:g} Hz, not {rate:g} Hz",
                lowest=MIN_RATE_HZ,
                highest=MAX_RATE_HZ,
                rate=self.sample_rate_hz,
            )
        for name, largest in _MAX_READING.items():
            values = np.asarray(getattr(self, name), dtype=np.float64)
            values = np.where(np.isinf(values), np.nan, values)
            if values.shape != (self.position.size,):
                raise UnusableInputError("sweep.lengths", "voltage, current and position of a test differ in length")
            size = float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))
            if size > largest:
                raise UnusableInputError(
                    "sweep.too_large",
                    "the {channel} reaches {value:.3g}, which no instrument measures: check the units",
                    channel=CHANNELS[name],
                    value=size,
                )
            object.__setattr__(self, name, values)
        if not MIN_SECONDS <= self.position.size / self.sample_rate_hz <= MAX_SECONDS:
            raise UnusableInputError(
                "sweep.length",
                "a test of a sweep must last {least:g} to {most:g} s, not {seconds:.3g} s",
                least=MIN_SECONDS,
                most=MAX_SECONDS,
                seconds=self.position.size / self.sample_rate_hz,
            )
        received = np.isfinite(self.voltage + self.current + self.position)
        if np.mean(received) < 0.5:
            raise UnusableInputError(
                "sweep.lost", "most samples of a test were lost: check the cable and repeat the sweep"
            )
        for name in _MAX_READING:
            if not np.ptp(getattr(self, name)[received]) > 0.0:
                raise UnusableInputError(
                    "sweep.constant", "the {channel} does not change during a test", channel=CHANNELS[name]
                )

    @classmethod
    def of_session(cls, test: Test) -> SweepTest:
        """Return a test of a session without its preload.

        Raises:
            UnusableInputError: a signal is missing or implausible; names the test.
        """
        preload = test.preload_s * test.sample_rate_hz
        first = round(min(preload, test.samples)) if preload > 0.0 else 0
        if missing := [name for name in _MAX_READING if name not in test.signals]:
            raise _of_test(
                test,
                Message("sweep.no_channel", "it has no {channel}, which a sweep needs", channel=CHANNELS[missing[0]]),
            )
        stage, sweep = test.notes.get("stage_m"), test.notes.get("sweep", 0.0)
        if not (isinstance(sweep, float | int) and 0 <= sweep < _MAX_SWEEPS and sweep == int(sweep)):
            raise _of_test(test, Message("sweep.number", "its number of the sweep, {sweep}, is not valid", sweep=sweep))
        try:
            return cls(
                **{name: test.signals[name][first:] for name in _MAX_READING},
                sample_rate_hz=test.sample_rate_hz,
                stage_m=float(stage) if isinstance(stage, float | int) and abs(stage) <= 1.0 else float("nan"),
                rest_m=test.surface_position_m,
                sweep=int(sweep),
            )
        except UnusableInputError as error:
            raise _of_test(test, error.message) from error

    @property
    def mean_position_m(self) -> float:
        """Mean position, m."""
        return float(np.nanmean(self.position))

    @property
    def swing_m(self) -> float:
        """RMS of the position about its mean, m."""
        return float(np.nanstd(self.position))


def _of_test(test: Test, why: str) -> UnusableInputError:
    return UnusableInputError("sweep.test", "test {number}: {reason}", number=test.number, reason=why)


MEMORY_S = 0.25
"""Length of the impulse response, s: a spring of 1,000 N/m with 66 g decays to 0.1 % within it."""
RATE_HZ = 2000.0
"""Sample rate of the identification, Hz."""
LOWEST_HZ, HIGHEST_HZ = 2.0, 200.0
"""Band of the Bode plot, Hz: the band of the stimulus."""
_FREQUENCIES = 41
"""Frequencies of the Bode plot."""


@dataclass(frozen=True, eq=False)
class SpringPoint:
    """Result at one position: apparent mass, damping and stiffness with the force constant of the device.

    ``vaf_percent`` is that of the impulse response, ``vaf_parametric_percent`` that of the second-order system.
    ``response_m_per_n`` (41,) is the measured compliance at ``frequency_hz`` (41,), from the impulse response.
    """

    position_m: float
    stage_m: float
    rest_m: float
    sweep: int
    swing_m: float
    peak_to_peak_m: float
    vaf_percent: float
    vaf_parametric_percent: float
    mass_kg: Estimate
    damping_n_s_per_m: Estimate
    stiffness_n_per_m: Estimate
    frequency_hz: Array
    response_m_per_n: NDArray[np.complex128]

    @property
    def system(self) -> SecondOrder:
        """The second-order system."""
        return SecondOrder(self.mass_kg.value, self.damping_n_s_per_m.value, self.stiffness_n_per_m.value)


def held_record(held: Array, position: Array, sample_rate_hz: float, unit: str) -> Record:
    """Return a record of the input held over the interval before each reading (n,), and of the position (n,), m.

    Higher sample rates are reduced to ``RATE_HZ`` by averaging the input: the spring does not respond faster.

    Raises:
        UnusableInputError: no samples were received.
    """
    every = max(1, round(sample_rate_hz / RATE_HZ))
    count = position.size // every
    means = held[: count * every].reshape(count, every).mean(axis=1)
    last = position[: count * every].reshape(count, every)[:, -1]
    held_from = np.append(means[1:], np.nan)  # a record stores the value held from each reading on
    valid = np.flatnonzero(np.isfinite(held_from) & np.isfinite(last))
    if not valid.size:
        raise UnusableInputError("sweep.all_lost", "all samples were lost: check the cable and repeat the sweep")
    whole = slice(int(valid[0]), int(valid[-1]) + 1)  # drop the ends, which lack a neighbour
    return Record(held_from[whole], last[whole], sample_rate_hz / every, "held", "position", unit, "m")


def _positive_std(estimate: Estimate) -> Estimate:
    """Return an estimate with a positive standard deviation, which an inverted coil would make negative."""
    return estimate if estimate.std is None else Estimate(estimate.value, abs(estimate.std))


def identify_point(test: SweepTest, mean_current: Array, device: DeviceDescription) -> SpringPoint:
    """Identify one test; ``mean_current`` (n,) is the mean over the interval before each reading.

    A current reading belongs to the end of the interval in which a command was held; used directly, it biases the mass
    low by some per cent. The mean current of each interval is therefore held over it.

    Raises:
        UnusableInputError: nothing moved, or the record is too short.
    """
    record = held_record(device.force_constant_n_per_a * mean_current, test.position, test.sample_rate_hz, "N")
    rate = record.sample_rate_hz
    model = Lms(memory=MEMORY_S, hold="zero-order").fit(record)
    parameters = model.report.parameters
    frequency = np.geomspace(LOWEST_HZ, HIGHEST_HZ, _FREQUENCIES)
    # Frequency response to a force, compensated for the zero-order hold.
    turned = np.exp(-2j * np.pi * frequency[:, None] * (model.lag_s - 0.5 / rate))  # (frequencies, lags)
    turned /= np.sinc(frequency / rate)[:, None]
    return SpringPoint(
        position_m=test.mean_position_m,
        stage_m=test.stage_m,
        rest_m=test.rest_m,
        sweep=test.sweep,
        swing_m=test.swing_m,
        peak_to_peak_m=float(np.nanmax(test.position) - np.nanmin(test.position)),
        vaf_percent=model.report.vaf_percent,
        vaf_parametric_percent=model.second_order.vaf_percent,
        mass_kg=_positive_std(parameters["mass_kg"]),
        damping_n_s_per_m=_positive_std(parameters["damping_n_s_per_m"]),
        stiffness_n_per_m=_positive_std(parameters["stiffness_n_per_m"]),
        frequency_hz=frequency,
        response_m_per_n=turned @ model.impulse_response / rate,
    )


GENTLE_V = 3.0
"""Maximum voltage of the gentle test, V: a swing of some tenths of a millimetre."""
GENTLE_S = 1.0
"""Duration of the gentle test, s."""
REST_S = 0.1
"""Time at 0 V before the gentle test, s: longer than the soft start of the device."""
STROKE_MARGIN_M = 0.5e-3
"""Distance of the swing from the stroke limits, m: the error of a linear prediction."""
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
    samples = join_blocks(blocks)
    volts, position = np.full(command.size, np.nan), np.full(command.size, np.nan)
    index = samples["index"].astype(np.int64) - run.first_index
    volts[index], position[index] = samples["voltage"], samples["position"]
    record = held_record(volts[quiet:], position[quiet:], rate, "V")
    model = run_while_polling(instrument, lambda: Lms(memory=MEMORY_S, hold="zero-order").fit(record), cancelled)
    if not model.second_order.vaf_percent >= 100.0 * _MIN_VAF:
        raise UnusableInputError(
            "sweep.no_response",
            "the probe does not follow the coil: check that the spring is fixed to the probe and moves freely",
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
