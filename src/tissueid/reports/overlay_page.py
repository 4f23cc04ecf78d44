"""Report of fits of several tests: one page, figures as files, and the numbers of all figures as CSV."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from tissueid.analysis.curves import kernels
from tissueid.analysis.curves import overlay_plots as curves
from tissueid.analysis.curves.overlay_plots import (
    Columns,
    bode_by_depth,
    depth_overlay,
    impulse_by_depth,
    signal_correlations,
)
from tissueid.analysis.curves.plot import Plot, as_csv
from tissueid.analysis.overlay import Overlay, quantity_label, repeated_values
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, grouped, number
from tissueid.identification.engines.wiener import WienerModel
from tissueid.identification.volterra.structure import VolterraModel
from tissueid.language import _, marked
from tissueid.messages import MISSING, translated
from tissueid.reports import captions
from tissueid.reports.page import (
    RESEARCH_LINE,
    FigureGroup,
    Picture,
    picture,
    template,
    write_figures,
    write_text_atomically,
)
from tissueid.reports.plot_renderer import draw_grid, key_over
from tissueid.reports.style import FULL_WIDTH, HALF_WIDTH, drawing, new_figure
from tissueid.reports.tables import Table
from tissueid.units import display_unit
from tissueid.version import SOFTWARE

Rows = Sequence[Sequence[Plot]]
_COLUMNS = 3
"""Largest number of kernels in one row."""
_PANEL = 2.9
"""Height of a row of panels, inches."""


@dataclass(frozen=True, eq=False)
class _Drawing:
    """A figure of an overlay: ``plots`` returns its rows of panels, or raises ``UnusableInputError``."""

    key: str
    heading: str
    alt: str
    caption: str
    plots: Callable[[Overlay], Rows]
    row_height: float | Callable[[Overlay], float] = _PANEL
    over: bool = True
    note: Callable[[Overlay], str] = lambda _overlay: ""


@dataclass(frozen=True, eq=False)
class DrawnFigures:
    """Figures with the plots that they show."""

    pictures: tuple[Picture, ...]
    plots: tuple[Plot, ...]

    def write_figures(self, folder: Path) -> tuple[Path, ...]:
        """Write every figure as SVG and PNG into a folder, which is made when missing, and return the files.

        Raises:
            OSError: the folder cannot be made or written to.
        """
        return write_figures(self.pictures, folder)

    def csv(self) -> str:
        """Return the numbers of all figures as CSV."""
        return as_csv(self.plots)


@dataclass(frozen=True, eq=False)
class OverlayReport(DrawnFigures):
    """The drawn figures of an overlay."""

    overlay: Overlay

    def html(self) -> str:
        """Return the page: scores, figures, tables."""
        sources = ", ".join(self.overlay.sources)
        return template("stimulus.html.j2").render(
            title=_("Several tests in one figure"),
            facts=((_("Tests"), sources), (_("Fits"), ", ".join(self.overlay.fits))),
            research_line=_(RESEARCH_LINE),
            software=SOFTWARE,
            headline=_("{count} fits").format(count=len(self.overlay.entries)),
            level="check" if self.overlay.refused else "good",
            concerns=tuple(translated(text) for text in self.overlay.refused),
            summary=(),
            tables=(overlay_scores(self.overlay), repeated_table(self.overlay)),
            group=FigureGroup("figures", _("Figures"), tuple(drawn.block for drawn in self.pictures)),
        )

    def write(self, path: Path) -> None:
        """Write the page atomically.

        Raises:
            OSError: the folder is missing, or the disk is full or not writable.
        """
        write_text_atomically(path, self.html())


def overlay_report(
    overlay: Overlay, calibration: Columns | None = None, keys: Sequence[str] | None = None
) -> OverlayReport:
    """Draw the figures of an overlay; those that its fits cannot give are left out, and all but one of a sweep.

    Args:
        overlay: the fits.
        calibration: columns of a dynamic sweep that are drawn under the depth profiles.
        keys: names of the figures to draw; None for all.
    """
    pictures: list[Picture] = []
    plots: list[Plot] = []
    for described in _DRAWINGS[:1] if overlay.swept else (_depth(calibration), *_DRAWINGS):
        if keys is not None and described.key not in keys:
            continue
        try:
            rows = described.plots(overlay)
        except UnusableInputError:
            continue
        plots += [plot for row in rows for plot in row]

        def make(described: _Drawing = described, rows: Rows = rows) -> tuple[Figure, str]:
            text = _(described.caption)
            height = described.row_height if isinstance(described.row_height, float) else described.row_height(overlay)
            return grid_figure(rows, height, over=described.over), " ".join(
                filter(None, (text, described.note(overlay)))
            )

        pictures.append(picture(described.key, _(described.heading), _(described.alt), make))
    return OverlayReport(tuple(pictures), tuple(plots), overlay)


@drawing
def grid_figure(rows: Rows, row_height: float, *, over: bool = True) -> Figure:
    """Return a figure of rows of plots; a row that is shorter than the first one leaves its places empty.

    ``over`` puts the key of the first panel over the whole figure.
    """
    columns = len(rows[0])
    figure = new_figure(FULL_WIDTH if columns > 1 else max(HALF_WIDTH, 0.7 * FULL_WIDTH), 0.5 + row_height * len(rows))
    full = [[*row, *[Plot("", rows[0][0].x, rows[0][0].y, missing=" ")] * (columns - len(row))] for row in rows]
    axes, _long = draw_grid(figure, full, key=not over)
    if over:
        key_over(figure, next((panel for panel in axes if panel.get_legend_handles_labels()[1]), axes[0]))
    return figure


def _rows(plots: Sequence[Plot], columns: int = _COLUMNS) -> Rows:
    """Return plots in rows of equal length as far as possible."""
    count = -(-len(plots) // columns)
    width = -(-len(plots) // count)
    return [plots[first : first + width] for first in range(0, len(plots), width)]


def _transposed(columns: Sequence[Sequence[Plot]]) -> Rows:
    """Return columns as rows of plots, in blocks of equal width one below the other where there are many."""
    blocks = -(-len(columns) // _COLUMNS)
    width = -(-len(columns) // blocks)
    return [row for first in range(0, len(columns), width) for row in zip(*columns[first : first + width], strict=True)]


def _depth(calibration: Columns | None) -> _Drawing:
    return _Drawing(
        "depth",
        marked("Mass, damping and stiffness against depth"),
        marked("Three panels against depth: mass, damping and stiffness of every test and fit."),
        marked(
            "Every source has a colour and every fit a marker, with 95 % bars or bands. Small tests about several "
            "loads that share a label are joined. Grey: the calibration spring along the stroke, if a sweep is given."
        ),
        lambda overlay: [depth_overlay(overlay, calibration)],
        row_height=3.6,
    )


def _loops(overlay: Overlay) -> str:
    """Return the loop widths of Wiener fits as a sentence."""
    said = []
    for entry in overlay.entries:
        if isinstance(entry.analysis.model, WienerModel):
            unit, scale = display_unit(entry.analysis.record.output_unit)
            said.append(f"{overlay.label(entry)} {number(scale * curves.loop_width(entry), 3)} {unit}")
    return _("Distance between the way in and the way out: {widths}.").format(widths=", ".join(said))


def _lobes(overlay: Overlay) -> str:
    """Return the main lobes of second-order kernels as a sentence."""
    said = []
    for entry in overlay.entries:
        model = entry.analysis.model
        if isinstance(model, VolterraModel) and model.kernel2 is not None:
            lobes = kernels.kernel_lobes(model.kernel2, model.lag_spacing / model.sample_rate_hz)
            said.append(
                _("{name}: peak at {lag} ms, {width} ms wide, side lobes of {side_lobe} %").format(
                    name=overlay.label(entry),
                    lag=fixed(1e3 * lobes.lag_s, 1),
                    width=fixed(1e3 * lobes.width_s, 1),
                    side_lobe=fixed(100.0 * lobes.side_lobe, 0),
                )
            )
    return f"{'; '.join(said)}."


_DRAWINGS = (
    _Drawing(
        "sweep",
        marked("Scores against an option"),
        marked("Two panels against the value of an option: variance accounted for and AICc of every fit."),
        marked(
            "All scores are those of the fitted samples. Models with partitions are scheduled by the measured output. "
            "The lowest AICc is the best; values far above the others are cut off."
        ),
        lambda overlay: [curves.sweep_overlay(overlay)],
        row_height=3.6,
    ),
    _Drawing(
        "scores",
        marked("Scores"),
        marked("Dots for each test and fit: variance accounted for."),
        marked("Scheduled scores use part of what they predict and cannot be compared with those of simulations."),
        lambda overlay: [[curves.score_overlay(overlay)]],
        row_height=lambda overlay: 0.8 + 0.3 * len({overlay.label(entry) for entry in overlay.entries}),
    ),
    _Drawing(
        "bode-by-depth",
        marked("Bode diagram by depth"),
        marked("Magnitude and phase against frequency at each depth, a column for each series."),
        marked(
            "The second-order system at each depth. The magnitude at low frequencies is one over the stiffness: it "
            "falls with depth where tissue stiffens."
        ),
        lambda overlay: _transposed(bode_by_depth(overlay)),
    ),
    _Drawing(
        "impulse-by-depth",
        marked("Impulse response by depth"),
        marked("Impulse responses at each depth, and below each divided by its area; a column for each series."),
        marked("Divided by its area, a response shows the dynamics alone: in a Wiener system all would coincide."),
        lambda overlay: _transposed(impulse_by_depth(overlay)),
    ),
    _Drawing(
        "responses",
        marked("Impulse responses and Bode diagrams"),
        marked("Impulse response, magnitude and phase of every fit, laid over each other."),
        marked("About the mean input of each test."),
        lambda overlay: [curves.response_overlay(overlay)],
        row_height=3.4,
    ),
    _Drawing(
        "nonlinearity",
        marked("Static nonlinearity by test"),
        marked("Measured output against the output of the linear stage, a panel for each source."),
        marked(
            "A line follows half a second of the samples; dashed, the fitted curve. Loops show dynamics that depend on "
            "the output, which no static nonlinearity describes."
        ),
        lambda overlay: _rows(curves.nonlinearity_overlay(overlay), 3),
        row_height=3.3,
        over=False,
        note=_loops,
    ),
    _Drawing(
        "correlations",
        marked("Correlations of input and output"),
        marked("Autocorrelations of input and output and their cross-correlation over both signs of the lag."),
        captions.CORRELATIONS,
        lambda overlay: [signal_correlations({curves.named(n): r for n, r in overlay.records.items()})],
        row_height=3.2,
    ),
    _Drawing(
        "first-kernels",
        marked("First-order kernels"),
        marked("First-order kernels against lag, and diagonals of the second-order kernels."),
        marked("Softer and less damped tissue has higher peaks and more oscillation."),
        lambda overlay: [kernels.first_kernels(overlay)],
        row_height=3.4,
    ),
    _Drawing(
        "second-kernels",
        marked("Second-order kernels side by side"),
        marked("Images of the second-order kernels over two lags, one for each test and fit."),
        marked("Kernels of the same fit share the scale of their colours. VAF of the fitted samples."),
        lambda overlay: _rows(kernels.second_kernels(overlay), 2),  # titles and colour bars take room
        row_height=3.1,
        over=False,
        note=_lobes,
    ),
    _Drawing(
        "partitions",
        marked("Kernels by depth side by side"),
        marked("A column for each fit: output, measured against modelled output, and kernels over lag and depth."),
        marked(
            "Scheduled by the measured output, fitted samples. In a Wiener system the peaks of all depths lie at one "
            "lag; where the parameters change independently, they move."
        ),
        lambda overlay: _transposed(kernels.partition_columns(overlay)),
        over=True,
    ),
)


def overlay_scores(overlay: Overlay) -> Table:
    """Return scores, parameters and seconds of every entry."""
    head = (
        _("Tests"), _("Fit"), _("VAF, fitted (%)"), _("VAF, held out (%)"), _("VAF, fitted, scheduled (%)"), "AICc",
        _("Parameters"), _("Seconds"), _("Interpretable"),
    )  # fmt: skip
    rows = []
    for entry in overlay.entries:
        report = entry.analysis.model.report
        swept = "" if entry.swept is None else f", {overlay.swept} {entry.swept:g}"
        criterion = report.aicc if entry.scheduled_aicc is None else entry.scheduled_aicc
        rows.append(
            (
                entry.source,
                f"{entry.fit.label}{swept}",
                fixed(report.vaf_percent, 1),
                fixed(report.vaf_validation_percent, 1),
                fixed(entry.scheduled_percent, 1),
                grouped(criterion),
                grouped(report.n_parameters),
                fixed(report.seconds, 2),
                translated(entry.fit.engine.family.interpretability),
            )
        )
    return Table(_("Scores"), head, tuple(rows))


def repeated_table(overlay: Overlay) -> Table:
    """Return mean, standard deviation and coefficient of variation of every quantity (Chen 2010, Table 3.1)."""
    head = (_("Tests"), _("Fit"), _("Quantity"), _("Unit"), _("Count"), _("Mean"), _("SD"), _("CV (%)"))
    rows = []
    for repeated in repeated_values(overlay):
        label, si_unit = quantity_label(repeated.quantity)
        unit, scale = display_unit(si_unit)
        finite = np.isfinite(repeated.std)
        rows.append(
            (
                repeated.source,
                repeated.fit,
                _(label),
                unit,
                str(repeated.count),
                number(scale * repeated.mean),
                number(scale * repeated.std, 3) if finite else MISSING,
                fixed(100.0 * repeated.cv, 2) if finite else MISSING,
            )
        )
    return Table(_("Mean and standard deviation over tests"), head, tuple(rows))
