"""Input panel of the Gap page: session, baseline twin, and the tests to fit and to check."""

from __future__ import annotations

import contextlib
import itertools
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from PySide6.QtCore import QObject, QSettings, Qt, Signal
from PySide6.QtWidgets import (
    QComboBox,
    QFileDialog,
    QFrame,
    QLabel,
    QLineEdit,
    QProgressBar,
    QToolButton,
    QWidget,
)

from tissueid.app import build
from tissueid.app.build import button, styled
from tissueid.app.small_window import FoldingBox
from tissueid.app.views.gap.diagnosis_loader import unique_titles
from tissueid.app.widgets import BigButton
from tissueid.app.window_state import load_texts, save_texts
from tissueid.formatting import clean
from tissueid.language import _, marked
from tissueid.messages import Message, translated
from tissueid.procedures.gap_plans import DiagnosisPlan, read_test_number

NOMINAL = marked("Nominal twin")
_NEWEST = 20
"""Maximum number of listed files of the folder."""
_MOST_FOLDERS, _MOST_ENTRIES = 200, 5000
_RECENT = 10
"""Maximum number of listed files from other folders."""
_LONGEST = 120
_SETTING = "gap"
_STEPS = 1000
_ONE_ROW = 640
_FIELDS_IN_A_ROW = 480


