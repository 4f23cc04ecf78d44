"""Whether the electrical and the mechanical half of a sweep agree, and what it means where they do not.

The spring gives newtons per ampere, the flux linkage volts per metre per second: were all scales right, one number. A
channel that reads too much by a factor, or a spring that is stiffer than is said, leaves marks by which it is known:

=================  =============  =============  ==============
too much by f      spring / flux  resistance     stage
=================  =============  =============  ==============
current reading    1 / f          1 / f          1
position reading   f squared      1              f
voltage reading    1 / f          f              1
spring             1 / f          1              1
=================  =============  =============  ==============
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import stats

from tissueid.calibration.flux import FluxFit
from tissueid.calibration.force_balance import BalanceFit
from tissueid.calibration.spring_points import SpringPoint
from tissueid.device import DeviceDescription
from tissueid.records import Estimate

ELECTRICAL_STD = 0.005
"""Relative deviation of voltage over position: the gains of two channels, unless they are known better."""
_DOUBT = 3.0
"""Deviations from which two figures disagree."""
_SHAPE_DOUBT = 1e-4
_LEAST_STAGES = 4

Cause = Literal["current", "position", "voltage", "spring", "unknown"]
_WORDS = {
    "current": "the current channel's scale explains it, for the resistance is off alike",
    "position": "the position channel's scale explains it, for the stage says the same",
    "voltage": "the voltage channel's scale explains it, for the resistance is off the other way",
    "spring": "the spring's stiffness, or the position channel's scale, explains it: resistance fits",
    "unknown": "no single scale explains it: check the spring, its fixture and the channels",
}


@dataclass(frozen=True)
class Agreement:
    """Force constant by spring over that by flux linkage, and what else tells of the scales.

    ``resistance`` is measured over expected; ``stage`` metres read over metres moved, None without a motorised stage.
    ``expected_std`` is how far the first ratio may be off by what is known of spring and channels; ``cause`` is None
    where they agree. ``same_shape`` is false where the two profiles differ by more than a factor.
    """

    ratio: Estimate
    expected_std: float
    resistance: Estimate
    stage: Estimate | None
    same_shape: bool
    cause: Cause | None

    @property
    def words(self) -> str:
        """The comparison in a sentence."""
        percent = 100.0 * (self.ratio.value - 1.0)
        allowed = 100.0 * self.expected_std
        said = (
            f"By the spring the force constant is {abs(percent):.2f} % {'more' if percent >= 0 else 'less'} than by "
            f"the flux linkage, of which ± {allowed:.1f} % is what spring and channels are known to"
        )
        if self.cause is not None:
            return f"{said}: they disagree. Of all single causes {_WORDS[self.cause]}"
        return f"{said}: they agree" if self.same_shape else f"{said}, but their courses along the stroke differ"


def compare(
    flux: FluxFit,
    balance: BalanceFit,
    points: Sequence[SpringPoint],
    device: DeviceDescription,
    electrical_std: float,
    spring_std: float,
) -> Agreement:
    """Hold the two profiles, the resistance and the stage against each other."""
    places = np.array(sorted({round(point.position_m, 4) for point in points}))
    at = flux.basis.values(places)
    by_flux, by_spring = at @ flux.coefficients, at @ balance.coefficients
    covariance = at @ (flux.covariance + balance.covariance) @ at.T
    weight = np.linalg.pinv(covariance, rcond=1e-8, hermitian=True)
    information = float(by_spring @ weight @ by_spring)
    share = float(by_spring @ weight @ by_flux) / information  # flux over spring
    left = by_flux - share * by_spring
    freedom = int(np.linalg.matrix_rank(covariance, tol=1e-8 * float(np.linalg.norm(covariance, 2)))) - 1
    chance = float(stats.chi2.sf(left @ weight @ left, max(1, freedom)))
    ratio = Estimate(1.0 / share, float(1.0 / np.sqrt(information) / share**2))
    resistances = np.array([found.value for found in flux.resistance_ohm]) / device.coil_resistance_ohm
    resistance = Estimate(float(resistances.mean()), float(resistances.std(ddof=1)) if resistances.size > 1 else None)
    stage = _stage(points)
    expected = float(np.hypot(electrical_std, spring_std))
    off = abs(ratio.value - 1.0) > _DOUBT * float(np.hypot(expected, ratio.std or 0.0))
    cause = _cause(ratio.value, resistance.value, stage) if off else None
    return Agreement(ratio, expected, resistance, stage, chance > _SHAPE_DOUBT, cause)


def _stage(points: Sequence[SpringPoint]) -> Estimate | None:
    """Metres read for each metre that the stage moved, where it did."""
    moved = [(point.stage_m, point.rest_m) for point in points if np.isfinite(point.stage_m + point.rest_m)]
    if len({stage for stage, _ in moved}) < _LEAST_STAGES:
        return None
    line = stats.linregress(*np.array(moved).T)
    return Estimate(float(line.slope), float(line.stderr))


def _cause(ratio: float, resistance: float, stage: Estimate | None) -> Cause:
    """Which single scale would leave the marks that are there."""
    if min(ratio, resistance, 1.0 if stage is None else stage.value) <= 0.0:
        return "unknown"  # one of them goes the wrong way round, which no scale explains
    size = abs(np.log(ratio))
    marks: dict[Cause, tuple[float, float, float]] = {
        "current": (np.log(ratio), np.log(ratio), 0.0),
        "position": (np.log(ratio), 0.0, 0.5 * np.log(ratio)),
        "voltage": (np.log(ratio), -np.log(ratio), 0.0),
        "spring": (np.log(ratio), 0.0, 0.0),
    }
    if stage is None:
        del marks["position"]  # cannot be told from the spring
    seen = np.array([np.log(ratio), np.log(resistance), 0.0 if stage is None else np.log(stage.value)])
    misses = {cause: float(np.linalg.norm(seen - np.array(mark))) for cause, mark in marks.items()}
    best = min(misses, key=lambda cause: misses[cause])
    return best if misses[best] < 0.35 * size else "unknown"
