"""The twin: our belief about the signal chain, from command to recorded numbers. Pure: arrays in, arrays out."""

from __future__ import annotations

from tissueid.twin.chain import State, TwinParameters, simulate

__all__ = ["State", "TwinParameters", "simulate"]
