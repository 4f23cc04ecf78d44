"""A spring that stands beside the tissue on purpose, taken off what was identified with it (thesis 2.2.3).

It is in parallel: probe, tissue and spring move together and their forces add, so stiffnesses do too. Mass and damping
of the spring are taken for none.
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
    """Whether a stiffness in N/m is among these."""
    return any(name.endswith(_STIFFNESS) for name in parameters)


def without_spring(parameters: Mapping[Name, Estimate], spring_n_per_m: float) -> dict[Name, Estimate]:
    """Parameters with the spring taken off every stiffness in N/m; the deviation stays as it is.

    What describes the whole is left as it is: natural frequency, damping ratio, and how fast stiffness grows with
    depth as a share of itself.
    """
    return {
        name: replace(found, value=found.value - spring_n_per_m) if _is_stiffness(name) else found
        for name, found in parameters.items()
    }


def profile_without_spring(profile: DepthProfile, spring_n_per_m: float) -> DepthProfile:
    """A profile along the way of the probe with the spring taken off its stiffness."""
    return replace(profile, stiffness=profile.stiffness - spring_n_per_m)


def _is_stiffness(name: str) -> bool:
    return name == "stiffness" or name.endswith(_STIFFNESS)
