"""Records that nobody here made. They stand beside the project where there are any; who wants them skips without."""

from __future__ import annotations

from pathlib import Path

_SHARED = Path(__file__).parents[2] / "shared"

RIG = _SHARED / "blind"
"""Sessions of an independent rig, ``rig-001.h5`` and on."""

REAL = _SHARED / "real"
