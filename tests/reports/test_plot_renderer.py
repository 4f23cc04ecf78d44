"""One renderer draws every plot: parts, units, scales, and what is missing."""

import csv
import io

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tissueid.analysis.curves import Axis, Bars, Curve, Mark, Plot, Surface, plot_or_reason, thin
from tissueid.analysis.curves.comparison_plots import rows_plot
from tissueid.analysis.curves.plot import as_csv, depth_roles, histogram
from tissueid.errors import UnusableInputError
from tissueid.messages import Message
from tissueid.reports.plot_axes import PAGE, Look, lay_out
from tissueid.reports.plot_renderer import draw_grid, draw_plot, draw_plots, draw_relief, draw_row

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


def test_named_rows_have_bars_along_the_abscissa_in_the_units_of_the_reader():
    rows = np.array([2.0, 1.0])
    bars = Curve(np.array([10.0, 20.0]), rows, kind="bars", low=np.array([9.0, 18.0]), high=rows + 20.0, across=True)
    span = Curve(np.zeros(0), np.array([0.5, 1.5]), kind="spans", across=True)
    y = Axis(limits=(0.5, 2.5), ticks=((2.0, "$a$"), (1.0, "b")))
    axes, _ = draw(Plot("t", LAG, y, (bars, span)), units=lambda unit: ("s", 1e-3) if unit == "ms" else (unit, 1.0))
    assert [label.get_text() for label in axes.get_yticklabels()] == ["$a$", "b"]
    (segments,) = (part.get_segments() for part in axes.containers[0][2])
    np.testing.assert_allclose(np.array(segments)[:, :, 0], [[0.009, 0.022], [0.018, 0.021]])
    assert len(axes.patches) == 1


def test_curves_by_depth_have_a_colour_bar():
    roles = depth_roles(3)
    curves = tuple(Curve(X, place + X, "", role) for place, role in enumerate(roles))
    axes, _ = draw(Plot("t", LAG, RESPONSE, curves, depths=Axis("Depth", "mm", limits=(1.0, 4.0))))
    assert [line.get_color() for line in axes.lines] == [PAGE.colour(role) for role in roles]
    bar = axes.figure.axes[-1]
    assert bar.get_ylabel() == "Depth (mm)"
    assert [label.get_text() for label in bar.get_yticklabels()] == ["1.00", "2.00", "3.00", "4.00"]


def test_plots_with_one_ordinate_share_it():
    plots = [Plot(name, LAG, RESPONSE, (Curve(X, factor * X, "same"),)) for name, factor in (("a", 1.0), ("b", 5.0))]
    left, right = draw_row(Figure(), plots)
    assert left.get_ylim() == right.get_ylim()
    assert (left.get_ylabel(), right.get_ylabel()) == ("mm/(N·s)", "")
    assert (left.get_legend() is None, right.get_legend() is None) == (False, True)


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


def test_texts_stand_over_the_axes_or_over_a_height_and_filled_curves_reach_zero():
    marks = (Mark(2.0, "preload"), Mark(10.0, "$a$", 5.0, "right", "text"))
    bars = histogram(X, np.array([1.0, 5.0, 10.0]), "good", "played")
    axes, _ = draw(Plot("", LAG, RESPONSE, (bars,), marks=marks), units=lambda unit: (unit, 2.0))
    over, right = axes.texts
    assert (over.get_text(), over.xy, over.get_ha(), over.get_color()) == (
        "preload",
        (4.0, 1.0),
        "left",
        PAGE.muted,
    )
    assert (right.get_text(), right.xy, right.get_ha(), right.get_parse_math()) == ("$a$", (20.0, 10.0), "right", False)
    (area,) = axes.patches
    assert area.get_label() == "played"
    assert area.get_xy()[:, 1].min() == 0.0


def test_a_grid_shares_abscissas_by_column_and_ordinates_by_row():
    rows = [[Plot("", LAG, axis, (Curve(X, X, name),)) for name in "ab"] for axis in (RESPONSE, LAG)]
    axes, _ = draw_grid(Figure(), rows)
    assert axes[0].get_shared_x_axes().joined(axes[0], axes[2])
    assert axes[0].get_shared_y_axes().joined(axes[0], axes[1])
    assert [one.get_xlabel() for one in axes] == ["", "", "Lag (ms)", "Lag (ms)"]
    assert [one.get_ylabel() for one in axes] == ["mm/(N·s)", "", "Lag (ms)", ""]
    assert [one.get_legend() is None for one in axes] == [False, False, True, True]


@pytest.mark.parametrize("width", [2.6, 3.5, 6.0])
def test_a_key_never_covers_the_title_where_rows_have_long_names(width):
    values, rows = np.array([3.0, 2.0]), np.array([0, 1])
    names = ["2026-01-15 10:30  left forearm, posterior"] * 2
    groups = [("others", "measured", rows[1:]), ("this sitting", "model", rows[:1])]
    plot = rows_plot("Mass", Axis("± one SD", "g"), names, values, 0.1 * values, groups)
    figure = Figure(figsize=(width, 1.2), dpi=100)
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    draw_plot(axes, plot)
    lay_out(figure)
    figure.canvas.draw()
    assert not axes.get_legend().get_window_extent().overlaps(axes._left_title.get_window_extent())


def test_spans_have_numbers_along_one_axis_alone():
    spans = Curve(np.zeros(0), np.array([1.0, 2.0]), kind="spans", across=True)
    lines = as_csv([Plot("p", Axis("x"), Axis("y"), (spans,))]).splitlines()
    assert [line.split(",")[2:5] for line in lines[1:]] == [["", "", "1.0"], ["", "", "2.0"]]
