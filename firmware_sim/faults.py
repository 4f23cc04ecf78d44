"""Faults: what goes wrong on purpose, in the device and on the line."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Seconds = Annotated[float, Field(ge=0, le=3600, allow_inf_nan=False)]


class PlannedFault(BaseModel):
    """One thing that goes wrong, timed from the first START, in seconds of the device's clock."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["reset", "stall", "unplug", "button"]
    after_start_s: Seconds
    seconds: Seconds = 2.0
    """How long a stall lasts; the other kinds are for good."""
