"""The pictures of a diagnosis: the chain, where the gap lies, the ranking, and recorded against simulated."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.patches import FancyBboxPatch

from tissueid.analysis.curves.plot import Axis, Plot, Surface
from tissueid.errors import UnusableInputError
from tissueid.gap.answer import content_of
from tissueid.gap.diagnosis import Diagnosis
from tissueid.gap.diagnosis_content import DiagnosisContent
from tissueid.gap.diagnosis_plots import (
    TIMES_NOISE,
    budget_plot,
    overlay_plots,
    profile_plot,
    ranking_plots,
    spectrum_plot,
)
from tissueid.gap.statement import ordered_candidates
from tissueid.language import _, marked
from tissueid.messages import Message
from tissueid.reports.page import Panel, missing_panel
from tissueid.reports.plot_renderer import draw_grid, draw_plot, draw_row
from tissueid.reports.style import INK, MUTED, ORANGE, SHADE
from tissueid.twin.effect import STAGE_NAMES, Stage

_PLACES: tuple[tuple[Stage, str, float, float], ...] = (
    ("drive", marked("Amplifier"), 1.0, 1.0),
    ("coil", marked("Coil"), 3.0, 1.0),
    ("mechanics", marked("Moving part\n(mechanics)"), 5.0, 1.0),
    ("sensing", marked("Sensors"), 7.0, 1.0),
    ("tissue", marked("Tissue"), 5.0, 0.0),
    ("environment", marked("Environment"), 7.0, 0.0),
)
"""Stage, what it is, and the middle of its box."""
_SIGNALS = (
    (0.0, marked("command")),
    (2.0, marked("voltage")),
    (4.0, marked("force")),
    (6.0, marked("motion")),
    (8.0, marked("numbers")),
)
"""Where a signal goes over from one stage to the next, and its name."""
_HALF_WIDTH, _HALF_HEIGHT = 0.62, 0.27
_DARKEST = 0.85


def draw_chain(figure: FigureBase, diagnosis: Diagnosis) -> None:
    """Boxes for the stages, arrows for the signals; the deeper a box is coloured, the larger its share of the gap."""
    axes = figure.subplots(1, 1)
    axes.set_axis_off()
    axes.set_xlim(-0.7, 8.9)
    axes.set_ylim(-0.5, 1.65)
    for stage, label, x, y in _PLACES:
        _box(axes, label, x, y, diagnosis.where.shares[stage], lit=stage in diagnosis.at_fault)
    for x, label in _SIGNALS:
        axes.annotate(
            "",
            (x + 1.0 - _HALF_WIDTH if x < 8.0 else 8.7, 1.0),
            (x - 1.0 + _HALF_WIDTH if x > 0.0 else -0.5, 1.0),
            arrowprops={"arrowstyle": "-|>", "color": MUTED, "linewidth": 1.1, "shrinkA": 0.0, "shrinkB": 0.0},
        )
        axes.text(x, 1.36, _(label), ha="center", va="bottom", color=INK, fontsize=8.5)
    _link(axes, (5.0, _HALF_HEIGHT), (5.0, 1.0 - _HALF_HEIGHT), both=True)
    _link(axes, (7.0, _HALF_HEIGHT), (7.0, 1.0 - _HALF_HEIGHT))
    _link(axes, (7.0 - _HALF_WIDTH, 0.0), (5.0 + _HALF_WIDTH, 0.0))
    axes.annotate(
        "",
        (3.0, 1.0 - _HALF_HEIGHT),
        (5.0 - 0.5 * _HALF_WIDTH, 1.0 - _HALF_HEIGHT),
        arrowprops={
            "arrowstyle": "-|>",
            "color": MUTED,
            "linewidth": 1.1,
            "linestyle": "--",
            "connectionstyle": "arc3,rad=-0.35",
        },
    )
    axes.text(3.85, 0.22, _("back-EMF"), ha="center", va="top", color=INK, fontsize=8.5)


def _box(axes: Axes, label: str, x: float, y: float, share: float, *, lit: bool) -> None:
    corner = (x - _HALF_WIDTH, y - _HALF_HEIGHT)
    size = (2.0 * _HALF_WIDTH, 2.0 * _HALF_HEIGHT)
    style = "round,pad=0,rounding_size=0.08"
    axes.add_patch(FancyBboxPatch(corner, *size, boxstyle=style, facecolor=SHADE, edgecolor="none", zorder=2))
    if share > 0.0:
        axes.add_patch(
            FancyBboxPatch(
                corner, *size, boxstyle=style, facecolor=ORANGE, alpha=_DARKEST * share, edgecolor="none", zorder=2
            )
        )
    edge, width = (ORANGE, 2.4) if lit else (MUTED, 0.9)
    axes.add_patch(
        FancyBboxPatch(corner, *size, boxstyle=style, facecolor="none", edgecolor=edge, linewidth=width, zorder=3)
    )
    axes.text(x, y + 0.07, _(label), ha="center", va="center", zorder=4, weight="bold" if lit else "normal")
    share_text = f"{100.0 * share:.0f} %" if share > 0.0 else _("named cause") if lit else _("only noise")
    axes.text(x, y - 0.12, share_text, ha="center", va="center", zorder=4, fontsize=8.0)


def _link(axes: Axes, start: tuple[float, float], end: tuple[float, float], *, both: bool = False) -> None:
    style = "<|-|>" if both else "-|>"
    axes.annotate(
        "",
        end,
        start,
        arrowprops={"arrowstyle": style, "color": MUTED, "linewidth": 1.1, "shrinkA": 0.0, "shrinkB": 0.0},
    )


_LISTED = 8


def gap_panels(diagnosis: Diagnosis, content: DiagnosisContent | None = None) -> Iterator[Panel]:
    """All pictures of a diagnosis with its content."""
    content = content or content_of(diagnosis)
    regions = diagnosis.where.regions
    yield Panel(
        "chain",
        _("The chain and the stage at fault"),
        _("Stages from command to recorded numbers; at fault: {stages}.").format(
            stages=", ".join(_(STAGE_NAMES[stage]) for stage in diagnosis.at_fault) or _("none")
        ),
        _(
            "Each stage is given what was measured upstream of it and refitted within its calibration; its share is "
            "what it still leaves, as the logarithm of error over noise. The deeper the colour, the larger the share."
        ),
        lambda figure: draw_chain(figure, diagnosis),
        height=2.5,
    )
    if not regions.profiles:
        yield missing_panel("where", _("Where the gap lies"), _("nothing was left to look at"))
        return
    of = _(regions.channel)
    yield Panel(
        "frequency",
        _("By frequency"),
        _(
            "Power of {channel} and of what the baseline leaves of it against frequency, with its linear, even and odd "
            "parts."
        ).format(channel=of),
        _(
            "What the refitted baseline leaves, and of it the parts that are coherent with the command (linear), with "
            "its square (even) and with its cube (odd). Shaded: bands that stand above the noise."
        ),
        partial(draw_spectrum, content=content),
        height=3.4,
    )
    yield Panel(
        "depth",
        _("By depth"),
        _("Error of {channel} against depth, and the noise.").format(channel=of),
        _(
            "Root-mean-square error as a multiple of the noise (what the sensors' noise alone leaves: 1, dashed). "
            "Full dots stand above it with significance."
        ),
        partial(draw_profile, content=content, name="depth_m"),
        wide=False,
        height=2.9,
    )
    yield Panel(
        "speed",
        _("By speed and direction"),
        _("Error of {channel} against velocity, and the noise.").format(channel=of),
        _("The same against velocity; positive is into the tissue."),
        partial(draw_profile, content=content, name="velocity_m_s"),
        wide=False,
        height=2.9,
    )
    yield Panel(
        "surface",
        _("Over depth and velocity"),
        _("Mean residual of {channel} as an image over depth and velocity.").format(channel=of),
        _(
            "What is left on average, as a multiple of the noise: a force that goes with depth shows as columns, "
            "friction as an upper and a lower half (restoring-force surface)."
        ),
        lambda figure: draw_surface(figure, diagnosis),
        wide=False,
        height=3.2,
    )
    yield Panel(
        "time",
        _("In the course of the test"),
        _("Error of {channel} against time, and the noise.").format(channel=of),
        _(
            "Root-mean-square error as a multiple of the noise by quarter second; full dots stand above it with "
            "significance."
        ),
        partial(draw_profile, content=content, name="time_s"),
        wide=False,
        height=3.2,
    )
    yield from _more_profiles(content, regions.mains_hz, of)
    if candidates := ordered_candidates(diagnosis):
        yield Panel(
            "ranking",
            _("Candidates"),
            _("Probability and closed share of each candidate effect."),
            _(
                "Left: probability that a candidate is the cause. Right: the share of the gap that it closes on "
                "held-out data, with 95 %. The same colour: candidates that this data cannot separate."
            ),
            lambda figure: draw_row(figure, ranking_plots(candidates[:_LISTED])),
            height=0.9 + 0.28 * min(len(candidates), _LISTED),
        )
    yield Panel(
        "budget",
        _("Gap budget"),
        _("Waterfall of the gap from before to after, with the share of each named effect, and the noise."),
        _(
            "Error over the signals' deviation on data held out for the check. Each effect closes the share between "
            "the ends of its bar when it is added to those above it."
        ),
        lambda figure: draw_grid(figure, [[budget_plot(content.budget)]], title=False, key=False),
        height=0.9 + 0.3 * len(content.budget),
    )
    yield Panel(
        "overlay",
        _("Before and after"),
        _("Recorded signals with the simulation before and after the effect was added, and both residuals below."),
        _(
            "A tenth of a second that was held out of the fit: of those in which the signal moves, "
            "that with the largest error. Below: recorded less simulated; dotted: what noise alone would leave."
        ),
        partial(draw_overlay, content=content, worst=regions.channel),
        height=5.0,
    )


def _more_profiles(content: DiagnosisContent, mains_hz: float, of: str) -> Iterator[Panel]:
    """Along what not every test has: a current, a stimulus whose size changes, the mains."""
    where = (
        ("current_a", "current", _("By current"), _("The same against the current of the coil.")),
        (
            "amplitude_n",
            "amplitude",
            _("By the amplitude of the stimulus"),
            _("The same against the root mean square of what was played in the last tenth of a second, as a force."),
        ),
        (
            "mains_phase_rad",
            "mains",
            _("By the phase of the mains"),
            _("The same against the phase of the mains from the start of the test: the mains shows in what is left."),
        ),
    )
    for name, key, heading, caption in where:
        if name in content.profiles:
            yield Panel(
                key,
                heading,
                _("Error of {channel}, {heading}, and the noise.").format(channel=of, heading=heading),
                caption,
                partial(draw_profile, content=content, name=name, mains_hz=mains_hz),
                wide=False,
                height=2.9,
            )


def draw_spectrum(figure: FigureBase, content: DiagnosisContent) -> None:
    """Amplitude densities of a residual and its parts."""
    assert content.spectrum is not None
    draw_plot(figure.subplots(1, 1), spectrum_plot(content.spectrum), title=False)


def draw_profile(figure: FigureBase, content: DiagnosisContent, name: str, mains_hz: float = 0.0) -> None:
    """Error along something, as a multiple of the noise floor."""
    plot = profile_plot(name, content.profiles[name])
    if name == "mains_phase_rad":
        label = Message("plot.mains_phase", "Phase at {hertz:.2f} Hz", hertz=mains_hz)
        plot = replace(plot, x=replace(plot.x, label=label))
    draw_plot(figure.subplots(1, 1), plot, title=False)


def draw_surface(figure: FigureBase, diagnosis: Diagnosis) -> None:
    """Mean residual over depth and velocity.

    Raises:
        UnusableInputError: too little was visited.
    """
    surface = diagnosis.where.regions.surface
    if surface is None:
        raise UnusableInputError("report.no_surface", "too little of depth and velocity was visited")
    values = Surface(
        1e3 * surface.depth_m, 1e3 * surface.velocity_m_s, surface.residual, marked("Residual"), TIMES_NOISE
    )
    draw_plot(figure.subplots(1, 1), Plot("", Axis(marked("Depth"), "mm"), Axis(marked("Velocity"), "mm/s"), (values,)))


def draw_overlay(figure: FigureBase, content: DiagnosisContent, worst: str) -> None:
    """Recorded and simulated over a stretch that was not fitted, for the signals that show it most.

    Raises:
        UnusableInputError: every sample was fitted.
    """
    if not content.overlays:
        raise UnusableInputError("report.all_fitted", "every sample was fitted")
    shown = [item for item in content.overlays if item.channel != "voltage" or worst == "voltage"]
    draw_grid(figure, list(zip(*map(overlay_plots, shown), strict=True)), title=False, heights=(3.0, 2.0))
