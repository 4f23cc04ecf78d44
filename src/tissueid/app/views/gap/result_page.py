"""Page of one diagnosis: verdict, signal chain, and tabs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFrame, QPushButton, QScrollArea, QTabWidget, QWidget

from tissueid.app import build
from tissueid.app.small_window import FoldingBox
from tissueid.app.views.gap.candidates_tab import CandidatesTab
from tissueid.app.views.gap.closure_tab import ClosureTab
from tissueid.app.views.gap.displayed_text import STAGE_TITLES, as_sentence, as_title
from tissueid.app.views.gap.localisation_tab import LocalisationTab
from tissueid.app.views.gap.next_test_tab import NextTestTab
from tissueid.app.views.gap.signal_chain import SignalChain
from tissueid.app.widgets import show_level
from tissueid.language import _, marked

if TYPE_CHECKING:
    from tissueid.app.views.gap.diagnosis_result import State
    from tissueid.app.views.gap.page_content import PageContent
    from tissueid.twin.effect import Stage

_STALE = {
    "changed": marked("The session file has changed since this diagnosis, which may not hold for it any more."),
    "missing": marked(
        "The session file is not where it was: what is shown here was kept, and no other effect can be fitted."
    ),
}
_TABS_HEIGHT = 390
_ONE_ROW = 680
_LEAST_WIDTH = 540
"""Of the page with a scroll bar: the drawing of the chain is no narrower, pixels."""


class ResultPage(QScrollArea):
    """Shows the content of a diagnosis, with buttons to save its outputs or to repeat it."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._story: PageContent | None = None
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setMinimumWidth(_LEAST_WIDTH)
        self.stale = build.label()
        self.again = build.button(_("Diagnose again"), tip=_("Run the same diagnosis on the session as it is now"))
        self.headline = build.label("headline")
        self.means = build.label()
        self.todo = build.label()
        self.remarks = build.label("muted")
        self.accept = build.button(
            _("Accept into twin…"), tip=_("Save a twin that has the named effect, for simulation and later diagnoses")
        )
        self.report = build.button(_("Report"), tip=_("Write the report next to the session, and open it"))
        self.export = build.button(_("Export JSON…"), tip=_("For scripts: the same answer as the command line gives"))
        self.chain = SignalChain()
        self.stage = build.label("heading")
        self.evidence = build.label()
        self.where, self.which, self.far, self.next = LocalisationTab(), CandidatesTab(), ClosureTab(), NextTestTab()
        self.tabs = build.styled(QTabWidget(), document_mode=True)
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
    def buttons(self) -> tuple[QPushButton, ...]:
        """Buttons for the diagnosis."""
        return self.again, self.accept, self.report, self.export

    @property
    def fields(self) -> list[QWidget]:
        """Widgets in tab order."""
        first: list[QWidget] = [
            self.again,
            self.accept,
            self.report,
            self.export,
            *self.chain.stages.values(),
            self.tabs.tabBar(),
        ]
        return [*first, self.which.table, self.far.channel, *self.next.fields]

    def show_story(self, story: PageContent, state: State = "") -> None:
        """Show a diagnosis and the state of its session file."""
        self._story = story
        for widget in (self._verdict, self.headline):
            show_level(widget, "check" if state == "changed" else story.level)
        self.headline.setText(as_title(story.headline))
        for label, lines in ((self.means, story.means), (self.remarks, story.remarks)):
            label.setText(" ".join(map(as_sentence, lines)))
            label.setVisible(bool(lines))
        self.todo.setText(_("What to do: {advice}").format(advice=" ".join(map(as_sentence, story.todo))))
        self.todo.setVisible(bool(story.todo))
        self.chain.show_shares([(item.stage, item.share, item.lit) for item in story.stages])
        first = story.at_fault[0] if story.at_fault else story.stages[0].stage
        self.chain.choose(first)
        self._show_stage(first)
        for tab in (self.where, self.which, self.far, self.next):
            tab.show_story(story)
        self._show_state(state)
        self.verticalScrollBar().setValue(0)

    def update_enabled(self, *, busy: bool, testing: bool, working: bool) -> None:
        """Enable or disable the controls."""
        for button in self.buttons:
            button.setEnabled(not (busy or (working and button in (self.again, self.accept))))
        self.next.prepare.setEnabled(not testing)

    def _show_state(self, state: State) -> None:
        self.stale.setText(_(_STALE[state]) if state else "")
        self.stale.setVisible(bool(state))
        self.again.setVisible(state == "changed")
        self.accept.setVisible(state != "changed")

    def _show_stage(self, stage: Stage) -> None:
        if self._story is None:
            return
        found = next(item for item in self._story.stages if item.stage == stage)
        self.stage.setText(
            (_("Evidence: {stage} (at fault)") if found.lit else _("Evidence: {stage}")).format(
                stage=_(STAGE_TITLES[stage])
            )
        )
        self.evidence.setText("\n".join(map(as_sentence, found.evidence)))
        self.evidence.setAccessibleName(f"{self.stage.text()}. {self.evidence.text()}")

    def _arrange(self) -> None:
        self._verdict = build.styled(QFrame(), role="verdict")
        offered = build.row(None)
        for button in self.buttons:
            offered.addWidget(button, 0, Qt.AlignmentFlag.AlignTop)
        build.column(
            build.fill(FoldingBox(_ONE_ROW), (self.headline, 1), offered),
            self.stale,
            self.means,
            self.todo,
            self.remarks,
            spacing=3,
            margins=(12, 8, 10, 8),
            parent=self._verdict,
        )
        card = build.styled(QFrame(), role="card")
        build.fill(
            FoldingBox(_ONE_ROW, card),
            (self.chain, 5),
            (build.column(self.stage, self.evidence, None, spacing=4), 3),
            spacing=14,
            margins=(8, 6, 12, 8),
        )
        self.tabs.setMinimumHeight(_TABS_HEIGHT)
        page = QWidget()
        build.column(self._verdict, card, (self.tabs, 1), spacing=8, parent=page)
        self.setWidget(page)
