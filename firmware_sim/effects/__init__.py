"""Effects that can be added to the plant: one class of bounded parameters each, compiled with the plant.

In a scenario file::

    [effects.dry_friction]
    level = 0.3

Their equations are independent of those of the twin. ``LISTED`` are effects in the diagnosis's library, ``UNLISTED``
are not.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise

from pydantic import ValidationError

from firmware_sim.effects import coil, drive, environment, mechanics, sensing, tissue
from firmware_sim.effects.base import ROWS, Effect
from firmware_sim.validation_reason import validation_reason

EFFECTS: Mapping[str, type[Effect]] = {
    kind.name: kind
    for module in (drive, coil, mechanics, tissue, sensing, environment)
    for kind in vars(module).values()
    if isinstance(kind, type) and issubclass(kind, Effect) and kind is not Effect
}
LISTED = tuple(name for name in ROWS if EFFECTS[name].listed)
UNLISTED = tuple(name for name in ROWS if not EFFECTS[name].listed)


def read_effects(given: Mapping[str, object]) -> tuple[Effect, ...]:
    """Return effects from a table of names and parameters, as in a scenario file, in the order of the plant.

    Raises:
        ValueError: an effect that does not exist, or an invalid parameter; one line.
    """
    found: list[Effect] = []
    for name, figures in given.items():
        if name not in EFFECTS:
            raise ValueError(f"effects has no {name!r}; there are: {', '.join(ROWS)}")
        try:
            found.append(EFFECTS[name].model_validate(figures))
        except ValidationError as error:
            # A misspelt parameter is also reported as missing; the misspelling is the helpful error.
            first = min(error.errors(), key=lambda item: item["type"] != "extra_forbidden")
            where = ".".join(["effects", name, *(str(part) for part in first["loc"])])
            raise ValueError(
                f"{where} cannot be used: {validation_reason(first, EFFECTS[name].model_fields)}"
            ) from error
    return in_order(found)


def in_order(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Return the effects in the order of the plant.

    Raises:
        ValueError: an effect is given twice.
    """
    found = sorted(effects, key=lambda effect: ROWS.index(effect.name))
    for one, other in pairwise(found):
        if one.name == other.name:
            raise ValueError(f"the effect {one.name} is given twice")
    return tuple(found)
