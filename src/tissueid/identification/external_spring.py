"""Correction of parameters for an external spring parallel to the tissue (thesis 2.2.3).

Probe, tissue and spring move together, so their forces and stiffnesses add. Mass and damping of the spring are
neglected.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TypeVar

from tissueid.identification.depth_profile import DepthProfile
from tissueid.records import Estimate

Name = TypeVar("Name", bound=str)

_STIFFNESS = "stiffness_n_per_m"


def has_stiffness(parameters: Mapping[str, Estimate]) -> bool:
    """Return whether the parameters include a stiffness in N/m."""
    return any(name.endswith(_STIFFNESS) for name in parameters)


def without_spring(parameters: Mapping[Name, Estimate], spring_n_per_m: float) -> dict[Name, Estimate]:
    """Return the parameters with the spring subtracted from every stiffness in N/m; standard deviations are unchanged.

    Natural frequency, damping ratio and relative growth of stiffness with depth still describe tissue and spring.
    """
    return {
        name: replace(found, value=found.value - spring_n_per_m) if _is_stiffness(name) else found
        for name, found in parameters.items()
    }


def profile_without_spring(profile: DepthProfile, spring_n_per_m: float) -> DepthProfile:
    """Return the depth profile with the spring subtracted from its stiffness."""
    return replace(profile, stiffness=profile.stiffness - spring_n_per_m)


def _is_stiffness(name: str) -> bool:
    return name == "stiffness" or name.endswith(_STIFFNESS)
