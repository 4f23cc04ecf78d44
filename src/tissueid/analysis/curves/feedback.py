"""Plots of tests with a feedback stimulus, their settling time, and the response during a test (Chen 2010, 6.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from tissueid.analysis.curves.plot import (
    KINDS,
    LAG,
    TIME,
    Array,
    Axis,
    Curve,
    Kind,
    Plot,
    Surface,
    depth_roles,
    histogram,
    kernel_unit,
    outline,
    signal_axis,
)
from tissueid.analysis.curves.signals import COLOURS, density_axis
from tissueid.analysis.curves.validation import ROLES, cloud_plot
from tissueid.errors import UnusableInputError
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.engines.als import AlsModel
from tissueid.identification.engines.lms import Lms
from tissueid.identification.online_identifier import OnlineModel
from tissueid.identification.second_order import SecondOrder
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record
from tissueid.units import display_unit

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
    measured = histogram(1e3 * seen, 1e3 * bins, COLOURS["position"])
    wanted = np.diff(run.desired_distribution(bins)) / (1e3 * np.diff(bins))
    desired = Curve(*outline(1e3 * bins, wanted), "", "text", "dashed", width=0.85)
    top = max(1.35 * float(measured.y.max()), 2.0 * float(wanted.max()))
    title = Message("plot.distance", "distance {distance}", distance=f"{run.distance:.3f}")
    return Plot(title, _DEPTH, density_axis("mm", top), (measured, desired))


def profiles_of(runs: Sequence[FeedbackRun]) -> dict[str, DepthProfile]:
    """Return mass, damping and stiffness by depth as identified by the feedback loop (Chen 2010, Fig. 6.12).

    Raises:
        UnusableInputError: none of the runs identified anything.
    """
    profiles = {run.label: run.profile for run in runs if run.profile is not None}
    if not profiles:
        raise UnusableInputError("report.no_loop_parameters", "the feedback loop identified no parameters")
    return profiles


THESIS_MASS_KG = 0.06
"""Mass of Fig. 6.6, kg; used where no mass was identified."""
_MOST_STIFFNESS, _MOST_DAMPING = 5000.0, 40.0
"""Ranges of the map, N/m and N s/m; identified values beyond extend them."""
_STEPS = 40
_MOST_MS = 150.0
"""Settling time of the fullest colour, ms; a system that slow has no use for feedback by blocks."""
_DOTS = ("o", "s", "D", "^")


def settling_times(mass_kg: float, damping: Array, stiffness: Array, share: float = 0.05) -> Array:
    """Return settling times, s, (dampings, stiffnesses), of second-order systems.

    Args:
        mass_kg: mass of all of them.
        damping: N s/m, (dampings,).
        stiffness: N/m, (stiffnesses,).
        share: of its peak below which an impulse response has settled.
    """
    systems = [[SecondOrder(mass_kg, b, k) for k in stiffness.tolist()] for b in damping.tolist()]
    return np.array([[system.settling_time_s(share) for system in row] for row in systems])


def settling_plot(runs: Sequence[FeedbackRun] = ()) -> Plot:
    """Return the 5 % settling time by stiffness and damping, with what feedback loops identified, by level of depth.

    The mass is the median of the identified ones. Dashed and dotted lines are where the response settles within a block
    of set-points and within the memory of the identification; in between a loop without identification should wait
    longer than a block, and beyond the memory the responses are cut off.
    """
    profiles = [(run.label, run.profile) for run in runs if run.profile is not None]
    masses = [profile.mass for _, profile in profiles]
    mass = float(np.median(np.concatenate(masses))) if masses else THESIS_MASS_KG
    tops = [
        1.05 * max([most, *(float(values.max()) for values in estimates)])
        for most, estimates in (
            (_MOST_STIFFNESS, [profile.stiffness for _, profile in profiles]),
            (_MOST_DAMPING, [profile.damping for _, profile in profiles]),
        )
    ]
    stiffness, damping = ((np.arange(_STEPS) + 0.5) * top / _STEPS for top in tops)
    times = settling_times(mass, damping, stiffness)
    parts: list[Curve | Surface] = [
        Surface(stiffness, damping, 1e3 * np.minimum(times, 1.0), marked("Settling time"), "ms", False, _MOST_MS)
    ]
    lengths = {(run.block_s, run.memory_s) for run in runs if run.memory_s > 0.0}
    for block_s, memory_s in sorted(lengths)[:1]:
        parts += _outline(stiffness, damping, times, block_s, "dashed", marked("block of {time_ms:g} ms"))
        parts += _outline(stiffness, damping, times, memory_s, "dotted", marked("memory of {time_ms:g} ms"))
    for (label, profile), marker in zip(profiles, _DOTS, strict=False):
        parts.append(Curve(profile.stiffness, profile.damping, label, "check", "points", width=2.0, marker=marker))
    title = Message("plot.settling", "5 % settling time, mass {mass_g} g", mass_g=f"{1e3 * mass:.0f}")
    across = Axis(marked("Stiffness"), "N/m", limits=(0.0, tops[0]))
    return Plot(title, across, Axis(marked("Damping"), "N·s/m", limits=(0.0, tops[1])), tuple(parts))


def _outline(stiffness: Array, damping: Array, times: Array, time_s: float, kind: Kind, template: str) -> list[Curve]:
    """Return least and greatest damping at each stiffness, where the response settles within a time."""
    ends = np.full((2, stiffness.size), np.nan)
    for column, settling_s in enumerate(times.T):
        within = np.flatnonzero(settling_s <= time_s)
        if within.size:
            for end, inside, step in ((0, within[0], -1), (1, within[-1], 1)):
                beyond = inside + step
                if 0 <= beyond < damping.size:
                    share = (time_s - settling_s[inside]) / (settling_s[beyond] - settling_s[inside])
                    ends[end, column] = damping[inside] + share * (damping[beyond] - damping[inside])
    name = Message("plot.settles_within", template, time_ms=1e3 * time_s)
    finite = [np.isfinite(values) for values in ends]
    return [
        Curve(stiffness[shown], values[shown], name if first else "", "text", kind)
        for first, values, shown in zip((True, False), ends, finite, strict=True)
        if shown.any()
    ]


_FULLEST = 0.999
"""Share of the responses after the first quarter below the value of the fullest colour."""


def convergence_plots(model: OnlineModel, record: Record) -> tuple[Plot, Plot]:
    """Return the distance of the response from the last one, and its value at three lags, against time.

    Raises:
        UnusableInputError: the model stored fewer than three responses.
    """
    course, time_s = _course(model)
    last = course[-1]
    size = float(np.sqrt(np.sum(last**2))) or 1.0
    distance = 100.0 * np.sqrt(np.sum((course - last) ** 2, axis=1)) / size
    unit, scale = kernel_unit(record)
    peak = int(np.argmax(np.abs(last)))
    shown = sorted({peak // 2, peak, min(2 * peak + 1, last.size - 1)})
    curves = []
    for lag, colour, kind in zip(shown, ROLES, KINDS, strict=False):
        name = Message("plot.at_lag", "at {lag:.1f} ms", lag=1e3 * float(model.lag_s[lag]))
        curves.append(Curve(time_s, scale * course[:, lag], name, colour, kind, width=0.8))
    away = Axis(marked("Distance"), "%", limits=(0.0, min(1.05 * float(distance.max()), 200.0) or 1.0))
    return (
        Plot("", TIME, away, (Curve(time_s, distance),)),
        Plot("", TIME, Axis(marked("Response"), unit), tuple(curves)),
    )


def response_over_time(model: OnlineModel, record: Record) -> tuple[Plot, Plot]:
    """Return the output, and the impulse response over time and lag (Chen 2010, Fig. 6.4a).

    Raises:
        UnusableInputError: the model stored fewer than three responses.
    """
    course, time_s = _course(model)
    unit, scale = kernel_unit(record)
    even = np.linspace(time_s[0], time_s[-1], course.shape[0])
    nearest = np.clip(np.searchsorted(time_s, even), 0, time_s.size - 1)
    top = scale * float(np.quantile(np.abs(course[course.shape[0] // 4 :]), _FULLEST)) or None
    time = replace(TIME, limits=(0.0, float(time_s[-1])))
    out_scale = display_unit(record.output_unit)[1]
    output = Curve(record.time, out_scale * record.output, colour="good", width=0.5)
    surface = Surface(even, 1e3 * model.lag_s, scale * course[nearest].T, unit=unit, limit=top)
    return (
        Plot("", time, signal_axis(record.output_name, record.output_unit), (output,)),
        Plot("", time, LAG, (surface,)),
    )


def response_by_depth(model: AlsModel, record: Record, fitted_output: Array) -> tuple[Plot, Plot]:
    """Return the responses averaged by the output (n,) at which they were estimated (Chen 2010, Fig. 6.4b).

    The first plot shows them over lag and depth, the second as curves.

    Raises:
        UnusableInputError: the model has fewer than two levels of depth.
    """
    if model.depth_position.size < 2:
        raise UnusableInputError(
            "report.no_depth_levels", "responses by depth need a fit with two depth levels or more"
        )
    unit, scale = kernel_unit(record)
    out_scale = display_unit(record.output_unit)[1]
    output = fitted_output[np.isfinite(fitted_output)]
    edges = out_scale * np.concatenate([[output.min()], model.depth_edges, [output.max()]])
    lag_ms, responses = 1e3 * model.lag_s, scale * model.depth_response
    surface = Surface(lag_ms, 0.5 * (edges[1:] + edges[:-1]), responses, unit=unit, edges=edges)
    depth = signal_axis(record.output_name, record.output_unit)
    places = out_scale * model.depth_position
    curves = zip(responses, depth_roles(len(responses)), strict=True)
    return (
        Plot("", LAG, replace(depth, reverse=True), (surface,)),
        Plot(
            "",
            replace(LAG, limits=(0.0, float(lag_ms[-1]))),
            Axis(marked("Impulse response"), unit, zero=True),
            tuple(Curve(lag_ms, response, "", role) for response, role in curves),
            depths=replace(depth, limits=(float(places.min()), float(places.max()))),
        ),
    )


def _course(model: OnlineModel) -> tuple[Array, Array]:
    """Return responses (t, lags) and their times (t,), s.

    Raises:
        UnusableInputError: the model stored fewer than three responses.
    """
    if model.trajectory.shape[0] < 3:
        raise UnusableInputError("report.record_too_short", "the record is too short for a response over time")
    return model.trajectory, model.trajectory_s
