"""Plots of diagnoses: where the gap lies, the ranking, and recorded against simulated signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from tissueid.analysis.curves.plot import CONFIDENCE, FREQUENCY, TIME, Array, Axis, Bars, Curve, Kind, Plot
from tissueid.errors import UnusableInputError
from tissueid.formatting import label_and_unit, number
from tissueid.gap.dataset import DatasetTest
from tissueid.gap.decision import Candidate
from tissueid.gap.diagnosis import Diagnosis, Ranked
from tissueid.gap.diagnosis_content import BudgetRow, GapProfile, GapSpectrum, SignalOverlay
from tissueid.gap.error_regions import ErrorProfile, ErrorSpectrum
from tissueid.gap.preparation import BLOCK_S
from tissueid.gap.statement import GapHistory, GapHistoryEntry, effect_title
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.sessions import SIGNAL_UNITS
from tissueid.units import display_unit, fine_unit

UNITS = {
    channel: (*display_unit(SIGNAL_UNITS[channel]), *fine_unit(SIGNAL_UNITS[channel]))
    for channel in ("voltage", "current", "position")
}
"""Signal: display unit and factor from SI, then those of its residual."""
PROFILES: Mapping[str, tuple[str, Axis, float]] = {
    "depth_m": (marked("By depth"), Axis(marked("Depth"), "mm"), 1e3),
    "velocity_m_s": (marked("By velocity"), Axis(marked("Velocity, positive goes in"), "mm/s"), 1e3),
    "time_s": (marked("By time"), TIME, 1.0),
    "current_a": (marked("By current"), Axis(marked("Current"), "A"), 1.0),
    "amplitude_n": (
        marked("By the amplitude of the stimulus"),
        Axis(marked("Amplitude of the last 0.1 s"), "N"),
        1.0,
    ),
    "mains_phase_rad": (marked("By the phase of the mains"), Axis(marked("Phase"), "°"), 180.0 / np.pi),
}
"""Profile: title, abscissa, and factor from SI to its unit."""
_LINES: Mapping[str, tuple[str, str, Kind, float]] = {
    "recorded": (marked("recorded"), "muted", "line", 0.8),
    "residual": (marked("left by the baseline"), "text", "line", 1.2),
    "linear": (marked("linear"), "measured", "dashed", 0.9),
    "even": (marked("even"), "model", "dotted", 0.9),
    "odd": (marked("odd"), "good", "dashed", 0.9),
    "noise": (marked("noise alone"), "check", "dashed", 0.9),
}
"""Line of a spectrum: name, role of its colour, kind and width."""
TIMES_NOISE = marked("× noise")
_LOG_FROM = 20.0
"""Largest error, as a multiple of the noise, above which a profile has a logarithmic axis; for a history, the ratio of
the largest to the smallest gap."""
_LEAST_ERROR = 0.01
_HOURS_BELOW_S = 2.0 * 86400.0
"""Duration of a history below which its axis has hours instead of days."""
_UNSEEN = 0.95
"""A stretch that no fit has seen is held out to this share: its ends may lie a sample or two off."""
_MOVES = 0.5
"""A signal moves where its deviation is at least this share of the upper quartile over all stretches."""


def spectrum_lines(spectrum: ErrorSpectrum) -> dict[str, Array]:
    """Return the amplitude densities of a spectrum by the name of the line; NaN where they are not shown."""
    scale = UNITS[spectrum.channel][3]
    least = 0.1 * scale * float(np.sqrt(spectrum.noise[0]))
    every = {name: scale * np.sqrt(getattr(spectrum, name)) for name in _LINES}
    return {name: np.where(values >= least, values, np.nan) for name, values in every.items()}


def spectrum_plot(spectrum: GapSpectrum) -> Plot:
    """Return amplitude densities of a signal, of what the baseline leaves of it, and of its parts; bands are shaded."""
    channel, lines = spectrum.channel, spectrum.lines
    ends = np.array(spectrum.bands, dtype=np.float64).ravel()
    shade = Curve(ends, np.zeros(0), colour="poor", kind="spans", opacity=0.12)
    curves = [
        Curve(spectrum.frequency, lines[name], label, colour, kind, width=width)
        for name, (label, colour, kind, width) in _LINES.items()
    ]
    every = np.concatenate([values[np.isfinite(values)] for values in lines.values()])
    # Room for the key above the lines.
    limits = (float(every.min()), 8.0 * float(every.max())) if every.size else None
    title = Message("plot.gap_by_frequency", "By frequency, {channel}", channel=channel)
    y = Axis(label_and_unit(channel)[0], f"{UNITS[channel][2]}/√Hz", log=True, limits=limits)
    return Plot(
        title, FREQUENCY, y, (shade, *curves), note=marked("Shaded: bands that stand above the noise with significance")
    )


def gap_spectrum(spectrum: ErrorSpectrum, bands_hz: tuple[tuple[float, float], ...]) -> GapSpectrum:
    """Return the amplitude densities of a spectrum with its significant bands."""
    return GapSpectrum(spectrum.channel, spectrum.frequency_hz, spectrum_lines(spectrum), bands_hz)


def profile_values(name: str, profile: ErrorProfile) -> GapProfile:
    """Return the profile of a name in its display unit; bins without data are left out."""
    with_data = np.isfinite(profile.error)
    middle = 0.5 * PROFILES[name][2] * (profile.edges[1:] + profile.edges[:-1])
    return GapProfile(
        middle[with_data], np.maximum(profile.error[with_data], _LEAST_ERROR), np.asarray(profile.above[with_data])
    )


def profile_plot(name: str, profile: GapProfile) -> Plot:
    """Return the error along something as a multiple of the noise floor; full dots stand above it with significance."""
    title, x, _scale = PROFILES[name]
    middle, error, above = profile.middle, profile.error, profile.above
    top = float(np.max(error, initial=1.0))
    log = top > _LOG_FROM
    y = Axis(marked("Error"), TIMES_NOISE, log=log, limits=(0.5, 2.0 * top) if log else (0.0, 1.1 * top))
    if not middle.size:
        return Plot(title, x, y, missing=marked("There is no data to show."))
    parts = (
        Curve(np.zeros(1), np.ones(1), marked("noise"), "muted", "level"),
        Curve(middle, error, colour="muted", width=0.7),
        Curve(middle[~above], error[~above], colour="muted", kind="circles"),
        Curve(middle[above], error[above], marked("above noise"), "poor", "points", width=2.6),
    )
    note = marked(
        "Root-mean-square error as a multiple of the noise; 1 is what the sensors' noise alone leaves. "
        "Red: above it with significance"
    )
    return Plot(title, x, y, parts, note=note)


def overlay_plots(shown: SignalOverlay) -> tuple[Plot, Plot]:
    """Return recorded and simulated signal over a stretch that was not fitted, and what the simulation leaves."""
    unit, _scale, fine_unit, _fine = UNITS[shown.channel]
    label = label_and_unit(shown.channel)[0]
    before, after = marked("before"), marked("after")
    simulated = [Curve(shown.time, shown.before, before, "model", "dashed", width=0.8)]
    residuals = [Curve(shown.time, shown.left_before, colour="model", width=0.7)]
    if shown.after is not None:
        simulated.append(Curve(shown.time, shown.after, after, "measured", width=0.8))
    if shown.left_after is not None:
        residuals.append(Curve(shown.time, shown.left_after, colour="measured", width=0.7))
    recorded = Curve(shown.time, shown.recorded, marked("recorded"), "muted", opacity=0.55, width=2.4)
    ends = shown.time[[0, -1]]
    noise = [
        Curve(ends, np.full(2, sign * CONFIDENCE * shown.noise), name, "check", "dotted", width=0.8)
        for sign, name in ((-1.0, ""), (1.0, marked("95 % of the noise")))
    ]
    return (
        Plot(
            label,
            TIME,
            Axis(label, unit),
            (recorded, *simulated),
            note=marked("A tenth of a second of held-out data"),
        ),
        Plot(marked("Recorded less simulated"), TIME, Axis(marked("Left over"), fine_unit), (*residuals, *noise)),
    )


def overlays_of(diagnosis: Diagnosis) -> tuple[SignalOverlay, ...]:
    """Return every signal over the held-out stretch that shows the gap most, the signal with the largest gap first.

    Raises:
        UnusableInputError: every sample was fitted.
    """
    worst = diagnosis.where.regions.channel
    test, first, last = largest_held_out_error(diagnosis, worst)
    shown = slice(first, last)
    time = np.arange(first, last) / test.sample_rate_hz
    best = diagnosis.best if diagnosis.verdict != "no_gap" else None
    overlays = []
    for name in sorted(diagnosis.dataset.channels, key=lambda name: name != worst):
        _unit, scale, _fine_unit, fine = UNITS[name]
        recorded = test.signals[name][shown]
        before = _simulated(diagnosis.search_result.baseline, test, name)[shown]
        after = None if best is None else _simulated(best, test, name)[shown]
        overlays.append(
            SignalOverlay(
                name,
                time,
                scale * recorded,
                scale * before,
                None if after is None else scale * after,
                fine * (recorded - before),
                None if after is None else fine * (recorded - after),
                fine * diagnosis.dataset.noise[name],
            )
        )
    return tuple(overlays)


def _simulated(candidate: Candidate, test: DatasetTest, name: str) -> Array:
    """Return a signal of a test simulated by a candidate, shape (n,), SI."""
    tests = candidate.fit.parameters.dataset.tests
    index = next(k for k, item in enumerate(tests) if item.number == test.number)
    return candidate.fit.predictions[index][name]


def largest_held_out_error(diagnosis: Diagnosis, channel: str) -> tuple[DatasetTest, int, int]:
    """Return the test, first sample and end of the held-out block with the largest error of the baseline.

    Blocks in which the signal is almost constant are ignored: they show an offset at most.

    Raises:
        UnusableInputError: there is none.
    """
    tried: list[tuple[float, float, DatasetTest, int, int]] = []
    for test in diagnosis.dataset.tests:
        if test.quiet and len(diagnosis.dataset.tests) > 1:
            continue
        held = test.purpose > 1
        size = max(8, round(BLOCK_S * test.sample_rate_hz))
        error = (
            test.signals[channel] - _simulated(diagnosis.search_result.baseline, test, channel)
        ) / diagnosis.dataset.noise[channel]
        for start in range(0, max(1, error.size - size + 1), max(1, size // 2)):
            inside = held[start : start + size] & np.isfinite(error[start : start + size])
            if held[start : start + size].mean() < _UNSEEN or not inside.any():
                continue
            worth = float(np.sqrt(np.mean(error[start : start + size][inside] ** 2)))
            moved = float(np.std(test.signals[channel][start : start + size][inside]))
            tried.append((worth, moved, test, start, min(start + size, error.size)))
    if not tried:
        raise UnusableInputError("report.all_fitted", "every sample was fitted")
    least = _MOVES * float(np.quantile([item[1] for item in tried], 0.75))
    return max((item for item in tried if item[1] >= least), key=lambda item: item[0])[2:]


def budget_rows(diagnosis: Diagnosis) -> tuple[BudgetRow, ...]:
    """Return the bars from the gap before to the noise floor: one for each named effect, then what remains.

    Without a named effect, the gap with the best candidate takes their place.
    """
    figures = diagnosis.gap
    rows = [BudgetRow(marked("Before"), 0.0, figures.before, "model")]
    if diagnosis.budget is not None:
        before = diagnosis.budget.before
        for step in diagnosis.budget.steps:
            rows.append(BudgetRow(effect_title(step.effect), min(step.gap_after, before), before, "measured"))
            before = step.gap_after
        rows.append(BudgetRow(marked("After"), 0.0, diagnosis.budget.after, "model"))
    elif diagnosis.best is not None:
        rows.append(BudgetRow(marked("After"), 0.0, figures.after, "model"))
    rows.append(BudgetRow(marked("Noise alone"), 0.0, figures.floor, "check"))
    return tuple(row for row in rows if np.isfinite(row.high))


def ranking_plots(candidates: Sequence[Ranked]) -> tuple[Plot, Plot]:
    """Return probability and closed share of candidates; those not separable from the first share its colour."""
    rows = np.arange(len(candidates), dtype=np.float64)
    alike = np.isin([item.effect for item in candidates], [candidates[0].effect, *candidates[0].indistinguishable])
    probability = 100.0 * np.array([item.probability for item in candidates])
    closed = 100.0 * np.maximum([item.closed for item in candidates], -1.0)
    low, high = 100.0 * np.clip([item.closed_ci for item in candidates], -1.0, 1.0).T
    bars: list[Bars] = []
    curves = [Curve(np.zeros(1), np.zeros(1), "", "muted", "position", width=0.8)]
    for role, some in (("model", alike), ("measured", ~alike)):
        bars.append(Bars(rows[some], probability[some], 0.62, colour=role, across=True, opacity=0.85))
        some = some & np.isfinite(closed)
        interval = Curve(closed[some], rows[some], "", role, "bars", low[some], high[some], across=True)
        curves.append(interval)
    ticks = tuple((row, effect_title(item.effect)) for row, item in zip(rows.tolist(), candidates, strict=True))
    y = Axis(limits=(-0.5, rows.size - 0.5), reverse=True, ticks=ticks)
    least = min(-5.0, 1.05 * float(np.nanmin(low[np.isfinite(closed)], initial=0.0)))
    return (
        Plot("", Axis(marked("Probability"), "%", limits=(0.0, 100.0)), y, tuple(bars)),
        Plot("", Axis(marked("Closed"), "%", limits=(least, 102.0)), y, tuple(curves)),
    )


def budget_plot(rows: Sequence[BudgetRow]) -> Plot:
    """Return the gap budget as a waterfall, in percent of the signals' deviation."""
    names = tuple(
        Message("plot.budget_row", "{name} {percent} %", name=row.name, percent=number(100.0 * (row.high - row.low), 3))
        for row in rows
    )
    base, height = np.array([row.low for row in rows]), np.array([row.high - row.low for row in rows])
    parts = [
        Bars(
            np.zeros(0),
            np.where([row.role == role for row in rows], 100.0 * height, np.nan),
            0.6,
            colour=role,
            names=names,
            across=True,
            base=100.0 * base,
        )
        for role in ("model", "measured", "check")
        if any(row.role == role for row in rows)
    ]
    top = 105.0 * max((row.high for row in rows), default=1.0)
    return Plot(marked("Gap budget"), Axis(marked("Gap"), "%", limits=(0.0, top)), Axis(), tuple(parts))


