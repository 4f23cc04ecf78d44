"""Tabs of a diagnosis: where the gap is, what may cause it, how far it is closed, and the next test."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import QModelIndex, QPersistentModelIndex, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QColor, QPainter, QPaintEvent, QResizeEvent
from PySide6.QtWidgets import (
    QFrame,
    QHeaderView,
    QLabel,
    QScrollArea,
    QSizePolicy,
    QStyle,
    QStyledItemDelegate,
    QStyleOptionViewItem,
    QTableWidget,
    QWidget,
)

from tissueid.app import build
from tissueid.app.build import button, styled
from tissueid.app.plot_canvas import PlotCanvas
from tissueid.app.small_window import FoldingBox
from tissueid.app.theme import appearance, faint
from tissueid.app.views.gap.page_content import STAGE_TITLES, as_sentence, as_title
from tissueid.app.widgets import fill_table
from tissueid.formatting import plus_minus, share_text, with_unit
from tissueid.language import _, marked
from tissueid.messages import Message, translated
from tissueid.units import shown_si

if TYPE_CHECKING:
    from tissueid.app.views.gap.page_content import PageContent, Proposal
    from tissueid.gap.diagnosis_content import BudgetRow, Fitted, GapProfile, Rival, SignalOverlay

_SHARE = Qt.ItemDataRole.UserRole
_ROW = 24


class BarTable(QTableWidget):
    """Table of texts; column ``bars`` also shows a share as a bar."""

    def __init__(self, name: str, head: Sequence[str], bars: int, parent: QWidget | None = None) -> None:
        super().__init__(0, len(head), parent)
        self._bars = bars
        build.for_reading(self, name, _ROW, horizontal_header_labels=list(head), word_wrap=True)
        self.setSelectionMode(QTableWidget.SelectionMode.SingleSelection)
        build.styled(
            self.verticalHeader(),
            minimum_section_size=_ROW,
            section_resize_mode=QHeaderView.ResizeMode.ResizeToContents,
        )
        self.horizontalHeader().setSectionResizeMode(0, QHeaderView.ResizeMode.Stretch)
        self._delegate = _Bar(self)
        self.setItemDelegateForColumn(bars, self._delegate)

    def fill(self, rows: Sequence[tuple[Sequence[str], float, bool]]) -> None:
        """Show rows of texts, share of the bar (0 to 1), and whether the row is bold."""
        bold = [row for row, (_texts, _share, is_bold) in enumerate(rows) if is_bold]
        fill_table(self, [texts for texts, _share, _bold in rows], bold)
        for row, (_texts, share, _bold) in enumerate(rows):
            if (item := self.item(row, self._bars)) is not None:
                item.setData(_SHARE, share)


class _Bar(QStyledItemDelegate):
    """Delegate that draws a bar behind the text."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)

    def paint(
        self, painter: QPainter, option: QStyleOptionViewItem, index: QModelIndex | QPersistentModelIndex
    ) -> None:
        """Draw a cell."""
        area = QRectF(option.rect).adjusted(3, 4, -3, -4)  # type: ignore[attr-defined]
        chosen = bool(option.state & QStyle.StateFlag.State_Selected)  # type: ignore[attr-defined]
        if chosen:
            painter.fillRect(option.rect, QColor(appearance.theme.accent))  # type: ignore[attr-defined]
        share = min(max(float(index.data(_SHARE) or 0.0), 0.0), 1.0)
        painter.fillRect(area, faint(appearance.theme.muted, 40))
        bar = QRectF(area.left(), area.top(), max(share * area.width(), 1.0 if share > 0.0 else 0.0), area.height())
        painter.fillRect(bar, faint(appearance.theme.model, 130))
        painter.setPen(QColor(appearance.theme.accent_text if chosen else appearance.theme.text))
        painter.drawText(area.adjusted(5, 0, -5, 0), Qt.AlignmentFlag.AlignVCenter, str(index.data() or ""))


_NOT_THERE = marked("There is no data to show.")
_ONE_ROW = 820
"""Width below which the three profiles stand below each other, pixels."""


