"""Temperature rise of a coil from a stimulus: first-order thermal model, one capacity and one resistance."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import fft, signal

from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.messages import Message
from tissueid.stimuli.base import Array, Stimulus, Unit


@dataclass(frozen=True)
class AssumedValue:
    """Assumed value with a lower and an upper bound."""

    least: float
    usual: float
    most: float


@dataclass(frozen=True)
class ThermalParameters:
    """Assumed thermal parameters of the coil; no source gives measured ones.

    The thesis winds 12 ohm of 28 gauge copper (2.2.1): 0.213 ohm/m and 0.72 g/m give 56 m and 40 g, at 385 J/(kg K) 16
    J/K. That is the lower bound of the heat capacity; the part of the bobbin that warms with the wire adds up to half
    of it. About 50 cm2 of surface at 12 to 50 W/(m2 K), from still air to air stirred by the moving coil, give 4 to 16
    K/W. The resistance is that of the cold coil: warm copper draws less current at the same voltage, so the predictions
    err on the high side.
    """

    heat_capacity_j_per_k: AssumedValue = AssumedValue(16.0, 20.0, 25.0)
    resistance_k_per_w: AssumedValue = AssumedValue(4.0, 8.0, 16.0)


@dataclass(frozen=True)
class TemperatureRise:
    """Maximum temperature rise of a coil during a stimulus, K.

    ``expected_k`` uses the typical parameters, ``least_k`` and ``most_k`` their bounds. ``bound_k`` is the adiabatic
    rise of the wire alone, an upper limit for any coil of this wire. ``energy_j`` is the dissipated heat, J.
    """

    expected_k: float
    least_k: float
    most_k: float
    bound_k: float
    energy_j: float


def heating(
    current_a: Array, resistance_ohm: float, sample_rate_hz: float, thermal: ThermalParameters | None = None
) -> TemperatureRise:
    """Compute the heating of a coil, initially at room temperature, by a current (n,), A, held for one sample each.

    Solves C dT/dt = I^2 R - T / R_th exactly for a piecewise constant current.
    """
    figures = thermal or ThermalParameters()
    capacity, resistance = figures.heat_capacity_j_per_k, figures.resistance_k_per_w
    power = current_a**2 * resistance_ohm  # (n,) W
    energy = float(np.sum(power)) / sample_rate_hz

    def warmest(capacity_j_per_k: float, resistance_k_per_w: float) -> float:
        kept = float(np.exp(-1.0 / (sample_rate_hz * capacity_j_per_k * resistance_k_per_w)))
        return float(np.max(signal.lfilter([(1.0 - kept) * resistance_k_per_w], [1.0, -kept], power)))

    return TemperatureRise(
        expected_k=warmest(capacity.usual, resistance.usual),
        least_k=warmest(capacity.most, resistance.least),
        most_k=warmest(capacity.least, resistance.most),
        bound_k=energy / capacity.least,
        energy_j=energy,
    )


Severity = Literal["refused", "caution"]

ROOM_C = 23.0
"""Temperature, degC, of a coil that has not been used."""

REFERENCE_EDGE_N_PER_S = 4600.0
"""Steepest edge, N/s, of the thesis' painless test: Gaussian noise, 8th-order low-pass at 200 Hz, 10 N (3.1.1, 7.1.1).

Median over seeds of 4 s of the kind ``noise`` from 0.5 to 10.5 N; single seeds give 3,800 to 5,800 N/s.
"""

SHARPER_RATIO = 1.5
SHARP_RATIO = 3.0
"""Ratios of the steepest edge to the reference above which edges count as sharper, and as sharp.

