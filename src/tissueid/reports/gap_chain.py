"""The chain from command to recorded numbers as a drawing, with the stage that is at fault lit."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.patches import FancyBboxPatch

from tissueid.gap.diagnosis import Diagnosis
from tissueid.language import _, marked
from tissueid.reports.style import INK, MUTED, ORANGE, SHADE
from tissueid.twin.effect import Stage

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


def draw_chain(figure: FigureBase, found: Diagnosis) -> None:
    """Boxes for the stages, arrows for the signals; the deeper a box is coloured, the larger its share of the gap."""
    axes = figure.subplots(1, 1)
    axes.set_axis_off()
    axes.set_xlim(-0.7, 8.9)
    axes.set_ylim(-0.5, 1.65)
    for stage, label, x, y in _PLACES:
        _box(axes, label, x, y, found.where.shares[stage], lit=stage in found.at_fault)
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
    words = f"{100.0 * share:.0f} %" if share > 0.0 else _("named cause") if lit else _("only noise")
    axes.text(x, y - 0.12, words, ha="center", va="center", zorder=4, fontsize=8.0)


def _link(axes: Axes, start: tuple[float, float], end: tuple[float, float], *, both: bool = False) -> None:
    style = "<|-|>" if both else "-|>"
    axes.annotate(
        "",
        end,
        start,
        arrowprops={"arrowstyle": style, "color": MUTED, "linewidth": 1.1, "shrinkA": 0.0, "shrinkB": 0.0},
    )
