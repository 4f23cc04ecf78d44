"""Figures of results for publications, drawn by matplotlib on white, with legend and units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from tissueid.app.theme import LIGHT
from tissueid.app.views.researcher.engine_outcome import EngineOutcome
from tissueid.app.views.researcher.plot_data import PICTURES, overlay
from tissueid.app.views.researcher.results_table import SERIES
from tissueid.language import _
from tissueid.messages import translated
from tissueid.units import shown

if TYPE_CHECKING:  # matplotlib is imported when the first figure is drawn
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tissueid.analysis.curves import Curve, Plot

_WIDTH, _PANEL, _REST = 7.2, 2.1, 0.8
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
        figure = new_figure(_WIDTH, _PANEL * len(plots) + _REST + _LEGEND_LINE * lines)
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
    handles, words = axes.get_legend_handles_labels()
    if any(words):
        columns = 1 if max(map(len, labels)) > _LONG else 2
        figure.legend(handles, words, title=_legible(common), loc="outside lower center", ncols=columns)


def _legible(text: str) -> str:
    """Return a label that matplotlib draws; it would skip one that begins with an underscore."""
    return f"\u200a{text}" if text.startswith("_") else text
