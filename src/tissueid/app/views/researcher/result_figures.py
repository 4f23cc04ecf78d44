"""Figures of results for publications, drawn by matplotlib on white, with legend and units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from tissueid.app.theme import LIGHT
from tissueid.app.views.researcher.engine_outcome import EngineOutcome
from tissueid.app.views.researcher.plot_data import Array, Line, Panel
from tissueid.app.views.researcher.plot_panels import OUTPUT, PANELS, PICTURES, PanelStyle
from tissueid.app.views.researcher.population import DATE, DISTRIBUTION, Population
from tissueid.app.views.researcher.results_table import SERIES
from tissueid.language import _
from tissueid.units import shown, shown_label

if TYPE_CHECKING:  # matplotlib is imported when the first figure is drawn
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tissueid.analysis.curves import Plot

_WIDTH, _PANEL, _REST = 7.2, 2.1, 0.8
"""Inches: width of a figure, height of a panel, and of a legend and an axis label."""
_LEGEND_LINE = 0.2
_SHORT = 26
"""Characters of a label that fit next to a panel."""
_LONG = 44
"""Letters of a label beyond which the legend has one column."""


@dataclass(frozen=True, eq=False)
class PictureFigure:
    """Figure of one of ``PICTURES``; ``common`` and ``labels`` form the legend."""

    name: str
    outcomes: tuple[EngineOutcome, ...]
    common: str
    labels: Sequence[str]

    @property
    def title(self) -> str:
        """Title of the figure, from which the file name is made."""
        return f"{_(self.name)} {self.common or ' '.join(self.labels[:1])}"

    def draw(self) -> Figure:
        """Draw the panels below each other."""
        from tissueid.reports.style import new_figure

        panels = PICTURES[self.name]
        lines = 2 + len(self.labels) // (1 if max(map(len, self.labels)) > _LONG else 2)
        figure = new_figure(_WIDTH, _PANEL * len(panels) + _REST + _LEGEND_LINE * lines)
        every = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
        for axes, panel in zip(every, panels, strict=True):
            self._draw_panel(axes, panel)
        for axes, panel in zip(every[:-1], panels[:-1], strict=True):
            if not PANELS[panel].x_label:
                axes.sharex(every[-1])
                axes.tick_params(labelbottom=False)
        _draw_legend(figure, every[0], self.common, self.labels)
        return figure

    def _draw_panel(self, axes: Axes, panel: Panel) -> None:
        look = PANELS[panel]
        unit, factor = shown(self.outcomes[0].plots.units.get(panel, ""))
        scale = _Scale(shown_label(PANELS[PICTURES[self.name][-1]].x_label)[1], factor, look.logs)
        same = len({(outcome.signals, *outcome.tests) for outcome in self.outcomes}) == 1
        faint = _("faint: scheduled by the measured output") if self.name == OUTPUT else _("faint: on the way out")
        once = {"measured": _("broad and pale: measured"), "out": faint}
        for place, outcome in enumerate(self.outcomes):
            colour = getattr(LIGHT, SERIES[place % len(SERIES)])
            measured, line = outcome.plots.measured.get(panel), outcome.plots.lines.get(panel)
            if measured is not None and (not same or place == 0):
                under, alpha = (LIGHT.muted, 0.6) if same else (colour, 0.3)
                words = once.pop("measured", None)
                axes.plot(measured.x, factor * measured.y, color=under, alpha=alpha, linewidth=2.4, label=words)
            _draw_line(axes, line or Line(np.zeros(0), np.zeros(0)), scale, colour, _legible(self.labels[place]))
            if line is not None and line.out_x is not None and line.out_y is not None:
                x, y = scale.across(line.out_x), scale.up(line.out_y)
                axes.plot(x, y, color=colour, alpha=0.5, linewidth=0.8, label=once.pop("out", None))
        _label(axes, look, unit)
        if not any(panel in outcome.plots.lines for outcome in self.outcomes):
            reasons = filter(None, dict.fromkeys(outcome.plots.missing.get(panel, "") for outcome in self.outcomes))
            axes.text(0.02, 0.5, " ".join(reasons), transform=axes.transAxes, wrap=True)


@dataclass(frozen=True)
class _Scale:
    """From what is drawn on the screen to what stands at the axes: factors, or decimal logarithms taken back."""

    x: float
    y: float
    logs: Sequence[str]

    def across(self, values: Array) -> Array:
        return np.asarray(10.0**values if "bottom" in self.logs else self.x * values)

    def up(self, values: Array) -> Array:
        return np.asarray(self.y * (10.0**values if "left" in self.logs else values))


def _draw_line(axes: Axes, line: Line, scale: _Scale, colour: str, label: str) -> None:
    x, marker, style = scale.across(line.x), "o" if line.dots else "", "none" if line.dots else "-"
    axes.plot(x, scale.up(line.y), color=colour, label=label, marker=marker, linestyle=style, linewidth=1.0, zorder=3)
    if line.low is not None and line.high is not None:
        axes.fill_between(x, scale.up(line.low), scale.up(line.high), color=colour, alpha=0.18, linewidth=0.0)


def _label(axes: Axes, look: PanelStyle, unit: str) -> None:
    """Give the axes their quantities and units; a quantity that is too long for its axis stands above."""
    from tissueid.reports.style import frequency_axis, log_axis

    title = _(look.title)
    if len(title) <= _SHORT:
        axes.set_ylabel(f"{title} ({unit})" if unit else title)
    else:
        axes.set_title(title)
        axes.set_ylabel(unit)
    if "bottom" in look.logs and axes.get_lines():
        known = np.concatenate([np.asarray(line.get_xdata(), np.float64) for line in axes.get_lines()])
        if known.size:
            frequency_axis(axes, float(known.min()), float(known.max()))
    if "left" in look.logs:
        log_axis(axes)
    axes.set_xlabel(shown_label(_(look.x_label))[0])


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
    """The population as it is shown: ``across`` is what it is drawn against, ``spread`` what the bars are."""

    title: str
    found: Population
    across: str
    x_label: str
    spread: str
    labels: Sequence[str]
    note: str

    def draw(self) -> Figure:
        """Draw points or bars, the means of groups, and the number of fits."""
        from tissueid.reports.style import new_figure

        figure = new_figure(_WIDTH, 4.2 + _LEGEND_LINE * len(self.labels))
        axes, found = figure.subplots(), self.found
        unit, factor = shown(found.unit)
        colours = [getattr(LIGHT, role) for role in SERIES]
        for place, (label, colour) in enumerate(zip(self.labels, colours, strict=False)):
            mask = found.group == place
            if self.across == DISTRIBUTION:
                counts = np.histogram(found.y[mask], found.edges)[0]
                axes.stairs(counts, factor * found.edges, color=colour, fill=True, alpha=0.35, label=_legible(label))
                axes.stairs(counts, factor * found.edges, color=colour)
            else:
                x = self._across(found.x[mask])
                axes.plot(
                    x, factor * found.y[mask], "o", color=colour, alpha=0.5, markersize=3.5, label=_legible(label)
                )
        if self.across == DISTRIBUTION:
            axes.set_ylabel(found.counted)
            axes.set_xlabel(self.x_label)
        else:
            self._draw_means(axes, factor, colours)
            axes.set_ylabel(f"{found.title} ({unit})" if unit else found.title)
            axes.set_xlabel(shown_label(found.x_label)[0])
        if found.places and self.across != DATE:
            axes.set_xticks(range(len(found.places)), [_legible(place) for place in found.places])
            if len(found.places) > 8:
                axes.tick_params("x", labelrotation=90)
        elif self.across == DATE:
            figure.autofmt_xdate()
        axes.set_title(self.note)
        _draw_legend(figure, axes, "", self.labels)
        return figure

    def _draw_means(self, axes: Axes, factor: float, colours: Sequence[str]) -> None:
        for mean in self.found.means if self.spread else ():
            half = factor * (mean.std if self.spread == "std" else mean.half_interval)
            bar = None if np.isnan(half) else half
            x = self._across(np.array([mean.x]))
            colour = colours[mean.group]
            axes.errorbar(x, [factor * mean.y], yerr=bar, fmt="o", color=colour, markeredgecolor=LIGHT.panel, zorder=4)

    def _across(self, x: Array) -> Any:
        if self.across == DATE:
            return [datetime.fromtimestamp(float(when)) for when in x]
        return x if self.found.places else shown_label(self.found.x_label)[1] * x


def _draw_legend(figure: Figure, axes: Axes, common: str, labels: Sequence[str]) -> None:
    handles, words = axes.get_legend_handles_labels()
    if any(words):
        columns = 1 if max(map(len, labels)) > _LONG else 2
        figure.legend(handles, words, title=_legible(common), loc="outside lower center", ncols=columns)


def _legible(text: str) -> str:
    """Return a label that matplotlib draws; it would skip one that begins with an underscore."""
    return f"\u200a{text}" if text.startswith("_") else text


__all__ = ["KernelFigure", "PictureFigure", "PopulationFigure"]
