"""Tab "Recommendation": the result of a comparison of engines, and the choice of engines."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import Qt
from PySide6.QtGui import QAction, QFont
from PySide6.QtWidgets import (
    QComboBox,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QMenu,
    QPlainTextEdit,
    QPushButton,
    QSplitter,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from tissueid.app.views.researcher.comparison_summary import COLUMNS, ComparisonSummary
from tissueid.app.views.researcher.results_table import in_two_lines
from tissueid.identification import engine_label, engine_names
from tissueid.language import _, marked

_ROW = 22
_NOTHING = marked("No comparison yet. “Compare engines” fits every engine to the chosen tests and recommends one.")


class RecommendationView(QWidget):
    """Shows one comparison at a time."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._verdicts: dict[str, ComparisonSummary] = {}
        self.choice = QComboBox()
        self.choice.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.choice.setAccessibleName(_("Test whose comparison is shown"))
        self.choice.currentIndexChanged.connect(self._show)
        self.engines = QPushButton(_("En&gines compared"))
        self._menu = QMenu(self.engines)
        self._actions: dict[str, QAction] = {}
        for name in engine_names():
            action = self._menu.addAction(engine_label(name))
            action.setCheckable(True)
            action.setChecked(True)
            action.toggled.connect(self._count)
            self._actions[name] = action
        self.engines.setMenu(self._menu)
        self.headline = QLabel()
        self.headline.setProperty("role", "headline")
        self.headline.setWordWrap(True)
        self.headline.setMinimumWidth(1)
        self.headline.setTextFormat(Qt.TextFormat.PlainText)
        self.words = QPlainTextEdit()
        self.words.setReadOnly(True)
        self.words.setTabChangesFocus(True)
        self.words.setAccessibleName(_("Reasons of the recommendation"))
        self.standings = QTableWidget(0, len(COLUMNS))
        self.standings.setHorizontalHeaderLabels([in_two_lines(_(name)) for name in COLUMNS])
        self.standings.setAccessibleName(_("Engines by how well they do"))
        self.standings.setEditTriggers(QTableWidget.EditTrigger.NoEditTriggers)
        self.standings.setSelectionBehavior(QTableWidget.SelectionBehavior.SelectRows)
        self.standings.setTabKeyNavigation(False)
        self.standings.setShowGrid(False)
        self.standings.setWordWrap(False)
        self.standings.verticalHeader().hide()
        self.standings.verticalHeader().setDefaultSectionSize(_ROW)
        header = self.standings.horizontalHeader()
        header.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        header.setHighlightSections(False)
        top = QHBoxLayout()
        top.addWidget(self.engines)
        top.addWidget(self.choice, 1)
        parts = QSplitter(Qt.Orientation.Vertical)
        parts.setChildrenCollapsible(False)
        parts.addWidget(self.words)
        parts.addWidget(self.standings)
        parts.setStretchFactor(0, 2)
        parts.setStretchFactor(1, 3)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 6, 0, 0)
        layout.setSpacing(6)
        layout.addLayout(top)
        layout.addWidget(self.headline)
        layout.addWidget(parts, 1)
        self._count()
        self._show()

    @property
    def compared(self) -> tuple[str, ...]:
        """The engines that are compared."""
        return tuple(name for name, action in self._actions.items() if action.isChecked())

    def take_compared(self, engines: Sequence[str]) -> None:
        """Select the engines to compare; unknown names are ignored, an empty selection means all."""
        known = [name for name in engines if name in self._actions] or list(self._actions)
        for name, action in self._actions.items():
            action.setChecked(name in known)

    def add(self, verdicts: Sequence[ComparisonSummary]) -> None:
        """Add summaries and show the first; a later summary of a test replaces the earlier one."""
        if not verdicts:
            return
        self._verdicts |= {verdict.label: verdict for verdict in verdicts}
        self.choice.blockSignals(True)
        self.choice.clear()
        self.choice.addItems(list(self._verdicts))
        self.choice.setCurrentIndex(self.choice.findText(verdicts[0].label))
        self.choice.blockSignals(False)
        self._show()

    def _count(self) -> None:
        some = len(self.compared)
        self.engines.setText(
            _("En&gines compared: {count}").format(count=_("all") if some == len(self._actions) else some)
        )

    def _show(self) -> None:
        verdict = self._verdicts.get(self.choice.currentText())
        self.choice.setVisible(verdict is not None)
        self.standings.setVisible(verdict is not None)
        if verdict is None:
            self.headline.setText("")
            self.headline.hide()
            self.words.setPlainText(_(_NOTHING))
            return
        self.headline.show()
        self.headline.setText(verdict.headline)
        parts = [verdict.judged_on, *verdict.reasons]
        parts += ["", _("Caveats"), *verdict.doubts] if verdict.doubts else []
        parts += ["", _("Suggested tests"), *verdict.experiments] if verdict.experiments else []
        self.words.setPlainText("\n".join(parts))
        self.standings.setRowCount(len(verdict.rows))
        bold = QFont(self.standings.font())
        bold.setBold(True)
        for row, texts in enumerate(verdict.rows):
            for column, text in enumerate(texts):
                item = QTableWidgetItem(text)
                if texts[1] == _("recommended"):
                    item.setFont(bold)
                item.setToolTip(text.replace("<", "‹").replace(">", "›") if column == len(texts) - 1 else "")
                if column in (2, 3, 4, 5):
                    item.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
                self.standings.setItem(row, column, item)
