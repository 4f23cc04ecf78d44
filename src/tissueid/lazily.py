"""Packages that import their modules only when somebody uses what is in them, so that programs start fast."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping, Sequence


def on_first_use(package: str, homes: Mapping[str, Sequence[str]]) -> Callable[[str], object]:
    """A module's ``__getattr__`` (PEP 562) that imports a name from its home when it is first asked for.

    ``homes`` maps modules of the package, by their last name, to the names that the package offers of each.

    Raises:
        AttributeError: raised by what is returned, for a name that has no home.
    """
    home_of = {name: home for home, names in homes.items() for name in names}

    def get(name: str) -> object:
        if name not in home_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(f"{package}.{home_of[name]}"), name)
        setattr(sys.modules[package], name, value)
        return value

    return get