class LocalisationTab(QWidget):
    """Four plots: spectrum, and error against depth, velocity and time."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.frequency = PlotCanvas(_("By frequency"))
        self.profiles = {
            "depth_m": PlotCanvas(_("By depth")),
            "velocity_m_s": PlotCanvas(_("By velocity")),
            "time_s": PlotCanvas(_("By time")),
        }
        self.cards: tuple[PlotCanvas, ...] = (self.frequency, *self.profiles.values())
        for card in self.cards:
            card.setMinimumHeight(165)
        build.column(
            (self.frequency, 1),
            (build.fill(FoldingBox(_ONE_ROW), *[(card, 1) for card in self.profiles.values()], spacing=8), 1),
            spacing=8,
            margins=(0, 6, 0, 0),
            parent=self,
        )

    def show_story(self, story: PageContent) -> None:
        """Draw the result of a diagnosis."""
        from tissueid.gap.diagnosis_plots import profile_plot, spectrum_plot

        if story.spectrum is None:
            self.frequency.say_missing(_(_NOT_THERE))
        else:
            self.frequency.show_plots([spectrum_plot(story.spectrum)])
        channel = story.spectrum.channel if story.spectrum is not None else ""
        for name, card in self.profiles.items():
            profile = story.profiles.get(name)
            if profile is None or not profile.middle.size:
                card.say_missing(_(_NOT_THERE))
                continue
            card.show_plots([profile_plot(name, profile)], description=_described(profile, channel))


def _described(profile: GapProfile, channel: str) -> str:
    most = int(np.argmax(profile.error))
    many = int(profile.above.sum())
    return _(
        "Error of the {channel}: {many} of {count} bins stand above the noise; most at {place:.3g}, "
        "{most:.3g} times it."
    ).format(
        channel=_(channel),
        many=many,
        count=profile.above.size,
        place=profile.middle[most],
        most=profile.error[most],
    )


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
        build.show_text(self.none, "" if there else translated(_NO_GAP if story.verdict == "no_gap" else _NO_TRACE))
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
        alike = _("This data cannot separate it from: {alike}.").format(alike=translated(rival.alike))
        self.alike.setText(alike if rival.alike else _("This data separates it from every other candidate."))
        self.leaves.setText(_("Signature: {signature}").format(signature=as_sentence(rival.signature)))
        self.remedy.setText(_("What to do: {advice}").format(advice=as_sentence(rival.remedy)) if rival.remedy else "")
        fitted = "\n".join([_("Fitted:"), *(_spoken(item) for item in rival.figures)])
        build.show_text(self.figures, fitted if rival.figures else "")

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


_NAMES = 0.5
"""Most of the width that names left of the bars take; longer names stand above."""
_BAR_LINE, _NAME_LINE, _FIGURE = 22, 18, 62
"""Height of a bar and of a name above it, and width of a figure, pixels."""
_ONE_LINE, _STACKED = _BAR_LINE + 4, _BAR_LINE + _NAME_LINE + 4
"""Distance from one bar to the next, pixels."""
_SIDE, _ONE_ROW_OF_BARS = 270, 660
"""Least width of the figures, and the width below which the plots stand below them, pixels."""


class ClosureTab(QWidget):
    """Bars of the gap on the left; one signal and its residual on the right."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._overlays: tuple[SignalOverlay, ...] = ()
        self.bars = _GapBars()
        self.closing = build.label()
        self.channel = build.choice({}, self._show_chosen, name=_("Signal to look at"))
        self.signals = PlotCanvas()
        self._arrange()

    def show_story(self, story: PageContent) -> None:
        """Draw the result of a diagnosis."""
        self.bars.show_rows(story.budget)
        self.closing.setText(translated(story.closing))
        self._overlays = story.overlays
        build.offer(self.channel, {k: _(item.channel.capitalize()) for k, item in enumerate(story.overlays)}, 0)
        self.channel.setEnabled(len(story.overlays) > 1)
        if not story.overlays:
            self.signals.say_missing(_("Every sample was used for the fit: there is no held-out data to compare with."))
        self._show_chosen()

    def _show_chosen(self) -> None:
        from tissueid.gap.diagnosis_plots import overlay_plots

        index = self.channel.currentIndex()
        if 0 <= index < len(self._overlays):
            self.signals.show_plots(overlay_plots(self._overlays[index]))

    def _arrange(self) -> None:
        choice = build.row(build.styled(QLabel(_("Signal")), buddy=self.channel), (self.channel, 1), spacing=8)
        side = build.styled(QFrame(), role="card", minimum_width=_SIDE)
        build.column(
            build.styled(
                QLabel(_("Gap on held-out data")),
                role="heading",
                word_wrap=True,
                tip=_("Error of the free run over the signals' deviation"),
            ),
            self.bars,
            self.closing,
            None,
            choice,
            spacing=8,
            margins=(12, 8, 12, 10),
            parent=side,
        )
        self.signals.setMinimumHeight(288)
        build.fill(FoldingBox(_ONE_ROW_OF_BARS, self), side, (self.signals, 1), spacing=8, margins=(0, 6, 0, 0))


