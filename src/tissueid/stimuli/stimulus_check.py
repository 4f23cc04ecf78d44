"""Check of a stimulus before it is played: force, heating, spectrum and comfort, and reasons against playing it."""

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
from tissueid.stimuli.heating import Heating, Thermal, heating

Severity = Literal["refused", "caution"]

ROOM_C = 23.0
"""Temperature, degC, of a coil that has not been used."""

REFERENCE_EDGE_N_PER_S = 4600.0
"""Steepest edge of the thesis' painless test: Gaussian noise, 8th-order low-pass at 200 Hz, over 10 N (3.1.1, 7.1.1).

The median over seeds of 4 s of the kind ``noise`` from 0.5 to 10.5 N; single seeds lie between 3,800 and 5,800.
"""

SHARPER = 1.5
SHARP = 3.0
"""Ratios of the steepness of the edges to the reference's from which they count as sharper than it, and as sharp.

A convention of this program, no clinical finding. The thesis found Gaussian and uniform noise painless and the sharp
transitions of binary noise painful (3.1.1): over the same 10 N at 2 kHz these are 1, 1.2 and 4.3 times the reference.
"""

CUTOFFS_HZ = (100.0, 200.0, 400.0)
_PERCENTS = (5, 50, 95)


@dataclass(frozen=True)
class Concern:
    """A concern about a stimulus: ``refused`` cannot be played, ``caution`` asks for a decision."""

    severity: Severity
    words: str


