"""Selection of the degree of each curve: as high as the record supports, plus a spare degree.

The derivatives of the simulated output with respect to coefficients that are not yet in the model give the gain of
adding each. A gain is tested by a score test with the long-run covariance of the score, which is robust against
coloured residuals (White 1982); AICc assumes independent samples and would add too many degrees. The strongest term is
added and the curves are refitted, until none is significant. At the end every free curve gets spare degrees, so that
its confidence band includes curvature too small to be detected.
"""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from tissueid.formatting import number
from tissueid.identification.base import Array
from tissueid.identification.dpn.curves import LogCurves
from tissueid.identification.dpn.fit import (
    TOLERANCE,
    DpnData,
    EstimatedCurves,
    FittedDpn,
    coefficient_covariance,
    estimate,
    minimise,
)
from tissueid.identification.impulse_response import dependence_samples, long_run_covariance
from tissueid.language import marked
from tissueid.messages import Listing, Message
from tissueid.records import Estimate
from tissueid.units import display_unit

_SIGNIFICANT_STD = 3.0
"""Significance threshold of a change with depth, in standard deviations."""

_LARGEST_RELATIVE_STD = 0.5
"""Relative standard deviation above which a parameter is undetermined."""

_SETTLING = 16.0
"""Time constants after which the effect of the initial state has decayed to 1e-7."""

_EXPLAINED = 0.05
"""Share of the squared error that a term outside the model must explain to be reported."""

_COMMON_TOLERANCE = 0.2
"""Largest difference of the changes of the three logarithms, relative to their mean, that counts as one common change.
"""

UNITS = {"mass": "kg", "damping": "N s/m", "stiffness": "N/m"}


def dpn_parameters(estimated: EstimatedCurves, surface: float | None, mechanical: bool) -> dict[str, Estimate]:
    """Return the named estimates at the median position.

    Mass, damping and stiffness there, their growth with depth (1/m), natural frequency and damping ratio; with a known
    surface also the stiffness of Eq. 3.33. For signals other than N and m, a gain instead of the three.
    """
    middle = float(np.median(estimated.position))
    here = np.array([middle])
    curves = estimated.curves
    mass, damping, stiffness = estimated.mass(here), estimated.damping(here), estimated.stiffness(here)
    estimates: dict[str, Estimate] = {}
    if mechanical:
        for name, band in (("mass_kg", mass), ("damping_n_s_per_m", damping), ("stiffness_n_per_m", stiffness)):
            estimates[name] = estimate(float(band.value[0]), float(band.std[0]))
        if surface is not None:
            secant = estimated.secant(here, surface)
            estimates["secant_stiffness_n_per_m"] = estimate(float(secant.value[0]), float(secant.std[0]))
        estimates["position_m"] = Estimate(middle)
        for name in ("mass", "damping", "stiffness"):
            estimates[f"{name}_growth_per_m"] = estimated.growth(name, middle)
        if curves.direction.size:
            estimates["damping_in_n_s_per_m"], estimates["damping_out_n_s_per_m"] = (
                estimate(float(band.value[0]), float(band.std[0]))
                for band in (estimated.damping(here, 1), estimated.damping(here, -1))
            )
    else:
        estimates["gain"] = estimate(1.0 / float(stiffness.value[0]), float(stiffness.std[0] / stiffness.value[0] ** 2))
    m, b, k = float(mass.value[0]), float(damping.value[0]), float(stiffness.value[0])
    frequency = math.sqrt(k / m)
    ratio = b / (2.0 * math.sqrt(k * m))
    estimates["natural_frequency_rad_per_s"] = estimate(
        frequency, frequency * estimated.combined_std(middle, (-0.5, 0.0, 0.5))
    )
    estimates["damping_ratio"] = estimate(ratio, ratio * estimated.combined_std(middle, (-0.5, 1.0, -0.5)))
    if curves.inertia.size:
        index = curves.places["inertia"].start
        estimates["inertia_share"] = estimate(
            float(curves.inertia[0]), math.sqrt(float(estimated.covariance[index, index]))
        )
    return estimates