A convention of this program, not a clinical finding. The thesis found Gaussian and uniform noise painless and the sharp
transitions of binary noise painful (3.1.1): over 10 N at 2 kHz these have 1, 1.2 and 4.3 times the reference.
"""

CUTOFFS_HZ = (100.0, 200.0, 400.0)
"""Frequencies, Hz, above which the share of power is reported."""
_PERCENTS = (5, 50, 95)


@dataclass(frozen=True)
class StimulusConcern:
    """Problem of a stimulus: ``refused`` must not be played, ``caution`` needs a decision of the operator."""

    severity: Severity
    message: str


@dataclass(frozen=True)
class StimulusCheck:
    """Properties of a stimulus. Forces and currents are those of a coil at rest; in motion, back-EMF reduces the force.

    ``force_mean_n``, ``force_std_n``, ``crest_factor``, ``percentiles_n`` (5, 50 and 95 % of the samples), ``skewness``
    and ``excess_kurtosis`` (0 for a Gaussian, -1.2 for a uniform distribution) and the power figures describe the part
    after the preload; they are None for a constant stimulus where they need variation. ``rms_current_a`` includes the
    mean, as it determines the heating. ``power_95_hz`` and ``power_99_hz`` are the frequencies below which 95 % and 99
    % of the zero-mean power lie; ``power_above`` pairs a frequency, Hz, with the share above it.
    ``steepest_edge_n_per_s`` is the largest difference of consecutive samples divided by the sample interval,
    ``edge_ratio`` the same relative to ``REFERENCE_EDGE_N_PER_S``, ``sharp_edges_per_s`` the rate of steps above
    ``SHARPER_RATIO`` times the reference.
    """

    seconds: float
    unit: Unit
    force_min_n: float
    force_max_n: float
    voltage_min_v: float
    voltage_max_v: float
    force_mean_n: float
    force_std_n: float
    crest_factor: float | None
    percentiles_n: tuple[float, float, float]
    skewness: float | None
    excess_kurtosis: float | None
    peak_current_a: float
    rms_current_a: float
    heating: TemperatureRise
    power_95_hz: float | None
    power_99_hz: float | None
    power_above: tuple[tuple[float, float], ...]
    steepest_edge_n_per_s: float
    edge_ratio: float
    sharp_edges_per_s: float
    concerns: tuple[StimulusConcern, ...]

    @property
    def playable(self) -> bool:
        """Whether no concern refuses the stimulus."""
        return all(concern.severity != "refused" for concern in self.concerns)

    @property
    def steepest_edge_n_per_ms(self) -> float:
        """Steepest edge, N/ms."""
        return self.steepest_edge_n_per_s / 1e3

    @property
    def feel(self) -> Message:
        """Expected sensation from the steepest edge."""
        if self.edge_ratio <= SHARPER_RATIO:
            return Message("stimulus.feel.gentle", "That is within the range of noise known to be painless.")
        if self.edge_ratio <= SHARP_RATIO:
            return Message(
                "stimulus.feel.harder",
                "That is {ratio:.1f} times as steep as in noise known to be painless: it will feel harder.",
                ratio=self.edge_ratio,
            )
        return Message(
            "stimulus.feel.hurts",
            "That is {ratio:.1f} times as steep as in noise known to be painless, like a random square wave: "
            "such edges are painful.",
            ratio=self.edge_ratio,
        )

    def summary(self) -> tuple[Message, ...]:
        """Return one sentence for each property of the stimulus; ``concerns`` are separate."""
        return tuple(_sentences(self))


def assess_stimulus(
    played: Stimulus,
    device: DeviceDescription,
    *,
    max_force_n: float,
    max_seconds: float,
    max_temperature_c: float,
    start_c: float = ROOM_C,
    thermal: ThermalParameters | None = None,
) -> StimulusCheck:
    """Check a stimulus for a device and limits.

    Args:
        played: stimulus, with or without preload.
        device: coil and amplifier.
        max_force_n: force limit, N, of the absolute value.
        max_seconds: length limit, s.
        max_temperature_c: coil temperature limit, degC.
        start_c: initial coil temperature, degC.
        thermal: thermal parameters of the coil; the assumed ones by default.

    Raises:
        UnusableInputError: the stimulus is empty or not finite.
    """
    values = np.asarray(played.values, dtype=np.float64)
    if values.size == 0 or not np.isfinite(values).all():
        raise UnusableInputError("stimulus.not_finite", "a stimulus must have at least one sample, all finite")
    volts = values * (device.voltage_for_force(1.0) if played.unit == "N" else 1.0)  # (n,) command
    current = volts * (device.amplifier_gain / device.coil_resistance_ohm)
    force = current * device.force_constant_n_per_a
    rate = played.sample_rate_hz
    part = force[min(round(played.preload_s * rate), force.size - 1) :]
    about = part - np.mean(part)
    std = float(np.std(part))
    varies = std > 1e-9 * max(float(np.max(np.abs(part))), 1e-300)
    frequency, share = _power(about, rate) if varies else (np.zeros(1), np.ones(1))
    steps = np.abs(np.diff(force)) * rate
    steepest = float(np.max(steps, initial=0.0))
    low, middle, high = (float(level) for level in np.percentile(part, _PERCENTS))
    warmth = heating(current, device.coil_resistance_ohm, rate, thermal)
    concerns = [
        *_limit_concerns(played, volts, device, max_force_n, max_seconds),
        *_heating_concerns(warmth, start_c, max_temperature_c),
        *_comfort_concerns(steepest, float(np.min(force))),
    ]
    return StimulusCheck(
        seconds=played.seconds,
        unit=played.unit,
        force_min_n=float(np.min(force)),
        force_max_n=float(np.max(force)),
        voltage_min_v=float(np.min(volts)),
        voltage_max_v=float(np.max(volts)),
        force_mean_n=float(np.mean(part)),
        force_std_n=std,
        crest_factor=float(np.max(np.abs(about))) / std if varies else None,
        percentiles_n=(low, middle, high),
        skewness=float(np.mean((about / std) ** 3)) if varies else None,
        excess_kurtosis=float(np.mean((about / std) ** 4)) - 3.0 if varies else None,
        peak_current_a=float(np.max(np.abs(current))),
        rms_current_a=float(np.sqrt(np.mean(current**2))),
        heating=warmth,
        power_95_hz=_power_quantile(frequency, share, 0.95) if varies else None,
        power_99_hz=_power_quantile(frequency, share, 0.99) if varies else None,
        power_above=tuple((hz, float(np.sum(share[frequency > hz])) if varies else 0.0) for hz in CUTOFFS_HZ),
        steepest_edge_n_per_s=steepest,
        edge_ratio=steepest / REFERENCE_EDGE_N_PER_S,
        sharp_edges_per_s=float(np.sum(steps > SHARPER_RATIO * REFERENCE_EDGE_N_PER_S)) / played.seconds,
        concerns=tuple(concerns),
    )


def _power(about: Array, rate: float) -> tuple[Array, Array]:
    """Return frequencies (lines,), Hz, and the share of the power at each, with a Hann window against leakage."""
    power = np.abs(fft.rfft(about * signal.windows.hann(about.size, sym=False))) ** 2
    return np.asarray(fft.rfftfreq(about.size, 1.0 / rate)), np.asarray(power / max(float(np.sum(power)), 1e-300))


def _power_quantile(frequency: Array, share: Array, wanted: float) -> float:
    """Return the frequency, Hz, below which the ``wanted`` share of the power lies."""
    return float(frequency[min(int(np.searchsorted(np.cumsum(share), wanted)), frequency.size - 1)])


def _limit_concerns(
    played: Stimulus, volts: Array, device: DeviceDescription, max_force_n: float, max_seconds: float
) -> Iterator[StimulusConcern]:
    """Yield a concern for each limit of the instrument that the stimulus exceeds."""
    if played.sample_rate_hz != device.sample_rate_hz:
        yield StimulusConcern(
            "refused",
            Message(
                "stimulus.check.rate",
                "Its sample rate is {rate:g} Hz, that of the instrument {needed:g} Hz: design it at {needed:g} Hz.",
                rate=played.sample_rate_hz,
                needed=device.sample_rate_hz,
            ),
        )
    peak = float(np.max(np.abs(volts)))
    newtons = peak * device.amplifier_gain * device.force_constant_n_per_a / device.coil_resistance_ohm
    if newtons > max_force_n:
        yield StimulusConcern(
            "refused",
            Message(
                "stimulus.check.force",
                "It reaches {force:.1f} N; the limit is {limit:g} N: lower the range.",
                force=newtons,
                limit=max_force_n,
            ),
        )
    if peak * max(device.amplifier_gain, 1.0) > device.amplifier_limit_v:
        needed = peak * max(device.amplifier_gain, 1.0)
        yield StimulusConcern(
            "refused",
            Message(
                "stimulus.check.voltage",
                "It needs {voltage:.1f} V; the amplifier gives {limit:g} V: lower the range.",
                voltage=needed,
                limit=device.amplifier_limit_v,
            ),
        )
    if played.seconds > max_seconds:
        yield StimulusConcern(
            "refused",
            Message(
                "stimulus.check.length",
                "It lasts {seconds:.1f} s; the maximum is {limit:g} s: shorten it.",
                seconds=played.seconds,
                limit=max_seconds,
            ),
        )


def _heating_concerns(warmth: TemperatureRise, start_c: float, max_temperature_c: float) -> Iterator[StimulusConcern]:
    """Yield a concern if the coil would reach its temperature limit."""
    if start_c + warmth.expected_k > max_temperature_c:
        yield StimulusConcern(
            "refused",
            Message(
                "stimulus.check.hot",
                "It would warm the coil to about {temperature:.0f} °C, above the limit of {limit:g} °C, and be "
                "stopped early. Lower the force or shorten it.",
                temperature=start_c + warmth.expected_k,
                limit=max_temperature_c,
            ),
        )
    elif start_c + warmth.most_k > max_temperature_c:
        yield StimulusConcern(
            "caution",
            Message(
                "stimulus.check.warm",
                "With poor cooling it may warm the coil to {temperature:.0f} °C, above the limit of {limit:g} "
                "°C, and be stopped early.",
                temperature=start_c + warmth.most_k,
                limit=max_temperature_c,
            ),
        )


def _comfort_concerns(steepest_n_per_s: float, least_n: float) -> Iterator[StimulusConcern]:
    """Yield concerns about the sensation of the person under the probe."""
    ratio = steepest_n_per_s / REFERENCE_EDGE_N_PER_S
    if ratio > SHARP_RATIO:
        yield StimulusConcern(
            "caution",
            Message(
                "stimulus.check.hurts",
                "Its edges are {ratio:.1f} times as steep as those of noise known to be painless. Such edges "
                "are painful: lower the range or the highest frequency.",
                ratio=ratio,
            ),
        )
    elif ratio > SHARPER_RATIO:
        yield StimulusConcern(
            "caution",
            Message(
                "stimulus.check.steep",
                "Its edges are {ratio:.1f} times as steep as those of noise known to be painless. Warn the "
                "person and begin with a smaller range.",
                ratio=ratio,
            ),
        )
    if least_n < 0.0:
        yield StimulusConcern(
            "caution",
            Message(
                "stimulus.check.pulls",
                "It pulls with up to {force:.2g} N: if this exceeds the weight of the coil, the probe leaves the skin.",
                force=-least_n,
            ),
        )


def _sentences(check: StimulusCheck) -> Iterator[Message]:
    yield Message(
        "stimulus.summary.range",
        "{seconds:.2f} s, {low:.2f} to {high:.2f} N ({least:.1f} to {most:.1f} V with the coil at rest).",
        seconds=check.seconds,
        low=check.force_min_n,
        high=check.force_max_n,
        least=check.voltage_min_v,
        most=check.voltage_max_v,
    )
    if check.crest_factor is None or check.power_95_hz is None or check.power_99_hz is None:
        yield Message(
            "stimulus.summary.constant", "The force does not vary ({force:.2f} N throughout).", force=check.force_mean_n
        )
    else:
        yield Message(
            "stimulus.summary.crest",
            "About its mean of {mean:.2f} N it has {rms:.2f} N root mean square, crest factor {crest:.2f}.",
            mean=check.force_mean_n,
            rms=check.force_std_n,
            crest=check.crest_factor,
        )
        yield Message(
            "stimulus.summary.power",
            "95 % of its power lies below {most:.0f} Hz, 99 % below {nearly_all:.0f} Hz.",
            most=check.power_95_hz,
            nearly_all=check.power_99_hz,
        )
    warmth = check.heating
    yield Message(
        "stimulus.summary.current",
        "The current is {rms:.2f} A root mean square, {peak:.2f} A at its peak.",
        rms=check.rms_current_a,
        peak=check.peak_current_a,
    )
    yield Message(
        "stimulus.summary.heat",
        "The coil warms by about {expected:.1f} K ({least:.1f} to {most:.1f} K, at most {bound:.1f} K).",
        expected=warmth.expected_k,
        least=warmth.least_k,
        most=warmth.most_k,
        bound=warmth.bound_k,
    )
    yield Message(
        "stimulus.summary.edge",
        "Its steepest edge is {edge:.2g} N/ms. {feel}",
        edge=check.steepest_edge_n_per_ms,
        feel=check.feel,
    )
