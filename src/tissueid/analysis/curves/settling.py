"""Settling time of the impulse response against stiffness and damping (Chen 2010, Fig. 6.6)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tissueid.analysis.curves.feedback import FeedbackRun
from tissueid.analysis.curves.plot import Array, Axis, Curve, Kind, Plot, Surface
from tissueid.identification.second_order import SecondOrder
from tissueid.language import marked
from tissueid.messages import Message

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
        1.05 * max([most, *(float(values.max()) for values in found)])
        for most, found in (
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


def _outline(stiffness: Array, damping: Array, times: Array, time_s: float, kind: Kind, words: str) -> list[Curve]:
    """Return least and greatest damping at each stiffness, where the response settles within a time."""
    ends = np.full((2, stiffness.size), np.nan)
    for column, found in enumerate(times.T):
        within = np.flatnonzero(found <= time_s)
        if within.size:
            for end, inside, step in ((0, within[0], -1), (1, within[-1], 1)):
                beyond = inside + step
                if 0 <= beyond < damping.size:
                    share = (time_s - found[inside]) / (found[beyond] - found[inside])
                    ends[end, column] = damping[inside] + share * (damping[beyond] - damping[inside])
    name = Message("plot.settles_within", words, time_ms=1e3 * time_s)
    known = [np.isfinite(values) for values in ends]
    return [
        Curve(stiffness[shown], values[shown], name if first else "", "text", kind)
        for first, values, shown in zip((True, False), ends, known, strict=True)
        if shown.any()
    ]
