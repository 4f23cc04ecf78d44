"""The numbers and the words of a fitted dynamic-parameter nonlinearity."""

from __future__ import annotations

import math

import numpy as np

from tissueid.identification.base import Array
from tissueid.identification.dpn.bands import KnownCurves
from tissueid.records import Estimate
from tissueid.wording import number, people_unit

_DOUBT = 3.0
"""Standard deviations by which a change with depth must stand out to be told as one."""

_KNOWN = 0.5
"""Relative standard deviation from which a parameter is called undetermined."""

_SETTLING = 16.0
"""Time constants after which a start is forgotten: to one part in ten million."""

_EXPLAINED = 0.05
"""Share of the squared error that a term which was switched off must explain to be told of."""

_ALIKE = 0.2
"""How far apart, in parts of their mean, the changes of the three logarithms may be to count as one."""

UNITS = {"mass": "kg", "damping": "N s/m", "stiffness": "N/m"}


def dpn_parameters(known: KnownCurves, surface: float | None, mechanical: bool) -> dict[str, Estimate]:
    """Named estimates at the median position.

    Mass, damping and stiffness there, their growth with depth (1/m), natural frequency and damping ratio; with a known
    surface the stiffness of Eq. 3.33 too. For signals other than N and m a gain instead of the three.
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


def settling_samples(known: KnownCurves, sample_rate_hz: float) -> int:
    """Samples after which a start is forgotten, from the mean rate of decay over the visited positions."""
    mass = known.curves.masses(known.position)
    decay = known.curves.dampings(known.position) / (2.0 * mass)
    squared = known.curves.stiffnesses(known.position) / mass - decay**2
    slowest = decay - np.sqrt(np.maximum(0.0, -squared))  # 1/s, of the slower of two poles where there are two
    return math.ceil(_SETTLING * sample_rate_hz / max(float(np.mean(slowest)), 1e-3))


def findings(known: KnownCurves, gains: dict[str, tuple[float, float]]) -> list[str]:
    """What the curves show, in words.

    Args:
        known: the curves.
        gains: score statistic and explained share of the squared error of terms that were switched off.
    """
    low, high = known.central()
    middle = float(np.median(known.position))
    ends = np.array([low, high])
    said = []
    changes, covariance = known.changes(low, high)
    told = np.abs(changes) > _DOUBT * np.sqrt(np.diag(covariance))  # nothing, where the covariance is unknown
    for name, change, stands_out in zip(UNITS, changes, told, strict=True):
        first, last = getattr(known, name)(ends).value
        unit, scale = people_unit(UNITS[name])
        where = f"between {1e3 * low:.2f} and {1e3 * high:.2f} mm"
        growth = known.growth(name, middle)
        if stands_out:
            way = "grows" if change > 0.0 else "falls"
            said.append(f"{name} {way} from {number(first * scale, 3)} to {number(last * scale, 3)} {unit} {where}")
        elif growth.std is not None and abs(growth.value) > _DOUBT * growth.std:
            way = "grows" if growth.value > 0.0 else "falls"
            said.append(
                f"{name} {way} by {number(abs(growth.value) / 10.0, 2)} % a millimetre at {1e3 * middle:.2f} mm; that "
                f"it differs from end to end, {where}, is not certain"
            )
        else:
            shown = number(math.sqrt(first * last) * scale, 3)
            said.append(f"{name} shows no change with depth that is certain: {shown} {unit}")
    if told.all() and _common(changes, covariance):
        said.append("mass, damping and stiffness grow by one common factor: a Wiener system would say the same")
    if known.curves.direction.size:
        here = np.array([middle])
        factor = float(known.damping(here, 1).value[0] / known.damping(here, -1).value[0])
        said.append(f"damping on the way in is {factor:.2f} times that on the way out")
    if known.curves.inertia.size:
        said.append(
            f"{known.curves.inertia[0]:.2f} of M'(y) y'^2 resists: Eq. 3.33 has none, a Wiener system all of it"
        )
    words = {
        "direction": "a damping that differs between the way in and the way out (direction)",
        "inertia": "a squared speed where the mass changes (inertia)",
    }
    for name, (statistic, explained) in gains.items():
        if statistic > _DOUBT**2 and explained > _EXPLAINED:
            said.append(f"{words[name]} would take {100.0 * explained:.0f} % off the squared error")
    return said


def doubts(known: KnownCurves) -> list[str]:
    """What to know before trusting the curves."""
    if not np.all(np.isfinite(known.covariance)):
        return ["the fit did not settle: mass, damping and stiffness have no uncertainty"]
    middle = float(np.median(known.position))
    here = np.array([middle])
    bands = {"mass": known.mass(here), "damping": known.damping(here), "stiffness": known.stiffness(here)}
    unknown = [name for name, band in bands.items() if band.std[0] > _KNOWN * band.value[0]]
    return [f"this record does not determine the {' and '.join(unknown)}"] if unknown else []


def estimate(value: float, std: float) -> Estimate:
    """A value with its standard deviation, None where that is not finite."""
    return Estimate(value, std if math.isfinite(std) else None)


def _common(changes: Array, covariance: Array) -> bool:
    """True when log M, log B and log K change with depth by as much, within their uncertainty and nearly so in size."""
    contrast = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]])
    apart = contrast @ changes
    statistic = float(apart @ np.linalg.solve(contrast @ covariance @ contrast.T, apart))
    return statistic < _DOUBT**2 and float(np.ptp(changes)) < _ALIKE * abs(float(np.mean(changes)))
