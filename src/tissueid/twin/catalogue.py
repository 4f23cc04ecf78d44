"""The library of effects: found by scanning ``tissueid.twin.effects`` and by entry points."""

from __future__ import annotations

import importlib
import pkgutil
import warnings
from functools import lru_cache
from importlib.metadata import entry_points

from tissueid.errors import UnusableInputError
from tissueid.twin import effects
from tissueid.twin.effect import STAGES, Effect

GROUP = "tissueid.effects"


@lru_cache(maxsize=1)
def all_effects() -> dict[str, Effect]:
    """Every effect by its name, in the order of the chain and then of the alphabet.

    A plug-in that fails to load, or takes a name that exists, is left out with a warning.
    """
    found: list[Effect] = []
    for module in pkgutil.iter_modules(effects.__path__):
        declared = getattr(importlib.import_module(f"{effects.__name__}.{module.name}"), "EFFECT", None)
        if isinstance(declared, Effect):
            found.append(declared)
    ours = {effect.name for effect in found}
    for plugin in entry_points(group=GROUP):
        try:
            declared = plugin.load()
            if not isinstance(declared, Effect) or declared.name in ours:
                raise TypeError("it is no Effect with a name of its own")
            found.append(declared)
        except Exception as error:  # noqa: BLE001 - a plug-in may fail in any way, and must fail alone
            warnings.warn(f"the effect plug-in {plugin.name!r} was left out: {error}", stacklevel=2)
    found.sort(key=lambda effect: (STAGES.index(effect.stage), effect.name))
    return {effect.name: effect for effect in found}


def effect(name: str) -> Effect:
    """The effect of that name.

    Raises:
        UnusableInputError: there is none; the line lists those that there are.
    """
    known = all_effects()
    if name not in known:
        raise UnusableInputError(f"there is no effect {name!r}: choose one of {', '.join(known)}")
    return known[name]
