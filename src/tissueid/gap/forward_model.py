"""Simulation of a test by the twin from its excitation: the command or the first recorded downstream signal."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable, Sequence

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.dataset import DatasetTest
from tissueid.gap.equivalent_simulation import fineness, simulate_equivalent
from tissueid.gap.parameters import Parametrisation
from tissueid.twin.chain_parameters import Instrument, Tissue
from tissueid.twin.effect import Readings
from tissueid.twin.simulation import (
    NOTHING_MEASURED,
    ActiveEffect,
    MeasuredSignals,
    Start,
    recorded,
    simulated_motion,
)

FloatArray = NDArray[np.float64]

STEP_S = 1.25e-4
"""Longest integration step, s: four in a sample at 2 kHz."""


def substeps_of(test: DatasetTest, step_s: float = STEP_S) -> int:
    """Return the number of integration steps in a sample of a test that are not longer than ``step_s``."""
    return max(1, int(np.ceil(1.0 / (test.sample_rate_hz * step_s))))


def starting_point(test: DatasetTest, resistance_ohm: float) -> Start:
    """Return the start of a test: at rest at the surface, unless its first readings differ."""
    at = test.starting_position_m
    if test.driven_by == "current":
        return Start(float(test.command[0]), at, 0.0)
    return Start(float(test.command[0]) / resistance_ohm, at, 0.0)


def simulate_test(
    parameters: Parametrisation,
    theta: FloatArray,
    test: DatasetTest,
    given: MeasuredSignals = NOTHING_MEASURED,
    substeps: int | None = None,
) -> Readings:
    """Return the simulated readings of a test, shape (n,) a signal.

    Args:
        parameters: coordinates of the fit.
        theta: their values.
        test: the test.
        given: measured signals that replace simulated ones; by default the excitation.
        substeps: integration steps in a sample; by default by ``STEP_S``.
    """
    if test.driven_by == "input":
        return simulate_equivalent(parameters, theta, test)
    instrument = parameters.instrument(theta)
    if given is NOTHING_MEASURED:
        given = test.excitation(parameters.dataset.tracking_rad_s)
    acting, on_tissue = parameters.acting(theta, test), test.fixture == "tissue"
    met = _MOTIONS.motion(
        test,
        instrument,
        parameters.tissue_of(theta, test),
        [item for item in acting if item.effect.hook is not None],
        given,
        substeps or substeps_of(test),
    )
    return recorded(met, acting, on_tissue)


class _MotionCache:
    """Cache of the last simulated motions: a fit of effects on the recorded numbers asks for the same motion
    repeatedly."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: OrderedDict[Hashable, tuple[object, Readings]] = OrderedDict()

    def motion(
        self,
        test: DatasetTest,
        instrument: Instrument,
        met: Tissue,
        hooked: Sequence[ActiveEffect],
        given: MeasuredSignals,
        substeps: int,
    ) -> Readings:
        """Return the signals before the sensors, simulated if they are not in the cache."""
        effects = tuple((item.effect.name, item.values.tobytes()) for item in hooked)
        start, on_tissue = starting_point(test, instrument.resistance_ohm), test.fixture == "tissue"
        # A repeat has the same motion: the key is the command and not the test.
        key = (test.played, start, on_tissue, id(given), instrument, met, effects, substeps)
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key][1]
        found = simulated_motion(
            test.command,
            test.sample_rate_hz,
            instrument,
            met,
            start,
            hooked,
            given=given,
            on_tissue=on_tissue,
            substeps=substeps,
        ).readings
        # Keep the given signals as well, so that their identities are not reused.
        self._kept[key] = (given, found)
        if len(self._kept) > self._most:
            self._kept.popitem(last=False)
        return found


_MOTIONS = _MotionCache(96)


__all__ = ["STEP_S", "fineness", "simulate_test", "starting_point", "substeps_of"]
