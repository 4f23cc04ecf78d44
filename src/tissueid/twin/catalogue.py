"""The library of effects: the modules of ``tissueid.twin.effects`` and plug-ins by entry points."""

from __future__ import annotations

import importlib
import pkgutil
import warnings
from functools import lru_cache
from importlib.metadata import entry_points

from tissueid.errors import UnusableInputError
from tissueid.messages import Message, Verbatim
from tissueid.twin import effects
from tissueid.twin.effect import STAGES, Effect

GROUP = "tissueid.effects"


@lru_cache(maxsize=1)
def all_effects() -> dict[str, Effect]:
    """Return all effects by name, ordered by stage and name.

    A plug-in that fails to load, or has the name of another effect, is left out with a warning.
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
    """Return the effect of a name.

    Raises:
        UnusableInputError: the library has no such effect.
    """
    known = all_effects()
    if name not in known:
        raise UnusableInputError(
            Message(
                "effect.unknown",
                "there is no effect {name}: choose one of {known}",
                name=Verbatim(name),
                known=", ".join(known),
            )
        )
    return known[name]
