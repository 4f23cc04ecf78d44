"""Why a control is grey while something goes on: one place that says so, for every page."""

from __future__ import annotations

from collections.abc import Iterable

from PySide6.QtWidgets import QWidget

_OWN = "own_tip"


def tell_why(controls: Iterable[QWidget], why: str) -> None:
    """Say on those that are disabled what is being waited for, ``why``; the others say again what they do.

    Where nothing goes on, ``why`` is empty. A tip that somebody else has set meanwhile is kept as the control's own.
    """
    for control in controls:
        told = control.accessibleDescription()
        if not told or control.toolTip() != told:
            control.setProperty(_OWN, control.toolTip())
        waits = bool(why) and not control.isEnabled()
        control.setToolTip(why if waits else str(control.property(_OWN)))
        control.setAccessibleDescription(why if waits else "")
