"""Programs of other makers that the build of the reference firmware needs."""

from __future__ import annotations

import shutil


class MissingToolError(RuntimeError):
    """A program is not installed; the message names it."""


def tool(what: str, *names: str) -> str:
    """Return the path of the first program that is installed.

    Args:
        what: is not done without it, such as ``qemu: not built``.
        names: of the programs.

    Raises:
        MissingToolError: none is installed.
    """
    for name in names:
        if found := shutil.which(name):
            return found
    raise MissingToolError(f"{what}, install {'one of ' if len(names) > 1 else ''}{', '.join(names)}")
