"""Effects that are tried on a dataset: those of the library, or those of an equivalent machine."""

from __future__ import annotations

from collections.abc import Mapping

from tissueid.device import DeviceDescription
from tissueid.gap.dataset import Dataset
from tissueid.twin.catalogue import all_effects
from tissueid.twin.effect import SCALES, Effect
from tissueid.twin.machine_effects import machine_effects

_DRIVE = frozenset({"amplifier_clipping", "amplifier_deadband"})
_OF_POSITION = frozenset({"end_stop", "mount_resonance", "cogging", "sensor_backlash"})
"""Effects outside the tissue that depend on the position, or on a record of it."""
_OF_VELOCITY = frozenset({"directional_damping"})
"""Effects on the tissue that do not depend on the position."""


def effects_of(dataset: Dataset) -> Mapping[str, Effect]:
    """Return the effects of the library by name, with bounds and starts for the instrument, or with those for an
    equivalent machine in an input-output record."""
    if dataset.equivalent is not None:
        return all_effects() | machine_effects()
    ratios = {name: getattr(dataset.instrument, name) / getattr(DeviceDescription, name) for name in SCALES}
    return {name: item.scaled(ratios) for name, item in all_effects().items()}


def acts_on_machine(dataset: Dataset, item: Effect) -> bool:
    """Return whether an effect can be identified in an input-output record."""
    about = dataset.equivalent
    if about is None:
        return False
    if about.output_is_velocity and (item.name in _OF_POSITION or item.stage == "tissue"):
        return item.name in _OF_VELOCITY
    if item.stage == "drive":
        return item.name in _DRIVE
    return item.stage in ("mechanics", "tissue", "sensing") and item.needs <= {"position", "command"}
