"""The report on paper: A4, who and what, the verdict, the numbers with their uncertainty, four figures."""

from __future__ import annotations

import io
import textwrap
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure

from tissueid.analysis import Analysis
from tissueid.calibration.in_force import in_words
from tissueid.core_words import for_report, said_by_core
from tissueid.device import SIMULATED_LINE
from tissueid.errors import UnusableInputError
from tissueid.identification.engines.lms import LmsModel
from tissueid.identification.engines.spectral import SpectralModel
from tissueid.identification.engines.wiener import WienerModel
from tissueid.language import _
from tissueid.reports.configured import surface_of
from tissueid.reports.diagnostics import held_out_prediction
from tissueid.reports.html import RESEARCH_LINE
from tissueid.reports.style import BLUE, GREEN, INK, LOST, MUTED, ORANGE, drawing, frequency_axis, log_axis
from tissueid.reports.tables import readable_date, said_status
from tissueid.reports.validation_figures import readable_stretch
from tissueid.reports.verdict import judge, key_numbers, linear_engine, visited
from tissueid.sessions import Session, Test
from tissueid.whole_file import whole_file
from tissueid.wording import clean, engine_label, people_unit

FurtherTable = tuple[str, Sequence[str], Sequence[Sequence[str]]]
"""A heading, the heads of columns, and rows."""

_WIDTH, _HEIGHT = 8.27, 11.69
_LEFT, _RIGHT, _TOP, _BOTTOM = 0.75, 7.52, 11.0, 0.75
"""Inches on A4, from its lower left corner."""
_LINE = 0.175
_ACROSS = 100
"""Letters that fit across at 9 points."""
_MOST_REASONS = 6
_LETTER = 0.066
"""Inches that a letter of 9 points takes on average, and some more."""
_FIGURES, _LEAST_FIGURES = 5.2, 4.2
_COLOURS = {"good": GREEN, "check": "#9a6200", "poor": LOST}
_EXCITED = 0.03
_MOST_DOTS = 1500
Analyses = Mapping[str, Analysis]


def write_pdf(
    path: Path,
    session: Session,
    test: Test,
    analyses: Analyses,
    *,
    result: tuple[FurtherTable, Sequence[str]] | None = None,
    further: Sequence[FurtherTable] = (),
) -> None:
    """Write the report of one test so that ``path`` is whole or untouched; one page, or two where ``further`` is long.

    ``result`` is the table of what stands as the result of the sitting, with lines below it: it comes first.

    Raises:
        UnusableInputError: nothing was analysed.
        OSError: the folder is missing, or the disk is full or not writable; nothing is left behind.
    """
    if not analyses:
        raise UnusableInputError(_("there is nothing to report: no test was analysed"))
    written = io.BytesIO()
    with warnings.catch_warnings():
        # Letters that the font lacks stand as boxes; the numbers are what matters.
        warnings.filterwarnings("ignore", message="Glyph", category=UserWarning)
        _write(written, session, test, analyses, result, further)
    with whole_file(path) as partial:
        partial.write_bytes(written.getvalue())


@drawing
def _write(
    target: io.BytesIO,
    session: Session,
    test: Test,
    analyses: Analyses,
    result: tuple[FurtherTable, Sequence[str]] | None,
    further: Sequence[FurtherTable],
) -> None:
    paper = _Paper()
    _heading(paper, session, test)
    if result is not None:
        table, below = result
        paper.table(*table)
        for line in below:
            for words in textwrap.wrap(clean(line), _ACROSS):
                paper.line(words, size=8.0, colour=MUTED)
        paper.rule()
    _verdict(paper, test, analyses)
    _numbers(paper, test, analyses)
    for table in further:
        paper.table(*table)
    _figures(paper, analyses)
    with PdfPages(
        target,
        metadata={
            "CreationDate": None,
            "Producer": None,
            "Title": _("TissueID report"),
            "Subject": _("Session {name}").format(name=session.session_id),
        },
    ) as pages:
        for number, page in enumerate(paper.pages, 1):
            page.text(_LEFT / _WIDTH, 0.45 / _HEIGHT, _(RESEARCH_LINE), fontsize=8.0, color=MUTED, fontweight="bold")
            count = _("TissueID · page {number} of {count}").format(number=number, count=len(paper.pages))
            page.text(_RIGHT / _WIDTH, 0.45 / _HEIGHT, count, fontsize=8.0, color=MUTED, ha="right")
            pages.savefig(page)


