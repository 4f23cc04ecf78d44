"""Recipes of chapter 6: inputs with given properties, online identification, feedback of the distribution."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from tissueid.analysis.curves.depth import profile_plots
from tissueid.analysis.curves.feedback import (
    THESIS_MASS_KG,
    FeedbackRun,
    profiles_of,
    response_by_depth,
    response_over_time,
    series_plots,
    settling_plot,
    settling_times,
)
from tissueid.analysis.curves.plot import Plot
from tissueid.analysis.curves.signals import amplitude_plots, autocorrelation_plots, power_plot, swaps_plot
from tissueid.analysis.curves.validation import held_out_prediction, scatter_plots
from tissueid.analysis.overlay import Overlay
from tissueid.formatting import fixed, grouped, number
from tissueid.identification.engines.als import AlsModel
from tissueid.identification.engines.dpn import Dpn
from tissueid.language import marked
from tissueid.reports.overlay_page import DrawnFigures
from tissueid.reports.stimulus_page import REPORT_NOTE, feedback_panels, feedback_run
from tissueid.sessions import Session
from tissueid.stimuli.interchange import autocorrelation, interchange
from tissueid.stimuli.kinds.interchange import Interchange
from tissueid_lab.thesis.comparisons import DPN, LINEAR, POSTERIOR, SITES, WIENER
from tissueid_lab.thesis.computing_times import autocorrelation_times, time_plot
from tissueid_lab.thesis.kernels import LARGE
from tissueid_lab.thesis.recipe import (
    NumberRow,
    Outcome,
    RecipeSource,
    Recording,
    ThesisFigure,
    drawn_grid,
    entry_of,
    fitted,
    percent,
)

_UNIFORM = Interchange(
    spectrum="band", cutoff_hz=200.0, seconds=5.0, lags=500, tolerance=1e-6, force_min_n=0.5, force_max_n=10.5
)
"""10,000 uniform samples with a cutoff of 200 Hz at 2 kHz (Fig. 6.1)."""
_GRID = 1 << 13
_SIZES, _QUICK_SIZES = (500, 1000, 2000, 5000, 10_000, 20_000, 50_000), (500, 1000, 2000)
_TRIALS, _QUICK_TRIALS = 1_000_000, 50_000
"""Pairs that the search of Fig. 6.2b draws, as published: from scrambled samples, both at random."""
_ONE = (RecipeSource(SITES[POSTERIOR], LARGE),)
_FEEDBACK_S = 5.0
_LABELS = {LINEAR: "linear", WIENER: "Wiener", DPN: "DPN"}
_RANGES_M = {LINEAR: (0.0005, 0.002), WIENER: (0.001, 0.004), DPN: (0.0005, 0.0028)}
"""Desired depths on each system, m: what it reaches with forces up to 10 N."""
_GAINS_N_PER_M = {LINEAR: 4670.0, WIENER: 1200.0, DPN: 2500.0}
"""Assumed mean stiffness without identification: of the linear preset, and those of the thesis."""


def _given_input(_quick: bool) -> Outcome:
    """Return an input with a given distribution and autocorrelation (Fig. 6.1)."""
    Interchange(seconds=0.5, lags=50, tolerance=1e-9, max_trials=500).design()  # compiled before the clock starts
    begin = time.perf_counter()
    search = _UNIFORM.design()
    seconds = time.perf_counter() - begin
    stimulus = _UNIFORM.stimulus_from(search)
    target = _UNIFORM.build_spectrum().autocorrelation(_UNIFORM.lags, _UNIFORM.sample_rate)
    wanted = _UNIFORM.build_spectrum().power(_GRID, _UNIFORM.sample_rate)
    hz = np.asarray(np.fft.rfftfreq(_GRID, 1.0 / _UNIFORM.sample_rate), dtype=np.float64)
    exact = bool(np.array_equal(np.sort(search.values), _UNIFORM.build_distribution().levels(_UNIFORM.samples)))
    plots = (
        *amplitude_plots(stimulus.values, "N"),
        power_plot(stimulus.values, stimulus.sample_rate_hz, "N", (hz, wanted)),
        *autocorrelation_plots(autocorrelation(stimulus.values, 100), stimulus.sample_rate_hz, target[:101]),
    )
    rows = [
        NumberRow(marked("distribution"), marked("the desired one"), marked("exact") if exact else marked("not exact")),
        NumberRow(
            marked("sum of squared errors of the autocorrelation over 500 lags"),
            marked("levels off"),
            number(search.error, 2),
        ),
        NumberRow(marked("swaps tried for 10,000 samples"), marked("over one million"), grouped(search.tried)),
        NumberRow(marked("time"), "1800 s", f"{fixed(seconds, 2)} s"),
    ]
    return drawn_grid(
        "input",
        marked("Input with a given distribution and autocorrelation"),
        marked("Distribution, spectrum and autocorrelation of the input, with their targets."),
        [plots[:3], plots[3:]],
        row_height=2.9,
    ), rows


def _autocorrelation_speed(quick: bool) -> Outcome:
    """Return times of an autocorrelation by four methods, and the levelling of the error (Fig. 6.2)."""
    timings = autocorrelation_times(_QUICK_SIZES if quick else _SIZES)
    start = np.random.Generator(np.random.PCG64(1)).permutation(_UNIFORM.build_distribution().levels(_UNIFORM.samples))
    target = _UNIFORM.build_spectrum().autocorrelation(_UNIFORM.lags, _UNIFORM.sample_rate)
    trials = _QUICK_TRIALS if quick else _TRIALS
    search = interchange(start, target, tolerance=1e-6, max_trials=trials, seed=2, guided=False)
    said = {
        "direct": marked("n²"),
        "transform": marked("n^0.7 (xcorr)"),
        "swap, all lags": marked("n, less overhead than xcorr"),
        "swap, 500 lags": marked("constant"),
        "swap, compiled": marked("not in the thesis"),
    }
    rows = [
        NumberRow(
            f"time of {timing.method}, power of n; at {grouped(timing.sizes[-1])} samples",
            said[timing.method],
            f"{fixed(timing.power, 2)}; {number(1e6 * timing.seconds[-1], 3)} µs",
        )
        for timing in timings
    ]
    history = search.history
    tenth = history[np.searchsorted(history[:, 0], 0.1 * trials), 2]
    rows.append(
        NumberRow(
            f"error before, after a tenth of {grouped(trials)} drawn pairs, after all",
            marked("falls fast, then levels"),
            ", ".join(number(float(error), 2) for error in (history[0, 2], tenth, history[-1, 2])),
        )
    )
    return drawn_grid(
        "autocorrelation",
        marked("Time of an autocorrelation by method, and error over swaps"),
        marked("Seconds against samples for each method, and sum of squared differences against accepted swaps."),
        [(time_plot(timings, marked("Samples")), swaps_plot(search))],
        row_height=3.6,
    ), rows


# -- identification while a test runs ---------------------------------------------------------------------------------

_ONLINE = (
    ("LMS", "73.8 %", "6.78e4", marked("about the length of the test")),
    ("RLS", "72.0 %", "6.79e4", marked("too long")),
    ("ALS", "86.7 %", "4.15e6", marked("viable in real time")),
)
"""Engine, VAF, AIC and time in the thesis (6.2)."""


def _online(overlay: Overlay) -> Outcome:
    rows = []
    for fit, vaf, aic, said in _ONLINE:
        report = entry_of(overlay, fit=fit).analysis.model.report
        tracked = report.details.get("vaf_tracking_percent")  # with the responses that followed the position
        followed = fit == "ALS" and tracked is not None
        rows.append(NumberRow(f"VAF, {fit}", vaf, percent(tracked if followed and tracked else report.vaf_percent)))
        if report.aic is not None:
            shifted = report.aic + report.n_samples * float(np.log(1e6))
            if followed:
                shifted += 2.0 * (report.details["n_parameters_tracking"] - report.n_parameters)
            rows.append(NumberRow(f"AIC, positions in mm, {fit}", aic, number(shifted, 3)))
        rows.append(NumberRow(f"time for a test of 4 s, {fit}", said, f"{fixed(report.seconds or float('nan'), 2)} s"))
    runs = [held_out_prediction(fit, entry_of(overlay, fit=fit).analysis) for fit, *_ in _ONLINE]
    return drawn_grid(
        "residual",
        marked("Measured against predicted position"),
        marked("Measured against predicted position for LMS, RLS and ALS."),
        [scatter_plots(runs)],
        row_height=3.2,
    ), rows


def _adaptive(overlay: Overlay) -> Outcome:
    model, record, part = fitted(overlay, AlsModel)
    peaks = 1e3 * model.depth_response.max(axis=1)
    at = 1e3 * model.lag_s[model.depth_response.argmax(axis=1)]
    return drawn_grid(
        "adaptive",
        marked("Impulse response over time and by depth"),
        marked("Position and impulse response over time; impulse responses averaged by depth."),
        [response_over_time(model, record), response_by_depth(model, record, record.output[part])],
        row_height=3.2,
    ), [
        NumberRow(
            marked("peak of the response, shallowest and deepest"),
            marked("stiffer and more damped with depth"),
            f"{fixed(float(peaks[0]), 0)} mm/(N·s) at {fixed(float(at[0]), 1)} ms and "
            f"{fixed(float(peaks[-1]), 0)} mm/(N·s) at {fixed(float(at[-1]), 1)} ms",
        )
    ]


# -- feedback of the distribution -------------------------------------------------------------------------------------


def _settling(_quick: bool) -> Outcome:
    """Return the settling time by stiffness and damping (Fig. 6.6)."""
    damping, stiffness = np.linspace(0.5, 40.0, 80), np.array([500.0, 1000.0, 2000.0, 4000.0])
    shortest = 1e3 * settling_times(THESIS_MASS_KG, damping, stiffness).min(axis=0)
    return drawn_grid(
        "settling",
        marked("Settling time"),
        marked("A map of the settling time by stiffness and damping."),
        [[settling_plot()]],
        row_height=3.8,
    ), [
        NumberRow(
            marked("shortest 5 % settling time at 500, 1000, 2000, 4000 N/m"),
            marked("about 60 ms in the dark region, at least 25 ms in practice"),
            f"{', '.join(fixed(float(value), 0) for value in shortest)} ms",
        )
    ]


def _feedback(
    sessions: Mapping[str, Session], cycles: Mapping[str, str], share: str, near: Mapping[str, str]
) -> Outcome:
    runs, rows, shares = [], [], []
    for label, session in sessions.items():
        test = session.test(1)
        run = feedback_run(test, label)
        runs.append(run)
        report = json.loads(str(test.notes[REPORT_NOTE]))
        length = run.force.size / run.sample_rate_hz / max(float(report["cycles"]), 0.5)
        rows.append(NumberRow(f"{label}: distance of the depths from uniform", near[label], fixed(run.distance, 3)))
        rows.append(NumberRow(f"{label}: length of a cycle", cycles[label], f"{fixed(length, 2)} s"))
        shares.append(100.0 * float(test.notes.get("generating_share", float("nan"))))
    rows.append(NumberRow(marked("computing time relative to the test"), share, percent(max(shares))))
    shown = ("feedback-series", "feedback-distributions")
    pictures = tuple(panel.picture() for panel in feedback_panels(runs) if panel.key in shown)
    return DrawnFigures(pictures, tuple(plot for run in runs for plot in _named(run, series_plots(run)))), rows


def _named(run: FeedbackRun, plots: Sequence[Plot]) -> list[Plot]:
    """Return plots with the label of their run before the name of each part."""
    return [
        replace(plot, parts=tuple(replace(part, name=f"{run.label} {part.name}".strip()) for part in plot.parts))
        for plot in plots
    ]


def _identified(sessions: Mapping[str, Session]) -> Outcome:
    """Return the parameters that the feedback loop identified, and those of ``dpn`` from the same test (Fig. 6.12)."""
    said = {
        "linear": marked("no variation with depth"),
        "Wiener": marked("all three vary alike"),
        "DPN": marked("each varies in its own way"),
    }
    runs = [feedback_run(session.test(1), label) for label, session in sessions.items()]
    rows = []
    for run in runs:
        if run.profile is None:
            continue
        fitted = Dpn().fit(run.record).depth_profile()
        for name, p in (("loop", run.profile), ("dpn", fitted)):
            if p is None:
                continue
            ratios = [fixed(float(values[-1] / values[0]), 1) for values in (p.mass, p.damping, p.stiffness)]
            masses = f"{fixed(1e3 * float(np.nanmin(p.mass)), 0)} to {fixed(1e3 * float(np.nanmax(p.mass)), 0)} g"
            what = f"{run.label}, {name}: M, B, K at the deepest over the shallowest level; M"
            rows.append(NumberRow(what, said[run.label], f"{', '.join(ratios)}; {masses}"))
    pictures = tuple(panel.picture() for panel in feedback_panels(runs) if panel.key == "feedback-parameters")
    return DrawnFigures(pictures, profile_plots(profiles_of(runs))), rows


def _systems(name: str, gains: Mapping[str, float] | None = None, **options: object) -> tuple[RecipeSource, ...]:
    return tuple(
        RecipeSource(
            label,
            Recording(
                f"{preset}-{name}",
                preset,
                (-0.6, 10.0),
                _FEEDBACK_S,
                options=(
                    *options.items(),
                    *zip(("depth_min_m", "depth_max_m"), _RANGES_M[preset], strict=True),
                    *((("gain_n_per_m", gains[preset]),) if gains else ()),
                ),
                stimulus="rtig",
            ),
        )
        for preset, label in _LABELS.items()
    )


_IDENTIFYING = _systems("identifying", cycle=0.2)
INPUT_FIGURES: tuple[ThesisFigure, ...] = (
    ThesisFigure("6.1", marked("Input with a given distribution and autocorrelation"), study=_given_input),
    ThesisFigure(
        "6.2", marked("Time of an autocorrelation by method, and error over swaps"), study=_autocorrelation_speed
    ),
    ThesisFigure(
        "6.3",
        marked("LMS, RLS and ALS side by side"),
        _ONE,
        ("LMS=lms,memory=0.125", "RLS=rls,memory=0.125", "ALS=als,memory=0.125,step=1"),
        ("responses",),
        drawn=_online,
    ),
    ThesisFigure(
        "6.4",
        marked("Impulse response by ALS over time and by depth"),
        _ONE,
        ("als,memory=0.125,step=1",),
        drawn=_adaptive,
    ),
    ThesisFigure("6.6", marked("Settling time by stiffness and damping"), study=_settling),
    ThesisFigure(
        "6.7",
        marked("Feedback of the distribution without identification, three systems (Figs. 6.7 and 6.8)"),
        _systems("feedback", _GAINS_N_PER_M, identify=False),
        recorded=partial(
            _feedback,
            cycles={"linear": "0.5 s", "Wiener": "0.7 s", "DPN": marked("about 1 s")},
            share="26 %",
            near={"linear": marked("near uniform"), "Wiener": marked("shifted"), "DPN": marked("shifted")},
        ),
    ),
    ThesisFigure(
        "6.10",
        marked("Feedback of the distribution with identification, three systems (Figs. 6.10 and 6.11)"),
        _IDENTIFYING,
        recorded=partial(
            _feedback,
            cycles=dict.fromkeys(_LABELS.values(), marked("as low as 0.2 s")),
            share="150 %",
            near=dict.fromkeys(_LABELS.values(), marked("near uniform")),
        ),
    ),
    ThesisFigure("6.12", marked("Parameters that the feedback loop identified"), _IDENTIFYING, recorded=_identified),
)
"""Figures of chapter 6."""
