"""Tab "Next test": the proposed test and the expected gain of each candidate test."""

from __future__ import annotations

from typing import TYPE_CHECKING

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QFrame, QWidget

from tissueid.app import build
from tissueid.app.build import button, styled
from tissueid.app.views.gap.bar_table import BarTable
from tissueid.app.views.gap.displayed_text import as_sentence, as_title
from tissueid.language import _, marked

if TYPE_CHECKING:
    from tissueid.app.views.gap.page_content import PageContent, Proposal

_NONE = {
    "no_gap": marked("No further test is needed: the twin explains this recording down to its noise."),
    "effect": marked("No further test is needed: the cause is clear."),
    "unexplained": marked("No test would separate the candidates: none of them explains the gap."),
}
_NONE_SEPARATES = marked(
    "More than one cause remains possible, and no test of this instrument would separate them: see the tab Which."
)


class NextTestTab(QWidget):
    """The proposed test; ``wanted`` is emitted to prepare it."""

    wanted = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.title = build.label("headline")
        self.why = build.label()
        self.put = build.label()
        self.by_hand = build.label()
        self.prepare = button(
            _("Prepare this test"),
            self.wanted,
            tip=_("Fill in the form of the guided test; nothing moves before you start it there"),
        )
        self.gains = BarTable(_("What each test would be worth"), (_("Test"), _("Expected odds")), 1)
        if (head := self.gains.horizontalHeaderItem(1)) is not None:
            head.setToolTip(
                _("How clearly the test would separate the candidates: 20 to 1 is clear, less than 3 to 1 is little")
            )
        self._arrange()

    @property
    def fields(self) -> list[QWidget]:
        """Widgets in tab order."""
        return [self.prepare, self.gains]

    def show_story(self, story: PageContent) -> None:
        """Show the proposed test of a diagnosis."""
        step = story.proposal
        self.title.setText(_("Nothing to measure") if step is None else as_title(step.title))
        clear = story.level == "good" and not any(item.alike for item in story.ranking if item.named)
        none = _NONE[story.verdict] if clear or story.verdict != "effect" else _NONE_SEPARATES
        self.why.setText(_(none) if step is None else as_sentence(step.why))
        self.put.setText("" if step is None else as_sentence(step.put))
        self.put.setVisible(bool(self.put.text()))
        self.by_hand.setText("" if step is None else as_sentence(step.by_hand))
        self.by_hand.setVisible(bool(self.by_hand.text()))
        self.prepare.setVisible(step is not None and step.fields is not None)
        self.gains.setVisible(step is not None)
        if step is not None:
            self._show_gains(step)

    def _show_gains(self, step: Proposal) -> None:
        most = max((gain for _title, gain, _odds in step.gains), default=0.0) or 1.0
        self.gains.fill(
            [
                ((as_title(title), _("{odds} to 1").format(odds=odds)), gain / most, title == step.title)
                for title, gain, odds in step.gains
            ]
        )

    def _arrange(self) -> None:
        card = styled(QFrame(), role="card")
        build.column(
            self.title,
            self.why,
            self.put,
            self.by_hand,
            build.row(self.prepare, None, spacing=8),
            None,
            spacing=8,
            margins=(12, 8, 12, 10),
            parent=card,
        )
        build.row((card, 1), (self.gains, 1), spacing=8, margins=(0, 6, 0, 0), parent=self)
