"""Base class of effects: name, stage, level (zero means absent), bounded parameters, and random draws of them.

The compiled loop reads one row of parameters per effect and keeps one row of state for it. The rows are numbered here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from pydantic.fields import FieldInfo

Array = NDArray[np.float64]
Stage = Literal["drive", "coil", "mechanics", "tissue", "sensing", "environment"]

(
    LATENCY,
    AMPLIFIER_LAG,
    AMPLIFIER_CLIPPING,
    AMPLIFIER_DEADBAND,
    AMPLIFIER_DRIFT,
    EDDY_CURRENTS,
    COIL_HEATING,
    INDUCTANCE_POSITION,
    FORCE_CONSTANT_POSITION,
    FLUX_SATURATION,
    RELUCTANCE_FORCE,
    DRY_FRICTION,
    DIRECTIONAL_FRICTION,
    QUADRATIC_DRAG,
    END_STOP,
    MOUNT_RESONANCE,
    COGGING,
    TISSUE_STIFFENING,
    VISCOELASTICITY,
    TISSUE_HYSTERESIS,
    PRECONDITIONING,
    ADDED_MASS,
    CONTACT_LOSS,
    DIRECTIONAL_DAMPING,
    REFLEX,
    SENSOR_NONLINEARITY,
    SENSOR_LAG,
    SENSOR_BACKLASH,
    CLOCK_SKEW,
    QUANTIZATION,
    DROPPED_SAMPLES,
    MAINS_HUM,
    PHYSIOLOGICAL_MOTION,
    # Effects that are not in the diagnosis's library, which must report them as unexplained.
    SLEW_RATE,
    DEMAGNETISATION,
    MAGNETIC_SPRING,
    WARMING_BEARING,
    CURRENT_CROSSTALK,
) = range(38)
"""Row of each effect in the arrays of parameters and of state."""
ROWS = tuple(name.lower() for name, row in list(globals().items()) if name.isupper() and isinstance(row, int))
"""Names of the effects in the order of their rows."""

CLOCK = len(ROWS)
"""Additional row of state: sub-steps since the start, and values of the previous sub-step."""

WIDTH = 40
MEMORY = 24
RINGS, RING_LENGTH = 3, 16384


@dataclass(frozen=True)
class ParameterRange:
    """Distribution of a random parameter: uniform or log-uniform between two values, optionally with a random sign."""

    low: float
    high: float
    logarithmic: bool = False
    either_sign: bool = False

    def draw(self, random: np.random.Generator) -> float:
        """Return one random value."""
        if self.logarithmic:
            value = float(np.exp(random.uniform(np.log(self.low), np.log(self.high))))
        else:
            value = float(random.uniform(self.low, self.high))
        return -value if self.either_sign and random.random() < 0.5 else value


@dataclass(frozen=True)
class DrawConditions:
    """Conditions for which an effect's parameters are drawn: surface, depth of the tests, and stimulus, SI."""

    surface_m: float = 0.010
    depth_m: float = 0.004
    swing_m: float = 0.0005
    mean_v: float = 16.0
    spread_v: float = 10.3


class Effect(BaseModel):
    """Parameters of an effect. ``level`` is its strength, in ``unit``; zero is exactly no effect.

    Raises:
        pydantic.ValidationError: a parameter is out of its bounds.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: ClassVar[str]
    stage: ClassVar[Stage]
    unit: ClassVar[str]
    typical: ClassVar[float]
    """A level that is clearly visible in a standard test."""
    listed: ClassVar[bool] = True
    """Whether the contract lists this effect."""

    level: float

    @property
    def acts(self) -> bool:
        """Whether the level is not zero."""
        return self.level != 0.0

    def row(self) -> Array:
        """Return the parameters for the compiled loop, shape (n,), the level first, then the others as declared."""
        return np.array([self._number(name) for name in type(self).model_fields], dtype=np.float64)

    def _number(self, name: str) -> float:
        value = getattr(self, name)
        if isinstance(value, str):
            return float(get_args(type(self).model_fields[name].annotation).index(value))
        return float(value)

    @classmethod
    def draw(cls, random: np.random.Generator, around: DrawConditions) -> Self:
        """Return an effect with widely distributed random parameters, from barely visible to gross."""
        return cls(**cls._drawn(random))

    @classmethod
    def _drawn(cls, random: np.random.Generator) -> dict[str, object]:
        values: dict[str, object] = {}
        for name, item in cls.model_fields.items():
            rule = _rule(item)
            if rule is not None:
                values[name] = rule.draw(random)
            elif item.annotation is int:
                values[name] = int(random.integers(0, 10_000))
            elif choices := get_args(item.annotation):
                values[name] = str(choices[int(random.integers(len(choices)))])
        return values


def _rule(item: FieldInfo) -> ParameterRange | None:
    return next((extra for extra in item.metadata if isinstance(extra, ParameterRange)), None)


def bounds(low: float, high: float) -> FieldInfo:
    """Return the bounds of a parameter, inclusive."""
    found: FieldInfo = Field(ge=low, le=high, allow_inf_nan=False)
    return found


def log_uniform(low: float, high: float, *, either_sign: bool = False) -> ParameterRange:
    """Return a log-uniform distribution."""
    return ParameterRange(low, high, True, either_sign)
