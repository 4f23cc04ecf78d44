"""Named twin: parameters of one instrument on one tissue, with accepted effects."""

from __future__ import annotations

from dataclasses import dataclass, field

from tissueid.twin.chain_parameters import InstrumentParameters, Tissue
from tissueid.twin.simulation import ActiveEffect


@dataclass(frozen=True)
class NamedTwin:
    """Parameters with standard deviations where known, SI, and effects.

    ``stds`` is by name: ``force_constant_n_per_a``, ``tissue_stiffness_n_per_m``, ``dry_friction.coulomb_n``.
    ``sample_rate_hz`` is that of the tests that the twin was fitted to. ``unmodelled`` is the error that the twin left
    of each signal there, without the sensor noise, as a share of the signal's standard deviation.
    """

    name: str
    version: int
    instrument: InstrumentParameters
    tissue: Tissue
    acting: tuple[ActiveEffect, ...]
    sample_rate_hz: float
    stds: dict[str, float] = field(default_factory=dict)
    unmodelled: dict[str, float] = field(default_factory=dict)

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(item.effect.name for item in self.acting)
