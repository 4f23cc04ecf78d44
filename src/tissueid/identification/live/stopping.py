"""Stopping rule of a running test: the parameters reach their target precision repeatedly."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, Self, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from tissueid.errors import UnusableInputError
from tissueid.identification.preparation import prepare
from tissueid.identification.second_order import Hold
from tissueid.identification.second_order_fit import SecondOrderFit, fit_second_order
from tissueid.language import marked
from tissueid.messages import Action, Listing, Message
from tissueid.plan_options import option_error
from tissueid.records import Estimate, Record

Parameter = Literal["mass", "damping", "stiffness"]
PARAMETERS: tuple[Parameter, ...] = get_args(Parameter)

WIDENING = 1.05
"""Factor on the standard deviations of a fit during a test, because of repeated looks.

A test that ends at a target standard deviation tends to end at a low estimate of it. Without the factor, the 95 %
intervals contained 93 to 95 % of the damping and 97 to 99 % of mass and stiffness at the end of such tests.
"""


@dataclass(frozen=True)
class Precision:
    """The second-order fit to a record so far, with the relative standard deviations of its parameters.

    ``seconds`` is the length of the record. ``relative_std`` holds the standard deviation of mass, damping and
    stiffness divided by the value, widened by ``WIDENING``, and infinite if unknown.
    """

    seconds: float
    second_order: SecondOrderFit
    relative_std: dict[Parameter, float]

    @property
    def estimates(self) -> dict[Parameter, Estimate]:
        """Mass, damping and stiffness, kg, N s/m, N/m, with their standard deviations."""
        system, sign = self.second_order.system, self.second_order.sign
        values = (sign * system.mass, sign * system.damping, sign * system.stiffness)
        return {
            name: Estimate(value, abs(value) * spread if math.isfinite(spread := self.relative_std[name]) else None)
            for name, value in zip(PARAMETERS, values, strict=True)
        }


def precision(record: Record, memory: float = 0.125, hold: Hold = "band-limited") -> Precision:
    """Fit the second-order system to all of a record, as ``lms`` does, and return it with the precision of its
    parameters.

    The standard deviations account for autocorrelated residuals, also those due to nonlinearity
    (:func:`fit_second_order`). Every call searches again from the start: a search that continues from the previous
    result can stay in a local minimum with a small standard deviation.

    Args:
        record: force and position so far, without the preload.
        memory: seconds that are not fitted at the start and after each gap.
        hold: course of the input between samples.

    Raises:
        UnusableInputError: nothing varies, or the record is shorter than its memory.
    """
    prepared = prepare(record, None, memory, len(PARAMETERS))
    fitted = fit_second_order(record, prepared.used, hold)
    return Precision(len(record) / record.sample_rate_hz, fitted, _relative(fitted))


def _relative(fitted: SecondOrderFit) -> dict[Parameter, float]:
    spread = np.full(len(PARAMETERS), np.inf)
    if fitted.log_covariance is not None:
        variance = np.diag(fitted.log_covariance)
        spread = np.where(np.isfinite(variance), WIDENING * np.sqrt(np.maximum(variance, 0.0)), np.inf)
    return dict(zip(PARAMETERS, spread.tolist(), strict=True))


Target = Annotated[float, Field(gt=0.0, le=0.5)]


class StopRule(BaseModel):
    """Stop when each named parameter meets its target at several consecutive looks.

    A test that ends at the first look that meets the targets ends at a low estimate of the standard deviation.
    ``looks`` and ``min_seconds`` keep the coverage of the confidence intervals (measured in docs/stimuli.md). The rule
    never prolongs a test.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    targets: dict[Parameter, Target] = Field(
        min_length=1, description="Standard deviation that is enough, as a share of the value, by parameter"
    )
    min_seconds: float = Field(1.0, ge=0.5, le=60.0, description="Least record, s; the preload comes before it")
    looks: int = Field(3, ge=1, le=20, description="Looks in a row that must meet the targets")
    look_every_s: float = Field(0.25, ge=0.05, le=5.0, description="Record from one look to the next, s")

    @classmethod
    def from_words(cls, texts: Iterable[str]) -> Self:
        """Return the rule for targets as on a command line, such as ``stiffness=0.02``.

        Raises:
            UnusableInputError: not a name and a share, an unknown parameter, or a share out of bounds.
        """
        targets: dict[str, float] = {}
        for word in texts:
            name, equals, share = word.partition("=")
            name = name.strip()
            if not equals or name not in PARAMETERS:
                raise UnusableInputError(
                    "stop_rule.target",
                    "a target is one of {names} with its relative uncertainty, such as {example}, got '{text}'",
                    names=Listing(PARAMETERS),
                    example=Action("stop_rule.example", "stiffness=0.02", marked("stiffness 2 %")),
                    text=word,
                )
            if name in targets:
                raise UnusableInputError("stop_rule.repeated", "the target of the {name} is given twice", name=name)
            targets[name] = _share(name, share)
        try:
            return cls.model_validate({"targets": targets})
        except ValidationError as error:
            raise UnusableInputError(option_error(marked("stop rule"), cls.model_fields, error)) from error

    def enough(self, looks: Sequence[Precision]) -> bool:
        """Return whether the latest of the looks, in time order, end the test."""
        newest = looks[-self.looks :]
        if len(newest) < self.looks or newest[-1].seconds < self.min_seconds:
            return False
        return all(look.relative_std[name] <= target for look in newest for name, target in self.targets.items())

    def in_words(self, look: Precision) -> str:
        """Return the precision of each parameter, such as ``stiffness known to 1.9 % (target 2 %)``."""
        items = tuple(
            Message(
                "stop_rule.known",
                "{name} known to {percent:.2g} % (target {target:.3g} %)",
                name=name,
                percent=100.0 * look.relative_std[name],
                target=100.0 * target,
            )
            for name, target in self.targets.items()
        )
        return Message("stop_rule.met", "{found}", found=Listing(items, marked(" and ")))

    def __str__(self) -> str:
        return " and ".join(f"{name} to {100.0 * target:.3g} %" for name, target in self.targets.items())


def _share(name: str, text: str) -> float:
    try:
        share = float(text)
    except ValueError:
        share = math.nan
    if not 0.0 < share <= 0.5:
        raise UnusableInputError(
            "stop_rule.share",
            "the target of the {name} is a share of its value between 0 and 0.5, such as 0.02 for 2 %, got '{text}'",
            name=name,
            text=text,
        )
    return share
