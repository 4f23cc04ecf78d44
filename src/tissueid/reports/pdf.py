"""The report on paper: A4, who and what, the verdict, the numbers with their uncertainty, four figures."""

from __future__ import annotations

import io
import textwrap
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf, PdfPages
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.layout_engine import PlaceHolderLayoutEngine

from tissueid.analysis import Analysis
from tissueid.analysis.curves.results import plots_of_test
from tissueid.atomic_write import atomic_file
from tissueid.calibration.active import calibration_summary
from tissueid.device import SIMULATED_LINE
from tissueid.errors import UnusableInputError
from tissueid.formatting import clean, subject_text
from tissueid.language import _
from tissueid.messages import translated
from tissueid.reports.page import RESEARCH_LINE, surface_of
from tissueid.reports.plot_axes import turn_names, wrap_label
from tissueid.reports.plot_renderer import draw_plot
from tissueid.reports.session_page import NOTHING_ANALYSED
from tissueid.reports.style import GREEN, INK, LOST, MUTED, drawing
from tissueid.reports.tables import readable_date, status_text
from tissueid.reports.verdict import judge, key_numbers, linear_engine, visited
from tissueid.sessions import Session, Test

FurtherTable = tuple[str, Sequence[str], Sequence[Sequence[str]]]
"""A heading, the heads of columns, and rows."""

_WIDTH, _HEIGHT = 8.27, 11.69
TEXT_WIDTH = 6.77
"""Inches between the margins."""
_LEFT, _RIGHT, _TOP, _BOTTOM = 0.75, 7.52, 11.0, 0.75
"""Inches on A4, from its lower left corner."""
_LINE = 0.175
_ACROSS = 100
"""Letters that fit across at 9 points."""
_MOST_REASONS = 6
_LETTER = 0.066
"""Inches that a letter of 9 points takes on average, and some more."""
_KEY_SIZE, _HANDLE = 7.5, 0.42
"""Size of the letters of a key in points, and inches of a sign with its gaps."""
_ORDINATE, _LEAST = 0.8, 0.3
"""Inches that the labels of an ordinate take at most, and the smallest width and height of axes."""
_FIGURES, _LEAST_FIGURES = 5.2, 4.2
_COLOURS = {"good": GREEN, "check": "#9a6200", "poor": LOST}
_WHOLE_TABLE, _START_OF_TABLE = 3.0, 1.2
"""Height of a table up to which it stands on one page, and room that is needed to begin a longer one; inches."""
_MEASURE = cast(Any, RendererAgg)(1, 1, 1200.0)
"""Measures the width of texts; at this resolution glyphs are not moved to whole pixels."""
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

    def draw(paper: PageWriter) -> None:
        _heading(paper, session, test)
        if result is not None:
            table, below = result
            paper.table(*table)
            for line in below:
                paper.wrapped(line)
            paper.draw_rule()
        _verdict(paper, test, analyses)
        _numbers(paper, test, analyses)
        for table in further:
            paper.table(*table)
        _figures(paper, analyses)

    write_pages(path, _("Session {name}").format(name=session.session_id), draw)


def write_pages(path: Path, subject: str, draw: Callable[[PageWriter], object]) -> None:
    """Draw pages about a subject in the style of the reports, and write them so that ``path`` is whole or untouched.

    Raises:
        OSError: the folder is missing, or the disk is full or not writable; nothing is left behind.
    """
    written = io.BytesIO()

    @drawing
    def write() -> None:
        paper = PageWriter()
        draw(paper)
        paper.write(written, subject)

    with warnings.catch_warnings():
        # Letters that the font lacks stand as boxes; the numbers are what matters.
        warnings.filterwarnings("ignore", message="Glyph", category=UserWarning)
        write()
    with atomic_file(path) as partial:
        partial.write_bytes(written.getvalue())