@dataclass(frozen=True)
class Appraisal:
    """A stimulus in figures. Forces and currents are those of a coil at rest; moving, it loses force to its back-EMF.

    ``force_mean_n``, ``force_std_n``, ``crest_factor``, ``percentiles_n`` (5, 50 and 95 % of the samples), ``skewness``
    and ``excess_kurtosis`` (0 for a Gaussian, -1.2 for a uniform distribution) and the figures of power are of the part
    after the preload; what needs variation is None where nothing varies. ``rms_current_a`` is about zero: it heats.
    ``power_95_hz`` and ``power_99_hz`` say where so much of the power about the mean ends, ``power_above`` pairs a
    frequency, Hz, with the share above it. ``steepest_edge_n_per_s`` is the largest step from one sample to the next
    over its time, ``edge_ratio`` that over ``REFERENCE_EDGE_N_PER_S``, ``sharp_edges_per_s`` how many steps a second
    are ``SHARPER`` than the reference.
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
    heating: Heating
    power_95_hz: float | None
    power_99_hz: float | None
    power_above: tuple[tuple[float, float], ...]
    steepest_edge_n_per_s: float
    edge_ratio: float
    sharp_edges_per_s: float
    concerns: tuple[Concern, ...]

    @property
    def playable(self) -> bool:
        """Whether nothing refuses it."""
        return all(concern.severity != "refused" for concern in self.concerns)

    @property
    def steepest_edge_n_per_ms(self) -> float:
        """Steepest edge, N/ms."""
        return self.steepest_edge_n_per_s / 1e3

    @property
    def feel(self) -> Message:
        """Meaning of the edges for the person under the probe."""
        if self.edge_ratio <= SHARPER:
            return Message("stimulus.feel.gentle", "That is no sharper than noise that is known to be painless.")
        if self.edge_ratio <= SHARP:
            return Message(
                "stimulus.feel.harder",
                "That is {ratio:.1f} times as sharp as noise that is known to be painless: it will feel harder.",
                ratio=self.edge_ratio,
            )
        return Message(
            "stimulus.feel.hurts",
            "That is {ratio:.1f} times as sharp as noise that is known to be painless, as sharp as a random square "
            "wave: "
            "edges like that hurt.",
            ratio=self.edge_ratio,
        )

    def summary(self) -> tuple[Message, ...]:
        """Return a sentence on each property of the stimulus; ``concerns`` are separate."""
        return tuple(_sentences(self))


def appraise(
    played: Stimulus,
    device: DeviceDescription,
    *,
    max_force_n: float,
    max_seconds: float,
    max_temperature_c: float,
    start_c: float = ROOM_C,
    thermal: Thermal | None = None,
) -> Appraisal:
    """Appraise a stimulus on a device within limits.

    Args:
        played: with its preload or without.
        device: whose coil and amplifier play it.
        max_force_n: limit of the force, N, either way.
        max_seconds: limit of the length, s.
        max_temperature_c: limit of the coil's temperature, degC.
        start_c: temperature of the coil before, degC.
        thermal: figures of the coil; the assumed ones by default.

    Raises:
        UnusableInputError: the stimulus has no samples, or some that are not finite.
    """
    values = np.asarray(played.values, dtype=np.float64)
    if values.size == 0 or not np.isfinite(values).all():
        raise UnusableInputError(
            Message("stimulus.not_finite", "a stimulus to be checked must be a row of finite values")
        )
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
        *_limits(played, volts, device, max_force_n, max_seconds),
        *_warmth(warmth, start_c, max_temperature_c),
        *_comfort(steepest, float(np.min(force))),
    ]
    return Appraisal(
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
        power_95_hz=_where(frequency, share, 0.95) if varies else None,
        power_99_hz=_where(frequency, share, 0.99) if varies else None,
        power_above=tuple((hz, float(np.sum(share[frequency > hz])) if varies else 0.0) for hz in CUTOFFS_HZ),
        steepest_edge_n_per_s=steepest,
        edge_ratio=steepest / REFERENCE_EDGE_N_PER_S,
        sharp_edges_per_s=float(np.sum(steps > SHARPER * REFERENCE_EDGE_N_PER_S)) / played.seconds,
        concerns=tuple(concerns),
    )


def _power(about: Array, rate: float) -> tuple[Array, Array]:
    """Frequencies (lines,), Hz, and the share of the power at each; a Hann window keeps the ends from showing."""
    power = np.abs(fft.rfft(about * signal.windows.hann(about.size, sym=False))) ** 2
    return np.asarray(fft.rfftfreq(about.size, 1.0 / rate)), np.asarray(power / max(float(np.sum(power)), 1e-300))


def _where(frequency: Array, share: Array, wanted: float) -> float:
    """Frequency, Hz, below which the ``wanted`` part of the power lies."""
    return float(frequency[min(int(np.searchsorted(np.cumsum(share), wanted)), frequency.size - 1)])


def _limits(
    played: Stimulus, volts: Array, device: DeviceDescription, max_force_n: float, max_seconds: float
) -> Iterator[Concern]:
    """Yield the limits of the instrument that the stimulus exceeds."""
    if played.sample_rate_hz != device.sample_rate_hz:
        yield Concern(
            "refused",
            Message(
                "stimulus.check.rate",
                "It has {rate:g} samples a second and the instrument {needed:g}: design it at {needed:g}.",
                rate=played.sample_rate_hz,
                needed=device.sample_rate_hz,
            ),
        )
    peak = float(np.max(np.abs(volts)))
    newtons = peak * device.amplifier_gain * device.force_constant_n_per_a / device.coil_resistance_ohm
    if newtons > max_force_n:
        yield Concern(
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
        yield Concern(
            "refused",
            Message(
                "stimulus.check.voltage",
                "It needs {voltage:.1f} V; the amplifier gives {limit:g} V: lower the range.",
                voltage=needed,
                limit=device.amplifier_limit_v,
            ),
        )
    if played.seconds > max_seconds:
        yield Concern(
            "refused",
            Message(
                "stimulus.check.length",
                "It lasts {seconds:.1f} s; there is room for {limit:g} s: shorten it.",
                seconds=played.seconds,
                limit=max_seconds,
            ),
        )


def _warmth(warmth: Heating, start_c: float, max_temperature_c: float) -> Iterator[Concern]:
    """Yield a concern where the coil would reach its temperature limit."""
    if start_c + warmth.expected_k > max_temperature_c:
        yield Concern(
            "refused",
            Message(
                "stimulus.check.hot",
                "It would warm the coil to about {temperature:.0f} °C and be ended before: the limit is {limit:g} °C. "
                "Lower the force or shorten it.",
                temperature=start_c + warmth.expected_k,
                limit=max_temperature_c,
            ),
        )
    elif start_c + warmth.most_k > max_temperature_c:
        yield Concern(
            "caution",
            Message(
                "stimulus.check.warm",
                "It may warm the coil to {temperature:.0f} °C where it cools badly, and be ended before; the limit is "
                "{limit:g} °C.",
                temperature=start_c + warmth.most_k,
                limit=max_temperature_c,
            ),
        )


def _comfort(steepest_n_per_s: float, least_n: float) -> Iterator[Concern]:
    """Yield concerns about what the person under the probe will feel."""
    ratio = steepest_n_per_s / REFERENCE_EDGE_N_PER_S
    if ratio > SHARP:
        yield Concern(
            "caution",
            Message(
                "stimulus.check.hurts",
                "Its edges are {ratio:.1f} times as steep as those of noise that is known to be painless. Edges like "
                "that "
                "hurt: lower the range or the highest frequency.",
                ratio=ratio,
            ),
        )
    elif ratio > SHARPER:
        yield Concern(
            "caution",
            Message(
                "stimulus.check.steep",
                "Its edges are {ratio:.1f} times as steep as those of noise that is known to be painless. Warn the "
                "person, and begin with a smaller range.",
                ratio=ratio,
            ),
        )
    if least_n < 0.0:
        yield Concern(
            "caution",
            Message(
                "stimulus.check.pulls",
                "It pulls by up to {force:.2g} N: where the weight of the coil does not make up for that, the probe "
                "leaves the skin.",
                force=-least_n,
            ),
        )


def _sentences(found: Appraisal) -> Iterator[Message]:
    yield Message(
        "stimulus.summary.range",
        "{seconds:.2f} s, {low:.2f} to {high:.2f} N ({least:.1f} to {most:.1f} V with the coil at rest).",
        seconds=found.seconds,
        low=found.force_min_n,
        high=found.force_max_n,
        least=found.voltage_min_v,
        most=found.voltage_max_v,
    )
    if found.crest_factor is None or found.power_95_hz is None or found.power_99_hz is None:
        yield Message(
            "stimulus.summary.constant", "The force does not vary ({force:.2f} N throughout).", force=found.force_mean_n
        )
    else:
        yield Message(
            "stimulus.summary.crest",
            "About its mean of {mean:.2f} N it has {rms:.2f} N root mean square, crest factor {crest:.2f}.",
            mean=found.force_mean_n,
            rms=found.force_std_n,
            crest=found.crest_factor,
        )
        yield Message(
            "stimulus.summary.power",
            "95 % of its power ends at {most:.0f} Hz, 99 % at {nearly_all:.0f} Hz.",
            most=found.power_95_hz,
            nearly_all=found.power_99_hz,
        )
    warmth = found.heating
    yield Message(
        "stimulus.summary.current",
        "The current is {rms:.2f} A root mean square, {peak:.2f} A at its peak.",
        rms=found.rms_current_a,
        peak=found.peak_current_a,
    )
    yield Message(
        "stimulus.summary.heat",
        "The coil warms by about {expected:.1f} K ({least:.1f} to {most:.1f} K), and by no more than {bound:.1f} K.",
        expected=warmth.expected_k,
        least=warmth.least_k,
        most=warmth.most_k,
        bound=warmth.bound_k,
    )
    yield Message(
        "stimulus.summary.edge",
        "Its steepest edge is {edge:.2g} N/ms. {feel}",
        edge=found.steepest_edge_n_per_ms,
        feel=found.feel,
    )