class RequestPanel(QFrame):
    """Input of a diagnosis. Signals: ``wanted`` for Run, ``unwanted`` for Cancel, ``changed`` for the selection."""

    wanted = Signal()
    unwanted = Signal()
    changed = Signal()

    def __init__(
        self, folder: Path, others: Callable[[], Sequence[Path]] = tuple, parent: QWidget | None = None
    ) -> None:
        super().__init__(parent)
        self.setProperty("role", "card")
        self._folder, self._others = folder, others
        self.session = _FileChoice(_("Session"), folder)
        self.twin = _FileChoice(_("Baseline twin"), folder, first=_(NOMINAL))
        self.open = button(_("Open…"), self._ask, name=_("Open a session or a twin…"))
        self.run = styled(
            BigButton(_("Run")),
            name=_("Run the diagnosis"),
            tip=_("Find out where simulated and recorded differ, and why (half a minute to some minutes)"),
            clicked=self.wanted,
        )
        self.stop = button(_("Cancel"), self.unwanted, name=_("Cancel the diagnosis"))
        self.fold = styled(
            QToolButton(),
            text=_("Advanced"),
            role="fold",
            checkable=True,
            tool_button_style=Qt.ToolButtonStyle.ToolButtonTextBesideIcon,
            name=_("Advanced: which tests to fit and to check"),
        )
        self.fit, self.check = QLineEdit(), QLineEdit()
        self.more = QWidget()
        self.doing = styled(QLabel(), role="muted")
        self.bar = styled(QProgressBar(), text_visible=False, name=_("Progress of the diagnosis"))
        self._arrange()
        self.fold.toggled.connect(self._unfold)
        self.session.changed.connect(self.changed)
        self._unfold(False)
        self.clear()
        self.look()

    @property
    def fields(self) -> list[QWidget]:
        """Widgets in tab order."""
        return [self.session.choice, self.twin.choice, self.open, self.run, self.stop, self.fold, self.fit, self.check]

    def asked(self) -> DiagnosisPlan:
        """Return the current plan.

        Raises:
            UnusableInputError: what is typed are no numbers of tests.
        """
        fit, check = (
            tuple(read_test_number(what, part) for part in field.text().replace(",", " ").split())
            for what, field in ((_("Tests to fit"), self.fit), (_("Tests to check"), self.check))
        )
        session, twin = self.session.path or Path(), self.twin.path
        return DiagnosisPlan(
            session=session.absolute(), twin=None if twin is None else twin.absolute(), fit=fit, check=check
        )

    def put(self, asked: DiagnosisPlan) -> None:
        """Select the values of an earlier request."""
        self.session.choose(asked.session)
        if asked.twin is None:
            self.twin.choice.setCurrentIndex(0)
        else:
            self.twin.choose(asked.twin)
        for field, numbers in ((self.fit, asked.fit), (self.check, asked.check)):
            field.setText(", ".join(map(str, numbers)))
        self.fold.setChecked(bool(asked.fit or asked.check))

    def look(self) -> None:
        """List the newest files of the folder; the selection stays."""
        folders = dict.fromkeys((self._folder, *self._others()))
        self.session.offer(_newest(folders, ".h5"))
        self.twin.offer(_newest(folders, ".toml"))

    def take(self, path: Path) -> None:
        """Select a file: a twin by its suffix, else a session."""
        (self.twin if path.suffix == ".toml" else self.session).choose(path)

    def _ask(self) -> None:
        dialog = styled(
            QFileDialog(
                self,
                _("Open a session or a twin"),
                str((self.session.path or self._folder / "x").parent),
                _("Sessions and twins (*.h5 *.toml);;All files (*)"),
            ),
            file_mode=QFileDialog.FileMode.ExistingFile,
            attribute=Qt.WidgetAttribute.WA_DeleteOnClose,
        )
        dialog.fileSelected.connect(lambda path: self.take(Path(path)))
        dialog.open()

    def on_session_saved(self, path: Path) -> None:
        """List a file that was saved."""
        (self.twin if path.suffix == ".toml" else self.session).add_recent(path)
        self.look()

    def show_progress(self, fraction: float | None, step: str) -> None:
        """Show the step and its completed share from 0 to 1; None where that is not known.

        A step of which nothing is done yet is shown without its count.
        """
        if isinstance(step, Message) and step.values.get("done") == 0:
            step, fraction = step.values["step"], None
        self.doing.setText(translated(step) if fraction is not None else f"{translated(step)}…")
        self.bar.setRange(0, 0 if fraction is None else _STEPS)
        self.bar.setValue(0 if fraction is None else round(_STEPS * fraction))

    def clear(self) -> None:
        """Hide the progress."""
        self.doing.hide()
        self.bar.hide()
        self.stop.hide()

    def begin(self) -> None:
        """Show the progress of a new diagnosis."""
        for widget in (self.doing, self.bar, self.stop):
            widget.show()
        self.stop.setEnabled(True)
        self.show_progress(None, _("Starting"))

    def show_reason(self, why: str) -> None:
        """Say why no diagnosis can start; an empty text hides it."""
        if why or self.bar.isHidden():
            self.doing.setText(why)
            self.doing.setVisible(bool(why))

    def update_enabled(self, *, busy: bool, testing: bool) -> None:
        """Enable or disable the controls."""
        for widget in (self.session.choice, self.twin.choice, self.open, self.fold, self.fit, self.check):
            widget.setEnabled(not testing)
        self.run.setEnabled(not busy and self.session.path is not None)

    def restore(self, settings: QSettings) -> None:
        """Restore the selection of the last start, as far as its files exist."""
        for name, choice in (("session", self.session), ("twin", self.twin)):
            for recent in reversed(load_texts(settings, f"{_SETTING}/recent_{name}s")[:_RECENT]):
                choice.add_recent(Path(recent))
            kept = str(settings.value(f"{_SETTING}/{name}", ""))
            if kept and Path(kept).is_file():
                choice.choose(Path(kept))
        self.look()
        self.fit.setText(str(settings.value(f"{_SETTING}/fit", "")))
        self.check.setText(str(settings.value(f"{_SETTING}/check", "")))
        self.fold.setChecked(bool(self.fit.text() or self.check.text()))

    def save(self, settings: QSettings) -> None:
        """Save the selection."""
        settings.setValue(f"{_SETTING}/session", str(self.session.path or ""))
        settings.setValue(f"{_SETTING}/twin", str(self.twin.path or ""))
        for name, choice in (("session", self.session), ("twin", self.twin)):
            save_texts(settings, f"{_SETTING}/recent_{name}s", [str(path) for path in choice.recent])
        settings.setValue(f"{_SETTING}/fit", self.fit.text())
        settings.setValue(f"{_SETTING}/check", self.check.text())

    def _unfold(self, opened: bool) -> None:
        self.fold.setArrowType(Qt.ArrowType.DownArrow if opened else Qt.ArrowType.RightArrow)
        self.more.setVisible(opened)

    def _arrange(self) -> None:
        choices = FoldingBox(_ONE_ROW)
        choices.setSpacing(8)
        for choice, share in ((self.session, 3), (self.twin, 2)):
            label = styled(QLabel(choice.choice.accessibleName()), role="field")
            choices.addLayout(build.column(label, choice.choice, spacing=2), share)
        choices.addLayout(build.column(None, build.row(None, self.open, self.run, spacing=8)))
        inside = FoldingBox(_FIELDS_IN_A_ROW, self.more)
        inside.setContentsMargins(0, 0, 0, 0)
        for words, field in ((_("Tests to fit"), self.fit), (_("Tests to check"), self.check)):
            label = styled(QLabel(words), buddy=field)
            build.styled(
                field,
                name=_("{field}, numbers with commas between").format(field=words),
                placeholder_text=_("chosen by itself"),
                max_length=200,
                fixed_width=130,
            )
            pair = build.row(label, field, spacing=None)
            pair.addSpacing(10)
            inside.addLayout(pair)
        self.bar.setFixedWidth(150)
        build.column(
            choices,
            build.row(self.fold, self.more, None, self.doing, self.bar, self.stop, spacing=10),
            spacing=4,
            margins=(12, 6, 12, 6),
            parent=self,
        )


