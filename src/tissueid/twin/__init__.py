"""The twin: our belief about the signal chain, from command to recorded numbers. Pure: arrays in, arrays out."""

from __future__ import annotations

from tissueid.twin.figures import Instrument, Tissue
from tissueid.twin.player import Player
from tissueid.twin.simulation import Start, simulate

__all__ = ["Instrument", "Player", "Start", "Tissue", "simulate"]
