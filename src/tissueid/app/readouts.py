"""Readouts next to STOP: force, coil temperature, contact, and the power of this window. The stop keys."""

from __future__ import annotations

from PySide6.QtCore import QCoreApplication, QEvent, QObject, Qt, Signal
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QFrame, QLabel, QWidget

from tissueid.app import build
from tissueid.app.live_signals import Safety
from tissueid.app.widgets import show_level
from tissueid.formatting import fixed
from tissueid.language import _
from tissueid.messages import MISSING, Message, translated

_KEYS = (Qt.Key.Key_Escape, Qt.Key.Key_Space)
_MEANT = (QEvent.Type.ShortcutOverride, QEvent.Type.KeyPress)
"""Events of a key: it is offered as a shortcut first. Accepting both keeps it from shortcuts and fields."""


class StopKeys(QObject):
    """An event filter of the application that sends ``pressed`` for each stop key while it listens.

    A shortcut would not do: a dialog hides it, and a text field takes the Space.
    """

    pressed = Signal()

    def listen(self, on: bool) -> None:
        """Start or stop listening."""
        application = QCoreApplication.instance()
        if application is not None:
            application.removeEventFilter(self)
            if on:
                application.installEventFilter(self)

    def eventFilter(self, _watched: QObject, event: QEvent) -> bool:  # noqa: N802
        """Intercept the stop keys of all widgets."""
        if event.type() in _MEANT and isinstance(event, QKeyEvent) and event.key() in _KEYS:
            event.accept()
            self.pressed.emit()
            return True
        return False


_EVERY = 8
"""Frames between two changes of a number: four a second can be read."""
_NEAR = 0.9
_WARM_SHARE = 0.8
NO_TEST = Message("stop.no_test", "No test is running")
KEYS_REACH = Message("stop.keys", "Esc or Space stops")
KEYS_LOST = Message("stop.keys_lost", "Keys do not reach this window: click it")


class SafetyReadouts(QFrame):
    """Readouts of a running test. A value near its limit changes its colour; nothing blinks."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setProperty("role", "card")
        self._frame, self._free, self._calibrating = 0, True, False
        self.force, self.coil, self.contact, self.keys = (QLabel() for _ in range(4))
        grid = build.grid(self, margins=(10, 6, 10, 6), horizontal_spacing=8, vertical_spacing=1)
        rows = ((_("Force"), self.force), (_("Coil"), self.coil), (_("Probe"), self.contact))
        for row, (name, value) in enumerate(rows):
            grid.addWidget(build.styled(QLabel(name), role="field"), row, 0)
            grid.addWidget(value, row, 1)
        grid.addWidget(self.keys, len(rows), 0, 1, 2)
        self.keys.setWordWrap(True)
        for value in (self.force, self.coil, self.contact, self.keys):
            build.styled(value, role="readout", text_format=Qt.TextFormat.PlainText, minimum_width=1)
        self.clear()

    def clear(self) -> None:
        """Show that no test is running."""
        self._frame, self._free = 0, True
        for label in (self.force, self.coil, self.contact):
            _say(label, MISSING)
        _say(self.keys, translated(NO_TEST))

    def show_link_lost(self, watchdog_s: float | None) -> None:
        """Show that the link was lost and that the instrument's watchdog releases the coil (within ``watchdog_s``)."""
        text = _("Line lost: the instrument's own watchdog releases the coil")
        if watchdog_s is not None:
            text = _("Line lost: the instrument's own watchdog releases the coil within {seconds:g} s")
        _say(self.keys, text.format(seconds=watchdog_s), "check")

    def show_watched(self, message: str, level: str) -> None:
        """Show the contact of the probe before a test, with the coil released."""
        _say(self.contact, message, "check" if level == "check" else "")
        _say(self.keys, _("Contact is watched; the coil is not driven"))

    def expect(self, *, calibrating: bool = False) -> None:
        """Show that a test starts, or a calibration, which shows the position of the probe in place of contact."""
        self.clear()
        self._free, self._calibrating = False, calibrating
        _say(self.keys, translated(KEYS_REACH))

    def show_key_reach(self, *, reach: bool) -> None:
        """Show whether the stop keys reach this window, unless the coil is already released."""
        if self._free:
            return
        _say(self.keys, translated(KEYS_REACH) if reach else translated(KEYS_LOST), "" if reach else "check")

    def show_safety(self, safety: Safety | None, *, free: bool = False) -> None:
        """Show the values; called with every frame. With ``free`` the coil is released: show nothing."""
        if free:
            self.clear()
        if safety is None or self._free:
            return
        if not self._calibrating:
            _say(self.contact, *_contact(safety))
        self._frame += 1
        if self._frame % _EVERY == 1:
            if self._calibrating:
                _say(self.contact, *_place(safety))
            _say(self.force, *_force(safety))
            _say(self.coil, *_coil(safety))


def _force(safety: Safety) -> tuple[str, str]:
    if safety.force_n is None:
        return MISSING, ""
    most = safety.limits.max_force_n
    return _("{force} N of {most:g} N").format(
        force=fixed(safety.force_n, 1), most=most
    ), "check" if safety.force_n > _NEAR * most else ""


def _coil(safety: Safety) -> tuple[str, str]:
    most = safety.limits.max_temperature_c
    temperatures_c = [value for value in (safety.temperature_c, safety.model_c) if value is not None]
    if not temperatures_c:
        return _("temperature not known"), "check"
    texts = [MISSING if safety.temperature_c is None else f"{fixed(safety.temperature_c, 0)} °C"]
    if safety.model_c is not None:
        texts.append(_("model {temperature} °C").format(temperature=fixed(safety.model_c, 0)))
    return _("{temperatures} of {most:g} °C").format(temperatures=", ".join(texts), most=most), "check" if max(
        temperatures_c
    ) > _WARM_SHARE * most else ""


def _contact(safety: Safety) -> tuple[str, str]:
    where = _(" · outside linear region") if safety.left_region else ""
    level = "check" if safety.left_region else ""
    if safety.contact is None:
        return _("finding the skin{where}").format(where=where), level
    return (
        (_("on the skin{where}").format(where=where), level)
        if safety.contact
        else (_("off the skin{where}").format(where=where), "check")
    )


def _place(safety: Safety) -> tuple[str, str]:
    if safety.position_m is None:
        return MISSING, ""
    return _("at {position} mm").format(position=fixed(1e3 * safety.position_m, 2)), ""


def _say(label: QLabel, text: str, level: str = "") -> None:
    if label.text() != text:
        label.setText(text)
        label.setAccessibleName(text)
    show_level(label, level)
