"""The library of effects: the modules of ``tissueid.twin.effects`` and plug-ins by entry points."""

from __future__ import annotations

import importlib
import pkgutil
from functools import lru_cache

from tissueid.errors import UnusableInputError
from tissueid.messages import Verbatim
from tissueid.plugins import load_plugins
from tissueid.twin import effects
from tissueid.twin.effect import STAGES, Effect

GROUP = "tissueid.effects"


@lru_cache(maxsize=1)
def all_effects() -> dict[str, Effect]:
    """Return all effects by name, ordered by stage and name.

    A plug-in that fails to load, or has the name of another effect, is left out with a warning.
    """
    collected: list[Effect] = []
    for module in pkgutil.iter_modules(effects.__path__):
        declared = getattr(importlib.import_module(f"{effects.__name__}.{module.name}"), "EFFECT", None)
        if isinstance(declared, Effect):
            collected.append(declared)

    def add(loaded: object) -> None:
        if not isinstance(loaded, Effect) or loaded.name in {effect.name for effect in collected}:
            raise TypeError("it is no Effect with a name of its own")
        collected.append(loaded)

    load_plugins(GROUP, "effect", add)
    collected.sort(key=lambda effect: (STAGES.index(effect.stage), effect.name))
    return {effect.name: effect for effect in collected}


def effect(name: str) -> Effect:
    """Return the effect of a name.

    Raises:
        UnusableInputError: the library has no such effect.
    """
    by_name = all_effects()
    if name not in by_name:
        raise UnusableInputError(
            "effect.unknown",
            "there is no effect {name}: choose one of {known}",
            name=Verbatim(name),
            known=", ".join(by_name),
        )
    return by_name[name]
