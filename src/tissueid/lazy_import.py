"""Lazy attributes of packages: their modules are imported at first use, so that programs start fast."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping, Sequence


def lazy_attributes(package: str, homes: Mapping[str, Sequence[str]]) -> Callable[[str], object]:
    """Return a module's ``__getattr__`` (PEP 562) that imports a name at its first use.

    Args:
        package: dotted name of the package.
        homes: the names that the package exports, by the last part of the name of their module.

    The returned function raises AttributeError for other names.
    """
    home_of = {name: home for home, names in homes.items() for name in names}

    def get(name: str) -> object:
        if name not in home_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(f"{package}.{home_of[name]}"), name)
        setattr(sys.modules[package], name, value)
        return value

    return get
