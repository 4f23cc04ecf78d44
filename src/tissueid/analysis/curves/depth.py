"""Curves of mass, damping and stiffness against depth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.analysis import Analysis
from tissueid.analysis.curves.plot import Array, Axis, Curve, Plot
from tissueid.errors import UnusableInputError
from tissueid.identification.depth_profile import DepthProfile
from tissueid.language import marked
from tissueid.messages import Message

QUANTITIES = {
    "mass": (Axis(marked("Mass"), "g"), "mass_kg", 1e3),
    "damping": (Axis(marked("Damping"), "N·s/m"), "damping_n_s_per_m", 1.0),
    "stiffness": (Axis(marked("Stiffness"), "N/m"), "stiffness_n_per_m", 1.0),
}
"""Axis, name of the parameter, and factor from SI to the unit of the axis."""


def profile_curve(
    profile: DepthProfile,
    quantity: str,
    rows: NDArray[np.intp] | NDArray[np.bool_],
    *,
    deviations: float = 1.0,
    origin_m: float = 0.0,
) -> Curve:
    """Return one quantity of some rows of a profile against depth (mm), with a band of some standard deviations."""
    scale = QUANTITIES[quantity][2]
    x = 1e3 * (profile.position[rows] - origin_m)
    y, std = scale * getattr(profile, quantity)[rows], scale * getattr(profile, f"{quantity}_std")[rows]
    half = deviations * np.where(np.isfinite(std), std, 0.0)
    return Curve(x, y, colour="model", low=y - half, high=y + half)


def depth_plots(analysis: Analysis) -> tuple[Plot, Plot, Plot]:
    """Return mass, damping and stiffness against position, each with one standard deviation.

    A faint curve shows retraction if it differs from indentation. An engine without a profile gives a point at
    the mean position.

    Raises:
        UnusableInputError: the engine estimates no mass, damping and stiffness.
    """
    profile = analysis.depth_profile()
    position = Axis(marked("Position"), "mm")
    made = []
    for quantity, (axis, _name, _scale) in QUANTITIES.items():
        if profile is None:
            parts = [_point(analysis, quantity)]
        else:
            parts = [profile_curve(profile, quantity, profile.direction >= 0)]
            out = profile.direction < 0
            if out.any():
                back = profile_curve(profile, quantity, out)
                parts.append(Curve(back.x, back.y, marked("faint: on the way out"), "model", opacity=0.5, width=0.8))
        made.append(Plot(axis.label, position, axis, tuple(parts)))
    return made[0], made[1], made[2]


def _point(analysis: Analysis, quantity: str) -> Curve:
    """Return the parameter of a linear system as a point at the mean position of the test."""
    record, found = analysis.record[analysis.fit_part], analysis.model.report.reportable_parameters
    known = all(name in found for _axis, name, _scale in QUANTITIES.values())
    if (record.output_unit, record.input_unit) != ("m", "N") or not known:
        raise UnusableInputError(
            Message("research.no_second_order", "this engine estimates no mass, damping and stiffness from this record")
        )
    _axis, name, scale = QUANTITIES[quantity]
    where: Array = np.array([1e3 * float(np.nanmean(record.output))])
    return Curve(where, np.array([scale * found[name].value]), colour="model", kind="points", width=2.0)
