"""Selection of the degree of each curve: as high as the record supports, plus a spare degree.

The derivatives of the simulated output with respect to coefficients that are not yet in the model give the gain of
adding each. A gain is tested by a score test with the long-run covariance of the score, which is robust against
coloured residuals (White 1982); AICc assumes independent samples and would add too many degrees. The strongest term is
added and the curves are refitted, until none is significant. At the end every free curve gets spare degrees, so that
its confidence band includes curvature too small to be detected.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from tissueid.identification.base import Array
from tissueid.identification.correlation import dependence_samples, long_run_covariance
from tissueid.identification.dpn.confidence_bands import coefficient_covariance
from tissueid.identification.dpn.curves import LogCurves
from tissueid.identification.dpn.fit import TOLERANCE, DpnData, FittedDpn, minimise

SERIES = ("mass", "damping", "stiffness", "direction", "inertia")

_FEWEST = {"mass": 1, "damping": 1, "stiffness": 1, "direction": 0, "inertia": 0}
"""Minimum number of coefficients of each series."""

_INTERMEDIATE_TOLERANCE = 1e-4
"""Relative decrease of the cost below which an intermediate fit ends."""

_DEGREES_TESTED = 2
"""Largest number of degrees tested together: a second degree can be present without the first."""

_SCORE_THRESHOLDS = (10.0, 13.0)
"""Thresholds of the score statistic for one additional coefficient and for two: exceeded by chance in 1 of 600."""

_INERTIA_RANGE = (-0.5, 1.5)
"""Plausible range of the share of M'(y) y'^2: 0, 0.5 or 1, plus its uncertainty."""


def score_gains(data: DpnData, fitted: FittedDpn, steps: dict[str, int]) -> dict[tuple[str, int], tuple[float, float]]:
    """Return the gain of each series from 1 to ``steps`` additional degrees.

    Returns for each series and number of degrees the score statistic, which is chi-squared with that many degrees of
    freedom if they are not needed, and the share of the squared error that they would explain.
    """
    steps = {name: more for name, more in steps.items() if more > 0}
    degrees = {name: _degree(fitted, name) for name in SERIES}
    wider = fitted.curves.with_degrees(**{name: degrees[name] + more for name, more in steps.items()})
    there = data.evaluate(wider, fitted.starts) if steps else None
    if there is None:
        return {}
    at = wider.places
    new = {name: np.arange(at[name].start + degrees[name] + 1, at[name].stop) for name in steps}
    old = np.setdiff1d(np.arange(wider.theta.size), np.concatenate(list(new.values())))
    q, _ = np.linalg.qr(there.slopes[:, old])
    every = np.concatenate(list(new.values()))
    own = there.slopes[:, every] - q @ (q.T @ there.slopes[:, every])  # (m, all that are new)
    # The covariance uses the errors without what all new terms explain, which is not noise.
    left = there.error_projected - own @ np.linalg.lstsq(own, there.error_projected, rcond=1e-8)[0]
    covariance = long_run_covariance(own * left[:, None], dependence_samples(left, data.rate))
    total, gram = own.T @ there.error_projected, own.T @ own
    gains = {}
    first = 0
    for name, columns in new.items():
        for more in range(1, columns.size + 1):
            some = slice(first, first + more)
            aim = total[some]
            statistic = float(aim @ np.linalg.lstsq(covariance[some, some], aim, rcond=1e-10)[0])
            explained = float(aim @ np.linalg.lstsq(gram[some, some], aim, rcond=1e-10)[0])
            gains[name, more] = (statistic, explained / there.rss)
        first += columns.size
    return gains


def select_degrees(
    data: DpnData, start: LogCurves, degrees: dict[str, int], free: Collection[str], most: int, spare: int
) -> tuple[FittedDpn, dict[str, int]] | None:
    """Fit constant curves, then raise the degrees as far as the record supports.

    Args:
        fitting: the record.
        start: constant curves.
        degrees: fixed degrees by series; they are reached one at a time.
        free: series whose degree is selected.
        most: largest degree.
        spare: degrees added to the free mass, damping and stiffness at the end.

    Returns:
        The fit, and the selected degree of each free series, -1 for a series that is left out; None if the constant
        curves cannot be simulated.
    """
    fitted = minimise(data, start, data.starts(), start.theta, _INTERMEDIATE_TOLERANCE)
    if fitted is None:
        return None
    for degree in range(max(degrees.values(), default=0) + 1):
        due = {name: degree for name in SERIES if degrees.get(name, -1) >= degree > _degree(fitted, name)}
        fitted = _refitted(data, fitted, due, start) or fitted if due else fitted
    growing = True
    while free and growing:
        growing = False
        gains = score_gains(data, fitted, {name: _degrees_to_test(fitted, name, most) for name in free})
        asked = [key for key, (statistic, _) in gains.items() if statistic > _SCORE_THRESHOLDS[key[1] - 1]]
        for name, more in sorted(asked, key=lambda key: -gains[key][1]):
            better = _refitted(data, fitted, {name: _degree(fitted, name) + more}, start)
            if better is not None and _plausible(better):
                fitted, growing = better, True
                break
    fitted = _without_insignificant_degrees(data, fitted, free, start)
    found = {name: _degree(fitted, name) for name in free}
    shapes = {"mass", "damping", "stiffness"} & set(free)
    wanted = {name: min(most, found[name] + spare) for name in SERIES if name in shapes and found[name] < most}
    return _refitted(data, fitted, wanted, start, TOLERANCE) or fitted, found


def _without_insignificant_degrees(
    data: DpnData, fitted: FittedDpn, free: Collection[str], start: LogCurves
) -> FittedDpn:
    """Return the fit without highest degrees that are no longer significant by the Wald test."""
    while True:
        covariance = coefficient_covariance(data, fitted)
        weakest: tuple[float, dict[str, int]] | None = None
        for name in free:
            place = fitted.curves.places[name]
            last = place.stop - 1
            if place.stop - place.start > _FEWEST[name] and np.isfinite(covariance[last, last]):
                statistic = float(fitted.curves.theta[last] ** 2 / covariance[last, last])
                if statistic < _SCORE_THRESHOLDS[0] and (weakest is None or statistic < weakest[0]):
                    weakest = statistic, {name: _degree(fitted, name) - 1}
        lighter = None if weakest is None else _refitted(data, fitted, weakest[1], start)
        if lighter is None:
            return fitted
        fitted = lighter


def _degree(fitted: FittedDpn, name: str) -> int:
    return int(getattr(fitted.curves, name).size) - 1


def _degrees_to_test(fitted: FittedDpn, name: str, most: int) -> int:
    """Return how many additional degrees of a series may be tested."""
    if name == "inertia":  # means nothing for a constant mass
        return 1 if fitted.curves.inertia.size == 0 and fitted.curves.mass.size > 1 else 0
    return max(0, min(_DEGREES_TESTED, most - _degree(fitted, name)))


def _plausible(fitted: FittedDpn) -> bool:
    """Return False if the share of M'(y) y'^2 is not possible for any mass, so that another effect must cause it."""
    low, high = _INERTIA_RANGE
    return all(low < share < high for share in fitted.curves.inertia)


def _refitted(
    data: DpnData,
    fitted: FittedDpn,
    degrees: dict[str, int],
    start: LogCurves,
    tolerance: float = _INTERMEDIATE_TOLERANCE,
) -> FittedDpn | None:
    """Return the fit with series of other degrees; None if it cannot be simulated."""
    curves = fitted.curves.with_degrees(**degrees)
    every = {name: int(getattr(curves, name).size) - 1 for name in SERIES}
    centre: Array = start.with_degrees(**every).theta
    return minimise(data, curves, fitted.starts, centre, tolerance)
