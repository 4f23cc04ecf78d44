"""What windows of several tests would fit alike is fitted once: the fit is the dear part of every result shown."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import fields

import numpy as np

from tissueid.analysis import Analysis, analyse_all
from tissueid.configuration import spring_of
from tissueid.sessions import Session, Test

_FITTED: dict[Hashable, dict[str, Analysis]] = {}


def analyse_once(
    session: Session, engines: Sequence[str], *, test: Test, tissue_alone: bool = False
) -> dict[str, Analysis]:
    """As ``analyse_all``, which sees of a session no more than is compared here. Refusals are worked out every time."""
    record = test.record()
    values = (getattr(record, field.name) for field in fields(record))
    compared = tuple(value.tobytes() if isinstance(value, np.ndarray) else value for value in values)
    gravity = tuple(test.notes.get(f"gravity_{way}_stroke_m_s2") for way in ("along", "across"))
    placed = (repr(test.surface_position_m), gravity, session.instrument.moving_mass_kg, tissue_alone)
    key = (*engines, test.number, test.configuration, spring_of(test.notes), placed, compared)
    if key not in _FITTED:
        _FITTED[key] = analyse_all(session, engines, test=test, tissue_alone=tissue_alone)
    return dict(_FITTED[key])
