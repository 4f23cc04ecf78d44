"""Page of one diagnosis: verdict, signal chain, and tabs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from PySide6.QtCore import QPointF, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QColor, QFont, QKeyEvent, QPainter, QPainterPath, QPaintEvent, QPen, QPolygonF, QResizeEvent
from PySide6.QtWidgets import (
    QAbstractButton,
    QButtonGroup,
    QFrame,
    QPushButton,
    QScrollArea,
    QSizePolicy,
    QWidget,
)

from tissueid.app import build
from tissueid.app.small_window import FoldingBox
from tissueid.app.theme import appearance, faint
from tissueid.app.views.gap.page_content import STAGE_TITLES, as_sentence, as_title
from tissueid.app.views.gap.result_tabs import CandidatesTab, ClosureTab, LocalisationTab, NextTestTab
from tissueid.app.widgets import show_level
from tissueid.language import _, marked

if TYPE_CHECKING:
    from tissueid.app.views.gap.diagnosis_result import State
    from tissueid.app.views.gap.page_content import PageContent
    from tissueid.twin.effect import Stage

_PLACES: dict[Stage, tuple[float, int]] = {
    "drive": (0.5, 0),
    "coil": (1.5, 0),
    "mechanics": (2.5, 0),
    "sensing": (3.5, 0),
    "tissue": (2.5, 1),
    "environment": (3.5, 1),
}
"""Middle of each box in columns of four, and its row."""
_SIGNALS = (marked("command"), marked("voltage"), marked("force"), marked("motion"), marked("numbers"))
"""What goes into each stage of the upper row, and out of the last."""
_SHARE_OF_COLUMN = 0.8
_MARGIN, _HEAD = 30.0, 5.0
_BOX_HEIGHT = 40.0
_DARKEST = 110
_ARROWS = {Qt.Key.Key_Left: -1, Qt.Key.Key_Up: -1, Qt.Key.Key_Right: 1, Qt.Key.Key_Down: 1}


class SignalChain(QWidget):
    """The signal chain; ``chosen`` carries the stage that was clicked."""

    chosen = Signal(str)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        build.styled(
            self,
            name=_("Signal chain"),
            minimum_size=(500, 136),
            size_policy=(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Preferred),
        )
        self.stages: dict[Stage, _Box] = {stage: _Box(stage, self) for stage in _PLACES}
        self._group = QButtonGroup(self)
        for stage, box in self.stages.items():
            self._group.addButton(box)
            box.clicked.connect(lambda _checked=False, stage=stage: self.chosen.emit(stage))

    def show_shares(self, shares: Sequence[tuple[Stage, float, bool]]) -> None:
        """Show the share of the gap of each stage, and whether it is at fault."""
        for stage, share, lit in shares:
            self.stages[stage].show_share(share, lit=lit)

    def choose(self, stage: Stage) -> None:
        """Select a stage."""
        self.stages[stage].setChecked(True)
        for name, box in self.stages.items():  # the tab key comes to the chosen one, the arrow keys to the others
            box.setFocusPolicy(Qt.FocusPolicy.StrongFocus if name == stage else Qt.FocusPolicy.ClickFocus)

    @property
    def chosen_box(self) -> QAbstractButton:
        """The selected box."""
        return self._group.checkedButton()

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return the preferred size."""
        return QSize(620, 150)

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        """Move along the stages with the arrow keys."""
        step = _ARROWS.get(Qt.Key(event.key()))
        boxes = list(self.stages.values())
        focus = next((k for k, box in enumerate(boxes) if box.hasFocus()), None)
        if step is None or focus is None:
            super().keyPressEvent(event)
            return
        box = boxes[(focus + step) % len(boxes)]
        box.setFocus(Qt.FocusReason.TabFocusReason)
        box.click()

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Place the boxes."""
        super().resizeEvent(event)
        for stage, box in self.stages.items():
            box.setGeometry(self._place(stage).toRect())

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        """Draw what connects the boxes."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setFont(self._small())
        top = [self._place(stage) for stage in ("drive", "coil", "mechanics", "sensing")]
        self._signals(painter, top)
        tissue, surround = self._place("tissue"), self._place("environment")
        contact = QPointF(tissue.center().x(), tissue.top()), QPointF(top[2].center().x(), top[2].bottom())
        noise = QPointF(surround.center().x(), surround.top()), QPointF(top[3].center().x(), top[3].bottom())
        press = QPointF(surround.left(), surround.center().y()), QPointF(tissue.right(), surround.center().y())
        for ends in (contact, contact[::-1], noise, press):
            self._arrow(painter, *ends)
        self._back_emf(painter, top[1], top[2], tissue)

    def _signals(self, painter: QPainter, top: Sequence[QRectF]) -> None:
        height = top[0].center().y()
        starts = [top[0].left() - _MARGIN, *(box.right() for box in top)]
        ends = [*(box.left() for box in top), top[-1].right() + _MARGIN]
        for start, end, name in zip(starts, ends, _SIGNALS, strict=True):
            self._arrow(painter, QPointF(start, height), QPointF(end, height))
            middle = 0.5 * (start + end)
            middle = min(max(middle, 34.0), self.width() - 34.0)
            painter.setPen(QColor(appearance.theme.muted))
            painter.drawText(QRectF(middle - 60, top[0].top() - 20, 120, 16), Qt.AlignmentFlag.AlignCenter, _(name))

    def _back_emf(self, painter: QPainter, coil: QRectF, moving: QRectF, tissue: QRectF) -> None:
        start = QPointF(moving.left() + 0.25 * moving.width(), moving.bottom())
        end = QPointF(coil.center().x(), coil.bottom())
        low = 0.5 * (moving.bottom() + tissue.top()) + 8.0
        path = QPainterPath(start)
        path.cubicTo(QPointF(start.x(), low), QPointF(end.x(), low), QPointF(end.x(), end.y() + _HEAD))
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.setPen(QPen(QColor(appearance.theme.muted), 1.2, Qt.PenStyle.DashLine))
        painter.drawPath(path)
        self._head(painter, QPointF(end.x(), end.y() + _HEAD), end)
        painter.setPen(QColor(appearance.theme.muted))
        area = QRectF(0.5 * (start.x() + end.x()) - 50, low + 1, 100, 16)
        painter.drawText(area, Qt.AlignmentFlag.AlignCenter, _("back-EMF"))

    def _arrow(self, painter: QPainter, start: QPointF, end: QPointF) -> None:
        painter.setPen(QPen(QColor(appearance.theme.muted), 1.2))
        painter.drawLine(start, end)
        self._head(painter, start, end)

    def _head(self, painter: QPainter, start: QPointF, end: QPointF) -> None:
        along = end - start
        length = max((along.x() ** 2 + along.y() ** 2) ** 0.5, 1e-6)
        unit = along / length
        side = QPointF(-unit.y(), unit.x())
        back = end - unit * _HEAD
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(QColor(appearance.theme.muted))
        painter.drawPolygon(QPolygonF([end, back + side * (0.6 * _HEAD), back - side * (0.6 * _HEAD)]))

    def _place(self, stage: Stage) -> QRectF:
        middle, row = _PLACES[stage]
        column = (self.width() - 2.0 * _MARGIN + 20.0) / 4.0
        x = _MARGIN - 10.0 + column * middle
        rows = max(self.height() - 20.0 - 2.0 * _BOX_HEIGHT - 4.0, 20.0)
        y = 20.0 + row * (_BOX_HEIGHT + rows)
        width = _SHARE_OF_COLUMN * column
        return QRectF(x - 0.5 * width, y, width, _BOX_HEIGHT)

    def _small(self) -> QFont:
        font = self.font()
        font.setPointSizeF(max(7.5, 0.85 * font.pointSizeF()))
        return font


