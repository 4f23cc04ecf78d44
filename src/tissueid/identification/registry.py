"""Registry of engines. An engine registers by one declaration in its own file.

Built-in engines are found by scanning ``tissueid.identification.engines``; other packages register theirs by an entry
point in the group ``tissueid.engines`` that names the engine class, or the module that declares it.
"""

from __future__ import annotations

from typing import TypeVar

from tissueid.identification.base import Engine
from tissueid.language import _, marked
from tissueid.plugins import Registry
from tissueid.records import Record

_EngineType = TypeVar("_EngineType", bound=type[Engine])
engines: Registry[Engine] = Registry(marked("engine"), Engine, "tissueid.identification.engines", "tissueid.engines")  # type: ignore[type-abstract]


def engine(declared: _EngineType) -> _EngineType:
    """Register an engine class under its ``name``; used as a decorator.

    Raises:
        ValueError: another class already has that name.
    """
    engines.register(declared)
    return declared


def get_engine(name: str) -> type[Engine]:
    """Return the engine class registered under a name.

    Raises:
        UnusableInputError: there is no engine of that name; the message lists the existing ones.
    """
    return engines.get(name)


def engine_names() -> tuple[str, ...]:
    """Return the names of all engines, in alphabetical order."""
    return engines.names()


def label_of(name: str) -> str:
    """Return the English label of an engine: its name with a capital if no such engine is installed."""
    return engines.get(name).label if name in engines.names() else name[:1].upper() + name[1:]


def engine_label(name: str) -> str:
    """Return the label of an engine in the active language."""
    return _(label_of(name))


def report_engines(record: Record | None = None) -> tuple[str, ...]:
    """Return the names of the engines of the standard report of a test, simplest family first.

    With the record of a test, those follow that are made for such a test.
    """
    kinds = sorted((engines.get(name) for name in engines.names()), key=lambda kind: kind.family.rank)
    standard = [kind.name for kind in kinds if kind.in_report]
    if record is None:
        return tuple(standard)
    return (*standard, *(kind.name for kind in kinds if not kind.in_report and kind.in_report_of(record)))
