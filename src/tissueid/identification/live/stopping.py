"""Stopping rule of a running test: the parameters reach their target precision repeatedly."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from tissueid.errors import UnusableInputError
from tissueid.identification.live.precision import PARAMETERS, Parameter, Precision
from tissueid.language import marked
from tissueid.messages import Listing, Message
from tissueid.option_errors import option_error

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
    def from_words(cls, words: Iterable[str]) -> Self:
        """Return the rule for targets as on a command line, such as ``stiffness=0.02``.

        Raises:
            UnusableInputError: not a name and a share, an unknown parameter, or a share out of bounds.
        """
        targets: dict[str, float] = {}
        for word in words:
            name, equals, share = word.partition("=")
            name = name.strip()
            if not equals or name not in PARAMETERS:
                raise UnusableInputError(
                    Message(
                        "stop_rule.target",
                        "a target is NAME=SHARE with one of {names}, such as stiffness=0.02, got '{text}'",
                        names=Listing(PARAMETERS),
                        text=word,
                    )
                )
            if name in targets:
                raise UnusableInputError(
                    Message("stop_rule.repeated", "the target of the {name} is given twice", name=name)
                )
            targets[name] = _share(name, share)
        try:
            return cls.model_validate({"targets": targets})
        except ValidationError as error:
            raise UnusableInputError(option_error(marked("stop rule"), cls.model_fields, error)) from error

    def met_by(self, look: Precision) -> bool:
        """Return whether one look meets every target."""
        return all(look.relative_std[name] <= target for name, target in self.targets.items())

    def enough(self, looks: Sequence[Precision]) -> bool:
        """Return whether the latest of the looks, in time order, end the test."""
        newest = looks[-self.looks :]
        if len(newest) < self.looks or newest[-1].seconds < self.min_seconds:
            return False
        return all(self.met_by(look) for look in newest)

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
            Message(
                "stop_rule.share",
                "the target of the {name} is a share of its value between 0 and 0.5, such as 0.02 for 2 %, got "
                "'{text}'",
                name=name,
                text=text,
            )
        )
    return share
