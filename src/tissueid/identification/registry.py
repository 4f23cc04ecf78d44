"""Which engines there are. An engine registers by one declaration in a file of its own.

Built-in engines are found by scanning ``tissueid.identification.engines``; other packages add theirs by an entry
point in the group ``tissueid.engines`` that names the engine class, or the module that declares it.
"""

from __future__ import annotations

from typing import TypeVar

from tissueid.identification.base import Engine
from tissueid.plugins import Registry

_EngineType = TypeVar("_EngineType", bound=type[Engine])
_engines: Registry[Engine] = Registry("engine", Engine, "tissueid.identification.engines", "tissueid.engines")  # type: ignore[type-abstract]


def engine(declared: _EngineType) -> _EngineType:
    """Register an engine class under its ``name``; used as a decorator.

    Raises:
        ValueError: another class already has that name.
    """
    _engines.register(declared)
    return declared


def get_engine(name: str) -> type[Engine]:
    """Return the engine class registered under a name.

    Raises:
        UnusableInputError: there is no engine of that name; the line lists those that there are.
    """
    return _engines.get(name)


def engine_names() -> tuple[str, ...]:
    """Return the names of all engines, in alphabetical order."""
    return _engines.names()
