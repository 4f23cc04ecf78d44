"""One renderer draws every plot: parts, units, scales, and what is missing."""

import csv
import io

import numpy as np
import pytest
from matplotlib.figure import Figure

from tissueid.analysis.curves import Axis, Bars, Curve, Plot, Surface, plot_or_reason, thin
from tissueid.analysis.curves.plot import as_csv
from tissueid.errors import UnusableInputError
from tissueid.messages import Message
from tissueid.reports.plot_renderer import PAGE, Look, draw_plot, draw_plots, draw_relief

NO_FORCE = Message("plot.test", "no {what} was recorded", what="force")
X = np.linspace(1.0, 10.0, 50)
LAG, RESPONSE = Axis("Lag", "ms"), Axis("", "mm/(N·s)")


def draw(plot, **how):
    axes = Figure().subplots()
    return axes, draw_plot(axes, plot, **how)


def test_curves_have_their_kinds_bands_names_and_units():
    measured = Curve(X, X, "measured", "measured", "points", X - 1.0, X + 1.0, "95 % band")
    plot = Plot("Impulse response", LAG, RESPONSE, (measured, Curve(X, 2.0 * X, "model", "model", "dashed")))
    axes, long = draw(plot, units=lambda unit: ("s", 1e-3) if unit == "ms" else (unit, 1.0))
    points, model = axes.lines
    assert (points.get_linestyle(), points.get_marker(), model.get_linestyle()) == ("None", ".", "--")
    assert model.get_color() == PAGE.colour("model")
    np.testing.assert_allclose(points.get_xdata(), 1e-3 * X)
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_title(loc="left")) == ("Lag (s)", "mm/(N·s)", plot.title)
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["95 % band", "measured", "model"]
    assert not long


def test_a_theme_colours_everything_without_global_settings():
    look = Look("#111111", "#222222", "#333333", "#444444", 8.0, {"measured": "#555555"})
    axes, _ = draw(Plot("t", LAG, RESPONSE, (Curve(X, X, "$a$"),)), look=look)
    assert axes.lines[0].get_color() == "#555555"
    assert axes.xaxis.label.get_color() == "#111111"
    assert axes.xaxis.label.get_fontsize() == 8.0
    (text,) = axes.get_legend().get_texts()
    assert not text.get_parse_math()


def test_a_wide_band_does_not_squeeze_the_curve():
    wide = Curve(X, X, low=X - 1e3, high=X + 1e3)
    axes, _ = draw(Plot("t", LAG, RESPONSE, (wide,)))
    assert axes.get_ylim()[1] < 20.0
    axes, _ = draw(Plot("t", LAG, Axis("", "mm", log=True), (Curve(X, X, low=X / 1e3, high=1e3 * X),)))
    assert axes.get_ylim()[1] <= 25.0


def test_long_lines_are_drawn_as_many_points_as_are_seen():
    x = np.arange(100_000.0)
    _axes, (line,) = draw(Plot("t", LAG, RESPONSE, (Curve(x, np.sin(x)),)))
    assert line.line.get_xdata().size <= 1800
    assert line.line.get_ydata().max() == pytest.approx(np.sin(x).max())
    line.show(1000.0, 1100.0)
    assert line.line.get_xdata().size == 102
    kept, values = thin(x, x)
    assert kept.size == values.size <= 1800


def test_levels_positions_bars_and_images_are_drawn():
    parts = (
        Curve(np.zeros(1), np.ones(1), "level", kind="level"),
        Curve(np.ones(1), np.ones(1), kind="position"),
        Bars(np.zeros(2), np.array([1.0, 2.0]), names=("a", "b"), error=np.array([0.1, 0.1])),
    )
    axes, _ = draw(Plot("t", Axis(), RESPONSE, parts))
    assert [label.get_text() for label in axes.get_xticklabels()] == ["a", "b"]
    assert [patch.get_height() for patch in axes.patches] == [1.0, 2.0]
    assert len(axes.lines) >= 2
    surface = Plot("k", LAG, LAG, (Surface(X, X[:20], np.outer(X[:20], X), "Kernel", "mm"),))
    axes, _ = draw(surface)
    assert axes.images[0].get_array().shape == (20, 50)
    relief = draw_relief(Figure(), surface)
    assert relief.get_zlabel() == "Kernel (mm)"


def test_plots_over_one_abscissa_share_it():
    plots = [Plot(name, LAG, RESPONSE, (Curve(X, X),)) for name in "ab"]
    (upper, lower), _ = draw_plots(Figure(), plots)
    assert upper.get_shared_x_axes().joined(upper, lower)
    assert (upper.get_xlabel(), lower.get_xlabel()) == ("", "Lag (ms)")


def test_where_there_is_nothing_it_says_why():
    def refuse():
        raise UnusableInputError(NO_FORCE)

    plot = plot_or_reason("t", LAG, RESPONSE, refuse)
    assert plot.missing == NO_FORCE
    axes, _ = draw(plot)
    assert f"N{NO_FORCE[1:]}" in [text.get_text() for text in axes.texts]
    assert not axes.axison


def test_numbers_are_saved_as_csv():
    plots = [
        Plot("a", LAG, RESPONSE, (Curve(X[:2], X[:2], "one", low=X[:2] - 1.0, high=X[:2]),)),
        Plot("b", LAG, LAG, (Surface(X[:1], X[:2], np.ones((2, 1)), "k", "mm"), Bars(X[:1], X[:1]))),
    ]
    rows = list(csv.DictReader(io.StringIO(as_csv(plots))))
    assert [row["plot"] for row in rows] == ["a", "a", "b", "b", "b"]
    assert (rows[0]["x"], rows[0]["x_unit"], rows[0]["low"]) == ("1.0", "ms", "0.0")
    assert (rows[2]["value"], rows[2]["value_unit"]) == ("1.0", "mm")
