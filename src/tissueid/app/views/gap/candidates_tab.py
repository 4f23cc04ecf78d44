"""Tab "Which": the ranked candidate effects and the details of the selected one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from PySide6.QtWidgets import QFrame, QScrollArea, QWidget

from tissueid.app import build
from tissueid.app.views.gap.bar_table import BarTable
from tissueid.app.views.gap.displayed_text import STAGE_TITLES, as_sentence, as_title
from tissueid.formatting import plus_minus, with_unit
from tissueid.language import _
from tissueid.messages import Message, translated
from tissueid.units import shown_si

if TYPE_CHECKING:
    from tissueid.app.views.gap.page_content import Fitted, PageContent, Rival

_NO_TRACE = Message(
    "gap.no_trace", "No effect leaves a trace in this recording that a refit of the twin would not take up."
)
_NO_GAP = Message(
    "gap.no_cause", "There is no gap, so no cause is looked for: the twin explains this recording down to its noise."
)


class CandidatesTab(QWidget):
    """Table of candidates, best first, with the details of the selected one."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._rivals: tuple[Rival, ...] = ()
        self.table = BarTable(
            _("Candidates, likeliest first"), (_("Effect"), _("Stage"), _("Probability"), _("Closed (95 %)")), 2
        )
        self.none = build.label("muted")
        self.title = build.label("heading")
        self.alike = build.label()
        self.leaves = build.label("muted")
        self.remedy = build.label()
        self.figures = build.label()
        self.table.itemSelectionChanged.connect(self._show_chosen)
        self._details = self._make_details()
        build.row((self.table, 3), (self.none, 3), (self._details, 2), spacing=8, margins=(0, 6, 0, 0), parent=self)

    def show_story(self, story: PageContent) -> None:
        """List the candidates and choose the first."""
        self._rivals = story.ranking
        self.table.fill(
            [
                (
                    (
                        as_title(item.title),
                        _(STAGE_TITLES[item.stage]),
                        translated(item.odds),
                        translated(item.closed),
                    ),
                    item.probability if item.probability == item.probability else 0.0,
                    item.named,
                )
                for item in self._rivals
            ]
        )
        there = bool(self._rivals)
        self.table.setVisible(there)
        self._details.setVisible(there)
        self.none.setText(translated(_NO_GAP if story.verdict == "no_gap" else _NO_TRACE))
        self.none.setVisible(not there)
        if there:
            self.table.clearSelection()
            self.table.selectRow(0)

    def take_units(self) -> None:
        """Show the values in the active unit system."""
        self._show_chosen()

    def _show_chosen(self) -> None:
        row = self.table.currentRow()
        if not 0 <= row < len(self._rivals):
            return
        rival = self._rivals[row]
        self.title.setText(as_title(rival.title))
        if rival.alike:
            self.alike.setText(_("This data cannot separate it from: {alike}.").format(alike=translated(rival.alike)))
        else:
            self.alike.setText(_("This data separates it from every other candidate."))
        self.leaves.setText(_("Signature: {signature}").format(signature=as_sentence(rival.signature)))
        self.remedy.setText(_("What to do: {advice}").format(advice=as_sentence(rival.remedy)) if rival.remedy else "")
        self.figures.setText("\n".join([_("Fitted:"), *(_spoken(item) for item in rival.figures)]))
        self.figures.setVisible(bool(rival.figures))

    def _make_details(self) -> QWidget:
        inside = QWidget()
        build.column(
            self.title, self.alike, self.figures, self.remedy, self.leaves, None, margins=(12, 8, 12, 8), parent=inside
        )
        scroll = build.styled(
            QScrollArea(), widget_resizable=True, frame_shape=QFrame.Shape.NoFrame, name=_("The chosen candidate")
        )
        scroll.setWidget(inside)
        card = build.styled(QFrame(), role="card")
        build.column(scroll, parent=card)
        return card


def _spoken(item: Fitted) -> str:
    unit, scale = shown_si(item.si_unit)
    return f"{as_title(item.meaning)}: {with_unit(plus_minus(item.value, scale), unit)}"
