"""Mains hum in the channels: 50 or 60 Hz and harmonics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy import fft, optimize

from tissueid.messages import Message
from tissueid.twin import _estimates
from tissueid.twin.effect import ActsOn, Effect, FloatArray, Parameter, Readings

HARMONICS = (1, 2, 3, 5)
CHANNELS = (("voltage", "V", 2e-3, 5.0), ("current", "A", 1e-3, 0.5), ("position", "m", 2e-6, 2e-3))
"""Name, unit, noise (the weight of the channel) and largest amplitude."""
BANDS_HZ = ((49.0, 51.0), (59.0, 61.0))
PER_TEST = 1 + len(HARMONICS)
PADDING = 8


def recording(readings: Readings, values: FloatArray) -> Readings:
    """Add two quadratures for each channel and harmonic, relative to the phase of the test."""
    frequency, phases, heights = values[0], values[1:PER_TEST], values[PER_TEST:].reshape(len(CHANNELS), -1)
    angle = 2.0 * np.pi * frequency * readings.time
    turned = [h * angle + phase for h, phase in zip(HARMONICS, phases, strict=True)]
    hum = heights @ np.stack([wave(turned_phase) for turned_phase in turned for wave in (np.cos, np.sin)])
    return replace(
        readings,
        voltage=readings.voltage + hum[0],
        current=readings.current + hum[1],
        position=readings.position + hum[2],
    )


def estimate_from_record(signals: Mapping[str, FloatArray], sample_rate_hz: float) -> Mapping[str, float]:
    """Return frequency and phases of the lines in the unexplained part of all channels, weighted by their noise.

    The sum over channels has a constant phase to each channel, whichever channels hum.
    """
    residuals = [_estimates.unexplained(signals, name, sample_rate_hz) / noise for name, _, noise, _ in CHANNELS]
    size = residuals[0].size
    time = np.arange(1, size + 1) / sample_rate_hz
    points = fft.next_fast_len(PADDING * size, real=True)
    spectra = [np.abs(fft.rfft(residual, points)) ** 2 for residual in residuals]
    usable = [h for h in HARMONICS if h * BANDS_HZ[-1][1] < 0.5 * sample_rate_hz]
    candidates = np.concatenate([np.linspace(low, high, 201) for low, high in BANDS_HZ])
    bins = [np.round(h * candidates * points / sample_rate_hz).astype(np.int64) for h in usable]
    power = sum((spectrum[at] for spectrum in spectra for at in bins), np.zeros(candidates.size))
    near = float(candidates[int(np.argmax(power))])

    def amplitudes(frequency: float) -> FloatArray:
        # Complex amplitudes, shape (channels, harmonics), as real and imaginary parts.
        columns = _estimates.waves(2.0 * np.pi * frequency * time, usable)
        return np.stack([columns.T @ residual for residual in residuals]) * (2.0 / size)

    optimum = optimize.minimize_scalar(
        lambda f: -float(np.sum(amplitudes(float(f)) ** 2)),
        bounds=(near - 0.15, near + 0.15),
        method="bounded",
        options={"xatol": 1e-4},
    )
    total = amplitudes(float(optimum.x)).sum(axis=0)
    start = {"frequency_hz": float(optimum.x)} | {f"phase_{h}_rad": 0.0 for h in HARMONICS}
    for k, h in enumerate(usable):
        start[f"phase_{h}_rad"] = float(np.arctan2(-total[2 * k + 1], total[2 * k]))
    return start


def _phase(harmonic: int) -> Message:
    return Message("effect.hum_phase", "phase of harmonic {number} at the start of the test", number=harmonic)


def _amplitude(part: str, harmonic: int, channel: str) -> Message:
    values = {"number": harmonic, "channel": channel}
    if part == "cosine":
        return Message("effect.hum_cosine", "cosine amplitude of harmonic {number} in the {channel}", **values)
    return Message("effect.hum_sine", "sine amplitude of harmonic {number} in the {channel}", **values)


EFFECT = Effect(
    name="mains_hum",
    stage="environment",
    acts_on=ActsOn.CHANNELS,
    title="Mains hum on the channels",
    equation="channel + sum over h = 1, 2, 3, 5 of a cos(h w t + phase) + b sin(h w t + phase), w = 2 pi 50 or 60 "
    "Hz; vanishes with every a = b = 0",
    signature="sharp lines at 50 or 60 Hz and twice, three and five times that, in quiet tests as well, unrelated to "
    "the command; each channel has its own strength, every test its own phase",
    source="Pintelon & Schoukens, System Identification: A Frequency Domain Approach (2012), ch. 2; Horowitz & Hill, "
    "The Art of Electronics (2015), ch. 8",
    parameters=(
        Parameter(
            "frequency_hz", "Hz", None, 48.5, 61.5, per_test=True, fixed=True, meaning="estimated from the record"
        ),
        *(
            Parameter(f"phase_{h}_rad", "rad", None, -4.0, 4.0, per_test=True, fixed=True, meaning=_phase(h))
            for h in HARMONICS
        ),
        *(
            Parameter(f"{name}_{part}_{h}", unit, 0.0, -most, most, meaning=_amplitude(part, h, name))
            for name, unit, _, most in CHANNELS
            for h in HARMONICS
            for part in ("cosine", "sine")
        ),
    ),
    starts=tuple((hertz,) + (0.0,) * (len(HARMONICS) + 2 * len(CHANNELS) * len(HARMONICS)) for hertz in (50.0, 60.0)),
    mistaken_for=("physiological_motion", "mount_resonance"),
    recording=recording,
    needs=frozenset({"voltage", "current", "position"}),
    estimate_from_record=estimate_from_record,
    jointly=True,
    remedy="Break ground loops, twist and screen the leads, keep them away from transformers.",
)
