"""Which engines there are. An engine registers by one declaration in a file of its own.

Built-in engines are found by scanning ``tissueid.identification.engines``; other packages add theirs by an entry
point in the group ``tissueid.engines`` that names the engine class, or the module that declares it. A plug-in
that fails to load is reported as a warning and costs no other engine.
"""

from __future__ import annotations

import importlib
import pkgutil
import warnings
from functools import cache
from importlib.metadata import entry_points
from typing import TypeVar

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Engine

ENTRY_POINT_GROUP = "tissueid.engines"

_EngineType = TypeVar("_EngineType", bound=type[Engine])
_engines: dict[str, type[Engine]] = {}


def engine(declared: _EngineType) -> _EngineType:
    """Register an engine class under its ``name``; used as a decorator.

    Raises:
        ValueError: another class already has that name.
    """
    held = _engines.setdefault(declared.name, declared)
    if (held.__module__, held.__qualname__) != (declared.__module__, declared.__qualname__):
        raise ValueError(f"two engines are called {declared.name!r}: {held.__module__} and {declared.__module__}")
    return declared


def get_engine(name: str) -> type[Engine]:
    """Return the engine class registered under a name.

    Raises:
        UnusableInputError: there is no engine of that name; the line lists those that there are.
    """
    _load()
    if name not in _engines:
        raise UnusableInputError(f"there is no engine {name!r}: choose one of {', '.join(engine_names())}")
    return _engines[name]


def engine_names() -> tuple[str, ...]:
    """Return the names of all engines, in alphabetical order."""
    _load()
    return tuple(sorted(_engines))


@cache
def _load() -> None:
    from tissueid.identification import engines

    for module in pkgutil.iter_modules(engines.__path__):
        importlib.import_module(f"{engines.__name__}.{module.name}")
    for plugin in entry_points(group=ENTRY_POINT_GROUP):
        try:
            loaded = plugin.load()
            if isinstance(loaded, type) and issubclass(loaded, Engine):
                engine(loaded)
        except Exception as error:  # noqa: BLE001 - a plug-in may fail in any way, and must fail alone
            warnings.warn(f"the engine plug-in {plugin.name!r} ({plugin.value}) was left out: {error}", stacklevel=2)
