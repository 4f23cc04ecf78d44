"""Recordings from other sources, in a folder next to the project. Tests that need them are skipped without it."""

from __future__ import annotations

from pathlib import Path

_SHARED = Path(__file__).parents[2] / "shared"

RIG = _SHARED / "blind"
"""Sessions of an independent rig, ``rig-001.h5`` and on."""

REAL = _SHARED / "real"

CASES = _SHARED / "cases"
"""Small records, each in a folder with what is right for it."""
