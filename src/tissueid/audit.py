"""The audit log: who did what when, and what it was before; append-only, each line bound to the one before by a hash."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

Role = Literal["clinician", "researcher", "technician"]


@dataclass(frozen=True)
class AuditLog:
    """A log of which lines are only ever added. ``path`` is made when the first line is."""

    path: Path

    def record(self, role: Role, what: str, *, subject: str = "", old: Any = None, new: Any = None) -> None:
        """Add one line: ``what`` was done (``calibration.made``, ``test.begun``, ...), to which ``subject``."""
        raise NotImplementedError
