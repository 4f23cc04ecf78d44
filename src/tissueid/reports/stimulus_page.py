"""Report of a designed stimulus, of a feedback test or a calibration: a page, or one sheet of figures."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from matplotlib.figure import FigureBase

from tissueid.analysis.curves.feedback import FeedbackRun, description_plots, profiles_of, series_plots, settling_plot
from tissueid.analysis.curves.plot import Array
from tissueid.analysis.curves.signals import (
    amplitude_plots,
    autocorrelation_plots,
    line_plot,
    power_plot,
    stimulus_plots,
    swaps_plot,
)
from tissueid.analysis.stimulus_design import StimulusDesign
from tissueid.atomic_write import atomic_file
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, grouped, number
from tissueid.identification.depth_profile import DepthProfile
from tissueid.language import _, marked
from tissueid.messages import Message, translated
from tissueid.reports import captions
from tissueid.reports.page import RESEARCH_LINE, FigureGroup, Panel, draw_sheet, template, write_text_atomically
from tissueid.reports.plot_renderer import draw_depth_panels, draw_grid, draw_plots, draw_row
from tissueid.reports.style import plain_image
from tissueid.reports.tables import Table, named_text
from tissueid.sessions import Test
from tissueid.stimuli import FeedbackKind
from tissueid.stimuli.kinds.multisine import Multisine
from tissueid.stimuli.stimulus_check import StimulusCheck
from tissueid.version import SOFTWARE

REPORT_NOTE = "stimulus_report"
"""Name of the note of a test that contains the report of its feedback stimulus as JSON."""
NO_DISTRIBUTION = Message("report.no_distribution", "the report of the stimulus contains no distribution of depth")


def feedback_run(test: Test, label: str) -> FeedbackRun:
    """Return a test as a run; ``label`` names it in figures.

    Raises:
        UnusableInputError: the test has no report of a feedback stimulus.
    """
    try:
        report = json.loads(str(test.notes[REPORT_NOTE]))
    except (KeyError, ValueError) as error:
        raise UnusableInputError(
            "report.no_feedback", "test {number} has no report of a feedback stimulus", number=test.number
        ) from error
    record = test.record()
    return run_from_report(report, record.input, record.output - test.surface_position_m, test.sample_rate_hz, label)


def run_from_report(report: Any, force: Array, depth: Array, sample_rate_hz: float, label: str) -> FeedbackRun:
    """Return a run of force (n,), N, and depth (n,), m, with the report of its stimulus.

    Raises:
        UnusableInputError: the report has no distribution of depth.
    """
    try:
        edges = np.asarray(report["edges_m"], dtype=np.float64)
        shares = np.asarray(report["desired"], dtype=np.float64)
        identified = report.get("identification")
        profile = _profile(identified, edges)
        block_s, memory_s = float(report.get("block_s", 0.0)), float((identified or {}).get("memory_s", 0.0))
    except (KeyError, ValueError, TypeError, IndexError, AttributeError) as error:
        raise UnusableInputError(NO_DISTRIBUTION) from error
    if not (math.isfinite(block_s) and math.isfinite(memory_s)):
        raise UnusableInputError(NO_DISTRIBUTION)
    if edges.ndim != 1 or shares.shape != (edges.size - 1,) or not np.all(np.diff(edges) > 0.0):
        raise UnusableInputError(NO_DISTRIBUTION)
    return FeedbackRun(label, force, depth, sample_rate_hz, edges, shares, profile, block_s, memory_s)


def _profile(identified: Mapping[str, Any] | None, edges: Array) -> DepthProfile | None:
    """Return mass, damping and stiffness by depth level; None where nothing was identified."""
    levels = [] if identified is None else identified["levels"]
    if not levels:
        return None
    columns = {name: np.array([float(level[name]) for level in levels]) for name in levels[0]}
    depth = columns["depth_m"]
    bounds = np.concatenate([edges[:1], 0.5 * (depth[1:] + depth[:-1]), edges[-1:]])
    unknown = np.full(depth.size, np.nan)
    return DepthProfile(
        position=depth,
        low=bounds[:-1],
        high=bounds[1:],
        direction=np.zeros(depth.size, dtype=np.int_),
        mass=columns["mass_kg"],
        mass_std=unknown,
        damping=columns["damping_n_s_per_m"],
        damping_std=unknown,
        stiffness=columns["stiffness_n_per_m"],
        stiffness_std=unknown,
        support=columns["samples"].astype(np.int_),
    )


def feedback_panels(runs: Sequence[FeedbackRun]) -> Iterator[Panel]:
    """Yield all panels of one run, or of several side by side."""
    yield Panel(
        "feedback-series",
        _("Force and depth over time"),
        _("Line plots over time of the force and, below, of the depth with its desired range."),
        _("The force sweeps so that the depth covers its range (dashed) with the desired distribution."),
        lambda figure: draw_grid(figure, list(zip(*map(series_plots, runs), strict=True))),
        height=3.9,
    )
    yield Panel(
        "feedback-distributions",
        _("Distributions and linear description"),
        _("Histograms of force and depth, the linear impulse response, and depth against its linear prediction."),
        _(
            "From left to right: force; depth, with the desired distribution (dashed) and Kolmogorov's distance from "
            "it; linear response of the whole test; depth against its linear prediction, which bends where the tissue "
            "stiffens."
        ),
        lambda figure: draw_grid(figure, [description_plots(run, run.label if len(runs) > 1 else "") for run in runs]),
        height=0.5 + 2.1 * len(runs),
    )
    yield Panel(
        "feedback-settling",
        _("Settling time, block and memory"),
        _("A map of the settling time of the impulse response by stiffness and damping."),
        _(
            "Time after which the impulse response stays below 5 % of its peak (Chen 2010, Fig. 6.6). The mean depth "
            "follows the offset of the force only over times longer than that: between the dashed lines, where there "
            "are any, a block is long enough, and between the dotted lines the memory is. Points: the levels of depth "
            "as identified during the test."
        ),
        lambda figure: draw_grid(figure, [[settling_plot(runs)]]),
        height=3.4,
    )
    yield Panel(
        "feedback-parameters",
        _("Mass, damping and stiffness by depth, identified during the test"),
        _("Three panels against depth: mass, damping and stiffness by level, and below the samples of each level."),
        _(
            "Estimates of the feedback loop by adaptive least squares, which steer the stimulus during the test. They "
            "are no result: neighbouring levels are averaged, and mass and damping can be wrong by a factor of two or "
            "more (Chen 2010, 6.3.2). Use an engine fitted to the whole record."
        ),
        lambda figure: draw_depth_panels(figure, profiles_of(runs), 0.0),
        height=4.3,
    )


_AMPLITUDES = marked("Left: histogram of the amplitudes. Right: share of samples below each amplitude.")
_INTENDED = marked("Dashed: intended amplitudes, counted in the same bins.")


def stimulus_panels(design: StimulusDesign) -> Iterator[Panel]:
    """Yield the panels that apply to a stimulus."""
    yield Panel(
        "time-series",
        _("Over time"),
        _("Line plots of the stimulus: the whole of it, and a fifth of a second sample by sample."),
        _("Above: the whole stimulus. Below: its beginning sample by sample. Volts are those of a coil at rest."),
        lambda figure: _draw_time_series(figure, design),
        height=3.9,
    )
    wanted = design.intended_amplitudes
    yield Panel(
        "amplitudes",
        _("Distribution of amplitudes"),
        _("Histogram and cumulative distribution of the values, with the intended ones as dashed lines."),
        captions.joined(_(_AMPLITUDES), "" if wanted is None else _(_INTENDED)),
        lambda figure: draw_row(figure, amplitude_plots(design.played, design.stimulus.unit, wanted)),
        height=2.7,
    )
    multisine = design.specification
    if isinstance(multisine, Multisine):
        yield Panel(
            "lines",
            _("Lines of one period"),
            _("Amplitude of the lines of one period against frequency: driven, detection and other lines."),
            _(
                "One period has a line every {spacing} Hz. Lines that are not driven contain only rounding, so that "
                "power of the response at these lines is noise or distortion."
            ).format(spacing=number(multisine.resolution_hz)),
            lambda figure: draw_row(figure, [line_plot(multisine, design.stimulus)]),
        )
    check, target = design.appraisal, design.target_power
    edges = [(hz, label) for hz, label in ((check.power_95_hz, "95 %"), (check.power_99_hz, "99 %")) if hz is not None]
    yield Panel(
        "power",
        _("Power spectral density"),
        _("Power spectral density against frequency, both axes logarithmic, with its target where there is one."),
        captions.joined(
            _("Welch's estimate. Dotted: frequencies below which 95 % and 99 % of the power about the mean lie."),
            "" if target is None else _("Dashed: target."),
        ),
        lambda figure: draw_row(
            figure, [power_plot(design.played, design.stimulus.sample_rate_hz, design.stimulus.unit, target, edges)]
        ),
        wide=False,
    )
    yield _autocorrelation(design)
    if design.search is not None:
        yield Panel(
            "swaps",
            _("Convergence of the interchange"),
            _("Sum of squared differences of the autocorrelation from its target against accepted swaps."),
            _(
                "Every accepted swap reduces the error. It begins at the error of the spectral surrogate (Chen 2010, "
                "Fig. 6.2b)."
            ),
            lambda figure: draw_row(figure, [swaps_plot(design.search)]),
            wide=False,
        )


def _draw_time_series(figure: FigureBase, design: StimulusDesign) -> None:
    """Draw the stimulus; the right axis converts newtons to volts, or volts to newtons."""
    in_newtons = design.stimulus.unit == "N"
    per_newton = design.device.voltage_for_force(1.0)
    factor = per_newton if in_newtons else 1.0 / per_newton
    for axes in draw_plots(figure, stimulus_plots(design.stimulus))[0]:
        other = axes.secondary_yaxis(
            "right", functions=(partial(np.multiply, factor), partial(np.multiply, 1.0 / factor))
        )
        other.set_ylabel(_("Command (V)") if in_newtons else _("Force at rest (N)"))
        other.spines["right"].set_visible(True)


def _autocorrelation(design: StimulusDesign) -> Panel:
    rate, error = design.stimulus.sample_rate_hz, design.autocorrelation_error
    caption = _("Autocorrelation of the played values about their mean, divided by its value at lag 0.")
    if error is not None:
        squares = _("Below: played minus target; the sum of squares over {lags} lags is {sum}.")
        caption = captions.joined(caption, squares.format(lags=design.autocorrelation.size - 1, sum=number(error, 2)))

    def draw(figure: FigureBase) -> None:
        plots = autocorrelation_plots(design.autocorrelation, rate, design.target_autocorrelation)
        draw_plots(figure, plots, heights=(1.5, 1.0)[: len(plots)])

    return Panel(
        "autocorrelation",
        _("Autocorrelation"),
        _("Normalised autocorrelation against lag, with its target where there is one and the difference below."),
        caption,
        draw,
        wide=False,
    )


FAR = 0.08
"""Kolmogorov distance from the desired distribution of depth above which the report shows a caution."""

FORMS: dict[str, tuple[str | bytes, ...]] = {
    ".html": ("<!DOCTYPE html",),
    ".pdf": ("%PDF",),
    ".png": (b"\x89PNG",),
    ".svg": ("<?xml", "<svg"),
}
"""File name suffixes of reports, and the first bytes of such files."""


@dataclass(frozen=True, eq=False)
class StimulusReport:
    """A report of verdict, tables and figures in the active language; ``facts`` are label and value."""

    title: str
    facts: tuple[tuple[str, str], ...]
    headline: str
    level: Literal["good", "check", "poor"]
    concerns: tuple[str, ...]
    summary: tuple[str, ...]
    tables: tuple[Table, ...]
    panels: tuple[Panel, ...]

    def html(self) -> str:
        """Return the page: verdict, figures, tables."""
        blocks = tuple(panel.picture().block for panel in self.panels)
        return template("stimulus.html.j2").render(
            title=self.title,
            facts=self.facts,
            research_line=_(RESEARCH_LINE),
            software=SOFTWARE,
            headline=self.headline,
            level=self.level,
            concerns=self.concerns,
            summary=self.summary,
            tables=self.tables,
            group=FigureGroup("figures", _("Figures"), blocks),
        )

    def write(self, path: Path) -> None:
        """Write a page or a sheet of all figures atomically; the suffix of the name chooses the form (``FORMS``).

        Raises:
            UnusableInputError: the suffix is not one of them, or there is nothing to draw.
            OSError: the folder is missing, or the disk is full or not writable.
        """
        form = output_suffix(path)
        if form == ".html":
            write_text_atomically(path, self.html())
            return
        figure = draw_sheet(self.title, self.panels)
        with atomic_file(path) as partial:
            plain_image(figure, partial, cast(Any, form.removeprefix(".")))


def output_suffix(path: Path) -> str:
    """Return the suffix of a file name, one of ``FORMS``.

    Raises:
        UnusableInputError: the suffix is not one of ``FORMS``.
    """
    form = path.suffix.lower()
    if form not in FORMS:
        raise UnusableInputError(
            "report.unknown_form",
            "the file name of a plot must end in {forms}, got {name}",
            forms=", ".join(FORMS),
            name=path.name,
        )
    return form


def judged(check: StimulusCheck) -> tuple[str, Literal["good", "check", "poor"]]:
    """Return the headline of a stimulus check and its level."""
    if not check.playable:
        return marked("The stimulus cannot be played"), "poor"
    if any(concern.severity == "caution" for concern in check.concerns):
        return marked("The stimulus can be played: read the cautions first"), "check"
    return marked("The stimulus can be played"), "good"


def stimulus_report(design: StimulusDesign) -> StimulusReport:
    """Return the report of a stimulus that is designed before its test."""
    stimulus, check, kind = design.stimulus, design.appraisal, design.specification
    headline, level = judged(check)
    force, voltage = (check.force_min_n, check.force_max_n), (check.voltage_min_v, check.voltage_max_v)
    low, high = force if stimulus.unit == "N" else voltage
    return StimulusReport(
        title=_("Stimulus {kind}, {low} to {high} {unit}, {seconds} s").format(
            kind=kind.name,
            low=fixed(low, 1),
            high=fixed(high, 1),
            unit=stimulus.unit,
            seconds=fixed(stimulus.seconds, 2),
        ),
        facts=(
            (_("Instrument"), f"{design.device.model}, {design.device.serial_number}"),
            (
                _("Samples"),
                _("{count} at {rate} Hz").format(count=grouped(len(stimulus)), rate=fixed(stimulus.sample_rate_hz, 0)),
            ),
            (_("Seed"), str(stimulus.seed)),
        ),
        headline=_(headline),
        level=level,
        concerns=tuple(translated(concern.message) for concern in check.concerns),
        summary=tuple(translated(line) for line in check.summary()),
        tables=(
            Table(_("Properties"), (), translated_rows(design.rows())),
            Table(_("Options"), (), option_rows(kind.describe())),
        ),
        panels=tuple(stimulus_panels(design)),
    )


def feedback_report(
    kind: FeedbackKind, runs: Sequence[FeedbackRun], rows: tuple[tuple[str, str], ...]
) -> StimulusReport:
    """Return the report of tests with a feedback stimulus; ``rows`` are their results as label and value."""
    worst = max(run.distance for run in runs)
    return StimulusReport(
        title=_("Stimulus {kind}, {low} to {high} N").format(
            kind=kind.name, low=fixed(kind.force_min_n, 1), high=fixed(kind.force_max_n, 1)
        ),
        facts=((_("Played on"), ", ".join(run.label for run in runs)), (_("Seed"), str(kind.seed))),
        headline=_("The depths follow the desired distribution within {distance}").format(distance=fixed(worst, 3)),
        level="good" if worst <= FAR else "check",
        concerns=(),
        summary=(
            _(
                "The number is Kolmogorov's distance: the largest difference between the share of samples above a "
                "depth and the desired share."
            ),
        ),
        tables=(
            Table(_("Results"), (), translated_rows(rows)),
            Table(_("Options"), (), option_rows(kind.describe())),
        ),
        panels=tuple(feedback_panels(runs)),
    )


def option_rows(options: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    """Return options as label and value."""
    return tuple(named_text(name, value) for name, value in options.items() if name != "type")


def translated_rows(rows: Sequence[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    """Return rows of label and value in the active language."""
    return tuple((translated(label), translated(value)) for label, value in rows)
