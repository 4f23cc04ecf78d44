"""Registries of classes that a file adds by a declaration, and another package by an entry point.

Built-in modules are found by scanning their package. A plug-in that fails to load causes a warning and is left out.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import warnings
from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any, Generic, TypeVar

T = TypeVar("T")

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")
_LONGEST_REASON = 300


class Registry(Generic[T]):
    """Classes under a base, by their ``name``.

    Args:
        what: word for one of them in messages.
        base: base class of all of them.
        package: dotted name of the package of the built-in ones.
        group: entry-point group for those of other packages.
    """

    def __init__(self, what: str, base: type[T], package: str, group: str) -> None:
        self._what = what
        self._base = base
        self._package = package
        self._group = group
        self.members: dict[str, type[T]] = {}
        self.loaded = False

    def register(self, declared: type[T]) -> None:
        """Add a class under its ``name``.

        Raises:
            ValueError: another class already has that name.
            TypeError: its name is none, or it lacks methods.
        """
        name = getattr(declared, "name", None)
        if not isinstance(name, str) or _NAME.fullmatch(name) is None:
            raise TypeError(f"{declared.__qualname__} has the name {name!r}: it needs letters, digits and _ only")
        if missing := sorted(getattr(declared, "__abstractmethods__", ())):
            raise TypeError(f"{declared.__qualname__} lacks {', '.join(missing)}")
        held = self.members.setdefault(name, declared)
        if (held.__module__, held.__qualname__) != (declared.__module__, declared.__qualname__):
            raise ValueError(
                f"two things of the kind {self._what} are called {name!r}: {held.__module__} and {declared.__module__}"
            )

    def get(self, name: str) -> type[T]:
        """Return the class of that name.

        Raises:
            UnusableInputError: there is none; the message lists the existing names.
        """
        names = self.names()
        if name not in self.members:
            from tissueid.errors import UnusableInputError  # not at the start of a command, which they would delay
            from tissueid.messages import Listing, Verbatim

            raise UnusableInputError(
                "registry.unknown_name",
                "there is no {what} '{name}': choose one of {names}",
                what=self._what,
                name=Verbatim(name),
                names=Listing(tuple(map(Verbatim, names))),
            )
        return self.members[name]

    def names(self) -> tuple[str, ...]:
        """Return all names, in alphabetical order."""
        if not self.loaded:
            self.loaded = True
            self._load()
        return tuple(sorted(self.members))

    def _load(self) -> None:
        package = importlib.import_module(self._package)
        for module in pkgutil.iter_modules(package.__path__):
            importlib.import_module(f"{self._package}.{module.name}")
        load_plugins(self._group, self._what, self._add)

    def _add(self, loaded: Any) -> None:
        if isinstance(loaded, type) and issubclass(loaded, self._base):
            self.register(loaded)
        elif not inspect.ismodule(loaded):
            raise TypeError(f"it is neither a class of the kind {self._base.__name__} nor a module")


def load_plugins(group: str, what: str, add: Callable[[Any], object]) -> None:
    """Load the entry points of a group and pass each to ``add``.

    One that fails, even by leaving the program while it is imported, is left out with a warning.
    """
    for plugin in entry_points(group=group):
        try:
            add(plugin.load())
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a plug-in may fail in any way, and must fail alone
            reason = "" if isinstance(error, SystemExit) else str(error)
            why = " ".join((reason or type(error).__name__).split())[:_LONGEST_REASON]
            left_out = f"the {what} plug-in {plugin.name!r} ({plugin.value}) was left out: {why}"
            warnings.warn("".join(mark if mark.isprintable() else "?" for mark in left_out), stacklevel=3)
