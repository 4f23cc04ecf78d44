"""Result of a diagnosis as plain values, which the page shows and stores."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal

from tissueid.app.file_stamp import Stamp, stamp_of
from tissueid.device import DeviceDescription
from tissueid.procedures.gap_plans import DiagnosisPlan

if TYPE_CHECKING:
    from tissueid.app.views.gap.page_content import PageContent
    from tissueid.instrument.twin_file import TwinFile

State = Literal["", "changed", "missing"]
"""State of the session file since its diagnosis; "" if it is unchanged."""


def new_key(when: datetime) -> str:
    """Return a unique key for a diagnosis; keys sort by time (UTC)."""
    return f"{when.astimezone(UTC):%Y%m%dT%H%M%S%fZ}-{secrets.token_hex(4)}"


def _now() -> datetime:
    return datetime.now(UTC)


@dataclass(frozen=True)
class DiagnosisResult:
    """A diagnosis with its plan.

    ``story`` is what the page shows of it, ``answer`` the JSON of ``tissueid gap diagnose``, ``report`` its page as
    HTML. ``twin`` is the content of the baseline twin, None for the nominal one; ``accepted`` that of the twin which
    has the named effects, None where there is none, and ``refused`` says why in words. ``stamp`` is that of the session
    file as it was diagnosed.
    """

    asked: DiagnosisPlan
    session_id: str
    instrument: DeviceDescription
    twin: TwinFile | None
    story: PageContent
    answer: Mapping[str, Any]
    report: str
    accepted: TwinFile | None = None
    refused: str = ""
    stamp: Stamp | None = None
    when: datetime = field(default_factory=_now)
    key: str = ""

    def __post_init__(self) -> None:
        if not self.key:
            object.__setattr__(self, "key", new_key(self.when))

    @property
    def state(self) -> State:
        """State of the session file; "" also if its stamp is unknown."""
        if self.stamp is None:
            return ""
        now = stamp_of(self.asked.session)
        return "missing" if now is None else "" if now == self.stamp else "changed"
