"""Is what was recorded the tissue's answer, or noise: noise floors, coherence, mains."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import signal

from tissueid.acquisition.quality.evidence import CUT_OFF_HZ, Array, Evidence
from tissueid.sessions.quality import QualityFinding
from tissueid.wording import fixed

LEAST_RATIO_DB, POOR_RATIO_DB = 20.0, 10.0
"""Signal over noise floor, of the position: below them the answer drowns."""
FORCE_RATIO_DB = 8.0
LEAST_COHERENCE = 0.5
"""Mean over the driven band. Skin that is tested over its whole depth has some 0.8."""
_DRIVEN = 0.03
"""Share of the greatest power density of the force from which a frequency counts as driven."""
_TOP = 0.25
"""The uppermost part of the band, where nothing but noise is left."""
_SEGMENT_S = 0.25

MAINS_HZ = (50.0, 60.0)
_HARMONICS = 3
MAINS_SHARE = 0.02
"""Amplitude of a mains line over the spread of the force."""
_NEIGHBOURS_HZ = 6.0
_SURE = 25.0
"""Power of a line over that of its neighbours: exponentially distributed, once in e^25 by chance."""


def noisy(evidence: Evidence) -> Iterator[QualityFinding]:
    """A noise floor that is high against the signal."""
    if evidence.test.kind in ("quiet", "free_air", "step_hold", "slow_ramp"):
        return
    for name, label, least, poor in (
        ("position", "position", LEAST_RATIO_DB, POOR_RATIO_DB),
        ("force", "force", FORCE_RATIO_DB, FORCE_RATIO_DB - 6.0),
    ):
        ratio = signal_to_noise_db(evidence.stimulus(name), evidence.rate)
        if ratio is None or ratio >= least:
            continue
        yield QualityFinding(
            f"noisy_{name}",
            "repeat" if ratio < poor else "look",
            f"The {label} is noisy: its signal stands {fixed(ratio, 0)} dB above the noise.",
            "Use a larger force, keep cables and phones away, and run the test again.",
            ratio,
        )


def signal_to_noise_db(values: Array, rate: float) -> float | None:
    """Spread of a signal over its white noise, dB, by the density at the top of the band; None where it is too short.

    The noise of the sensors is white and the motion is not: it has long died away there.
    """
    length = round(_SEGMENT_S * rate)
    if values.size < 4 * length:
        return None
    density = signal.welch(values, rate, nperseg=length)[1]
    top = density[round((1.0 - _TOP) * density.size) : -1]
    floor = float(np.median(top)) * rate / 2.0
    spread = float(np.var(values))
    return float(10.0 * np.log10(max(spread - floor, 1e-12 * spread) / floor)) if floor > 0.0 and spread > 0.0 else None


def incoherent(evidence: Evidence) -> Iterator[QualityFinding]:
    """Motion that the force does not explain."""
    if evidence.test.kind not in ("stochastic", "spring") or not evidence.mechanical:
        return
    found = mean_coherence(evidence)
    if found is None or found >= LEAST_COHERENCE:
        return
    yield QualityFinding(
        "incoherent",
        "look",
        f"Only {fixed(100 * found, 0)} % of the motion goes with the force, by its coherence: something else moved the "
        f"probe, or {evidence.setting.odd}.",
        evidence.setting.to_explain,
        found,
    )


def mean_coherence(evidence: Evidence) -> float | None:
    """Coherence of force and position, averaged over the power of the position where the force drives it."""
    length = round(_SEGMENT_S * evidence.rate)
    part = slice(evidence.first, None)
    if evidence.test.samples - evidence.first < 4 * length or evidence.known[part].mean() < 0.8:
        return None
    force, position = evidence.force[part], evidence.position[part]
    frequency, power = signal.welch(force, evidence.rate, nperseg=length)
    answer = signal.welch(position, evidence.rate, nperseg=length)[1]
    together = np.abs(signal.csd(force, position, evidence.rate, nperseg=length)[1]) ** 2
    driven = (frequency > 0.0) & (power > _DRIVEN * power[1:].max()) & (answer > 0.0)
    if not driven.any():
        return None
    # |S_fy|^2 / (S_ff S_yy), weighted with S_yy.
    return float(np.sum(together[driven] / power[driven]) / np.sum(answer[driven]))


def mains(evidence: Evidence) -> Iterator[QualityFinding]:
    """A line of 50 or 60 Hz, or a harmonic, that the motion does not account for."""
    test = evidence.test
    if not evidence.mechanical or test.kind not in ("stochastic", "spring", "quiet"):
        return
    part = slice(evidence.first, None)
    if not evidence.received[part].all() or test.samples - evidence.first < 2.0 * evidence.rate:
        return
    balance = unbalanced_force(evidence)
    spread = float(np.std(evidence.force[evidence.known]))
    lines = [mains_line(balance, evidence.rate, hertz) for hertz in MAINS_HZ]
    amplitude, hertz = max(lines, key=lambda line: line[0])
    share = amplitude / spread if spread > 0.0 else 0.0
    if share <= MAINS_SHARE:
        return
    yield QualityFinding(
        "mains",
        "look",
        f"The signals hold the mains at {fixed(hertz, 0)} Hz: {fixed(amplitude, 2)} N, {fixed(100 * share, 1)} % of "
        "the force's spread, that no motion accounts for.",
        "Use another socket, keep the cable away from power supplies, and check the earth of the instrument.",
        share,
    )


def unbalanced_force(evidence: Evidence) -> Array:
    """What is left of the force, N, after inertia, and damping and stiffness that follow depth and direction; (n,).

    A line in any signal that moves nothing is left over, with the stochastic motion gone that would bury it.
    """
    known = evidence.known
    depth = evidence.position - float(np.mean(evidence.position[known]))
    depth = depth / (float(np.std(depth[known])) or 1.0)
    velocity = evidence.velocity / (float(np.std(evidence.velocity[known])) or 1.0)
    inertia = evidence.acceleration / (float(np.std(evidence.acceleration[known])) or 1.0)
    powers = [depth**power for power in range(1, 5)]
    moving = [velocity * depth**power for power in range(4)]
    columns = np.column_stack(
        [np.ones(depth.size), *powers, *moving, np.abs(velocity), velocity * np.abs(velocity), inertia, inertia * depth]
    )
    found = np.linalg.lstsq(columns[known], evidence.force[known], rcond=None)[0]
    rest = evidence.force - columns @ found
    return np.asarray(rest[known], dtype=np.float64)


def mains_line(values: Array, rate: float, mains_hz: float) -> tuple[float, float]:
    """Amplitude and frequency of the strongest line at a mains frequency or its harmonics that is no chance.

    It is held against its neighbours, whose power is exponentially distributed; zero where none stands out.
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
        if power[places[near]].max() < _SURE * (np.mean(power[places[~near]]) or 1.0):
            continue
        amplitude = 2.0 * float(np.sqrt(power[places[near]].max())) / float(taper.sum())
        if amplitude > best[0]:
            best = amplitude, harmonic * mains_hz
    return best
