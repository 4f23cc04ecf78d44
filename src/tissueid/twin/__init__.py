"""Digital twin: simulation of the signal chain from command to recorded samples. Pure functions of arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tissueid.lazy_import import lazy_attributes

if TYPE_CHECKING:
    from tissueid.twin.chain_parameters import InstrumentParameters, Tissue
    from tissueid.twin.player import Player
    from tissueid.twin.simulation import Start, simulate
else:
    __getattr__ = lazy_attributes(
        __name__,
        {
            "chain_parameters": ("InstrumentParameters", "Tissue"),
            "player": ("Player",),
            "simulation": ("Start", "simulate"),
        },
    )

__all__ = ["InstrumentParameters", "Player", "Start", "Tissue", "simulate"]
