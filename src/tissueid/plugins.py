"""Registries: kinds of thing that a file adds by a declaration, and another package by an entry point.

The modules of a package of ours are found by scanning it; a plug-in that fails to load is reported as a warning and
costs no other.
"""

from __future__ import annotations

import importlib
import pkgutil
import warnings
from importlib.metadata import entry_points
from typing import Any, Generic, TypeVar

from tissueid.errors import UnusableInputError

T = TypeVar("T")


class Registry(Generic[T]):
    """Classes under a base, by their ``name``.

    Args:
        what: one of them in a word, as messages say it.
        base: what each must derive from.
        package: dotted name of the package whose modules declare ours.
        group: entry-point group in which other packages name theirs.
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
        """The class of that name.

        Raises:
            UnusableInputError: there is none; the line lists those that there are.
        """
        names = self.names()
        if name not in self._members:
            raise UnusableInputError(f"there is no {self._what} {name!r}: choose one of {', '.join(names)}")
        return self._members[name]

    def names(self) -> tuple[str, ...]:
        """All names, in alphabetical order."""
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