class _Paper:
    """Pages that are filled from top to bottom; a new one begins where the old one is full."""

    def __init__(self) -> None:
        self.pages: list[Figure] = []
        self._new_page()

    def room(self, inches: float) -> None:
        """Make sure that so much is left, on a new page where it has to be."""
        if self.y - inches < _BOTTOM:
            self._new_page()

    def line(self, words: str, *, size: float = 9.0, colour: str = INK, bold: bool = False) -> None:
        """One line of text."""
        self.room(_LINE)
        self.y -= max(_LINE, size * 1.35 / 72.0)
        self.text(_LEFT, words, size=size, colour=colour, bold=bold)

    def text(self, x: float, words: str, *, size: float = 9.0, colour: str = INK, bold: bool = False) -> None:
        """Words at a place of the present line."""
        weight = "bold" if bold else "normal"
        self.pages[-1].text(x / _WIDTH, self.y / _HEIGHT, clean(words), fontsize=size, color=colour, fontweight=weight)

    def rule(self) -> None:
        """A thin line across."""
        self.y -= 0.09
        at = [self.y / _HEIGHT] * 2
        figure = self.pages[-1]
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), frame_on=False, xticks=[], yticks=[])
        axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
        axes.grid(visible=False)
        axes.plot([_LEFT / _WIDTH, _RIGHT / _WIDTH], at, color=MUTED, linewidth=0.6)
        self.y -= 0.03

    def table(self, heading: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """A table whose columns are as wide as what stands in them; where that is too wide, the first gives way."""
        self.room(min(3.0, _LINE * (len(rows) + 3)))
        self.y -= 0.08
        self.line(heading, size=11.0, bold=True)
        letters = [max(_shown(head), *(len(row[place]) for row in rows)) for place, head in enumerate(heads)]
        most = int((_RIGHT - _LEFT) / _LETTER) - sum(letters[1:]) - 3 * len(letters)
        letters[0] = max(8, min(letters[0], most))
        starts = [_LEFT + _LETTER * (sum(letters[:place]) + 3 * place) for place in range(len(letters))]
        if any(heads):
            self.y -= _LINE
            for x, head in zip(starts, heads, strict=True):
                self.text(x, head, size=8.0, colour=MUTED)
        for row in rows:
            self.room(_LINE)
            self.y -= _LINE
            for x, cell, wide in zip(starts, row, letters, strict=True):
                self.text(x, _short(cell, wide))

    def _new_page(self) -> None:
        page = Figure(figsize=(_WIDTH, _HEIGHT))
        page.set_layout_engine("none")  # everything has its place already
        self.pages.append(page)
        self.y = _TOP


def _heading(paper: _Paper, session: Session, test: Test) -> None:
    site = test.site[:1].upper() + test.site[1:]
    paper.line(_short(site, 55) or _("Tissue measurement"), size=17.0, bold=True)
    paper.y -= 0.06
    device = session.instrument
    told = _("number {number}, {status}; {configuration}, {seconds:.1f} s at {rate:g} Hz").format(
        number=test.number,
        status=said_status(test.status),
        configuration=said_by_core(test.configuration),
        seconds=test.samples / test.sample_rate_hz,
        rate=test.sample_rate_hz,
    )
    facts = (
        (_("Subject"), session.subject.pseudonym),
        (_("Date"), readable_date(session.created)),
        (_("Instrument"), f"{device.model}, {device.serial_number}"),
        (_("Calibration"), for_report(in_words(device))),
        (_("Test"), told),
        (_("Session"), session.session_id),
    )
    for name, value in facts:
        paper.line(name, colour=MUTED)
        paper.text(_LEFT + 0.95, _short(value, 86))
    if device.simulated:
        paper.line(_(SIMULATED_LINE), bold=True)
    paper.rule()


def _verdict(paper: _Paper, test: Test, analyses: Analyses) -> None:
    verdict = judge(test, analyses)
    paper.line(_(verdict.headline), size=13.0, colour=_COLOURS[verdict.level], bold=True)
    lines = [line for reason in verdict.reasons for line in textwrap.wrap(clean(for_report(reason)), _ACROSS)]
    for line in lines[:_MOST_REASONS]:
        paper.line(line)
    if len(lines) > _MOST_REASONS:
        paper.line(_("… The HTML report has all of it."), colour=MUTED)


def _numbers(paper: _Paper, test: Test, analyses: Analyses) -> None:
    rows = []
    for found in key_numbers(analyses):
        value = f"{found.value} ± {found.std}" if found.std else found.value
        rows.append((found.label, f"{value} {found.unit}".strip(), found.note))
    if not rows:
        return
    paper.table(_("This test"), ("", _("Value ± standard deviation"), ""), rows)
    if where := visited(analyses, surface_of(test)):
        for line in textwrap.wrap(clean(said_by_core(where)), _ACROSS):
            paper.line(line, size=8.0, colour=MUTED)


def _shown(head: str) -> int:
    """Letters of 9 points that the head of a column takes, which has 8."""
    return round(8 * len(head) / 9)


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"


# -- figures ------------------------------------------------------------------------------------------------------


def _figures(paper: _Paper, analyses: Analyses) -> None:
    """Four of them, two by two, in what is left of the page or on a new one."""
    paper.room(_LEAST_FIGURES)
    figure = paper.pages[-1]
    top = paper.y - 0.4
    width, height = 2.85, (min(_FIGURES, paper.y - _BOTTOM) - 1.6) / 2
    draws: tuple[tuple[str, Callable[[Axes, Analyses], None]], ...] = (
        (_("Impulse response"), _impulse),
        (_("Magnitude of the compliance"), _magnitude),
        (_("Static nonlinearity"), _nonlinearity),
        (_("Unseen motion"), _prediction),
    )
    for place, (name, draw) in enumerate(draws):
        x = _LEFT + 0.45 + (place % 2) * (width + 0.7)
        y = top - height - (place // 2) * (height + 0.75)
        axes = figure.add_axes((x / _WIDTH, y / _HEIGHT, width / _WIDTH, height / _HEIGHT))
        axes.set_title(name, fontweight="bold")
        try:
            draw(axes, analyses)
        except UnusableInputError as error:
            axes.set_axis_off()
            axes.text(0.0, 0.5, textwrap.fill(said_by_core(str(error)), 44), color=MUTED, transform=axes.transAxes)
    paper.y = _BOTTOM


def _impulse(axes: Axes, analyses: Analyses) -> None:
    model = analyses["lms"].model if "lms" in analyses else None
    if not isinstance(model, LmsModel):
        raise UnusableInputError(_("no impulse response could be estimated"))
    lag_ms, response, std = 1e3 * model.lag_s, 1e3 * model.impulse_response, 1e3 * model.impulse_response_std
    fine_s = np.linspace(0.0, float(model.lag_s[-1]), 300)
    fitted = 1e3 * model.second_order.sign * model.second_order.system.impulse_response(fine_s)
    axes.fill_between(lag_ms, response - std, response + std, color=BLUE, alpha=0.22, linewidth=0.0)
    axes.plot(lag_ms, response, color=BLUE, linestyle="none", marker=".", markersize=3.0, label=_("measured ± 1 s.d."))
    axes.plot(1e3 * fine_s, fitted, color=ORANGE, label=_("second order"))
    axes.set_xlabel(_("Lag (ms)"))
    axes.set_ylabel("mm/(N·s)")
    axes.legend(loc="upper right")


def _magnitude(axes: Axes, analyses: Analyses) -> None:
    model = analyses["spectral"].model if "spectral" in analyses else None
    if not isinstance(model, SpectralModel):
        raise UnusableInputError(_("no transfer function could be estimated"))
    spectra = model.spectra
    shown = (spectra.frequency_hz > 0.0) & (spectra.input_psd > _EXCITED * spectra.input_psd[1:].max())
    shown &= spectra.magnitude > 0.0
    if shown.sum() < 3:
        raise UnusableInputError(_("the input has power at fewer than three frequencies"))
    frequency = spectra.frequency_hz[shown]
    axes.plot(frequency, 1e3 * spectra.magnitude[shown], color=BLUE, linestyle="none", marker=".", markersize=3.0)
    fine = np.geomspace(frequency[0], frequency[-1], 300)
    axes.plot(fine, 1e3 * np.abs(model.second_order.system.frequency_response(fine)), color=ORANGE)
    frequency_axis(axes, float(frequency[0]), float(frequency[-1]))
    log_axis(axes)
    axes.set_ylabel("mm/N")


def _nonlinearity(axes: Axes, analyses: Analyses) -> None:
    analysis = analyses.get("wiener")
    if analysis is None or not isinstance(analysis.model, WienerModel):
        raise UnusableInputError(_("no static nonlinearity could be estimated"))
    record = analysis.record[analysis.fit_part]
    inner = analysis.model.linear_output(record.input)
    known = np.isfinite(inner) & np.isfinite(record.output)
    if known.sum() < 2:
        raise UnusableInputError(_("no sample lies where the Wiener model can be run"))
    inner, measured = inner[known], record.output[known]
    some = slice(None, None, max(1, inner.size // _MOST_DOTS))
    unit, scale = people_unit(record.output_unit)
    fine = np.linspace(inner.min(), inner.max(), 300)
    axes.plot(
        inner[some],
        scale * measured[some],
        color=BLUE,
        linestyle="none",
        marker=".",
        markersize=1.0,
        alpha=0.5,
    )
    axes.plot(fine, scale * analysis.model.nonlinearity(fine), color=ORANGE)
    axes.set_xlabel(_("Force after the linear stage (N)"))
    axes.set_ylabel(_("Position ({unit})").format(unit=unit))


def _prediction(axes: Axes, analyses: Analyses) -> None:
    name = "wiener" if "wiener" in analyses else linear_engine(analyses)
    if name is None:
        raise UnusableInputError(_("no model could be run on motion that it had not seen"))
    found = held_out_prediction(engine_label(name), analyses[name])
    part = readable_stretch(found, 0.4)
    unit, scale = people_unit(found.output_unit)
    time_s = found.time_s[part] - found.time_s[part][0]
    axes.plot(time_s, scale * found.measured[part], color=BLUE, linewidth=2.6, alpha=0.5, label=_("measured"))
    axes.plot(time_s, scale * found.predicted[part], color=ORANGE, linewidth=1.0, label=_("predicted"))
    axes.set_xlabel(_("Time (s)"))
    axes.set_ylabel(_("Position ({unit})").format(unit=unit))
    axes.legend(loc="upper right", ncols=2)