class PageWriter:
    """Writer of PDF pages from top to bottom; begins a new page when one is full."""

    def __init__(self) -> None:
        self.pages: list[Figure] = []
        self._new_page()

    def ensure_room(self, inches: float) -> None:
        """Begin a new page where less than this height is left."""
        if self.y - inches < _BOTTOM:
            self._new_page()

    def line(self, text: str, *, size: float = 9.0, colour: str = INK, bold: bool = False) -> None:
        """One line of text."""
        self.ensure_room(_LINE)
        self.y -= max(_LINE, size * 1.35 / 72.0)
        self.text(_LEFT, text, size=size, colour=colour, bold=bold)

    def wrapped(self, text: str, *, size: float = 8.0, across: int = _ACROSS) -> None:
        """Text in small muted lines of at most ``across`` letters."""
        for line in textwrap.wrap(clean(text), across):
            self.line(line, size=size, colour=MUTED)

    def text(self, x: float, text: str, *, size: float = 9.0, colour: str = INK, bold: bool = False) -> None:
        """Text at ``x`` inches on the present line."""
        weight = "bold" if bold else "normal"
        self.pages[-1].text(x / _WIDTH, self.y / _HEIGHT, clean(text), fontsize=size, color=colour, fontweight=weight)

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

    def table(
        self,
        heading: str,
        heads: Sequence[str],
        rows: Sequence[Sequence[str]],
        *,
        size: float = 9.0,
        widths: Sequence[float] | None = None,
    ) -> None:
        """A table whose columns are as wide as what stands in them; where that is too wide, the first gives way.

        Heads may have several lines and stand again on each page; ``widths`` of all columns are in inches, if known.
        """
        whole = _LINE * size / 9.0 * (len(rows) + 4)
        self.ensure_room(whole if whole < _WHOLE_TABLE else _START_OF_TABLE)
        self.y -= 0.08
        self.line(heading, size=11.0, bold=True)
        letter = _LETTER * size / 9.0
        if widths is not None:
            self._rows([_LEFT + sum(widths[:column]) for column in range(len(widths))], heads, rows, size)
            return
        letters = [max(_shown(head), *(len(row[column]) for row in rows)) for column, head in enumerate(heads)]
        most = int((_RIGHT - _LEFT) / letter) - sum(letters[1:]) - 3 * len(letters)
        letters[0] = max(8, min(letters[0], most))
        starts = [_LEFT + letter * (sum(letters[:column]) + 3 * column) for column in range(len(letters))]
        short = [[_short(cell, wide) for cell, wide in zip(row, letters, strict=True)] for row in rows]
        self._rows(starts, heads, short, size)

    def _rows(self, starts: Sequence[float], heads: Sequence[str], rows: Sequence[Sequence[str]], size: float) -> None:
        line = _LINE * size / 9.0
        self._heads(starts, heads, size)
        for row in rows:
            page = self.pages[-1]
            self.ensure_room(line)
            if self.pages[-1] is not page:
                self._heads(starts, heads, size)
            self.y -= line
            for x, cell in zip(starts, row, strict=True):
                self.text(x, cell, size=size)

    def _heads(self, starts: Sequence[float], heads: Sequence[str], size: float) -> None:
        split = [head.split("\n") for head in heads]
        count = max(map(len, split)) if any(heads) else 0
        for row in range(count):
            self.y -= _LINE * size / 9.0
            for x, lines in zip(starts, split, strict=True):
                if row >= count - len(lines):
                    self.text(x, lines[row - count + len(lines)], size=8.0 * size / 9.0, colour=MUTED)

    def write(self, target: io.BytesIO, subject: str) -> None:
        """Write all pages as PDF, with their numbers; ``subject`` is what the report is about."""
        metadata = {"CreationDate": None, "Producer": None, "Title": _("TissueID report"), "Subject": subject}
        with PdfPages(target, metadata=metadata) as pages:
            for number, page in enumerate(self.pages, 1):
                line, at = _(RESEARCH_LINE), 0.45 / _HEIGHT
                page.text(_LEFT / _WIDTH, at, line, fontsize=8.0, color=MUTED, fontweight="bold")
                count = _("TissueID · page {number} of {count}").format(number=number, count=len(self.pages))
                page.text(_RIGHT / _WIDTH, at, count, fontsize=8.0, color=MUTED, ha="right")
                FigureCanvasPdf(page).print_pdf(pages)  # type: ignore[no-untyped-call] # savefig draws a page twice

    def key(self, handles: Sequence[Artist], names: Sequence[str]) -> None:
        """Draw the key of the figures below, in columns across the page."""
        if not handles:
            return
        columns, height = key_size(names)
        at = (_LEFT / _WIDTH, (self.y - 0.04) / _HEIGHT)
        self.pages[-1].legend(
            list(handles),
            [clean(name) for name in names],
            loc="upper left",
            bbox_to_anchor=at,
            ncols=columns,
            fontsize=_KEY_SIZE,
            handlelength=1.6,
            columnspacing=1.2,
            borderpad=0.2,
            borderaxespad=0.0,
        )
        self.y -= height

    def drawings(self, draws: Sequence[tuple[str, Callable[[Axes], object]]], inches: float, count: int = 0) -> None:
        """Draw figures in one row, each below its title, as large as their labels leave room for.

        Args:
            draws: titles, and functions that draw on empty axes.
            inches: height of the row with titles and labels.
            count: number of figures that fit in the row; that of ``draws`` if not given.
        """
        self.ensure_room(inches)
        width = (_RIGHT - _LEFT) / (count or len(draws))
        page = self.pages[-1]
        drawn, cells = [], []
        for index, (title, draw) in enumerate(draws):
            x, y, high = _LEFT + index * width, self.y - inches + 0.1, inches - 0.35
            shortened = _short(clean(title), int(width / _LETTER))
            page.text(x / _WIDTH, (self.y - 0.17) / _HEIGHT, shortened, fontsize=9.0, color=INK, fontweight="bold")
            cells.append((x, y, width - 0.15, high))
            axes = page.add_axes((x / _WIDTH, y / _HEIGHT, (width - 0.15) / _WIDTH, high / _HEIGHT))
            draw(axes)
            if axes.get_xscale() == "linear":  # names, not frequencies
                turn_names(axes, width - _ORDINATE)
            drawn.append(axes)
        _fit_axes(page, drawn, cells)
        self.y -= inches

    def _new_page(self) -> None:
        page = Figure(figsize=(_WIDTH, _HEIGHT))
        page.set_layout_engine(PlaceHolderLayoutEngine(True, False))  # everything has its place already
        self.pages.append(page)
        self.y = _TOP


