"""Recorded and simulated over a stretch that no fit has seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.gap.diagnosis import Diagnosis
from tissueid.reports.gap_panels import simulated_by, unseen_stretch

Array = NDArray[np.float64]

UNITS = {"voltage": ("V", 1.0, "mV", 1e3), "current": ("A", 1.0, "mA", 1e3), "position": ("mm", 1e3, "µm", 1e6)}
"""Signal: the unit of the signal and of what is left of it, and how much of each is one SI unit."""


@dataclass(frozen=True)
class Overlay:
    """One signal: time (s), recorded and simulated (``unit``), what is left and its noise (``fine_unit``), shape (n,).

    ``after`` and ``left_after`` are None where no explanation was found.
    """

    channel: str
    unit: str
    fine_unit: str
    time: Array
    recorded: Array
    before: Array
    after: Array | None
    left_before: Array
    left_after: Array | None
    noise: float


def overlays_of(found: Diagnosis) -> tuple[Overlay, ...]:
    """Every signal, the one that shows the gap most first; none where every sample was fitted."""
    worst = found.where.regions.channel
    if worst not in found.observed.channels:
        return ()
    try:
        test, first, last = unseen_stretch(found, worst)
    except UnusableInputError:
        return ()
    shown = slice(first, last)
    time = np.arange(first, last) / test.sample_rate_hz
    best = found.best if found.verdict != "no_gap" else None
    overlays = []
    for name in sorted(found.observed.channels, key=lambda name: name != worst):
        unit, scale, fine_unit, fine = UNITS[name]
        recorded = test.signals[name][shown]
        before = simulated_by(found.found.baseline, test, name)[shown]
        after = None if best is None else simulated_by(best, test, name)[shown]
        overlays.append(
            Overlay(
                name,
                unit,
                fine_unit,
                time,
                scale * recorded,
                scale * before,
                None if after is None else scale * after,
                fine * (recorded - before),
                None if after is None else fine * (recorded - after),
                fine * found.observed.noise[name],
            )
        )
    return tuple(overlays)
