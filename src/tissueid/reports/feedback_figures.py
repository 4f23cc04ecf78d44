"""Figures of a feedback stimulus: time series, distributions, parameters by depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from scipy import stats

from tissueid.analysis.curves.diagnostics import Array
from tissueid.analysis.curves.plot import Axis, thin
from tissueid.analysis.curves.validation import cloud_plot
from tissueid.errors import UnusableInputError
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.engines.lms import Lms
from tissueid.language import _, marked
from tissueid.messages import Message
from tissueid.records import Record
from tissueid.reports.depth_panels import draw_depth_panels
from tissueid.reports.plot_renderer import draw_plot
from tissueid.reports.style import (
    BLUE,
    DASHES,
    GREEN,
    INK,
    MUTED,
    ORANGE,
)

_BINS = 30
_OUTSIDE = 4
"""Number of bins beyond either end of the desired range; the outermost also counts depths further out."""

_FAINT = 1e-4
"""Smallest singular value of the force, relative to the largest, that is used for the linear response.

The stochastic part is weak compared with the sweeps, and above its cut-off there is nothing to divide by.
"""


@dataclass(frozen=True, eq=False)
class FeedbackRun:
    """One test with a feedback stimulus, without its preload.

    ``force`` (n,), N, and ``depth`` (n,), m below the surface, are NaN where a sample was lost. ``edges`` (bins + 1,),
    m, are the limits of the bins and ``shares`` (bins,) the desired share of time in each. ``profile`` holds the
    parameters that the feedback loop identified, with positions counted from the surface.
    """

    label: str
    force: Array
    depth: Array
    sample_rate_hz: float
    edges: Array
    shares: Array
    profile: DepthProfile | None = None

    @property
    def record(self) -> Record:
        """Return force and depth as a record for engines."""
        return Record(self.force, self.depth, self.sample_rate_hz)

    def desired_distribution(self, depth: Array) -> Array:
        """Return the desired distribution function at depths (k,), 0 to 1."""
        cumulative = np.concatenate([[0.0], np.cumsum(self.shares)])
        return np.asarray(np.interp(depth, self.edges, cumulative), dtype=np.float64)

    @property
    def distance(self) -> float:
        """Return Kolmogorov's distance of the received depths from the desired distribution."""
        seen = self.depth[np.isfinite(self.depth)]
        return float(stats.ks_1samp(seen, self.desired_distribution).statistic) if seen.size else float("nan")


def draw_feedback_series(figure: FigureBase, runs: Sequence[FeedbackRun]) -> None:
    """Draw force and depth over time, one column for each run (Chen 2010, Figs. 6.7 and 6.10)."""
    every = figure.subplots(2, len(runs), sharex="col", sharey="row", squeeze=False)
    for (above, below), run in zip(every.T, runs, strict=True):
        time_s = np.arange(run.force.size) / run.sample_rate_hz
        above.plot(*thin(time_s, run.force), color=ORANGE, linewidth=0.7)
        below.plot(*thin(time_s, 1e3 * run.depth), color=GREEN, linewidth=0.7)
        for edge in (run.edges[0], run.edges[-1]):
            below.axhline(1e3 * edge, color=INK, linewidth=1.0, linestyle=DASHES[1])
        above.set_title(run.label)
        below.set_xlim(0.0, run.force.size / run.sample_rate_hz)
        below.set_xlabel(_("Time (s)"))
    every[0, 0].set_ylabel(_("Force (N)"))
    every[1, 0].set_ylabel(_("Depth (mm)"))
    figure.align_ylabels()


def draw_feedback_distributions(figure: FigureBase, runs: Sequence[FeedbackRun]) -> None:
    """Draw distributions of force and depth, linear response, and residual nonlinearity (Figs. 6.8 and 6.11).

    The response is that of the ``lms`` engine on the whole test, without directions that the force hardly excites; the
    last column is the measured depth against its prediction, with the mean of the cloud as a curve.

    Raises:
        UnusableInputError: too few samples were received for a response.
    """
    every = figure.subplots(len(runs), 4, squeeze=False)
    for (force, depth, response, bend), run in zip(every, runs, strict=True):
        known = run.force[np.isfinite(run.force)]
        force.hist(known, bins=_BINS, density=True, color=ORANGE, alpha=0.4, histtype="stepfilled")
        force.set_ylabel(_("Density (1/{unit})").format(unit="N"))
        _depths(depth, run)
        model = Lms(method="svd", tolerance=_FAINT).fit(run.record)
        lag_ms = 1e3 * model.lag_s
        response.axhline(0.0, color=MUTED, linewidth=0.8)
        response.plot(lag_ms, 1e3 * model.impulse_response, color=BLUE, linewidth=1.2)
        response.set_xlim(0.0, float(lag_ms[-1]))
        response.set_ylabel(_("Response ({unit})").format(unit="mm/(N·s)"))
        cloud = cloud_plot(model.simulate(run.force), run.depth, "m", colour="good")
        depth_axis = Axis(marked("Depth"), "mm")
        draw_plot(bend, replace(cloud, x=Axis(), y=depth_axis, parts=cloud.parts[:-1], square=False))
        if len(runs) > 1:
            force.set_title(run.label)
    labels = (_("Force (N)"), _("Depth (mm)"), _("Lag (ms)"), _("Linear prediction (mm)"))
    for axes, label in zip(every[-1], labels, strict=True):
        axes.set_xlabel(label)


def _depths(axes: Axes, run: FeedbackRun) -> None:
    """Draw the histogram of the depths, the desired one, and their distance."""
    low, high = float(run.edges[0]), float(run.edges[-1])
    bins = np.linspace(low, high, _BINS + 1)
    before, after = bins[:_OUTSIDE] - bins[_OUTSIDE] + low, bins[1 : _OUTSIDE + 1] - low + high
    bins = np.concatenate([before, bins, after])
    seen = np.clip(run.depth[np.isfinite(run.depth)], bins[0], bins[-1])
    if not seen.size:
        raise UnusableInputError(Message("report.no_depths", "no depth was received"))
    axes.hist(1e3 * seen, bins=(1e3 * bins).tolist(), density=True, color=GREEN, alpha=0.4, histtype="stepfilled")
    wanted = np.diff(run.desired_distribution(bins)) / (1e3 * np.diff(bins))
    axes.stairs(wanted, 1e3 * bins, color=INK, linestyle=DASHES[1], linewidth=1.1)
    axes.set_ylim(0.0, max(1.3 * axes.get_ylim()[1], 2.0 * float(wanted.max())))
    axes.set_title(_("distance {distance}").format(distance=f"{run.distance:.3f}"), fontsize=8.5)
    axes.set_ylabel(_("Density (1/{unit})").format(unit="mm"))


def draw_feedback_parameters(figure: FigureBase, runs: Sequence[FeedbackRun]) -> None:
    """Draw mass, damping and stiffness by depth as identified by the feedback loop (Chen 2010, Fig. 6.12).

    Raises:
        UnusableInputError: none of the runs identified anything.
    """
    profiles = {run.label: run.profile for run in runs if run.profile is not None}
    if not profiles:
        raise UnusableInputError(Message("report.no_loop_parameters", "the feedback loop identified no parameters"))
    draw_depth_panels(figure, profiles, 0.0)
