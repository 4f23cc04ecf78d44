"""Registries of classes that a file adds by a declaration, and another package by an entry point.

Built-in modules are found by scanning their package. A plug-in that fails to load causes a warning and is left out.
"""

from __future__ import annotations

import importlib
import pkgutil
import warnings
from importlib.metadata import entry_points
from typing import Any, Generic, TypeVar

from tissueid.errors import UnusableInputError
from tissueid.messages import Listing, Message, Verbatim

T = TypeVar("T")


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
        self._members: dict[str, type[T]] = {}
        self._loaded = False

    def register(self, declared: type[T]) -> None:
        """Add a class under its ``name``.

        Raises:
            ValueError: another class already has that name.
        """
        name = str(getattr(declared, "name", ""))
        held = self._members.setdefault(name, declared)
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
        if name not in self._members:
            raise UnusableInputError(
                Message(
                    "registry.unknown_name",
                    "there is no {what} '{name}': choose one of {names}",
                    what=self._what,
                    name=Verbatim(name),
                    names=Listing(tuple(map(Verbatim, names))),
                )
            )
        return self._members[name]

    def names(self) -> tuple[str, ...]:
        """Return all names, in alphabetical order."""
        if not self._loaded:
            self._loaded = True
            self._load()
        return tuple(sorted(self._members))

    def _load(self) -> None:
        package = importlib.import_module(self._package)
        for module in pkgutil.iter_modules(package.__path__):
            importlib.import_module(f"{self._package}.{module.name}")
        for plugin in entry_points(group=self._group):
            try:
                loaded: Any = plugin.load()
                if isinstance(loaded, type) and issubclass(loaded, self._base):
                    self.register(loaded)
            except Exception as error:  # noqa: BLE001 - a plug-in may fail in any way, and must fail alone
                warnings.warn(
                    f"the {self._what} plug-in {plugin.name!r} ({plugin.value}) was left out: {error}", stacklevel=2
                )
