"""Choice of a test by its name, above the settings of the stimulus."""

from __future__ import annotations

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QStandardItemModel
from PySide6.QtWidgets import QComboBox, QLabel, QWidget

from tissueid.app import build
from tissueid.language import _
from tissueid.messages import Message, translated
from tissueid.procedures.test_presets import PRESETS, Preset

OWN = ""
"""Choice of settings that are those of no preset."""


class PresetChooser(QWidget):
    """``chosen`` carries a preset that the user chose."""

    chosen = Signal(object)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.choice = build.styled(QComboBox(), name=_("Test"))
        for preset in PRESETS:
            self.choice.addItem(_(preset.title), preset.name)
        self.choice.addItem(_("Own settings"), OWN)
        self.reason = build.styled(
            QLabel(), role="muted", word_wrap=True, minimum_width=1, text_format=Qt.TextFormat.PlainText, hidden=True
        )
        build.column(self.choice, self.reason, spacing=3, parent=self)
        self.choice.activated.connect(self._choose)

    def show_preset(self, preset: Preset | None) -> None:
        """Show which preset the settings are; None for settings of one's own."""
        self.choice.setCurrentIndex(self.choice.findData(OWN if preset is None else preset.name))

    def allow(self, most_n: float) -> None:
        """Offer the presets whose force is within ``most_n``, N, and say why the others are not."""
        reasons = []
        model = self.choice.model()
        assert isinstance(model, QStandardItemModel)
        for place, preset in enumerate(PRESETS):
            words = why_not_offered(preset, most_n)
            model.item(place).setEnabled(not words)
            self.choice.setItemData(place, words, Qt.ItemDataRole.ToolTipRole)
            if words:
                reasons.append(words)
        self.reason.setText("\n".join(reasons))
        self.reason.setVisible(bool(reasons))

    def _choose(self) -> None:
        name = self.choice.currentData()
        self.chosen.emit(next((preset for preset in PRESETS if preset.name == name), None))


def why_not_offered(preset: Preset, most_n: float) -> str:
    """Return why a test is not offered where limits and instrument allow ``most_n``, N; "" where it is."""
    if preset.needed_n <= most_n:
        return ""
    words = Message(
        "form.preset_force",
        "{title} is not offered: it needs {needed:g} N, and limits and instrument allow {most:g} N.",
        title=_(preset.title),
        needed=preset.needed_n,
        most=most_n,
    )
    return translated(words)
