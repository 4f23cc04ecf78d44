"""Tooltips that say why a control is disabled while a job runs."""

from __future__ import annotations

from collections.abc import Iterable

from PySide6.QtWidgets import QWidget

_OWN = "own_tip"


def show_disabled_reason(controls: Iterable[QWidget], why: str) -> None:
    """Set the tooltip of disabled controls to ``why``, and restore the tooltip of the others.

    ``why`` is empty if no job runs. A tooltip that was changed meanwhile is kept as the control's own.
    """
    for control in controls:
        shown = control.accessibleDescription()
        if not shown or control.toolTip() != shown:
            control.setProperty(_OWN, control.toolTip())
        waits = bool(why) and not control.isEnabled()
        control.setToolTip(why if waits else str(control.property(_OWN)))
        control.setAccessibleDescription(why if waits else "")