class _Box(QAbstractButton):
    """Clickable box of one stage in the picture of the signal chain."""

    def __init__(self, stage: Stage, parent: QWidget) -> None:
        super().__init__(parent)
        self._title = _(STAGE_TITLES[stage])
        self._share, self._lit = 0.0, False
        build.styled(
            self, checkable=True, focus_policy=Qt.FocusPolicy.StrongFocus, cursor=Qt.CursorShape.PointingHandCursor
        )
        self.show_share(0.0, lit=False)

    def show_share(self, share: float, *, lit: bool) -> None:
        """Show the share (0 to 1), and whether the stage is at fault."""
        self._share, self._lit = share, lit
        text = f"{100.0 * share:.0f} %" if share > 0.0 else _("named cause") if lit else _("only noise")
        self.setText(text)
        fault = _(", at fault") if lit else ""
        of = _("of what noise does not explain") if share > 0.0 else ""
        build.styled(
            self,
            name=_("Stage {title}, {share} {of}").format(title=self._title, share=text, of=of).strip() + fault,
            tip=f"{self._title}: {text} {of}".strip() + f"{fault}. {_('Click for its evidence.')}",
        )
        self.update()

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        """Draw the box; its colour is deeper for a larger share."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        area = QRectF(self.rect()).adjusted(2, 2, -2, -2)
        painter.setBrush(QColor(appearance.theme.field))
        painter.setPen(Qt.PenStyle.NoPen)
        painter.drawRoundedRect(area, 5, 5)
        painter.setBrush(faint(appearance.theme.poor, round(_DARKEST * min(self._share, 1.0))))
        edge, width = (appearance.theme.poor, 3.0) if self._lit else (appearance.theme.edge, 1.0)
        painter.setPen(QPen(QColor(edge), width))
        painter.drawRoundedRect(area, 5, 5)
        if self.hasFocus() or self.isChecked():
            style = Qt.PenStyle.DashLine if self.hasFocus() else Qt.PenStyle.SolidLine
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.setPen(QPen(QColor(appearance.theme.accent), 1.5, style))
            painter.drawRoundedRect(area.adjusted(3, 3, -3, -3), 3, 3)
        font = self.font()
        font.setBold(self._lit)
        painter.setFont(font)
        painter.setPen(QColor(appearance.theme.text))
        half = 0.5 * area.height()
        painter.drawText(area.adjusted(0, 3, 0, -half + 2), Qt.AlignmentFlag.AlignCenter, self._title)
        font.setBold(False)
        font.setPointSizeF(max(7.5, 0.85 * font.pointSizeF()))
        painter.setFont(font)
        painter.drawText(area.adjusted(0, half - 2, 0, -3), Qt.AlignmentFlag.AlignCenter, self.text())

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        """Click on Return; leave the arrow keys to the chain."""
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            self.click()
        elif Qt.Key(event.key()) in _ARROWS:
            event.ignore()
        else:
            super().keyPressEvent(event)


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


class DiagnosisPage(QScrollArea):
    """Shows the content of a diagnosis, with buttons to save its outputs or to repeat it."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._story: PageContent | None = None
        build.styled(
            self,
            widget_resizable=True,
            frame_shape=QFrame.Shape.NoFrame,
            focus_policy=Qt.FocusPolicy.NoFocus,
            minimum_width=_LEAST_WIDTH,
        )
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
        pages = (
            (self.where, _("Where")),
            (self.which, _("Which")),
            (self.far, _("How far")),
            (self.next, _("Next test")),
        )
        self.tabs = build.tabs(_("Where, which, how far, what next"), *pages)
        build.single_tab_stop(self.tabs)
        self.chain.chosen.connect(self._show_stage)
        self._arrange()

    @property
    def buttons(self) -> tuple[QPushButton, ...]:
        """Buttons for the diagnosis."""
        return self.again, self.accept, self.report, self.export

    @property
    def fields(self) -> list[QWidget]:
        """Widgets in tab order."""
        first = [*self.buttons, *self.chain.stages.values(), self.tabs.tabBar()]
        return [*first, self.which.table, self.far.channel, *self.next.fields]

    def show_story(self, story: PageContent, state: State = "") -> None:
        """Show a diagnosis and the state of its session file."""
        self._story = story
        for widget in (self._verdict, self.headline):
            show_level(widget, "check" if state == "changed" else story.level)
        self.headline.setText(as_title(story.headline))
        for label, lines in ((self.means, story.means), (self.remarks, story.remarks)):
            build.show_text(label, " ".join(map(as_sentence, lines)))
        advised = _("What to do: {advice}").format(advice=" ".join(map(as_sentence, story.todo)))
        build.show_text(self.todo, advised if story.todo else "")
        self.chain.show_shares([(item.stage, item.share, item.lit) for item in story.stages])
        first = story.at_fault[0] if story.at_fault else story.stages[0].stage
        self.chain.choose(first)
        self._show_stage(first)
        for tab in (self.where, self.which, self.far, self.next):
            tab.show_story(story)
        build.show_text(self.stale, _(_STALE[state]) if state else "")
        self.again.setVisible(state == "changed")
        self.accept.setVisible(state != "changed")
        self.verticalScrollBar().setValue(0)

    def update_enabled(self, *, busy: bool, testing: bool, working: bool) -> None:
        """Enable or disable the controls."""
        for button in self.buttons:
            button.setEnabled(not (busy or (working and button in (self.again, self.accept))))
        self.next.prepare.setEnabled(not testing)

    def _show_stage(self, stage: Stage) -> None:
        if self._story is None:
            return
        content = next(item for item in self._story.stages if item.stage == stage)
        self.stage.setText(
            (_("Evidence: {stage} (at fault)") if content.lit else _("Evidence: {stage}")).format(
                stage=_(STAGE_TITLES[stage])
            )
        )
        self.evidence.setText("\n".join(map(as_sentence, content.evidence)))
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
