"""Parameters, findings and warnings of a fitted dynamic parameter nonlinearity."""

from __future__ import annotations

import math

import numpy as np

from tissueid.formatting import number
from tissueid.identification.base import Array
from tissueid.identification.dpn.confidence_bands import EstimatedCurves
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


def dpn_parameters(known: EstimatedCurves, surface: float | None, mechanical: bool) -> dict[str, Estimate]:
    """Return the named estimates at the median position.

    Mass, damping and stiffness there, their growth with depth (1/m), natural frequency and damping ratio; with a known
    surface also the stiffness of Eq. 3.33. For signals other than N and m, a gain instead of the three.
    """
    middle = float(np.median(known.position))
    here = np.array([middle])
    curves = known.curves
    mass, damping, stiffness = known.mass(here), known.damping(here), known.stiffness(here)
    found: dict[str, Estimate] = {}
    if mechanical:
        for name, band in (("mass_kg", mass), ("damping_n_s_per_m", damping), ("stiffness_n_per_m", stiffness)):
            found[name] = estimate(float(band.value[0]), float(band.std[0]))
        if surface is not None:
            secant = known.secant(here, surface)
            found["secant_stiffness_n_per_m"] = estimate(float(secant.value[0]), float(secant.std[0]))
        found["position_m"] = Estimate(middle)
        for name in ("mass", "damping", "stiffness"):
            found[f"{name}_growth_per_m"] = known.growth(name, middle)
        if curves.direction.size:
            found["damping_in_n_s_per_m"], found["damping_out_n_s_per_m"] = (
                estimate(float(band.value[0]), float(band.std[0]))
                for band in (known.damping(here, 1), known.damping(here, -1))
            )
    else:
        found["gain"] = estimate(1.0 / float(stiffness.value[0]), float(stiffness.std[0] / stiffness.value[0] ** 2))
    m, b, k = float(mass.value[0]), float(damping.value[0]), float(stiffness.value[0])
    frequency = math.sqrt(k / m)
    ratio = b / (2.0 * math.sqrt(k * m))
    found["natural_frequency_rad_per_s"] = estimate(frequency, frequency * known.combined_std(middle, (-0.5, 0.0, 0.5)))
    found["damping_ratio"] = estimate(ratio, ratio * known.combined_std(middle, (-0.5, 1.0, -0.5)))
    if curves.inertia.size:
        place = curves.places["inertia"].start
        found["inertia_share"] = estimate(float(curves.inertia[0]), math.sqrt(float(known.covariance[place, place])))
    return found


def settling_samples(known: EstimatedCurves, sample_rate_hz: float) -> int:
    """Return the samples after which the initial state has decayed, from the mean decay rate over the visited
    positions.
    """
    mass = known.curves.masses(known.position)
    decay = known.curves.dampings(known.position) / (2.0 * mass)
    squared = known.curves.stiffnesses(known.position) / mass - decay**2
    slowest = decay - np.sqrt(np.maximum(0.0, -squared))  # 1/s, of the slower of two poles where there are two
    return math.ceil(_SETTLING * sample_rate_hz / max(float(np.mean(slowest)), 1e-3))


def findings(known: EstimatedCurves, gains: dict[str, tuple[float, float]]) -> list[str]:
    """Return how mass, damping and stiffness change with depth, and which optional terms would reduce the error.

    Args:
        known: the curves.
        gains: score statistic and explained share of the squared error of terms outside the model.
    """
    low, high = known.central()
    middle = float(np.median(known.position))
    ends = np.array([low, high])
    found: list[str] = []
    changes, covariance = known.changes(low, high)
    significant = np.abs(changes) > _SIGNIFICANT_STD * np.sqrt(
        np.diag(covariance)
    )  # False where the covariance is unknown
    for name, change, stands_out in zip(UNITS, changes, significant, strict=True):
        found.append(_change(known, name, change if stands_out else 0.0, ends, middle))
    if significant.all() and _common(changes, covariance):
        found.append(
            Message(
                "dpn.common_factor",
                "mass, damping and stiffness change by one common factor: a Wiener system would show the same",
            )
        )
    if known.curves.direction.size:
        here = np.array([middle])
        factor = float(known.damping(here, 1).value[0] / known.damping(here, -1).value[0])
        found.append(
            Message(
                "dpn.direction", "damping in inward motion is {factor:.2f} times that in outward motion", factor=factor
            )
        )
    if known.curves.inertia.size:
        found.append(
            Message(
                "dpn.inertia",
                "a share of {share:.2f} of M'(y) y'^2 acts as a force: none in Eq. 3.33, all of it in a Wiener system",
                share=float(known.curves.inertia[0]),
            )
        )
    for name, (statistic, explained) in gains.items():
        if statistic > _SIGNIFICANT_STD**2 and explained > _EXPLAINED:
            found.append(
                Message(
                    "dpn.term_would_help",
                    "{term} would reduce the squared error by {percent:.0f} %",
                    term=_TERMS[name],
                    percent=100.0 * explained,
                )
            )
    return found


_NAMES = {"mass": marked("mass"), "damping": marked("damping"), "stiffness": marked("stiffness")}
_TERMS = {
    "direction": marked("a damping that depends on the direction (direction)"),
    "inertia": marked("a squared speed where the mass changes (inertia)"),
}


def _change(known: EstimatedCurves, name: str, change: float, ends: Array, middle: float) -> Message:
    """Return how one parameter changes between two depths (2,), m; ``change`` is 0 where it is not significant."""
    first, last = getattr(known, name)(ends).value
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
    growth = known.growth(name, middle)
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


def curve_warnings(known: EstimatedCurves) -> list[str]:
    """Return warnings about the curves."""
    if not np.all(np.isfinite(known.covariance)):
        return [
            Message("dpn.not_converged", "the fit did not converge: mass, damping and stiffness have no uncertainty")
        ]
    middle = float(np.median(known.position))
    here = np.array([middle])
    bands = {"mass": known.mass(here), "damping": known.damping(here), "stiffness": known.stiffness(here)}
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


def estimate(value: float, std: float) -> Estimate:
    """Return a value with its standard deviation, None if that is not finite."""
    return Estimate(value, std if math.isfinite(std) else None)


def _common(changes: Array, covariance: Array) -> bool:
    """Return whether log M, log B and log K change equally with depth, within their uncertainty and in size."""
    contrast = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]])
    difference = contrast @ changes
    statistic = float(difference @ np.linalg.solve(contrast @ covariance @ contrast.T, difference))
    return statistic < _SIGNIFICANT_STD**2 and float(np.ptp(changes)) < _COMMON_TOLERANCE * abs(float(np.mean(changes)))
