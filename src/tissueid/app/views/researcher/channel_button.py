"""Button that selects the drawn signals."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QMenu, QPushButton, QWidget

from tissueid.app.views.researcher.plot_stack import MOST_PLOTS
from tissueid.app.views.researcher.signal_loading import Channel
from tissueid.language import _

_FIRST = ("force", "position", "voltage", "input", "output", "current")
"""Signals drawn by default: the first three of these that exist."""
_AT_FIRST = 3


class ChannelButton(QPushButton):
    """Button with a checkable menu of all signals; ``changed`` is emitted on each change."""

    changed = Signal()

    def __init__(self, wanted: Sequence[str], parent: QWidget | None = None) -> None:
        super().__init__(_("Signals"), parent)
        self.wanted = list(wanted)
        """Names of the selected signals; none before a selection."""
        self._channels: list[Channel] = []
        self.setMenu(QMenu(self))
        self.setToolTip(_("Which signals are drawn"))
        self.offer([])

    def offer(self, channels: Sequence[Channel]) -> None:
        """Offer signals in this order."""
        self._channels = list(channels)
        menu = self.menu()
        menu.clear()
        drawn = self.drawn
        for channel in channels:
            action = menu.addAction(channel.title.replace("&", "&&"))
            action.setCheckable(True)
            action.setChecked(channel in drawn)
            action.setData(channel)
            action.setEnabled(channel in drawn or len(drawn) < MOST_PLOTS)
            action.toggled.connect(self._toggle)
        self.setEnabled(bool(channels))
        self.setText(
            _("Signals ({drawn} of {count})").format(drawn=len(drawn), count=len(channels))
            if channels
            else _("Signals")
        )

    @property
    def drawn(self) -> list[Channel]:
        """Signals to draw, from top to bottom."""
        names = {channel.name for channel in self._channels}
        wanted = [name for name in self.wanted if name in names]
        if not wanted:
            wanted = [name for name in _FIRST if name in names][:_AT_FIRST]
        if not wanted:
            wanted = [channel.name for channel in self._channels][:_AT_FIRST]
        return [channel for channel in self._channels if channel.name in wanted][:MOST_PLOTS]

    def _toggle(self) -> None:
        checked = [action.data().name for action in self.menu().actions() if action.isChecked()]
        self.wanted = checked
        self.offer(self._channels)
        self.changed.emit()


__all__ = ["ChannelButton"]
