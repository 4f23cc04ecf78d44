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
from tissueid.atomic_write import atomic_file
from tissueid.calibration.active import calibration_summary
from tissueid.device import SIMULATED_LINE
from tissueid.errors import UnusableInputError
from tissueid.formatting import clean, subject_text
from tissueid.identification import engine_label
from tissueid.identification.engines.lms import LmsModel
from tissueid.identification.engines.spectral import SpectralModel
from tissueid.identification.engines.wiener import Wiener, WienerModel
from tissueid.language import _
from tissueid.messages import Message, translated
from tissueid.reports.blocks import report_text
from tissueid.reports.captions import FEW_FREQUENCIES
from tissueid.reports.configured import surface_of
from tissueid.reports.diagnostics import held_out_prediction
from tissueid.reports.html import NOTHING_ANALYSED, RESEARCH_LINE
from tissueid.reports.style import BLUE, GREEN, INK, LOST, MUTED, ORANGE, drawing, frequency_axis, log_axis
from tissueid.reports.tables import readable_date, status_text
from tissueid.reports.validation_figures import readable_stretch
from tissueid.reports.verdict import judge, key_numbers, linear_engine, visited
from tissueid.sessions import Session, Test
from tissueid.units import display_unit

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
        raise UnusableInputError(NOTHING_ANALYSED)
    written = io.BytesIO()
    with warnings.catch_warnings():
        # Letters that the font lacks stand as boxes; the numbers are what matters.
        warnings.filterwarnings("ignore", message="Glyph", category=UserWarning)
        _write(written, session, test, analyses, result, further)
    with atomic_file(path) as partial:
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
    paper = _PageWriter()
    _heading(paper, session, test)
    if result is not None:
        table, below = result
        paper.table(*table)
        for line in below:
            for words in textwrap.wrap(clean(line), _ACROSS):
                paper.line(words, size=8.0, colour=MUTED)
        paper.draw_rule()
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


class _PageWriter:
    """Writer of PDF pages from top to bottom; begins a new page when one is full."""

    def __init__(self) -> None:
        self.pages: list[Figure] = []
        self._new_page()

    def ensure_room(self, inches: float) -> None:
        """Begin a new page where less than this height is left."""
        if self.y - inches < _BOTTOM:
            self._new_page()

    def line(self, words: str, *, size: float = 9.0, colour: str = INK, bold: bool = False) -> None:
        """One line of text."""
        self.ensure_room(_LINE)
        self.y -= max(_LINE, size * 1.35 / 72.0)
        self.text(_LEFT, words, size=size, colour=colour, bold=bold)

    def text(self, x: float, words: str, *, size: float = 9.0, colour: str = INK, bold: bool = False) -> None:
        """Words at a place of the present line."""
        weight = "bold" if bold else "normal"
        self.pages[-1].text(x / _WIDTH, self.y / _HEIGHT, clean(words), fontsize=size, color=colour, fontweight=weight)

    def draw_rule(self) -> None:
        """Draw a thin horizontal line."""
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
        self.ensure_room(min(3.0, _LINE * (len(rows) + 3)))
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
            self.ensure_room(_LINE)
            self.y -= _LINE
            for x, cell, wide in zip(starts, row, letters, strict=True):
                self.text(x, _short(cell, wide))

    def _new_page(self) -> None:
        page = Figure(figsize=(_WIDTH, _HEIGHT))
        page.set_layout_engine("none")  # everything has its place already
        self.pages.append(page)
        self.y = _TOP


def _heading(paper: _PageWriter, session: Session, test: Test) -> None:
    site = test.site[:1].upper() + test.site[1:]
    paper.line(_short(site, 55) or _("Tissue measurement"), size=17.0, bold=True)
    paper.y -= 0.06
    device = session.instrument
    settings = _("{status}; {configuration}, {seconds:.1f} s at {rate:g} Hz").format(
        status=status_text(test.status),
        configuration=translated(test.configuration),
        seconds=test.samples / test.sample_rate_hz,
        rate=test.sample_rate_hz,
    )
    if len(session.tests) > 1:
        place = _("{number} of the {count} of this session").format(number=test.number, count=len(session.tests))
        settings = f"{place}, {settings}"
    facts = (
        (_("Subject"), subject_text(session.subject.pseudonym)),
        (_("Date"), readable_date(session.created)),
        (_("Instrument"), f"{device.model}, {device.serial_number}"),
        (_("Calibration"), report_text(calibration_summary(device))),
        (_("Test"), settings),
        (_("Session"), session.session_id),
    )
    for name, value in facts:
        paper.line(name, colour=MUTED)
        paper.text(_LEFT + 0.95, _short(value, 86))
    if device.simulated:
        paper.line(_(SIMULATED_LINE), bold=True)
    paper.draw_rule()


