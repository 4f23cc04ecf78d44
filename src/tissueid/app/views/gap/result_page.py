"""One diagnosis on a page: the verdict, the chain, and where, which, how far and what next."""

from __future__ import annotations

from typing import TYPE_CHECKING

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFrame, QHBoxLayout, QPushButton, QScrollArea, QTabWidget, QVBoxLayout, QWidget

from tissueid.app.small_window import FoldingBox
from tissueid.app.theme import Theme
from tissueid.app.views.gap.chain import Chain
from tissueid.app.views.gap.far_tab import FarTab
from tissueid.app.views.gap.labels import plain_label, show_level
from tissueid.app.views.gap.next_tab import NextTab
from tissueid.app.views.gap.where_tab import WhereTab
from tissueid.app.views.gap.which_tab import WhichTab
from tissueid.app.views.gap.words import STAGE_TITLES
from tissueid.language import _

if TYPE_CHECKING:
    from tissueid.app.views.gap.story import Story
    from tissueid.twin.effect import Stage

_TABS_HEIGHT = 390
_ONE_ROW = 680
_LEAST_WIDTH = 540
"""Of the page with a scroll bar: the drawing of the chain is no narrower, pixels."""


class ResultPage(QScrollArea):
    """Shows a story; the three buttons are for what is kept of it."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._story: Story | None = None
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setMinimumWidth(_LEAST_WIDTH)
        self.headline = plain_label("headline")
        self.means = plain_label()
        self.todo = plain_label()
        self.remarks = plain_label("muted")
        self.accept = QPushButton(_("Accept into twin…"))
        self.accept.setToolTip(_("Save a twin that has the named effect, for simulation and later diagnoses"))
        self.report = QPushButton(_("Report"))
        self.report.setToolTip(_("Write this as one page beside the session, and open it"))
        self.export = QPushButton(_("Export JSON…"))
        self.export.setToolTip(_("For scripts: the same answer as the command line gives"))
        self.chain = Chain()
        self.stage = plain_label("heading")
        self.evidence = plain_label()
        self.where, self.which, self.far, self.next = WhereTab(), WhichTab(), FarTab(), NextTab()
        self.tabs = QTabWidget()
        self.tabs.setDocumentMode(True)
        self.tabs.tabBar().setDrawBase(False)
        # One stop of the tab key, not two: the second would lead back to the bar, and never past it.
        self.tabs.setFocusProxy(None)  # type: ignore[arg-type]
        self.tabs.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.tabs.tabBar().setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.tabs.tabBar().setAccessibleName(_("Where, which, how far, what next"))
        for title, tab in (
            (_("Where"), self.where),
            (_("Which"), self.which),
            (_("How far"), self.far),
            (_("Next test"), self.next),
        ):
            self.tabs.addTab(tab, title)
        self.chain.chosen.connect(self._show_stage)
        self._arrange()

    @property
    def fields(self) -> list[QWidget]:
        """What the tab key visits, in order."""
        first: list[QWidget] = [self.accept, self.report, self.export, *self.chain.stages.values(), self.tabs.tabBar()]
        return [*first, self.which.table, self.far.channel, *self.next.fields]

    def show_story(self, story: Story) -> None:
        """Show a diagnosis."""
        self._story = story
        for widget in (self._verdict, self.headline):
            show_level(widget, story.level)
        self.headline.setText(story.headline)
        for label, lines in ((self.means, story.means), (self.remarks, story.remarks)):
            label.setText(" ".join(lines))
            label.setVisible(bool(lines))
        self.todo.setText(_("What to do: {advice}").format(advice=" ".join(story.todo)))
        self.todo.setVisible(bool(story.todo))
        self.chain.show_shares([(item.stage, item.share, item.lit) for item in story.stages])
        first = story.at_fault[0] if story.at_fault else story.stages[0].stage
        self.chain.choose(first)
        self._show_stage(first)
        for tab in (self.where, self.which, self.far, self.next):
            tab.show_story(story)
        self.verticalScrollBar().setValue(0)

    def settle(self, *, busy: bool, testing: bool) -> None:
        """Enable what makes sense."""
        for button in (self.accept, self.report, self.export):
            button.setEnabled(not busy)
        self.next.prepare.setEnabled(not testing)

    def paint_with(self, theme: Theme) -> None:
        """Take on the colours of a theme."""
        for part in (self.chain, self.where, self.which, self.far, self.next):
            part.paint_with(theme)

    def _show_stage(self, stage: Stage) -> None:
        if self._story is None:
            return
        found = next(item for item in self._story.stages if item.stage == stage)
        self.stage.setText(
            (_("Evidence: {stage} (at fault)") if found.lit else _("Evidence: {stage}")).format(
                stage=_(STAGE_TITLES[stage])
            )
        )
        self.evidence.setText("\n".join(found.evidence))
        self.evidence.setAccessibleName(f"{self.stage.text()}. {self.evidence.text()}")

    def _arrange(self) -> None:
        self._verdict = QFrame()
        self._verdict.setProperty("role", "verdict")
        offered = QHBoxLayout()
        offered.setSpacing(6)
        offered.addStretch(1)
        for button in (self.accept, self.report, self.export):
            offered.addWidget(button, 0, Qt.AlignmentFlag.AlignTop)
        top = FoldingBox(_ONE_ROW)
        top.setSpacing(6)
        top.addWidget(self.headline, 1)
        top.addLayout(offered)
        verdict = QVBoxLayout(self._verdict)
        verdict.setContentsMargins(12, 8, 10, 8)
        verdict.setSpacing(3)
        verdict.addLayout(top)
        for label in (self.means, self.todo, self.remarks):
            verdict.addWidget(label)
        card = QFrame()
        card.setProperty("role", "card")
        evidence = QVBoxLayout()
        evidence.setSpacing(4)
        evidence.addWidget(self.stage)
        evidence.addWidget(self.evidence)
        evidence.addStretch(1)
        middle = FoldingBox(_ONE_ROW, card)
        middle.setContentsMargins(8, 6, 12, 8)
        middle.setSpacing(14)
        middle.addWidget(self.chain, 5)
        middle.addLayout(evidence, 3)
        self.tabs.setMinimumHeight(_TABS_HEIGHT)
        page = QWidget()
        column = QVBoxLayout(page)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(8)
        column.addWidget(self._verdict)
        column.addWidget(card)
        column.addWidget(self.tabs, 1)
        self.setWidget(page)