def settling_samples(estimated: EstimatedCurves, sample_rate_hz: float) -> int:
    """Return the samples after which the initial state has decayed, from the mean decay rate over the visited
    positions.
    """
    mass = estimated.curves.masses(estimated.position)
    decay = estimated.curves.dampings(estimated.position) / (2.0 * mass)
    squared = estimated.curves.stiffnesses(estimated.position) / mass - decay**2
    slowest = decay - np.sqrt(np.maximum(0.0, -squared))  # 1/s, of the slower of two poles where there are two
    return math.ceil(_SETTLING * sample_rate_hz / max(float(np.mean(slowest)), 1e-3))


def findings(estimated: EstimatedCurves, gains: dict[str, tuple[float, float]]) -> list[str]:
    """Return how mass, damping and stiffness change with depth, and which optional terms would reduce the error.

    Args:
        known: the curves.
        gains: score statistic and explained share of the squared error of terms outside the model.
    """
    low, high = estimated.central()
    middle = float(np.median(estimated.position))
    ends = np.array([low, high])
    messages: list[str] = []
    changes, covariance = estimated.changes(low, high)
    significant = np.abs(changes) > _SIGNIFICANT_STD * np.sqrt(
        np.diag(covariance)
    )  # False where the covariance is unknown
    for name, change, stands_out in zip(UNITS, changes, significant, strict=True):
        messages.append(_change(estimated, name, change if stands_out else 0.0, ends, middle))
    if significant.all() and _common(changes, covariance):
        messages.append(
            Message(
                "dpn.common_factor",
                "mass, damping and stiffness change by one common factor: a Wiener system would show the same",
            )
        )
    if estimated.curves.direction.size:
        here = np.array([middle])
        factor = float(estimated.damping(here, 1).value[0] / estimated.damping(here, -1).value[0])
        messages.append(
            Message(
                "dpn.direction", "damping in inward motion is {factor:.2f} times that in outward motion", factor=factor
            )
        )
    if estimated.curves.inertia.size:
        messages.append(
            Message(
                "dpn.inertia",
                "a share of {share:.2f} of M'(y) y'^2 acts as a force: none in Eq. 3.33, all of it in a Wiener system",
                share=float(estimated.curves.inertia[0]),
            )
        )
    for name, (statistic, explained) in gains.items():
        if statistic > _SIGNIFICANT_STD**2 and explained > _EXPLAINED:
            messages.append(
                Message(
                    "dpn.term_would_help",
                    "{term} would reduce the squared error by {percent:.0f} %",
                    term=_TERMS[name],
                    percent=100.0 * explained,
                )
            )
    return messages


_NAMES = {"mass": marked("mass"), "damping": marked("damping"), "stiffness": marked("stiffness")}
_TERMS = {
    "direction": marked("a damping that depends on the direction (direction)"),
    "inertia": marked("a squared speed where the mass changes (inertia)"),
}


def _change(estimated: EstimatedCurves, name: str, change: float, ends: Array, middle: float) -> Message:
    """Return how one parameter changes between two depths (2,), m; ``change`` is 0 where it is not significant."""
    first, last = getattr(estimated, name)(ends).value
    unit, scale = display_unit(UNITS[name])
    values = {
        "name": _NAMES[name],
        "start": number(first * scale, 3),
        "end": number(last * scale, 3),
        "unit": unit,
        "low": 1e3 * float(ends[0]),
        "high": 1e3 * float(ends[1]),
    }
    if change > 0.0:
        return Message(
            "depth.rises", "{name} rises from {start} to {end} {unit} from {low:.2f} to {high:.2f} mm", **values
        )
    if change < 0.0:
        return Message(
            "depth.falls", "{name} falls from {start} to {end} {unit} from {low:.2f} to {high:.2f} mm", **values
        )
    growth = estimated.growth(name, middle)
    if growth.std is not None and abs(growth.value) > _SIGNIFICANT_STD * growth.std:
        values = {
            "name": _NAMES[name],
            "percent": number(abs(growth.value) / 10.0, 2),
            "place": 1e3 * middle,
            "low": 1e3 * float(ends[0]),
            "high": 1e3 * float(ends[1]),
        }
        if growth.value > 0.0:
            return Message(
                "depth.rises_locally",
                "{name} rises by {percent} % per millimetre at {place:.2f} mm; its change from {low:.2f} to "
                "{high:.2f} mm "
                "is not significant",
                **values,
            )
        return Message(
            "depth.falls_locally",
            "{name} falls by {percent} % per millimetre at {place:.2f} mm; its change from {low:.2f} to {high:.2f} mm "
            "is not significant",
            **values,
        )
    return Message(
        "dpn.constant",
        "{name} shows no significant change with depth: {value} {unit}",
        name=_NAMES[name],
        value=number(math.sqrt(first * last) * scale, 3),
        unit=unit,
    )


