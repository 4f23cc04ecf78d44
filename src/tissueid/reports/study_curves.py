"""Figures of curves by group in the report of a study, of kernels, and of their principal components."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial

from tissueid.analysis.curves.plot import Plot
from tissueid.analysis.curves.samples import (
    DAMPING,
    KERNEL1,
    KERNEL2,
    MAGNITUDE,
    MASS,
    NONLINEARITY,
    PARTITIONS,
    PHASE,
    STIFFNESS,
)
from tissueid.language import _, marked
from tissueid.messages import Verbatim, translated
from tissueid.studies.curve_groups import By, GroupCurve, chosen, directions
from tissueid.studies.curve_plots import (
    component_curves,
    component_panels,
    curve_plot,
    kernel_panel,
    name_of,
    scores_plot,
    shared_limit,
    title_of,
)
from tissueid.studies.study_statistics import StudyStatistics

Plots = Mapping[str, Callable[[], Plot]]
"""Functions that compute plots, by the name of the parameter; a ``Verbatim`` is the label of a plot of a group."""
MOST_PANELS = 24
"""Largest number of groups whose kernels are drawn."""
_LINES = marked(
    "Lines: mean of the subjects, each the mean of its tests, or mean of the tests of a material. Bands: 95 % interval "
    "of the mean. A line ends where fewer than nine tenths of the subjects or tests have a value."
)
CURVE_CAPTIONS: Mapping[str, str] = {
    "response": _LINES,
    "depth": marked(
        "Lines: mean of the subjects, each the mean of its tests, or mean of the tests of a material. Bands: 95 % "
        "interval of the mean. Thin lines: subjects, or tests of a material. A mean ends where fewer than nine "
        "tenths of them have a value."
    ),
    "static": _LINES,
    "kernel": _LINES,
    "change": marked(
        "Change against the reference at the same depth, paired by subject. Lines: mean of the subjects. Bands: 95 % "
        "interval of the mean. Thin lines: subjects. A mean ends where fewer than nine tenths of them have a "
        "value."
    ),
    "second": marked(
        "Mean of the subjects, each the mean of its tests, or mean of the tests of a material; mean VAF of the tests. "
        "All groups have the same scale of colours."
    ),
    "partition": marked(
        "Kernels of the partitions of depth, mean of the subjects or of the tests of a material, where at least half "
        "have a value; mean VAF of the tests in a run that is scheduled by the measured depth. All groups have the "
        "same scale of colours."
    ),
    "components1": marked("Mean kernel of all tests, and its change by one standard deviation of each component."),
    "components2": marked(
        "Mean kernel of all tests, and its change by one standard deviation of each component, which share a scale of "
        "colours. Percent: share of the variance."
    ),
    "scores": marked("One point per test."),
}
"""What the signs of a figure of curves are, by the first word of the key of its group."""
_HEADINGS: Mapping[str, str] = {
    "response": marked("Frequency response"),
    "depth": marked("Mass, damping and stiffness against depth"),
    "static": marked("Fitted static nonlinearity"),
    "kernel": marked("First-order kernels"),
    "second": marked("Second-order kernels"),
    "partition": marked("Kernels by depth"),
}
_CURVES: Mapping[str, tuple[str, ...]] = {
    "response": (MAGNITUDE, PHASE),
    "depth": (MASS, DAMPING, STIFFNESS),
    "static": (NONLINEARITY,),
    "kernel": (KERNEL1,),
}
"""Curves of each kind of figure with lines."""
_PANELS = {"second": KERNEL2, "partition": PARTITIONS}
"""Kernel of each kind of figure with a panel for each group."""
_GROUPS: Mapping[By, str] = {
    "site": marked("{figure}: sites"),
    "condition": marked("{figure}: conditions"),
    "material": marked("{figure}: materials"),
}
_ORDERS = {KERNEL1: marked("first-order kernel"), KERNEL2: marked("second-order kernel")}


def curve_figures(found: StudyStatistics) -> Iterator[tuple[str, str, Plots]]:
    """Yield key, heading and plots of each group of figures of curves, of kernels and of principal components."""
    for kind, heading in _HEADINGS.items():
        for by, words in _GROUPS.items():
            if kind in _CURVES:
                plots = _lines(found.curves, by, _CURVES[kind])
            else:
                plots = _panels(chosen(found.curves, by, _PANELS[kind]))
            if plots:
                yield f"{kind}-{by}", _(words).format(figure=_(heading)), plots
    if plots := _lines(found.curves, "change", _CURVES["depth"]):
        yield "change-depth", _("Change against depth: conditions"), plots
    for one in found.components:
        order = _(_ORDERS[one.curve])
        if one.curve == KERNEL1:
            shown: Plots = {_label(component_curves(one)): partial(component_curves, one)}
        else:
            shown = {_label(plot): partial(_same, plot) for plot in component_panels(one)}
        number = "1" if one.curve == KERNEL1 else "2"
        yield f"components{number}-all", _("Principal components, {kernel}").format(kernel=order), shown
        if len(one.names) > 1:
            plots = {_label(scores_plot(one)): partial(scores_plot, one)}
            yield f"scores-{number}", _("Scores of the components, {kernel}").format(kernel=order), plots


def _lines(curves: Sequence[GroupCurve], by: By, names: Sequence[str]) -> Plots:
    own = [chosen(curves, by, name) for name in names]
    groups = list(dict.fromkeys(one.group for some in own for one in some))
    plots: dict[str, Callable[[], Plot]] = {}
    for some in own:
        for way in directions(some):
            shown = [one for one in some if one.direction == way]
            plots[Verbatim(translated(title_of(shown[0], groups)))] = partial(curve_plot, shown, groups)
    return plots


def _panels(curves: Sequence[GroupCurve]) -> Plots:
    if not curves:
        return {}
    limit = shared_limit(curves)
    return {Verbatim(translated(name_of(one))): partial(kernel_panel, one, limit) for one in curves[:MOST_PANELS]}


def _label(plot: Plot) -> Verbatim:
    return Verbatim(translated(plot.title))


def _same(plot: Plot) -> Plot:
    return plot
