"""What is to be diagnosed: a session, a twin to begin with, and, folded away, which tests serve what."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from PySide6.QtCore import QObject, QSettings, Qt, Signal
from PySide6.QtWidgets import (
    QComboBox,
    QFileDialog,
    QFrame,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QProgressBar,
    QPushButton,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from tissueid.app.buttons import BigButton
from tissueid.app.small_window import FoldingBox
from tissueid.app.views.gap.diagnosing import Asked, numbers_of_tests
from tissueid.language import _, marked, spoken
from tissueid.wording import clean

NOMINAL = marked("Nominal twin")
_RECENT = 20
_LONGEST = 60
_SETTING = "gap"
_ONE_ROW = 640
_FIELDS_IN_A_ROW = 480


class Asking(QFrame):
    """``wanted`` and ``unwanted`` say that Run and Cancel were pressed, ``changed`` that something else was chosen."""

    wanted = Signal()
    unwanted = Signal()
    changed = Signal()

    def __init__(self, folder: Path, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setProperty("role", "card")
        self._folder = folder
        self.session = _FileChoice(_("Session"), _("Open a session"), _("Sessions (*.h5);;All files (*)"), folder)
        self.twin = _FileChoice(
            _("Baseline twin"), _("Open a twin"), _("Twins (*.toml);;All files (*)"), folder, first=_(NOMINAL)
        )
        self.run = BigButton(_("Run"))
        self.run.setAccessibleName(_("Run the diagnosis"))
        self.run.setToolTip(_("Find out where simulated and recorded differ, and why (half a minute to some minutes)"))
        self.stop = QPushButton(_("Cancel"))
        self.stop.setAccessibleName(_("Cancel the diagnosis"))
        self.fold = QToolButton()
        self.fold.setText(_("Advanced"))
        self.fold.setProperty("role", "fold")
        self.fold.setCheckable(True)
        self.fold.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        self.fold.setAccessibleName(_("Advanced: which tests to fit and to check"))
        self.fit, self.check = QLineEdit(), QLineEdit()
        self.more = QWidget()
        self.doing = QLabel()
        self.doing.setProperty("role", "muted")
        self.bar = QProgressBar()
        self.bar.setTextVisible(False)
        self.bar.setAccessibleName(_("Progress of the diagnosis"))
        self._arrange()
        self.run.clicked.connect(self.wanted)
        self.stop.clicked.connect(self.unwanted)
        self.fold.toggled.connect(self._unfold)
        self.session.changed.connect(self.changed)
        self._unfold(False)
        self.rest()
        self.look()

    @property
    def fields(self) -> list[QWidget]:
        """What the tab key visits, in order."""
        first = [self.session.choice, self.session.open, self.twin.choice, self.twin.open]
        return [*first, self.run, self.stop, self.fold, self.fit, self.check]

    def asked(self) -> Asked:
        """What is chosen.

        Raises:
            UnusableInputError: what is typed are no numbers of tests.
        """
        fit, check = (
            numbers_of_tests(self.fit.text(), _("tests to fit")),
            numbers_of_tests(self.check.text(), _("to check")),
        )
        return Asked(self.session.path or Path(), self.twin.path, fit, check, spoken())

    def look(self) -> None:
        """Offer the newest files of the folder; what is chosen stays."""
        self.session.offer(_newest(self._folder, ".h5"))
        self.twin.offer(_newest(self._folder, ".toml"))

    def take(self, path: Path) -> None:
        """Take a file that was dropped: a twin by its suffix, anything else as a session."""
        (self.twin if path.suffix == ".toml" else self.session).choose(path)

    def tell(self, what: str, done: int, total: int) -> None:
        """What goes on, and how much of it is done; a total of 0 is not known."""
        known = total > 1
        self.doing.setText(
            _("{what}: {done} of {total}").format(what=_(what), done=done, total=total) if known else f"{_(what)}…"
        )
        self.bar.setRange(0, total if known else 0)
        self.bar.setValue(done if known else 0)

    def rest(self) -> None:
        """Nothing goes on."""
        self.doing.hide()
        self.bar.hide()
        self.stop.hide()

    def begin(self) -> None:
        """A diagnosis begins."""
        for widget in (self.doing, self.bar, self.stop):
            widget.show()
        self.stop.setEnabled(True)
        self.tell(_("Starting"), 0, 0)

    def settle(self, *, busy: bool, testing: bool) -> None:
        """Enable what makes sense."""
        for widget in (*self.session.fields, *self.twin.fields, self.fold, self.fit, self.check):
            widget.setEnabled(not testing)
        self.run.setEnabled(not busy and self.session.path is not None)

    def restore(self, settings: QSettings) -> None:
        """Choose what was chosen last time, as far as it is still there."""
        for name, choice in (("session", self.session), ("twin", self.twin)):
            kept = str(settings.value(f"{_SETTING}/{name}", ""))
            if kept and Path(kept).is_file():
                choice.choose(Path(kept))
        self.fit.setText(str(settings.value(f"{_SETTING}/fit", "")))
        self.check.setText(str(settings.value(f"{_SETTING}/check", "")))
        self.fold.setChecked(bool(self.fit.text() or self.check.text()))

    def save(self, settings: QSettings) -> None:
        """Keep what is chosen."""
        settings.setValue(f"{_SETTING}/session", str(self.session.path or ""))
        settings.setValue(f"{_SETTING}/twin", str(self.twin.path or ""))
        settings.setValue(f"{_SETTING}/fit", self.fit.text())
        settings.setValue(f"{_SETTING}/check", self.check.text())

    def _unfold(self, opened: bool) -> None:
        self.fold.setArrowType(Qt.ArrowType.DownArrow if opened else Qt.ArrowType.RightArrow)
        self.more.setVisible(opened)

    def _arrange(self) -> None:
        choices = FoldingBox(_ONE_ROW)
        choices.setSpacing(8)
        for choice, share in ((self.session, 3), (self.twin, 2)):
            label = QLabel(choice.choice.accessibleName())
            label.setProperty("role", "field")
            row = QHBoxLayout()
            row.setSpacing(6)
            row.addWidget(choice.choice, 1)
            row.addWidget(choice.open)
            column = QVBoxLayout()
            column.setSpacing(2)
            column.addWidget(label)
            column.addLayout(row)
            choices.addLayout(column, share)
        choices.addWidget(self.run, 0, Qt.AlignmentFlag.AlignBottom | Qt.AlignmentFlag.AlignRight)
        inside = FoldingBox(_FIELDS_IN_A_ROW, self.more)
        inside.setContentsMargins(0, 0, 0, 0)
        for words, field in ((_("Tests to fit"), self.fit), (_("Tests to check"), self.check)):
            label = QLabel(words)
            label.setBuddy(field)
            field.setAccessibleName(_("{field}, numbers with commas between").format(field=words))
            field.setPlaceholderText(_("chosen by itself"))
            field.setMaxLength(200)
            field.setFixedWidth(130)
            pair = QHBoxLayout()
            pair.addWidget(label)
            pair.addWidget(field)
            pair.addSpacing(10)
            inside.addLayout(pair)
        below = QHBoxLayout()
        below.setSpacing(10)
        below.addWidget(self.fold)
        below.addWidget(self.more)
        below.addStretch(1)
        below.addWidget(self.doing)
        self.bar.setFixedWidth(150)
        below.addWidget(self.bar)
        below.addWidget(self.stop)
        rows = QVBoxLayout(self)
        rows.setContentsMargins(12, 6, 12, 6)
        rows.setSpacing(4)
        rows.addLayout(choices)
        rows.addLayout(below)


class _FileChoice(QObject):
    """A list of files and a button that opens others; it lends its two controls to whoever arranges them."""

    changed = Signal()

    def __init__(self, name: str, title: str, kinds: str, folder: Path, first: str = "") -> None:
        super().__init__()
        self._title, self._kinds, self._folder, self._first = title, kinds, folder, first
        self.choice = QComboBox()
        self.choice.setAccessibleName(name)
        self.choice.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.choice.setMinimumContentsLength(12)
        self.choice.setPlaceholderText(_("No session: open one, or drop its file here"))
        self.open = QPushButton(_("Open…"))
        self.open.setAccessibleName(f"{title}…")
        self.open.clicked.connect(self._ask)
        self.choice.currentIndexChanged.connect(self._tell)
        if first:
            self.choice.addItem(first, "")
        self._own: Path | None = None

    @property
    def fields(self) -> tuple[QWidget, ...]:
        """Its controls."""
        return self.choice, self.open

    @property
    def path(self) -> Path | None:
        """The chosen file; None for none, or for the first entry."""
        found = self.choice.currentData()
        return Path(found) if found else None

    def offer(self, paths: list[Path]) -> None:
        """Fill the list anew; what is chosen stays."""
        kept = self.path
        shown = list(dict.fromkeys([*([self._own] if self._own else []), *paths]))
        self.choice.blockSignals(True)
        self.choice.clear()
        if self._first:
            self.choice.addItem(self._first, "")
        for path in shown:
            self.choice.addItem(clean(path.name)[:_LONGEST], str(path))
            self.choice.setItemData(self.choice.count() - 1, clean(str(path)), Qt.ItemDataRole.ToolTipRole)
        place = self.choice.findData(str(kept)) if kept else -1
        self.choice.setCurrentIndex(place if place >= 0 else 0 if self.choice.count() else -1)
        self.choice.blockSignals(False)
        self._tell()

    def choose(self, path: Path) -> None:
        """Take a file, from wherever it is."""
        place = self.choice.findData(str(path))
        if place < 0:
            self._own = path
            place = 1 if self._first else 0
            self.choice.insertItem(place, clean(path.name)[:_LONGEST], str(path))
        self.choice.setCurrentIndex(place)

    def _tell(self) -> None:
        self.choice.setToolTip(clean(str(self.path or "")))
        self.changed.emit()

    def _ask(self) -> None:
        dialog = QFileDialog(self.open, self._title, str((self.path or self._folder / "x").parent), self._kinds)
        dialog.setFileMode(QFileDialog.FileMode.ExistingFile)
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        dialog.fileSelected.connect(self._take)
        dialog.open()

    def _take(self, path: str) -> None:
        self.choose(Path(path))


def _newest(folder: Path, suffix: str) -> list[Path]:
    """The newest files with a suffix; none where the folder cannot be read."""
    dated = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.name.endswith(suffix) and not entry.name.startswith("."):
                    with contextlib.suppress(OSError):  # it has just gone
                        dated.append((entry.stat().st_mtime, Path(entry.path)))
    except OSError:
        return []
    return [path for _, path in sorted(dated, reverse=True)][:_RECENT]
