"""Plots of tests with a feedback stimulus: time series, distributions, linear response."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from tissueid.analysis.curves.plot import Array, Axis, Curve, Plot, histogram, outline
from tissueid.analysis.curves.signals import COLOURS, density_axis
from tissueid.analysis.curves.units import LAG, TIME
from tissueid.analysis.curves.validation import cloud_plot
from tissueid.errors import UnusableInputError
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.engines.lms import Lms
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record

_BINS = 30
_OUTSIDE = 4
"""Number of bins beyond either end of the desired range; the outermost also counts depths further out."""
_FAINT = 1e-4
"""Smallest singular value of the force, relative to the largest, that is used for the linear response.

The stochastic part is weak compared with the sweeps, and above its cut-off there is nothing to divide by.
"""
_FORCE, _DEPTH = Axis(marked("Force"), "N"), Axis(marked("Depth"), "mm")


@dataclass(frozen=True, eq=False)
class FeedbackRun:
    """One test with a feedback stimulus, without its preload.

    ``force`` (n,), N, and ``depth`` (n,), m below the surface, are NaN where a sample was lost. ``edges`` (bins + 1,),
    m, are the limits of the bins and ``shares`` (bins,) the desired share of time in each. ``profile`` holds the
    parameters that the feedback loop identified, with positions counted from the surface. ``block_s`` is the length of
    a block of set-points and ``memory_s`` that of the identified responses; 0 where it is not known.
    """

    label: str
    force: Array
    depth: Array
    sample_rate_hz: float
    edges: Array
    shares: Array
    profile: DepthProfile | None = None
    block_s: float = 0.0
    memory_s: float = 0.0

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


def series_plots(run: FeedbackRun) -> tuple[Plot, Plot]:
    """Return force and depth over time, with the desired range of the depth (Chen 2010, Figs. 6.7 and 6.10)."""
    time_s = np.arange(run.force.size) / run.sample_rate_hz
    time = replace(TIME, limits=(0.0, run.force.size / run.sample_rate_hz))
    levels = [Curve(np.zeros(1), 1e3 * run.edges[[end]], "", "text", "level") for end in (0, -1)]
    force = Curve(time_s, run.force, "", COLOURS["force"], width=0.55)
    depth = Curve(time_s, 1e3 * run.depth, "", COLOURS["position"], width=0.55)
    return Plot(run.label, time, _FORCE, (force,)), Plot("", time, _DEPTH, (depth, *levels))


def description_plots(run: FeedbackRun, title: str = "") -> tuple[Plot, ...]:
    """Return distributions of force and depth, linear response, and residual nonlinearity (Figs. 6.8 and 6.11).

    The response is that of the ``lms`` engine on the whole test, without directions that the force hardly excites; the
    last plot is the measured depth against its prediction, with the mean of the cloud as a curve.

    Raises:
        UnusableInputError: too few samples were received for a response.
    """
    force = histogram(run.force[np.isfinite(run.force)], _BINS, COLOURS["force"])
    model = Lms(method="svd", tolerance=_FAINT).fit(run.record)
    lag_ms = 1e3 * model.lag_s
    response = Curve(lag_ms, 1e3 * model.impulse_response, width=0.9)
    cloud = cloud_plot(model.simulate(run.force), run.depth, "m", colour=COLOURS["position"])
    return (
        Plot(title, _FORCE, density_axis("N", 1.05 * float(force.y.max())), (force,)),
        _depths(run),
        Plot(
            "",
            replace(LAG, limits=(0.0, float(lag_ms[-1]))),
            Axis(marked("Response"), "mm/(N·s)", zero=True),
            (response,),
        ),
        Plot("", Axis(marked("Linear prediction"), "mm"), _DEPTH, cloud.parts[:-1]),
    )


def _depths(run: FeedbackRun) -> Plot:
    """Return the histogram of the depths, the desired one, and their distance."""
    low, high = float(run.edges[0]), float(run.edges[-1])
    bins = np.linspace(low, high, _BINS + 1)
    before, after = bins[:_OUTSIDE] - bins[_OUTSIDE] + low, bins[1 : _OUTSIDE + 1] - low + high
    bins = np.concatenate([before, bins, after])
    seen = np.clip(run.depth[np.isfinite(run.depth)], bins[0], bins[-1])
    if not seen.size:
        raise UnusableInputError("report.no_depths", "no depth was received")
    found = histogram(1e3 * seen, 1e3 * bins, COLOURS["position"])
    wanted = np.diff(run.desired_distribution(bins)) / (1e3 * np.diff(bins))
    desired = Curve(*outline(1e3 * bins, wanted), "", "text", "dashed", width=0.85)
    top = max(1.35 * float(found.y.max()), 2.0 * float(wanted.max()))
    title = Message("plot.distance", "distance {distance}", distance=f"{run.distance:.3f}")
    return Plot(title, _DEPTH, density_axis("mm", top), (found, desired))


def profiles_of(runs: Sequence[FeedbackRun]) -> dict[str, DepthProfile]:
    """Return mass, damping and stiffness by depth as identified by the feedback loop (Chen 2010, Fig. 6.12).

    Raises:
        UnusableInputError: none of the runs identified anything.
    """
    profiles = {run.label: run.profile for run in runs if run.profile is not None}
    if not profiles:
        raise UnusableInputError("report.no_loop_parameters", "the feedback loop identified no parameters")
    return profiles


__all__ = ["FeedbackRun", "description_plots", "profiles_of", "series_plots"]
