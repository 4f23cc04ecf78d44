"""Quality checks of the signals: noise floors, coherence, mains."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import signal

from tissueid.acquisition.quality.prepared_test import CUT_OFF_HZ, Array, PreparedTest
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.sessions.quality import QualityFinding

MIN_RATIO_DB, POOR_RATIO_DB = 20.0, 10.0
"""Signal-to-noise ratios of the position, dB, below which a test is doubtful or should be repeated."""
FORCE_RATIO_DB = 8.0
"""Signal-to-noise ratio of the force, dB, below which a test is doubtful."""
MIN_COHERENCE = 0.5
"""Mean coherence over the driven band below which a test is doubtful. Skin over its full depth: about 0.8."""
_DRIVEN_SHARE = 0.03
"""Power density of the force, relative to its maximum, above which a frequency counts as driven."""
_NOISE_BAND = 0.25
"""Share of the band at its upper end that contains only noise."""
_SEGMENT_S = 0.25
"""Length of the segments of the spectral estimates, s."""

MAINS_HZ = (50.0, 60.0)
"""Mains frequencies that are searched."""
_HARMONICS = 3
"""Number of mains harmonics that are searched."""
MAINS_SHARE = 0.02
"""Amplitude of a mains line, relative to the standard deviation of the force, above which it is reported."""
_NEIGHBOURS_HZ = 6.0
"""Half-width of the band, Hz, whose mean power is the reference for a line."""
_LINE_RATIO = 25.0
"""Threshold of the power of a line relative to the mean of its neighbours; noise exceeds it with probability e^-25."""


def check_noise(prepared: PreparedTest) -> Iterator[QualityFinding]:
    """Report a high noise floor."""
    if prepared.test.kind in ("quiet", "free_air", "step_hold", "slow_ramp"):
        return
    for name, label, least, poor in (
        ("position", marked("position"), MIN_RATIO_DB, POOR_RATIO_DB),
        ("force", marked("force"), FORCE_RATIO_DB, FORCE_RATIO_DB - 6.0),
    ):
        ratio = signal_to_noise_db(prepared.stimulus(name), prepared.rate)
        if ratio is None or ratio >= least:
            continue
        yield QualityFinding(
            f"noisy_{name}",
            "repeat" if ratio < poor else "look",
            Message(
                "quality.noisy",
                "The {signal} signal is noisy: its signal-to-noise ratio is {ratio:.0f} dB.",
                signal=label,
                ratio=ratio,
            ),
            marked("Use a larger force, keep cables and phones away, and run the test again."),
            ratio,
        )


def signal_to_noise_db(values: Array, rate: float) -> float | None:
    """Return the signal-to-noise ratio, dB; None for a short signal.

    The white sensor noise is estimated from the power density at the top of the band, where there is no motion.
    """
    length = round(_SEGMENT_S * rate)
    if values.size < 4 * length:
        return None
    density = signal.welch(values, rate, nperseg=length)[1]
    top = density[round((1.0 - _NOISE_BAND) * density.size) : -1]
    floor = float(np.median(top)) * rate / 2.0
    spread = float(np.var(values))
    return float(10.0 * np.log10(max(spread - floor, 1e-12 * spread) / floor)) if floor > 0.0 and spread > 0.0 else None


def check_coherence(prepared: PreparedTest) -> Iterator[QualityFinding]:
    """Report motion that the force does not explain."""
    if prepared.test.kind not in ("stochastic", "spring") or not prepared.mechanical:
        return
    found = mean_coherence(prepared)
    if found is None or found >= MIN_COHERENCE:
        return
    yield QualityFinding(
        "incoherent",
        "look",
        Message("quality.incoherent", prepared.texts.incoherent, percent=100 * found),
        prepared.texts.coherence_advice,
        found,
    )


def mean_coherence(prepared: PreparedTest) -> float | None:
    """Return the coherence of force and position over the driven band, weighted by the power of the position."""
    length = round(_SEGMENT_S * prepared.rate)
    part = slice(prepared.first, None)
    if prepared.test.samples - prepared.first < 4 * length or prepared.known[part].mean() < 0.8:
        return None
    force, position = prepared.force[part], prepared.position[part]
    frequency, power = signal.welch(force, prepared.rate, nperseg=length)
    answer = signal.welch(position, prepared.rate, nperseg=length)[1]
    together = np.abs(signal.csd(force, position, prepared.rate, nperseg=length)[1]) ** 2
    driven = (frequency > 0.0) & (power > _DRIVEN_SHARE * power[1:].max()) & (answer > 0.0)
    if not driven.any():
        return None
    # |S_fy|^2 / (S_ff S_yy), weighted with S_yy.
    return float(np.sum(together[driven] / power[driven]) / np.sum(answer[driven]))


def check_mains(prepared: PreparedTest) -> Iterator[QualityFinding]:
    """Report a line at 50 or 60 Hz, or a harmonic, that the motion does not explain."""
    test = prepared.test
    if not prepared.mechanical or test.kind not in ("stochastic", "spring", "quiet"):
        return
    part = slice(prepared.first, None)
    if not prepared.received[part].all() or test.samples - prepared.first < 2.0 * prepared.rate:
        return
    balance = unbalanced_force(prepared)
    spread = float(np.std(prepared.force[prepared.known]))
    lines = [mains_line(balance, prepared.rate, hertz) for hertz in MAINS_HZ]
    amplitude, hertz = max(lines, key=lambda line: line[0])
    share = amplitude / spread if spread > 0.0 else 0.0
    if share <= MAINS_SHARE:
        return
    yield QualityFinding(
        "mains",
        "look",
        Message(
            "quality.mains",
            "The signals contain mains interference at {hertz:.0f} Hz: {newtons:.2f} N, {percent:.1f} % of the force's "
            "standard deviation.",
            hertz=hertz,
            newtons=amplitude,
            percent=100 * share,
        ),
        marked("Use another socket, keep the cable away from power supplies, and check the earth of the instrument."),
        share,
    )


def unbalanced_force(prepared: PreparedTest) -> Array:
    """Return the residual force, N, (n,), after subtracting inertia and depth- and direction-dependent damping and
    stiffness.

    Removing the stochastic part exposes a line that does not move the probe.
    """
    known = prepared.known
    depth = prepared.position - float(np.mean(prepared.position[known]))
    depth = depth / (float(np.std(depth[known])) or 1.0)
    velocity = prepared.velocity / (float(np.std(prepared.velocity[known])) or 1.0)
    inertia = prepared.acceleration / (float(np.std(prepared.acceleration[known])) or 1.0)
    powers = [depth**power for power in range(1, 5)]
    moving = [velocity * depth**power for power in range(4)]
    columns = np.column_stack(
        [np.ones(depth.size), *powers, *moving, np.abs(velocity), velocity * np.abs(velocity), inertia, inertia * depth]
    )
    found = np.linalg.lstsq(columns[known], prepared.force[known], rcond=None)[0]
    rest = prepared.force - columns @ found
    return np.asarray(rest[known], dtype=np.float64)


def mains_line(values: Array, rate: float, mains_hz: float) -> tuple[float, float]:
    """Return amplitude and frequency of the strongest significant line at a mains frequency or harmonic.

    A line is compared with the mean power of its neighbours. The amplitude is 0 without a significant line.
    """
    taper = signal.get_window("hann", values.size)
    power = np.abs(np.fft.rfft((values - values.mean()) * taper)) ** 2
    width = rate / values.size
    best = 0.0, mains_hz
    for harmonic in range(1, _HARMONICS + 1):
        centre = round(harmonic * mains_hz / width)
        reach, line = round(_NEIGHBOURS_HZ / width), 2
        if harmonic * mains_hz > CUT_OFF_HZ or centre + reach >= power.size or reach <= 2 * line:
            continue
        places = np.arange(centre - reach, centre + reach + 1)
        near = np.abs(places - centre) <= line
        if power[places[near]].max() < _LINE_RATIO * (np.mean(power[places[~near]]) or 1.0):
            continue
        amplitude = 2.0 * float(np.sqrt(power[places[near]].max())) / float(taper.sum())
        if amplitude > best[0]:
            best = amplitude, harmonic * mains_hz
    return best
