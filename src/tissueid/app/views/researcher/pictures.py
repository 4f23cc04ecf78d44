"""Overlaid plots of several results, one picture at a time, and their figures for files."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import Qt
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QLabel, QPushButton, QWidget

from tissueid.analysis.curves.overlay_plots import calibration_curves
from tissueid.analysis.curves.plot import Curve
from tissueid.app import build
from tissueid.app.context import AppContext
from tissueid.app.plot_canvas import PlotCanvas
from tissueid.app.theme import LIGHT, appearance
from tissueid.app.views.researcher.engine_outcome import (
    DEPTH,
    KERNELS,
    OUTPUT,
    PICTURES,
    EngineOutcome,
    keys_of,
    overlay,
)
from tissueid.app.views.researcher.results_table import SERIES
from tissueid.app.words import in_words
from tissueid.calibration.status import calibration_folder
from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.formatting import fixed
from tissueid.language import _, marked
from tissueid.messages import Verbatim, translated
from tissueid.procedures.overlay import sweep_columns
from tissueid.units import shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tissueid.analysis.curves import Curve, Plot

_WIDTH, _PANEL_INCHES, _REST = 7.2, 2.1, 0.8
"""Inches: width of a figure, height of a panel, and of a legend and an axis label."""
_LEGEND_LINE = 0.2
_MOST_LEVEL = 8
"""Number of names below an axis above which they are turned upright."""
_LONG = 44
"""Letters of a label beyond which the legend has one column."""


@dataclass(frozen=True, eq=False)
class PictureFigure:
    """Figure of one of ``PICTURES``; ``common`` and ``labels`` form the legend, ``under`` lies below a panel."""

    name: str
    outcomes: tuple[EngineOutcome, ...]
    common: str
    labels: Sequence[str]
    under: Mapping[str, Curve] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Title of the figure, from which the file name is made."""
        return f"{_(self.name)} {self.common or ' '.join(self.labels[:1])}"

    def plots(self, colours: Sequence[str]) -> list[Plot]:
        """Return the panels, with the results laid over each other in some colours."""
        same = len({(outcome.signals, outcome.preparation, *outcome.tests) for outcome in self.outcomes}) == 1
        names = [_legible(label) for label in self.labels]
        made = []
        for panel in PICTURES[self.name]:
            plot = overlay([outcome.plots.panels[panel] for outcome in self.outcomes], colours, names, same_data=same)
            below = self.under.get(panel)
            made.append(plot if below is None else replace(plot, parts=(below, *plot.parts)))
        return made

    def draw(self) -> Figure:
        """Draw the panels below each other."""
        from tissueid.reports.plot_renderer import draw_plots
        from tissueid.reports.style import new_figure

        plots = self.plots([getattr(LIGHT, role) for role in SERIES])
        lines = 2 + len(self.labels) // (1 if max(map(len, self.labels)) > _LONG else 2)
        figure = new_figure(_WIDTH, _PANEL_INCHES * len(plots) + _REST + _LEGEND_LINE * lines)
        every, _long = draw_plots(figure, plots, units=shown, key=False)
        _draw_legend(figure, every[0], self.common, self.labels)
        return figure


@dataclass(frozen=True, eq=False)
class KernelsFigure:
    """Figure of several kernels side by side."""

    title: str
    plots: tuple[Plot, ...]

    def draw(self) -> Figure:
        """Draw the kernels."""
        from tissueid.reports.plot_renderer import draw_grid
        from tissueid.reports.style import new_figure

        figure = new_figure(0.5 * _WIDTH * len(self.plots), 4.0)
        draw_grid(figure, [self.plots], units=shown)
        return figure


@dataclass(frozen=True, eq=False)
class KernelFigure:
    """Figure of a kernel as an image or a surface."""

    title: str
    plot: Plot
    turned: bool = False

    def draw(self) -> Figure:
        """Draw the kernel."""
        from tissueid.reports.plot_renderer import draw_plot, draw_relief
        from tissueid.reports.style import new_figure

        figure = new_figure(_WIDTH, 5.0)
        if self.turned:
            axes: Axes = draw_relief(figure, self.plot, units=shown, title=False)
        else:
            axes = figure.subplots()
            draw_plot(axes, self.plot, units=shown, title=False)
        axes.set_title(_legible(self.title), wrap=True)
        return figure


