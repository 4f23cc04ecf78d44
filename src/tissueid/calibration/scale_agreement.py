"""Agreement of the electrical and the mechanical half of a sweep, and the cause of a disagreement.

The spring gives newtons per ampere, the flux linkage volts per metre per second: the same number if all scales are
right. A channel that reads too much by a factor f, or a spring that is too stiff by f, changes three ratios:

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
from tissueid.language import marked
from tissueid.messages import Message, Quantity
from tissueid.records import Estimate

ELECTRICAL_STD = 0.005
"""Default relative standard deviation of the ratio of voltage and position scales."""
_DISAGREEMENT_STD = 3.0
"""Standard deviations above which two values disagree."""
_SHAPE_P_VALUE = 1e-4
"""p-value below which two profiles differ in shape."""
_MIN_STAGES = 4
"""Minimum number of stage positions for a comparison with the position channel."""

Cause = Literal["current", "position", "voltage", "spring", "unknown"]


@dataclass(frozen=True)
class Agreement:
    """Ratio of the force constants by spring and by flux linkage, and further ratios that depend on the scales.

    ``resistance`` is measured over expected; ``stage`` is metres read per metre moved, None without a motorised stage.
    ``expected_std`` is the uncertainty of the first ratio from spring and channels. ``cause`` is None if they agree.
    ``same_shape`` is False if the two profiles differ by more than a factor.
    """

    ratio: Estimate
    expected_std: float
    resistance: Estimate
    stage: Estimate | None
    same_shape: bool
    cause: Cause | None

    @property
    def words(self) -> Message:
        """Result of the comparison in a sentence."""
        ratio = self.ratio.value - 1.0
        said = Message(
            "sweep.ratio.higher" if ratio >= 0.0 else "sweep.ratio.lower",
            _HIGHER if ratio >= 0.0 else _LOWER,
            difference=Quantity(100.0 * abs(ratio), "%", 2),
            uncertainty=Quantity(100.0 * self.expected_std, "%", 1),
        )
        if self.cause is not None:
            return Message(
                "sweep.scales", "{comparison}: they disagree. {cause}", comparison=said, cause=_CAUSES[self.cause]
            )
        if self.same_shape:
            return Message("sweep.agree", "{comparison}: they agree", comparison=said)
        return Message("sweep.shapes", "{comparison}, but their profiles along the stroke differ", comparison=said)


_HIGHER = marked(
    "The force constant by the spring is {difference} higher than by the flux linkage, with an uncertainty of spring "
    "and "
    "channels of ±{uncertainty}"
)
_LOWER = marked(
    "The force constant by the spring is {difference} lower than by the flux linkage, with an uncertainty of spring "
    "and "
    "channels of ±{uncertainty}"
)
_CAUSES: dict[Cause, Message] = {
    "current": Message(
        "sweep.cause.current",
        "The scale of the current channel is the most likely cause: the resistance is off by the same factor",
    ),
    "position": Message(
        "sweep.cause.position",
        "The scale of the position channel is the most likely cause: the stage shows the same",
    ),
    "voltage": Message(
        "sweep.cause.voltage",
        "The scale of the voltage channel is the most likely cause: the resistance is off in the other direction",
    ),
    "spring": Message(
        "sweep.cause.spring",
        "The stiffness of the spring, or the scale of the position channel, is the most likely cause: the resistance "
        "is "
        "right",
    ),
    "unknown": Message(
        "sweep.cause.unknown", "No single scale explains it: check the spring, its fixture and the channels"
    ),
}


def compare(
    flux: FluxFit,
    balance: BalanceFit,
    points: Sequence[SpringPoint],
    device: DeviceDescription,
    electrical_std: float,
    spring_std: float,
) -> Agreement:
    """Compare the two profiles, the resistance and the stage.

    Args:
        flux: electrical half.
        balance: mechanical half.
        points: identified positions.
        device: nominal figures.
        electrical_std: relative standard deviation of the scale of voltage over position.
        spring_std: relative standard deviation of the stiffness of the spring.
    """
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
    off = abs(ratio.value - 1.0) > _DISAGREEMENT_STD * float(np.hypot(expected, ratio.std or 0.0))
    cause = _cause(ratio.value, resistance.value, stage) if off else None
    return Agreement(ratio, expected, resistance, stage, chance > _SHAPE_P_VALUE, cause)


def _stage(points: Sequence[SpringPoint]) -> Estimate | None:
    """Return metres read per metre of stage travel; None if the stage did not move."""
    moved = [(point.stage_m, point.rest_m) for point in points if np.isfinite(point.stage_m + point.rest_m)]
    if len({stage for stage, _ in moved}) < _MIN_STAGES:
        return None
    line = stats.linregress(*np.array(moved).T)
    return Estimate(float(line.slope), float(line.stderr))


def _cause(ratio: float, resistance: float, stage: Estimate | None) -> Cause:
    """Return the single scale error that explains all ratios best."""
    if min(ratio, resistance, 1.0 if stage is None else stage.value) <= 0.0:
        return "unknown"  # a channel is inverted, which no scale explains
    size = abs(np.log(ratio))
    marks: dict[Cause, tuple[float, float, float]] = {
        "current": (np.log(ratio), np.log(ratio), 0.0),
        "position": (np.log(ratio), 0.0, 0.5 * np.log(ratio)),
        "voltage": (np.log(ratio), -np.log(ratio), 0.0),
        "spring": (np.log(ratio), 0.0, 0.0),
    }
    if stage is None:
        del marks["position"]  # not distinguishable from the spring
    seen = np.array([np.log(ratio), np.log(resistance), 0.0 if stage is None else np.log(stage.value)])
    misses = {cause: float(np.linalg.norm(seen - np.array(mark))) for cause, mark in marks.items()}
    best = min(misses, key=lambda cause: misses[cause])
    return best if misses[best] < 0.35 * size else "unknown"
