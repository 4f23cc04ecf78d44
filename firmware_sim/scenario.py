"""Scenario: which tissue, which seed, how fast, and which faults happen when. Read from a TOML file."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from firmware_sim.faults import PlannedFault
from firmware_sim.plant import SAMPLE_RATE_HZ
from firmware_sim.presets import DEFAULT, preset_names


class Scenario(BaseModel):
    """Everything that makes one simulated instrument; the same scenario always plays the same way."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    preset: str = DEFAULT
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    speed: Annotated[float, Field(gt=0, le=1000)] = 1.0
    """Device seconds per second; the watchdog's clock is never accelerated."""
    serial_number: Annotated[str, Field(pattern=r"^[\x20-\x7e]{1,16}$")] = "SIM-0001"
    sample_rate_hz: Annotated[float, Field(ge=500, le=10_000)] = SAMPLE_RATE_HZ
    protocol: tuple[Annotated[int, Field(ge=0, le=255)], Annotated[int, Field(ge=0, le=255)]] = (1, 1)
    faults: tuple[PlannedFault, ...] = ()


def load_scenario(path: Path | None, **overrides: object) -> Scenario:
    """A scenario from a file, with options from the command line laid over it.

    Raises:
        ValueError: one line that says what is wrong with the file or the options.
    """
    values: dict[str, object] = {}
    if path is not None:
        try:
            values = tomllib.loads(path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            reason = getattr(error, "strerror", None) or ("not text" if isinstance(error, UnicodeError) else error)
            raise ValueError(f"cannot read the scenario {path}: {reason}") from error
    values |= {name: value for name, value in overrides.items() if value is not None}
    try:
        scenario = Scenario.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ValueError(f"the scenario's {where} cannot be used: {first['msg']}") from error
    if scenario.preset not in preset_names():
        raise ValueError(f"no preset {scenario.preset!r}; there are: {', '.join(preset_names())}")
    return scenario
