"""Quality checks of the signals: noise floors, coherence, mains, differences from earlier tests at this site."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import signal

from tissueid.acquisition.quality.prepared_test import CUT_OFF_HZ, Array, PreparedTest
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.sessions import Test
from tissueid.sessions.quality import QualityFinding
from tissueid.test_settings import placement

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
    coherence = mean_coherence(prepared)
    if coherence is None or coherence >= MIN_COHERENCE:
        return
    yield QualityFinding(
        "incoherent",
        "look",
        Message("quality.incoherent", prepared.texts.incoherent, percent=100 * coherence),
        prepared.texts.coherence_advice,
        coherence,
    )


def mean_coherence(prepared: PreparedTest) -> float | None:
    """Return the coherence of force and position over the driven band, weighted by the power of the position."""
    length = round(_SEGMENT_S * prepared.rate)
    part = slice(prepared.first, None)
    if prepared.test.samples - prepared.first < 4 * length or prepared.valid[part].mean() < 0.8:
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
    spread = float(np.std(prepared.force[prepared.valid]))
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
    valid = prepared.valid
    depth = prepared.position - float(np.mean(prepared.position[valid]))
    depth = depth / (float(np.std(depth[valid])) or 1.0)
    velocity = prepared.velocity / (float(np.std(prepared.velocity[valid])) or 1.0)
    inertia = prepared.acceleration / (float(np.std(prepared.acceleration[valid])) or 1.0)
    powers = [depth**power for power in range(1, 5)]
    moving = [velocity * depth**power for power in range(4)]
    columns = np.column_stack(
        [np.ones(depth.size), *powers, *moving, np.abs(velocity), velocity * np.abs(velocity), inertia, inertia * depth]
    )
    coefficients = np.linalg.lstsq(columns[valid], prepared.force[valid], rcond=None)[0]
    rest = prepared.force - columns @ coefficients
    return np.asarray(rest[valid], dtype=np.float64)


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


MAX_EARLIER = 10
"""Maximum number of earlier tests that are compared."""

UNUSUAL_SHARE, UNUSUAL_REPEAT_SHARE = 0.10, 0.40
"""Differences of two responses to one command, relative to their spread: doubtful, repeat. Usual: 4 % (thesis Table
7.1).
"""
UNUSUAL_RATIO = 3.0
"""Difference from the repeats, relative to their usual difference, above which a test is unusual."""
PARAMETER_SHARE = 0.30
"""Relative deviation of a parameter from the median of tests with other commands above which a test is unusual."""
SHIFTED_M = 0.15e-3
"""Change of the mean position, m, above which a test is unusual."""
SETTLING_M = 0.05e-3
"""Change of the mean position from test to test, m, that is reported as settling."""
SETTLING_SHARE = 0.02
"""The same, relative to the depth."""

_STEP = 4
"""Decimation of the compared responses, still faster than any motion."""
_PARAMETERS = {
    "mass": marked("The mass differs by {percent:.0f} % from that of {count} earlier tests at this site."),
    "damping": marked("The damping differs by {percent:.0f} % from that of {count} earlier tests at this site."),
    "stiffness": marked("The stiffness differs by {percent:.0f} % from that of {count} earlier tests at this site."),
}
_DEEPER, _LESS_DEEP = marked("deeper"), marked("less deep")


@dataclass(frozen=True, eq=False)
class QuickFit:
    """Mass, kg, damping, N s/m, and stiffness, N/m, from a fast fit that is accurate enough to compare tests."""

    mass: float
    damping: float
    stiffness: float


def quick_fit(prepared: PreparedTest) -> QuickFit | None:
    """Fit force = M a + B v + K x + constant to the filtered signals; return None if the fit is not determined."""
    if not prepared.mechanical:
        return None
    valid = prepared.valid
    columns = np.column_stack(
        [prepared.acceleration[valid], prepared.velocity[valid], prepared.position[valid], np.ones(valid.sum())]
    )
    scale = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    if not np.all(scale > 0.0):
        return None
    columns /= scale
    coefficients, _, rank, _ = np.linalg.lstsq(columns, prepared.force[valid], rcond=None)
    if rank < scale.size:
        return None
    mass, damping, stiffness, _ = coefficients / scale
    return QuickFit(float(mass), float(damping), float(stiffness))


def comparable_tests(test: Test, earlier: Sequence[Test]) -> list[Test]:
    """Return the newest completed earlier tests of the same site, kind, configuration and sample rate."""
    same = [
        other
        for other in earlier
        if (other.site, other.kind, other.configuration) == (test.site, test.kind, test.configuration)
        and placement(other.notes) == placement(test.notes)
        and other.status == "completed"
        and other.sample_rate_hz == test.sample_rate_hz
        and other.number != test.number
    ]
    return same[-MAX_EARLIER:]


def tests_with_same_command(test: Test, others: Sequence[Test]) -> list[Test]:
    """Return the tests that played the same command."""
    command = test.signals.get("command")
    if command is None:
        return []
    repeats = []
    for other in others:
        theirs = other.signals.get("command")
        if theirs is None or theirs.shape != command.shape:
            continue
        there = np.isfinite(command) & np.isfinite(theirs)
        if there.any() and np.max(np.abs(command[there] - theirs[there])) < 1e-6 + 1e-3 * np.ptp(command[there]):
            repeats.append(other)
    return repeats


def check_against_earlier(prepared: PreparedTest, others: Sequence[Test]) -> Iterator[QualityFinding]:
    """Report differences from the earlier tests at this site."""
    if not others or "position" not in prepared.test.signals:
        return
    repeats = tests_with_same_command(prepared.test, others)
    if repeats:
        yield from _against_repeats(prepared, repeats)
    elif len(others) > 1:
        yield from _against_parameters(prepared, others)


def _against_repeats(prepared: PreparedTest, repeats: Sequence[Test]) -> Iterator[QualityFinding]:
    """Compare the responses to the same command."""
    responses = [
        np.asarray(test.signals["position"][prepared.first :: _STEP], dtype=np.float64)
        for test in (*repeats, prepared.test)
    ]
    spread = float(np.nanstd(responses[-1])) or 1.0
    levels = [float(np.nanmean(response)) for response in responses]
    settling = _settling(prepared, levels)
    if settling is not None:
        yield settling
    elif (shifted := _shifted(prepared, levels)) is not None:
        yield shifted
    shapes = [response - np.nanmean(response) for response in responses]
    mine = float(np.median([_difference(shapes[-1], other) for other in shapes[:-1]])) / spread
    pairs = [
        _difference(a, b) / spread for index, a in enumerate(shapes[:-1]) for b in shapes[index + 1 : len(repeats)]
    ]
    usual = float(np.median(pairs)) if pairs else 0.0
    if mine > max(UNUSUAL_SHARE, UNUSUAL_RATIO * usual):
        percent, count = 100 * mine, len(repeats)
        if not pairs:
            message = Message(
                "quality.unusual.response",
                "The response differs by {percent:.0f} % from that of the earlier test with the same command at this "
                "site.",
                percent=percent,
                count=count,
            )
        else:
            message = Message(
                "quality.unusual.response",
                "The response differs by {percent:.0f} % from {count} earlier tests with the same command at this "
                "site, which differ from each other by {usual:.0f} %.",
                percent=percent,
                count=count,
                usual=100 * usual,
            )
        yield QualityFinding(
            "unusual",
            "repeat" if mine > UNUSUAL_REPEAT_SHARE else "look",
            message,
            prepared.texts.unusual_advice,
            mine,
        )


def _settling(prepared: PreparedTest, levels: Sequence[float]) -> QualityFinding | None:
    """Yield a finding when the mean depth changes from test to test, as in settling tissue (thesis Fig. 7.4)."""
    surface = prepared.test.surface_position_m
    depth = levels[-1] - surface if np.isfinite(surface) else np.inf
    steps = np.diff(levels)
    last = float(steps[-1])
    least = max(SETTLING_M, SETTLING_SHARE * depth if np.isfinite(depth) else 0.0)
    if abs(last) < least:
        return None
    calmer = len(steps) == 1 or bool(np.sign(steps[-2]) == np.sign(last) and abs(last) <= abs(steps[-2]))
    if not calmer:
        return None
    earlier = marked("the first test at this site") if len(steps) == 1 else marked("the test before")
    return QualityFinding(
        "settling",
        "look",
        Message(
            "quality.settling",
            prepared.texts.settling,
            size=1e3 * abs(last),
            direction=_DEEPER if last > 0 else _LESS_DEEP,
            earlier=earlier,
        ),
        prepared.texts.settling_advice,
        abs(last),
    )


def _shifted(prepared: PreparedTest, levels: Sequence[float]) -> QualityFinding | None:
    """Yield a finding when the mean position differs from all earlier repeats by more than they differ
    from each other.
    """
    before = np.array(levels[:-1])
    off = float(levels[-1] - np.median(before))
    if before.size < 2 or abs(off) <= max(SHIFTED_M, UNUSUAL_RATIO * float(np.ptp(before))):
        return None
    return QualityFinding(
        "unusual",
        "look",
        Message(
            "quality.unusual.position",
            "The mean probe position was {size:.2f} mm {direction} than in {count} earlier tests with the same command "
            "at this site.",
            size=1e3 * abs(off),
            direction=_DEEPER if off > 0 else _LESS_DEEP,
            count=int(before.size),
        ),
        prepared.texts.unusual_advice,
        abs(off),
    )


def _difference(a: Array, b: Array) -> float:
    return float(np.sqrt(np.nanmean((a - b) ** 2)))


def _against_parameters(prepared: PreparedTest, others: Sequence[Test]) -> Iterator[QualityFinding]:
    """Compare mass, damping and stiffness of quick fits with tests of other commands and similar loads."""
    mine = quick_fit(prepared)
    if mine is None:
        return
    load = _load(prepared)
    fits = []
    for other in others:
        theirs = PreparedTest(other, prepared.device)
        if theirs.mechanical and np.allclose(_load(theirs), load, rtol=0.1, atol=0.2):
            fits.append(quick_fit(theirs))
    determined = [fit for fit in fits if fit is not None]
    if len(determined) < 2:
        return
    for name, template in _PARAMETERS.items():
        values = np.array([getattr(fit, name) for fit in determined])
        middle = float(np.median(values))
        deviation = 1.4826 * float(np.median(np.abs(values - middle)))
        off = abs(getattr(mine, name) - middle)
        if middle > 0.0 and off > max(PARAMETER_SHARE * middle, 5.0 * deviation):
            yield QualityFinding(
                "unusual",
                "look",
                Message(f"quality.unusual.{name}", template, percent=100 * off / middle, count=len(determined)),
                prepared.texts.unusual_advice,
                off / middle,
            )


def _load(prepared: PreparedTest) -> Array:
    """Return mean and standard deviation of the force, N, shape (2,)."""
    force = prepared.stimulus("force")
    return np.array([force.mean(), force.std()]) if force.size else np.full(2, np.nan)
