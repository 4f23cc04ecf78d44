"""Calibration files: TOML that says what was measured on which device, when, how well, under which conditions."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Finite = Annotated[float, Field(allow_inf_nan=False)]


class Quantity(BaseModel):
    """A value with its standard deviation and unit."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    value: Finite
    std: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    unit: str = ""


class Calibration(BaseModel):
    """One calibration of one device.

    ``quantities`` are single figures by name (``coil_resistance_ohm``, ``force_constant_n_per_a``,
    ``linear_region_min_m``, ...); ``tables`` are columns of equal length by name (``force_constant``: ``position_m``,
    ``value_n_per_a``, ``std_n_per_a``). ``problems`` says why a verdict is ``failed``.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    format: Literal["tissueid-calibration"] = "tissueid-calibration"
    format_version: Literal["1.0"] = "1.0"
    kind: Literal["static", "sweep"]
    model: str
    serial_number: str
    firmware_version: str = ""
    date: str
    """ISO 8601, UTC."""
    valid_days: Annotated[int, Field(ge=1, le=3650)] = 90
    software: str
    conditions: dict[str, float | str] = Field(default_factory=dict)
    verdict: Literal["passed", "failed"]
    problems: tuple[str, ...] = ()
    quantities: dict[str, Quantity] = Field(default_factory=dict)
    tables: dict[str, dict[str, tuple[Finite, ...]]] = Field(default_factory=dict)