class _FileChoice(QObject):
    """A list of files.

    ``recent`` are files from outside the folder that were saved or opened, newest first.
    """

    changed = Signal()

    def __init__(self, name: str, folder: Path, first: str = "") -> None:
        super().__init__()
        self._folder, self._first = folder, first
        self._titles: dict[Path, str] = {}
        self.recent: list[Path] = []
        self.choice = styled(
            QComboBox(),
            name=name,
            size_adjust_policy=QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon,
            minimum_contents_length=12,
            placeholder_text=_("No session: open one, or drop its file here"),
        )
        self.choice.currentIndexChanged.connect(self._tell)
        if first:
            self.choice.addItem(first, "")

    @property
    def path(self) -> Path | None:
        """The selected file; None for no selection or the first entry."""
        found = self.choice.currentData()
        return Path(found) if found else None

    @property
    def untitled(self) -> list[Path]:
        """Listed files whose titles were not read yet."""
        return [path for path in self._offered if path not in self._titles]

    def offer(self, paths: list[Path]) -> None:
        """List recent files from other folders, then ``paths``; the selection stays."""
        kept = self.path
        self.choice.blockSignals(True)
        self.choice.clear()
        if self._first:
            self.choice.addItem(self._first, "")
        for path in dict.fromkeys([*(path for path in self.recent if path not in paths), *paths]):
            self.choice.addItem("", str(path))
        self._show_titles()
        place = self.choice.findData(str(kept)) if kept else -1
        self.choice.setCurrentIndex(place if place >= 0 else 0 if self.choice.count() else -1)
        self.choice.blockSignals(False)
        self._tell()

    def choose(self, path: Path) -> None:
        """Select a file from any folder."""
        place = self.choice.findData(str(path))
        self._remember(path)  # a listed one too: newer files may displace it from the list
        if place < 0:
            self._titles.pop(path, None)
            place = 1 if self._first else 0
            self.choice.insertItem(place, "", str(path))
            self._show_titles()
        self.choice.setCurrentIndex(place)

    def add_recent(self, path: Path) -> None:
        """Add a file from another folder, and mark its title for reading."""
        self._titles.pop(path, None)
        self._remember(path)

    def _remember(self, path: Path) -> None:
        if path.parent != self._folder:
            self.recent = [path, *(other for other in self.recent if other != path)][:_RECENT]

    def entitle(self, titles: Mapping[Path, str | None]) -> None:
        """Show titles in place of file names; remove missing files (None) from the recent ones."""
        self._titles |= {path: title or "" for path, title in titles.items()}
        self.recent = [path for path in self.recent if titles.get(path, "") is not None]
        self._show_titles()

    @property
    def _offered(self) -> list[Path]:
        return [Path(found) for place in range(self.choice.count()) if (found := self.choice.itemData(place))]

    def _show_titles(self) -> None:
        called = unique_titles({path: self._titles.get(path, "") for path in self._offered})
        for place in range(self.choice.count()):
            if found := self.choice.itemData(place):
                self.choice.setItemText(place, called[Path(found)][:_LONGEST])
                self.choice.setItemData(place, clean(found), Qt.ItemDataRole.ToolTipRole)

    def _tell(self) -> None:
        self.choice.setToolTip(clean(str(self.path or "")))
        self.changed.emit()


def _newest(folders: Iterable[Path], suffix: str) -> list[Path]:
    """Return the newest files with a suffix in folders and the folders in them, as far as these can be read."""
    dated: list[tuple[float, Path]] = []
    waiting = [(folder, True) for folder in folders]
    for folder, deeper in waiting:
        with contextlib.suppress(OSError), os.scandir(folder) as entries:
            for entry in itertools.islice(entries, _MOST_ENTRIES):
                with contextlib.suppress(OSError):  # it has just gone
                    if entry.name.startswith("."):
                        continue
                    if entry.name.endswith(suffix):
                        dated.append((entry.stat().st_mtime, Path(entry.path)))
                    elif deeper and len(waiting) < _MOST_FOLDERS and entry.is_dir(follow_symlinks=False):
                        waiting.append((Path(entry.path), False))
    return [path for _, path in sorted(dated, reverse=True)][:_NEWEST]