class _GapBars(QWidget):
    """Waterfall with values: gap before, what each named effect closes, gap after, noise alone."""

    def __init__(self) -> None:
        super().__init__()
        self._rows: tuple[BudgetRow, ...] = ()
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)

    def show_rows(self, rows: tuple[BudgetRow, ...]) -> None:
        """Show the rows from top to bottom."""
        self._rows = rows
        values = ", ".join(f"{translated(row.name)} {share_text(row.high - row.low)}" for row in rows)
        build.styled(
            self,
            tip="\n".join(f"{translated(row.name)}: {share_text(row.high - row.low)}" for row in rows),
            name=_("Gap: {values}").format(values=values),
        )
        self._fit()
        self.update()

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return a width for short names."""
        return QSize(220, self.height())

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Take a height of one line per bar, or of two where names need a line of their own."""
        self._fit()

    def _fit(self) -> None:
        self.setFixedHeight(self._pitch(self.width()) * max(len(self._rows), 3))

    def _pitch(self, width: int) -> int:
        return _STACKED if self._name_width() > _NAMES * width else _ONE_LINE

    def _name_width(self) -> int:
        letters = self.fontMetrics()
        return 8 + max((letters.horizontalAdvance(translated(row.name)) for row in self._rows), default=0)

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        """Draw the bars, each with its name left of it or above."""
        painter = QPainter(self)
        most = max((row.high for row in self._rows if np.isfinite(row.high)), default=1.0) or 1.0
        pitch = self._pitch(self.width())
        begin, below = (0.0, _NAME_LINE) if pitch == _STACKED else (float(self._name_width()), 0)
        room = max(self.width() - begin - _FIGURE, 10.0)
        for index, row in enumerate(self._rows):
            top = pitch * index
            painter.setPen(QColor(appearance.theme.text))
            name_room = QRectF(0, top, begin - 8.0 if begin else self.width(), below or _BAR_LINE)
            shown = self.fontMetrics().elidedText(
                translated(row.name), Qt.TextElideMode.ElideRight, int(name_room.width())
            )
            painter.drawText(name_room, Qt.AlignmentFlag.AlignVCenter, shown)
            start, end = (room * value / most if np.isfinite(value) else 0.0 for value in (row.low, row.high))
            width = max(end - start, 1.0)
            bar = QRectF(begin + start, top + below + 4, width, 14)
            painter.fillRect(bar, QColor(getattr(appearance.theme, row.role)))
            figure = QRectF(bar.right() + 6, top + below, _FIGURE, _BAR_LINE)
            painter.drawText(figure, Qt.AlignmentFlag.AlignVCenter, share_text(row.high - row.low))


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
        build.show_text(self.put, "" if step is None else as_sentence(step.put))
        build.show_text(self.by_hand, "" if step is None else as_sentence(step.by_hand))
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
