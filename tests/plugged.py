"""Plug-ins of other packages that seem to be installed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from unittest.mock import patch

from tissueid import plugins
from tissueid.plugins import Registry


@dataclass
class Plugin:
    """An entry point. Loading it returns ``loaded``, or raises it if it is an exception."""

    name: str
    loaded: object
    value: str = "elsewhere:X"

    def load(self) -> object:
        if isinstance(self.loaded, BaseException):
            raise self.loaded
        return self.loaded


@contextmanager
def plugged_in(asked: str, installed: Iterable[object], registry: Registry | None = None) -> Iterator[None]:
    """Find these plug-ins in a group of entry points; the registry reads them again, and forgets them at the end."""
    forgotten = nullcontext()
    if registry is not None:
        registry.names()
        forgotten = patch.multiple(registry, members=dict(registry.members), loaded=False)
    with forgotten, patch.object(plugins, "entry_points", lambda group: installed if group == asked else []):
        yield
