"""The units of the window from one start to the next, and from one moment to the next."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from PySide6.QtCore import QSettings
from PySide6.QtWidgets import QWidget

from tissueid.units import use


@runtime_checkable
class FollowsUnits(Protocol):
    """A widget that shows figures."""

    def take_units(self) -> None:
        """Show the figures again in the active units."""


SETTING = "units"
"""Under which the choice is kept."""


def take_kept(settings: QSettings) -> None:
    """Put the units of last time in force; whatever else stands there means clinical ones."""
    use(settings.value(SETTING, ""))


def show_everywhere(window: QWidget) -> None:
    """Let everything in a window show its figures in the units in force."""
    for widget in window.findChildren(QWidget):
        if isinstance(widget, FollowsUnits):
            widget.take_units()