def _verdict(paper: _PageWriter, test: Test, analyses: Analyses) -> None:
    verdict = judge(test, analyses)
    paper.line(_(verdict.headline), size=13.0, colour=_COLOURS[verdict.level], bold=True)
    lines = [line for reason in verdict.reasons for line in textwrap.wrap(clean(report_text(reason)), _ACROSS)]
    for line in lines[:_MOST_REASONS]:
        paper.line(line)
    if len(lines) > _MOST_REASONS:
        paper.line(_("… The HTML report has all of it."), colour=MUTED)


def _numbers(paper: _PageWriter, test: Test, analyses: Analyses) -> None:
    rows = []
    for found in key_numbers(analyses):
        value = f"{found.value} ± {found.std}" if found.std else found.value
        rows.append((found.label, f"{value} {found.unit}".strip(), found.note))
    if not rows:
        return
    paper.table(_("This test"), ("", _("Value ± standard deviation"), ""), rows)
    if where := visited(analyses, surface_of(test)):
        for line in textwrap.wrap(clean(translated(where)), _ACROSS):
            paper.line(line, size=8.0, colour=MUTED)


def _shown(head: str) -> int:
    """Letters of 9 points that the head of a column takes, which has 8."""
    return round(8 * len(head) / 9)


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"


# -- figures ------------------------------------------------------------------------------------------------------


def _figures(paper: _PageWriter, analyses: Analyses) -> None:
    """Four of them, two by two, in what is left of the page or on a new one."""
    paper.ensure_room(_LEAST_FIGURES)
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
            axes.text(0.0, 0.5, textwrap.fill(translated(error.message), 44), color=MUTED, transform=axes.transAxes)
    paper.y = _BOTTOM


def _impulse(axes: Axes, analyses: Analyses) -> None:
    model = next((a.model for a in analyses.values() if isinstance(a.model, LmsModel)), None)
    if model is None:
        raise UnusableInputError(Message("report.no_impulse_response", "no impulse response could be estimated"))
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
    model = next((a.model for a in analyses.values() if isinstance(a.model, SpectralModel)), None)
    if model is None:
        raise UnusableInputError(Message("report.no_transfer_function", "no transfer function could be estimated"))
    spectra = model.spectra
    shown = (spectra.frequency_hz > 0.0) & (spectra.input_psd > _EXCITED * spectra.input_psd[1:].max())
    shown &= spectra.magnitude > 0.0
    if shown.sum() < 3:
        raise UnusableInputError(FEW_FREQUENCIES)
    frequency = spectra.frequency_hz[shown]
    axes.plot(frequency, 1e3 * spectra.magnitude[shown], color=BLUE, linestyle="none", marker=".", markersize=3.0)
    fine = np.geomspace(frequency[0], frequency[-1], 300)
    axes.plot(fine, 1e3 * np.abs(model.second_order.system.frequency_response(fine)), color=ORANGE)
    frequency_axis(axes, float(frequency[0]), float(frequency[-1]))
    log_axis(axes)
    axes.set_ylabel("mm/N")


def _nonlinearity(axes: Axes, analyses: Analyses) -> None:
    analysis = analyses.get(Wiener.name)
    if analysis is None or not isinstance(analysis.model, WienerModel):
        raise UnusableInputError(Message("report.no_nonlinearity", "no static nonlinearity could be estimated"))
    record = analysis.record[analysis.fit_part]
    inner = analysis.model.linear_output(record.input)
    known = np.isfinite(inner) & np.isfinite(record.output)
    if known.sum() < 2:
        raise UnusableInputError(
            Message(
                "report.wiener_not_run",
                "the Wiener model cannot be simulated: no sample has an uninterrupted input over the memory",
            )
        )
    inner, measured = inner[known], record.output[known]
    some = slice(None, None, max(1, inner.size // _MOST_DOTS))
    unit, scale = display_unit(record.output_unit)
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
    name = Wiener.name if Wiener.name in analyses else linear_engine(analyses)
    if name is None:
        raise UnusableInputError(Message("report.no_free_run", "no model could be run on motion that it had not seen"))
    found = held_out_prediction(engine_label(name), analyses[name])
    part = readable_stretch(found, 0.4)
    unit, scale = display_unit(found.output_unit)
    time_s = found.time_s[part] - found.time_s[part][0]
    axes.plot(time_s, scale * found.measured[part], color=BLUE, linewidth=2.6, alpha=0.5, label=_("measured"))
    axes.plot(time_s, scale * found.predicted[part], color=ORANGE, linewidth=1.0, label=_("predicted"))
    axes.set_xlabel(_("Time (s)"))
    axes.set_ylabel(_("Position ({unit})").format(unit=unit))
    axes.legend(loc="upper right", ncols=2)
