"""The twin: our belief about the signal chain, from command to recorded numbers. Pure: arrays in, arrays out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tissueid.lazily import on_first_use

if TYPE_CHECKING:
    from tissueid.twin.figures import Instrument, Tissue
    from tissueid.twin.player import Player
    from tissueid.twin.simulation import Start, simulate
else:
    __getattr__ = on_first_use(
        __name__,
        {
            "figures": ("Instrument", "Tissue"),
            "player": ("Player",),
            "simulation": ("Start", "simulate"),
        },
    )

__all__ = ["Instrument", "Player", "Start", "Tissue", "simulate"]