def history_plot(history: GapHistory) -> Plot:
    """Return gap and floor of every session over time; the first session in which the gap grew is marked."""
    diagnosed = [entry for entry in history.entries if entry.answer is not None]
    title, y_axis = marked("Gap over time"), Axis(marked("Gap"), "%")
    time, x_axis = _times(diagnosed)
    if not diagnosed:
        return Plot(title, x_axis, y_axis, missing=marked("There is no data to show."))
    gap = 100.0 * np.array([entry.gap("before") for entry in diagnosed])
    floor = 100.0 * np.array([entry.gap("floor") for entry in diagnosed])
    grew = np.array([entry.grew for entry in diagnosed])
    parts = [
        Curve(time, floor, marked("noise floor"), "check", "dashed", width=0.9),
        Curve(time, gap, colour="muted", width=0.7),
        Curve(time[~grew], gap[~grew], marked("no gap"), "good", "points", width=2.6),
        Curve(time[grew], gap[grew], marked("gap"), "poor", "points", width=1.6, marker="D"),
    ]
    first = history.first_grown
    if first is not None:
        at = time[diagnosed.index(first)]
        parts.append(
            Curve(np.array([at]), np.zeros(1), marked("first session in which it grew"), "poor", "position", width=0.8)
        )
    low, high = float(np.nanmin(np.minimum(gap, floor))), float(np.nanmax(gap))
    log = low > 0.0 and high > _LOG_FROM * low
    limits = (0.7 * low, 2.0 * high) if log else (0.0, 1.25 * high)
    return Plot(title, x_axis, Axis(y_axis.label, y_axis.unit, log=log, limits=limits), tuple(parts))


def _times(entries: Sequence[GapHistoryEntry]) -> tuple[Array, Axis]:
    # Time since the first session, or the number of the session where a time is unknown.
    times = [entry.time for entry in entries]
    dated = [time for time in times if time is not None]
    if not dated or len(dated) < len(times):
        return np.arange(1.0, len(entries) + 1.0), Axis(marked("Session"))
    seconds = np.array([(time - dated[0]).total_seconds() for time in dated])
    unit, factor = ("h", 3600.0) if seconds.max() < _HOURS_BELOW_S else ("d", 86400.0)
    return seconds / factor, Axis(marked("Time since the first session"), unit)