def key_size(names: Sequence[str]) -> tuple[int, float]:
    """Return the number of columns of a key across the page and its height in inches."""
    if not names:
        return 1, 0.0
    longest = max(text_width(clean(name), _KEY_SIZE) for name in names) + _HANDLE
    columns = max(1, min(len(names), int((_RIGHT - _LEFT) / longest)))
    return columns, 0.06 + 0.18 * -(-len(names) // columns)


def text_width(text: str, size: float) -> float:
    """Return the width of a line of text in inches."""
    width, _height, _descent = _MEASURE.get_text_width_height_descent(text, FontProperties(size=size), False)
    return float(width / _MEASURE.dpi)


def _fit_axes(page: Figure, drawn: Sequence[Axes], cells: Sequence[tuple[float, float, float, float]]) -> None:
    """Place axes so that they fill their cells (left, bottom, width, height in inches) with all their labels."""
    renderer = cast(Any, FigureCanvasAgg(page)).get_renderer()
    for _attempt in range(3):  # ticks and lines of labels follow the size
        edges = []
        for axes in drawn:
            wrap_label(axes, axes.bbox.height)
            inside, outside = axes.get_window_extent(renderer), axes.get_tightbbox(renderer)
            outside = inside if outside is None else outside
            ends = inside.x0 - outside.x0, inside.y0 - outside.y0, outside.x1 - inside.x1, outside.y1 - inside.y1
            edges.append([max(0.0, end / page.dpi) for end in ends])
        below, above = max(edge[1] for edge in edges), max(edge[3] for edge in edges)
        for axes, (left_edge, _below, right_edge, _above), (x, y, width, height) in zip(
            drawn, edges, cells, strict=True
        ):
            size = max(_LEAST, width - left_edge - right_edge), max(_LEAST, height - below - above)
            axes.set_position(((x + left_edge) / _WIDTH, (y + below) / _HEIGHT, size[0] / _WIDTH, size[1] / _HEIGHT))


def _heading(paper: PageWriter, session: Session, test: Test) -> None:
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
        ordinal = _("{number} of the {count} of this session").format(number=test.number, count=len(session.tests))
        settings = f"{ordinal}, {settings}"
    facts = (
        (_("Subject"), subject_text(session.subject.pseudonym)),
        (_("Date"), readable_date(session.created)),
        (_("Instrument"), f"{device.model}, {device.serial_number}"),
        (_("Calibration"), translated(calibration_summary(device))),
        (_("Test"), settings),
        (_("Session"), session.session_id),
    )
    for name, value in facts:
        paper.line(name, colour=MUTED)
        paper.text(_LEFT + 0.95, _short(value, 86))
    if device.simulated:
        paper.line(_(SIMULATED_LINE), bold=True)
    paper.draw_rule()


def _verdict(paper: PageWriter, test: Test, analyses: Analyses) -> None:
    verdict = judge(test, analyses)
    paper.line(_(verdict.headline), size=13.0, colour=_COLOURS[verdict.level], bold=True)
    lines = [line for reason in verdict.reasons for line in textwrap.wrap(clean(translated(reason)), _ACROSS)]
    for line in lines[:_MOST_REASONS]:
        paper.line(line)
    if len(lines) > _MOST_REASONS:
        paper.line(_("… The HTML report has all of it."), colour=MUTED)


def _numbers(paper: PageWriter, test: Test, analyses: Analyses) -> None:
    rows = [
        (
            key_number.label,
            f"{key_number.value}{f' ± {key_number.std}' if key_number.std else ''} {key_number.unit}".strip(),
            key_number.note,
        )
        for key_number in key_numbers(analyses)
    ]
    if not rows:
        return
    paper.table(_("This test"), ("", _("Value ± standard deviation"), ""), rows)
    paper.wrapped(translated(visited(analyses, surface_of(test))))


def _shown(head: str) -> int:
    """Letters of 9 points that the head of a column takes, which has 8."""
    return round(8 * max(map(len, head.split("\n"))) / 9)


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"


# -- figures ------------------------------------------------------------------------------------------------------


def _figures(paper: PageWriter, analyses: Analyses) -> None:
    """Four of them, two by two, in what is left of the page or on a new one."""
    paper.ensure_room(_LEAST_FIGURES)
    figure = paper.pages[-1]
    top = paper.y - 0.4
    width, height = 2.85, (min(_FIGURES, paper.y - _BOTTOM) - 1.6) / 2
    test_plots = plots_of_test(analyses, linear_engine(analyses))
    plots = (
        (_("Impulse response"), test_plots.impulse),
        (_("Magnitude of the compliance"), test_plots.magnitude),
        (_("Static nonlinearity"), test_plots.nonlinearity),
        (_("Unseen motion"), test_plots.prediction),
    )
    for index, (name, plot) in enumerate(plots):
        x = _LEFT + 0.45 + (index % 2) * (width + 0.7)
        y = top - height - (index // 2) * (height + 0.75)
        axes = figure.add_axes((x / _WIDTH, y / _HEIGHT, width / _WIDTH, height / _HEIGHT))
        draw_plot(axes, plot, title=False)
        axes.set_title(name, fontweight="bold")
    paper.y = _BOTTOM