def curve_warnings(estimated: EstimatedCurves) -> list[str]:
    """Return warnings about the curves."""
    if not np.all(np.isfinite(estimated.covariance)):
        return [
            Message("dpn.not_converged", "the fit did not converge: mass, damping and stiffness have no uncertainty")
        ]
    middle = float(np.median(estimated.position))
    here = np.array([middle])
    bands = {"mass": estimated.mass(here), "damping": estimated.damping(here), "stiffness": estimated.stiffness(here)}
    unknown = tuple(_NAMES[name] for name, band in bands.items() if band.std[0] > _LARGEST_RELATIVE_STD * band.value[0])
    if not unknown:
        return []
    return [
        Message(
            "dpn.undetermined",
            "this record does not determine the {names}",
            names=Listing(unknown, marked(" and ")),
        )
    ]


def _common(changes: Array, covariance: Array) -> bool:
    """Return whether log M, log B and log K change equally with depth, within their uncertainty and in size."""
    contrast = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]])
    difference = contrast @ changes
    statistic = float(difference @ np.linalg.solve(contrast @ covariance @ contrast.T, difference))
    return statistic < _SIGNIFICANT_STD**2 and float(np.ptp(changes)) < _COMMON_TOLERANCE * abs(float(np.mean(changes)))


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
    unexplained = there.error_projected - own @ np.linalg.lstsq(own, there.error_projected, rcond=1e-8)[0]
    covariance = long_run_covariance(own * unexplained[:, None], dependence_samples(unexplained, data.rate))
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
    low, high = _INERTIA_RANGE
    growing = True
    while free and growing:
        growing = False
        gains = score_gains(data, fitted, {name: _degrees_to_test(fitted, name, most) for name in free})
        asked = [key for key, (statistic, _) in gains.items() if statistic > _SCORE_THRESHOLDS[key[1] - 1]]
        for name, more in sorted(asked, key=lambda key: -gains[key][1]):
            better = _refitted(data, fitted, {name: _degree(fitted, name) + more}, start)
            # A share of M'(y) y'^2 that no mass has must have another cause.
            if better is not None and all(low < share < high for share in better.curves.inertia):
                fitted, growing = better, True
                break
    fitted = _without_insignificant_degrees(data, fitted, free, start)
    selected = {name: _degree(fitted, name) for name in free}
    shapes = {"mass", "damping", "stiffness"} & set(free)
    wanted = {name: min(most, selected[name] + spare) for name in SERIES if name in shapes and selected[name] < most}
    return _refitted(data, fitted, wanted, start, TOLERANCE) or fitted, selected


def _without_insignificant_degrees(
    data: DpnData, fitted: FittedDpn, free: Collection[str], start: LogCurves
) -> FittedDpn:
    """Return the fit without highest degrees that are no longer significant by the Wald test."""
    while True:
        covariance = coefficient_covariance(data, fitted)
        weakest: tuple[float, dict[str, int]] | None = None
        for name in free:
            columns = fitted.curves.places[name]
            last = columns.stop - 1
            if columns.stop - columns.start > _FEWEST[name] and np.isfinite(covariance[last, last]):
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