@dataclass(frozen=True, eq=False)
class PopulationFigure:
    """The population as it is shown; ``note`` says what is drawn."""

    title: str
    plot: Plot
    note: str

    def draw(self) -> Figure:
        """Draw points or bars, the means of groups, and the number of fits."""
        from tissueid.reports.plot_renderer import draw_plot
        from tissueid.reports.style import new_figure

        labels = [translated(part.name) for part in self.plot.parts if part.name]
        figure = new_figure(_WIDTH, 4.2 + _LEGEND_LINE * len(labels))
        axes = figure.subplots()
        draw_plot(axes, self.plot, units=shown, key=False)
        if len(self.plot.x.ticks) > _MOST_LEVEL:
            axes.tick_params("x", labelrotation=90)
        axes.set_title(self.note)
        _draw_legend(figure, axes, "", labels or [""])
        return figure


def _draw_legend(figure: Figure, axes: Axes, common: str, labels: Sequence[str]) -> None:
    handles, names = axes.get_legend_handles_labels()
    if any(names):
        columns = 1 if max(map(len, labels)) > _LONG else 2
        figure.legend(handles, names, title=_legible(common), loc="outside lower center", ncols=columns)


def _legible(text: str) -> str:
    """Return a label that matplotlib draws; it would skip one that begins with an underscore."""
    return f"\u200a{text}" if text.startswith("_") else text


_MOST_BESIDE = 4
"""Largest number of kernels side by side: more would be too small."""
_MISSING = marked("No result has a kernel to show: run Volterra, Depth or Direction.")


class KernelPlot(QWidget):
    """Plot of one kernel, selected by ``choice``: an image where ``flat`` is checked, a surface where ``raised`` is.

    With kernels of several results, ``choice`` also offers those of the same kind side by side (Chen 2010, Fig. 4.12).
    """

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.choice = build.choice({}, self._show, 10, name=_("Result whose kernel is shown"))
        self.canvas = PlotCanvas()
        self._plots: list[Plot] = []
        self._groups: list[tuple[Plot, ...]] = []
        self.back = build.button(_("Reset view"), self.canvas.show_everything, tip=_("Look at it as at first (Home)"))
        self.flat = build.button(_("Image"), tip=_("Seen from above, every value a colour"))
        self.raised = build.button(_("Surface"), tip=_("In space, every value a height; it can be turned"))
        for button in (self.flat, self.raised):
            build.styled(button, checkable=True, role="toggle", auto_exclusive=True)
        top = build.row((self.choice, 1), self.back, self.flat, self.raised, spacing=4)
        self.flat.setChecked(True)
        self.raised.toggled.connect(self._show)
        build.column(top, (self.canvas, 1), spacing=4, parent=self)
        self._show()

    @property
    def plot(self) -> Plot | None:
        """The shown kernel."""
        index = self.choice.currentIndex()
        return self._plots[index] if 0 <= index < len(self._plots) else None

    @property
    def side_by_side(self) -> tuple[Plot, ...]:
        """The kernels that are shown side by side; empty where one is shown."""
        index = self.choice.currentIndex() - len(self._plots)
        return self._groups[index] if 0 <= index < len(self._groups) else ()

    @property
    def turned(self) -> bool:
        """Whether the surface is shown."""
        return self.raised.isChecked() and not self.side_by_side

    def offer(self, outcomes: Sequence[EngineOutcome]) -> None:
        """Offer the kernels of results; the selection stays."""
        pairs = [(f"{outcome.label}: {_(plot.title)}", plot) for outcome in outcomes for plot in outcome.plots.kernels]
        self._plots = [plot for _name, plot in pairs]
        kinds: dict[str, list[Plot]] = {}
        for outcome in outcomes:
            for plot in outcome.plots.kernels:
                kinds.setdefault(str(plot.title), []).append(replace(plot, title=Verbatim(outcome.label)))
        several = {title: _on_one_scale(plots[:_MOST_BESIDE]) for title, plots in kinds.items() if len(plots) > 1}
        self._groups = list(several.values())
        together = [_("{kernel}: side by side").format(kernel=_(title)) for title in several]
        build.offer_texts(self.choice, [text for text, _plot in pairs] + together)
        self._show()

    def _show(self) -> None:
        plot, together = self.plot, self.side_by_side
        self.choice.setVisible(plot is not None or bool(together))
        for widget in (self.flat, self.raised):
            widget.setVisible(plot is not None)
        self.back.setVisible(plot is not None and self.turned)
        if together:
            self.canvas.show_plots(together, side_by_side=True)
        elif plot is None:
            self.canvas.say_missing(_(_MISSING))
        else:
            self.canvas.show_plots([plot], relief=self.turned)


def _on_one_scale(plots: Sequence[Plot]) -> tuple[Plot, ...]:
    """Return plots of kernels with the same scale of colours."""
    surfaces = [plot.surface for plot in plots if plot.surface is not None]
    top = max((float(np.abs(surface.values).max()) for surface in surfaces), default=0.0)
    return tuple(
        plot if plot.surface is None else replace(plot, parts=(replace(plot.surface, limit=top or None),))
        for plot in plots
    )


