"""Chooser of an instrument: an editable list of addresses, and the state of the chosen one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from PySide6.QtCore import QModelIndex, QPersistentModelIndex, Qt, Signal
from PySide6.QtWidgets import (
    QComboBox,
    QLabel,
    QStyledItemDelegate,
    QStyleOptionViewItem,
    QWidget,
)

from tissueid.app import build
from tissueid.app.words import CalibrationState
from tissueid.formatting import clean
from tissueid.instrument import FoundInstrument
from tissueid.instrument.discovery import IN_PROCESS
from tissueid.instrument.twin_list import is_twin_url
from tissueid.language import _, marked
from tissueid.messages import Message, Verbatim, translated

DEFAULT_URL = "simulated://forearm"
TYPED = Message("instruments.typed", "Typed address: tried when the test starts.")
_SHOWN = Qt.ItemDataRole.UserRole
"""What the open list shows of an instrument: its name and address. The line that is typed into has the address."""
_WIDEST, _MARGIN = 640, 40
_TWIN = marked("twin of a diagnosis, in this program")


def _name(item: FoundInstrument) -> str:
    """Return the name of an instrument in the list."""
    return translated(item.name or item.what)


class _Names(QStyledItemDelegate):
    """Draws the names of instruments in the open list."""

    def initStyleOption(self, option: QStyleOptionViewItem, index: QModelIndex | QPersistentModelIndex) -> None:  # noqa: N802
        """Take the name and the address as the text."""
        super().initStyleOption(option, index)
        option.text = str(index.data(_SHOWN) or "")  # type: ignore[attr-defined]


class InstrumentChooser(QWidget):
    """URL of an instrument, a button that looks for more, and a line about the chosen one."""

    described = Signal()
    """Sent when the list, the choice or what is known of an instrument has changed."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._found: dict[str, FoundInstrument] = {}
        self._doubted: set[str] = set()
        self._calibrations: dict[str, CalibrationState] = {}
        self.choice = build.styled(QComboBox(), editable=True, insert_policy=QComboBox.InsertPolicy.NoInsert)
        # A completer would turn a typed /dev/ttyACM1 into a listed /dev/ttyACM10.
        self.choice.setCompleter(None)  # type: ignore[arg-type]
        build.styled(
            self.choice,
            name=_("Instrument"),
            accessible_description=_("A port, socket://HOST:PORT or simulated://TISSUE"),
            tip=_("A port, socket://HOST:PORT or simulated://TISSUE"),
            size_adjust_policy=QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon,
        )
        self.refresh = build.button(
            _("&Find"), name=_("Find instruments"), tip=_("Look for an instrument at every port")
        )
        self.about = build.styled(
            QLabel(), role="field", word_wrap=True, minimum_width=1, text_format=Qt.TextFormat.PlainText
        )
        self.calibration = build.styled(
            QLabel(), role="readout", word_wrap=True, minimum_width=1, text_format=Qt.TextFormat.PlainText
        )
        build.column(build.row((self.choice, 1), self.refresh), self.about, self.calibration, spacing=3, parent=self)
        self._names = _Names(self)
        self.choice.setItemDelegate(self._names)
        self.choice.view().setTextElideMode(Qt.TextElideMode.ElideMiddle)
        self.choice.currentTextChanged.connect(self._describe)

    @property
    def url(self) -> str:
        """The chosen or typed address."""
        return self.choice.currentText().strip()

    def choose(self, url: str) -> None:
        """Choose an address."""
        if self.choice.findText(url) >= 0:
            self.choice.setCurrentText(url)
        else:
            self.choice.setEditText(url)

    def offer(self, instruments: Sequence[FoundInstrument]) -> None:
        """Replace the list; the chosen or typed address stays."""
        kept = self.url or DEFAULT_URL
        self._found = {item.url: item for item in instruments}
        self._doubted &= {item.url for item in instruments if item.answers is None}
        self.choice.blockSignals(True)
        self.choice.clear()
        for index, (url, item) in enumerate(self._found.items()):
            self.choice.addItem(url)
            shown = clean(f"{_name(item)}: {url}")
            self.choice.setItemData(index, shown, _SHOWN)
            self.choice.setItemData(index, shown, Qt.ItemDataRole.AccessibleTextRole)
            self.choice.setItemData(index, shown, Qt.ItemDataRole.ToolTipRole)
        letters = self.choice.fontMetrics()
        texts = [str(self.choice.itemData(index, _SHOWN)) for index in range(self.choice.count())]
        widths = [letters.horizontalAdvance(text) for text in texts]
        self.choice.view().setMinimumWidth(min(max(widths, default=0) + _MARGIN, _WIDEST))
        self.choice.blockSignals(False)
        self.choose(kept)
        self._describe()

    def offer_twins(self, models: Mapping[str, str]) -> None:
        """List the twins of a folder, their models by address, in place of those listed before."""
        own = [item for url, item in self._found.items() if not is_twin_url(url)]
        twins = [FoundInstrument(url, _TWIN, True, model, model) for url, model in models.items()]
        if list(self._found.values()) != [*own, *twins]:
            self.offer([*own, *twins])

    def tell_calibration(self, url: str, state: CalibrationState) -> None:
        """Store and show the state of calibration of the instrument at ``url``."""
        if self._calibrations.get(url) != state:
            self._calibrations[url] = state
            self._describe_calibration()

    def forget_calibrations(self) -> None:
        """Forget all states of calibration, after a new calibration."""
        self._calibrations.clear()
        self._describe_calibration()

    def doubt(self, url: str) -> None:
        """Mark an instrument that failed as not known to be ready."""
        item = self._found.get(url)
        if item is not None and not url.startswith(IN_PROCESS):
            self._found[url] = replace(item, answers=None)
            self._doubted.add(url)
            self._describe()

    @property
    def states(self) -> dict[str, tuple[str, CalibrationState]]:
        """State, a message, and calibration of the chosen and each listed instrument, by address."""
        urls = dict.fromkeys([*([] if self.url in self._found else [self.url]), *self._found])
        return {url: (self._health(url), self.calibration_of(url)) for url in urls if url}

    def calibration_of(self, url: str) -> CalibrationState:
        """Return the state of calibration of the instrument at ``url``."""
        return self._calibrations.get(url, CalibrationState())

    def _health(self, url: str) -> str:
        item = self._found.get(url)
        if item is None:
            return TYPED if url else ""
        if item.answers:
            return Message("instruments.ready", "Ready: {what}.", what=item.detail or item.what)
        if url in self._doubted:
            return Message(
                "instruments.failed",
                "{what}: it failed the last time; “Find” checks it again.",
                what=Verbatim(_name(item)),
            )
        if item.answers is None:
            return Message(
                "instruments.not_asked",
                "{what}: not checked yet; “Find” checks whether it is ready.",
                what=Verbatim(_name(item)),
            )
        return Message("instruments.no_answer", "Does not answer: {what}.", what=item.detail or item.what)

    def _describe(self) -> None:
        self.about.setText(translated(self._health(self.url)))
        self._describe_calibration()

    def _describe_calibration(self) -> None:
        state = self.calibration_of(self.url)
        self.calibration.setText(_(state.summary))
        build.restyle(
            self.calibration,
            tip="\n".join(state.warnings),
            name=" ".join([_(state.summary), *state.warnings]),
            level=state.level,
        )
        self.described.emit()
