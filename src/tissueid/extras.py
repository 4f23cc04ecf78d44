"""Optional packages and the extras of this package that install them."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Mapping

from tissueid.errors import UnusableInputError
from tissueid.messages import Verbatim

EXTRAS: Mapping[str, str] = {
    "PySide6": "app",
    "shiboken6": "app",
    "pyqtgraph": "app",
    "pandas": "study",
    "pyarrow": "study",
    "sklearn": "study",
    "statsmodels": "study",
    "distributed": "cluster",
    "fsspec": "cluster",
}
"""Extra that installs each optional package, by the name under which the package is imported."""


def check_packages(*names: str) -> None:
    """Check that optional packages are installed.

    Raises:
        UnusableInputError: one is missing; the message names the command that installs it.
    """
    for name in names:
        if importlib.util.find_spec(name) is None:
            raise missing_package(name)


def missing_package(name: str) -> UnusableInputError:
    """Return the error about an optional package that is not installed.

    Args:
        name: one of ``EXTRAS``.
    """
    return UnusableInputError(
        "extra.missing",
        "this needs {package}, which is not installed: {python} -m pip install 'tissueid[{extra}]'",
        package=Verbatim(name),
        python=Verbatim(sys.executable),
        extra=Verbatim(EXTRAS[name]),
    )