_CHOICE = 80
"""Minimum width of the choice of a picture, pixels."""
_LEAST, _AROUND = 48, 8
"""Characters of a name in the legend that are shown at least, and those that the square and the margins take."""
_PANEL = 100
"""Minimum height of a panel, pixels."""

_LOW = 460
"""Height of the plots with their legend below which the legend has two lines, pixels."""
_ANY = 16_777_215


class Pictures(QWidget):
    """Plots of results. ``show_outcomes`` returns the drawn ones in the order of their colours."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        titles = {name: _(name) for name in PICTURES}
        self.choice = build.choice(titles, name=_("Picture"), minimum_width=_CHOICE)
        self._drawn: list[EngineOutcome] = []
        self._total = 0
        self._refused = ""
        self._under: Mapping[str, Curve] = {}
        self._for_depth: list[QWidget] = []
        self.plots, self.kernel = PlotCanvas(), KernelPlot()
        self._pages = build.stack(self.plots, self.kernel)
        self.legend = build.styled(
            QLabel(),
            text_format=Qt.TextFormat.RichText,
            word_wrap=True,
            alignment=Qt.AlignmentFlag.AlignTop,
            minimum_width=1,
            name=_("Key of the plots"),
        )
        self.choice.currentIndexChanged.connect(self._show)
        appearance.changed.connect(self._show_legend)
        self.canvas = QWidget()
        self._inside = build.column(self.legend, (self._pages, 1), spacing=4, parent=self.canvas)
        self.tools = build.row(self.choice, spacing=4)
        build.column(self.tools, (self.canvas, 1), spacing=4, parent=self)
        self.show_outcomes(())

    def show_outcomes(self, outcomes: Sequence[EngineOutcome], total: int = 0) -> list[EngineOutcome]:
        """Draw the first seven results with the same signals that were not refused.

        ``total`` counts all fits of the table, which the legend says where only some are drawn.
        """
        there = [outcome for outcome in outcomes if outcome.report is not None]
        self._refused = "" if there or not outcomes else translated(outcomes[0].refused)
        self._drawn = [outcome for outcome in there if outcome.plots.units == there[0].plots.units][: len(SERIES)]
        self._total = max(total, len(there))
        self.kernel.offer([o for o in there if o.plots.kernels])
        self._show()
        return self._drawn

    def add_for_depth(self, widget: QWidget) -> None:
        """Add a widget above the plots against depth, which is hidden with other pictures."""
        self._for_depth.append(widget)
        self._inside.insertWidget(0, widget, 0, Qt.AlignmentFlag.AlignLeft)
        self._show()

    def show_calibration(self, curves: Mapping[str, Curve]) -> None:
        """Draw the curves of a calibration below the results against depth; none without any."""
        self._under = curves
        self.choice.setCurrentIndex(self.choice.findData(DEPTH))
        self._show()

    @property
    def calibrated(self) -> bool:
        """Whether a calibration lies below the results."""
        return bool(self._under)

    @property
    def outcomes(self) -> tuple[EngineOutcome, ...]:
        """The drawn results in the order of their colours."""
        return tuple(self._drawn)

    @property
    def figure(self) -> PictureFigure | KernelFigure | KernelsFigure | None:
        """The shown plot as a figure for files; None if nothing is shown."""
        name, kernel = self.choice.currentData(), self.kernel.plot
        if name == KERNELS and self.kernel.side_by_side:
            return KernelsFigure(self.kernel.choice.currentText(), self.kernel.side_by_side)
        if name == KERNELS:
            text, turned = self.kernel.choice.currentText(), self.kernel.turned
            return None if kernel is None else KernelFigure(text, kernel, turned)
        return PictureFigure(name, tuple(self._drawn), *self.keys(), self._under) if self._drawn else None

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Elide the names in the legend to the available width."""
        super().resizeEvent(event)
        self._show_legend()

    # -- inside -------------------------------------------------------------------------------------------

    def keys(self, room: int | None = None) -> tuple[str, list[str]]:
        """Return the common part of the labels of the drawn results, and the label of each in the legend.

        With ``room`` names are elided to that number of characters, but not the scores.
        """
        common, labels = keys_of(self._drawn)
        scores = [""] * len(labels)
        if self.choice.currentData() == OUTPUT:
            scores = [f": {_scores(outcome)}" for outcome in self._drawn]
        if room is not None:
            labels = [
                in_the_middle(label, max(_LEAST // 2, room - len(score)))
                for label, score in zip(labels, scores, strict=True)
            ]
        return common, [label + score for label, score in zip(labels, scores, strict=True)]

    def _show(self) -> None:
        name = self.choice.currentData()
        panels = PICTURES[name]
        for widget in self._for_depth:
            widget.setVisible(name == DEPTH)
        self._pages.setCurrentWidget(self.plots if panels else self.kernel)
        self.plots.setMinimumHeight(_PANEL * len(panels))
        if panels and not self._drawn:
            refused = _("Refused: {reason}").format(reason=self._refused) if self._refused else ""
            self.plots.say_missing(refused or _("Nothing to show yet: choose tests and run an engine."))
        elif panels:
            self.plots.show_plots(
                PictureFigure(name, tuple(self._drawn), *self.keys(), self._under).plots(SERIES), key=False
            )
        self._show_legend()

    def _show_legend(self) -> None:
        theme = appearance.theme
        room = max(_LEAST, self.width() // max(1, self.fontMetrics().averageCharWidth()) - _AROUND)
        common, labels = self.keys(room)
        entries = [html.escape(f"{common}:")] if common else []
        for role, label in zip(SERIES, labels, strict=False):
            name = html.escape(label).replace(" ", "&nbsp;")
            entries.append(f'<span style="color:{getattr(theme, role)}">■</span>&nbsp;{name}')
        panels = PICTURES[self.choice.currentData()]
        every = [[outcome.plots.panels[panel] for outcome in self._drawn] for panel in panels]
        below = [self._under[panel].name for panel in panels if panel in self._under][:1]
        # The key says what else is drawn: measurements, and faint curves.
        notes = [_(name) for name in below]
        named = (text for plots in every for plot in plots for c in plot.curves for text in (c.name, c.band) if text)
        notes += dict.fromkeys(_(text) for text in named)
        for plots in every:
            without = sum(not plot.parts for plot in plots)
            if 0 < without < len(plots):
                text = _("{without} of {count} have none").format(without=without, count=len(plots))
                notes.append(f"{translated(plots[0].title)}: {text}")
        if len(self._drawn) < self._total:
            notes.append(
                _("{drawn} of {count} drawn: select which in the table").format(
                    drawn=len(self._drawn), count=self._total
                )
            )
        entries += [f'<span style="color:{theme.muted}">{note}</span>' for note in notes]
        self.legend.setText(" &nbsp;&nbsp; ".join(entries))
        self.legend.setMinimumHeight(0)  # what the text needs must be asked without the former bounds
        self.legend.setMaximumHeight(_ANY)
        needed = max(0, self.legend.heightForWidth(self.width()))  # -1 without a text
        if self.height() < _LOW:  # the plots need the room more; the tool tip has the rest
            needed = min(needed, 2 * self.legend.fontMetrics().lineSpacing())
            self.legend.setToolTip(self.legend.text())
        else:
            self.legend.setToolTip("")
        self.legend.setFixedHeight(needed)  # a splitter does not know heights of wrapped texts
        self.legend.setVisible(bool(entries) and bool(panels))


def in_the_middle(text: str, longest: int) -> str:
    """Return a text that is elided in the middle."""
    half = (longest - 1) // 2
    return text if len(text) <= longest else f"{text[:half]}…{text[-half:]}"


def _scores(outcome: EngineOutcome) -> str:
    """Return the VAF on held-out data, and that of the simulation scheduled by measured depth if there is one."""
    report = outcome.report
    assert report is not None
    score = _("VAF {vaf} %").format(vaf=fixed(report.vaf_validation_percent, 1))
    scheduled = report.vaf_scheduled_percent
    return (
        score
        if scheduled is None
        else _("{vaf} (scheduled {scheduled} %)").format(vaf=score, scheduled=fixed(scheduled, 1))
    )


class CalibrationButton(QPushButton):
    """Checked while a sweep lies below the results; asks for its file, or takes it away."""

    def __init__(self, context: AppContext, pictures: Pictures) -> None:
        super().__init__(_("Calibration…"))
        self._context, self._pictures = context, pictures
        build.styled(
            self,
            checkable=True,
            name=_("Draw a calibration below the results"),
            tip=_("Draw mass, damping and stiffness of a dynamic sweep below the results against depth"),
        )
        self.clicked.connect(self._choose)

    def draw_sweep(self, path: Path) -> None:
        """Draw a dynamic sweep (Chen 2010, Figs. 3.13 and 5.9)."""
        try:
            self._pictures.show_calibration(calibration_curves(sweep_columns(path)))
        except TissueIDError as error:
            self._context.say(in_words(error), problem=True)
        self._check()

    def _choose(self, wanted: bool) -> None:
        if not wanted:
            self._pictures.show_calibration({})
            return
        folder = None
        with suppress(UnusableInputError):
            folder = calibration_folder()
        dialog = build.ask_path(self, _("Dynamic sweep"), folder, self.draw_sweep, "TOML (*.toml)")
        dialog.finished.connect(self._check)

    def _check(self) -> None:
        self.setChecked(self._pictures.calibrated)
