"""Plans of a calibration: options with their bounds, for the procedures, the command line and the window."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from tissueid.errors import UnusableInputError
from tissueid.instrument import CLINICAL, Limits
from tissueid.messages import Listing
from tissueid.plan_options import Option, Plan

STEPS = ("electrical", "force", "position", "range", "temperature", "acceleration", "supply")
MIN_SWING_M = 0.3e-3
"""Minimum swing to either side at a position that is measured, m."""
_MAX_GAUGE_M = 0.2
"""Largest height of a gauge block, m."""
_MAX_POSITIONS = 200
"""Largest number of positions of a sweep."""


@dataclass(frozen=True)
class Spring:
    """Calibration spring: stiffness, N/m, and its relative standard deviation."""

    stiffness_n_per_m: float = 1000.0
    relative_std: float = 0.02

    def check(self) -> None:
        """Raise for a spring that is not usable for calibration.

        Raises:
            UnusableInputError: the stiffness or its uncertainty is out of range.
        """
        if not (10.0 <= self.stiffness_n_per_m <= 1e5 and 0.0 <= self.relative_std < 0.5):
            raise UnusableInputError("calibration.spring", "a spring has 10 to 100000 N/m, known to better than 50 %")


class RepeatedPlan(Plan):
    """Number of runs and validity of a calibration."""

    repeats: Annotated[int, Option("--repeats", metavar="N", help="number of runs"), Field(ge=1, le=100)] = 1
    valid_days: Annotated[
        int, Option("--valid-days", metavar="DAYS", help="validity in days"), Field(ge=1, le=3650)
    ] = 90


class StaticPlan(RepeatedPlan):
    """Steps and references of a static calibration. Without ``steps`` all steps are run.

    ``gauges_m`` are heights of gauge blocks, for instruments without a stage. With ``in_place`` the spring is already
    under the probe and no instructions are shown: steps that need an operator are skipped. With ``push_only`` the probe
    only pushes the spring and is not fixed to it. With two ``orientations`` the accelerometer is also read upside down.

    Raises:
        UnusableInputError: a step is unknown, or a value is out of range.
    """

    steps: Annotated[
        tuple[str, ...],
        Option("--steps", metavar="A,B", separator=",", help="only these steps; an unknown name lists all"),
    ] = Field((), validate_default=True)
    weights_kg: Annotated[
        tuple[float, ...],
        Option("--weight", metavar="GRAMS", scale=1e-3, help="a known weight; may be repeated"),
    ] = ()
    gauges_m: Annotated[
        tuple[float, ...],
        Option(
            "--gauge", metavar="MM", scale=1e-3, help="height of a gauge block, if there is no stage; three or more"
        ),
    ] = ()
    ambient_c: Annotated[float | None, Option("--ambient", metavar="DEGC", help="room temperature")] = None
    orientations: Annotated[
        int,
        Option("--orientations", metavar="N", help="2: also upside down, for the zero of the accelerometer"),
        Field(ge=1, le=2),
    ] = 1
    in_place: Annotated[
        bool, Option("--in-place", help="the spring is under the probe; skip steps that need a person")
    ] = False
    push_only: Annotated[bool, Option("--push-only", help="the probe pushes on the spring and is not fixed to it")] = (
        False
    )
    spring: Spring = Spring()
    limits: Limits = CLINICAL

    @field_validator("steps")
    @classmethod
    def _all_by_default(cls, steps: tuple[str, ...]) -> tuple[str, ...]:
        return steps or STEPS

    @model_validator(mode="after")
    def _usable(self) -> Self:
        for step in self.steps:
            if step not in STEPS:
                raise UnusableInputError(
                    "calibration.step",
                    "there is no step '{step}': choose from {steps}",
                    step=step,
                    steps=Listing(STEPS),
                )
        self.spring.check()
        if self.in_place and (self.weights_kg or self.gauges_m or self.turn_over):
            raise UnusableInputError(
                "calibration.in_place",
                "--in-place runs without a person: leave out --weight, --gauge and --orientations",
            )
        if any(not 0.001 <= mass <= 0.3 for mass in self.weights_kg) or len(self.weights_kg) > 20:
            raise UnusableInputError("calibration.weights", "give at most 20 weights of 1 to 300 g")
        if self.gauges_m and (len(set(self.gauges_m)) < 3 or len(self.gauges_m) > 50):
            raise UnusableInputError("calibration.gauges", "give gauge blocks of 3 to 50 different heights")
        if not all(0.0 <= height <= _MAX_GAUGE_M for height in self.gauges_m):
            raise UnusableInputError(
                "calibration.gauge_height",
                "the height of a gauge block must be 0 to {limit:g} mm",
                limit=1e3 * _MAX_GAUGE_M,
            )
        if self.ambient_c is not None and not -10.0 <= self.ambient_c <= 50.0:
            raise UnusableInputError("calibration.ambient", "the room temperature must be -10 to 50 °C")
        return self

    @property
    def turn_over(self) -> bool:
        """Whether the accelerometer is also read upside down."""
        return self.orientations > 1

    @property
    def shown_steps(self) -> int:
        """Number of steps of one repeat whose progress is shown, at most."""
        weighing = len(self.weights_kg) if "force" in self.steps else 0
        turning = int(self.turn_over and "acceleration" in self.steps)
        moving = sum(name in self.steps for name in ("position", "range"))
        return 2 + weighing + turning + moving + (2 if "supply" in self.steps else 0)


class SweepPlan(RepeatedPlan):
    """Positions, duration and amplitude of a sweep.

    ``swing_m`` is the largest amplitude to either side, m; it is reduced near the ends of the stroke.

    Raises:
        UnusableInputError: a value is out of range.
    """

    from_m: Annotated[float, Option("--from", metavar="MM", scale=1e-3, help="first position on the stroke")] = 0.002
    to_m: Annotated[float, Option("--to", metavar="MM", scale=1e-3, help="last position")] = 0.030
    step_m: Annotated[float, Option("--step", metavar="MM", scale=1e-3, help="distance between positions")] = 0.002
    seconds: Annotated[float, Option("--seconds", metavar="S", help="length of the test at each position")] = 4.0
    swing_m: Annotated[float, Option("--swing", metavar="MM", scale=1e-3, help="largest amplitude to either side")] = (
        2.5e-3
    )
    seed: Annotated[int, Option("--seed", help="seed of the noise"), Field(ge=0, le=2**31 - 1)] = 1
    limits: Limits = CLINICAL

    @model_validator(mode="after")
    def _usable(self) -> Self:
        if not 0.0 <= self.from_m < self.to_m <= 0.1:
            raise UnusableInputError(
                "sweep.range", "a sweep must end at a larger position than it starts, both on the stroke, in mm"
            )
        if not 0.5e-3 <= self.step_m <= 5.0e-3:
            raise UnusableInputError("sweep.step", "the step of a sweep must be 0.5 to 5 mm")
        if (self.to_m - self.from_m) / self.step_m > _MAX_POSITIONS:
            raise UnusableInputError(
                "sweep.positions", "a sweep may have at most {limit} positions: widen the step", limit=_MAX_POSITIONS
            )
        if not 1.0 <= self.seconds <= 20.0:
            raise UnusableInputError("sweep.seconds", "each test of a sweep must last 1 to 20 s")
        if not MIN_SWING_M <= self.swing_m <= 5.0e-3:
            raise UnusableInputError(
                "sweep.swing", "the swing of a sweep must be {least:g} to 5 mm", least=1e3 * MIN_SWING_M
            )
        return self

    @property
    def positions_m(self) -> tuple[float, ...]:
        """Positions of the probe, rising, m."""
        count = 1 + round((self.to_m - self.from_m) / self.step_m - 1e-6)
        places = self.from_m + self.step_m * np.arange(count)
        return tuple(float(position) for position in places[places <= self.to_m + 1e-9])
