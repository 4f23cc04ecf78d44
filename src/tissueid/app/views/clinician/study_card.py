"""The card of a sitting in a study: the next test, its site on a body, and the progress."""

from __future__ import annotations

from collections.abc import Collection

from PySide6.QtCore import QPointF, QRectF, QSize, Qt
from PySide6.QtGui import QColor, QFont, QPainter, QPaintEvent, QPalette, QPen
from PySide6.QtWidgets import QFrame, QProgressBar, QSizePolicy, QVBoxLayout, QWidget

from tissueid.app.build import button, column, fill, label, row, styled
from tissueid.app.small_window import FoldingBox
from tissueid.app.theme import appearance
from tissueid.app.views.clinician.body_map import HEIGHT, SPOTS, WIDTH, Side, Spot, outline
from tissueid.app.widgets import ElidedLabel
from tissueid.formatting import clean
from tissueid.language import _
from tissueid.messages import Message, Verbatim, translated
from tissueid.procedures.study_protocol import finished_sites
from tissueid.procedures.study_sitting import SittingState

_SIDES: tuple[Side, ...] = ("front", "back")
_SIZE = QSize(122, 146)
_CAPTION = 16.0
"""Pixels for the captions."""


class SittingMap(QWidget):
    """Both sides of a body. Sites that are not standard ones are not drawn."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._outline = outline()
        self.next_site = ""
        self.sites: tuple[str, ...] = ()
        self.finished: frozenset[str] = frozenset()
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Fixed)

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return a fixed size, which fits next to a few words in a narrow window."""
        return _SIZE

    def show_sites(self, sites: Collection[str], next_site: str, finished: Collection[str]) -> None:
        """Show the sites of a sitting; ``next_site`` is "" when it is complete."""
        self.sites, self.next_site, self.finished = tuple(sites), next_site, frozenset(finished)
        self.setAccessibleName(
            _("Body map: next site {site}; finished: {finished}").format(
                site=next_site or _("none"), finished="; ".join(sorted(finished)) or _("none")
            )
        )
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:  # noqa: N802
        """Draw both sides next to each other, each with its sites."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        font = QFont(self.font())
        font.setPointSizeF(0.8 * font.pointSizeF())
        painter.setFont(font)
        width = self.width() / len(_SIDES)
        scale = min(width / WIDTH, (self.height() - _CAPTION) / HEIGHT)
        for index, (side, caption) in enumerate(zip(_SIDES, (_("Front"), _("Back")), strict=True)):
            x0 = index * width + (width - scale * WIDTH) / 2
            self._draw_side(painter, side, scale, x0)
            painter.setPen(QColor(appearance.theme.muted))
            area = QRectF(index * width, self.height() - _CAPTION, width, _CAPTION)
            painter.drawText(area, Qt.AlignmentFlag.AlignCenter, caption)
        painter.end()

    def _draw_side(self, painter: QPainter, side: Side, scale: float, x0: float) -> None:
        painter.save()
        painter.translate(x0, 0.0)
        painter.scale(scale, scale)
        pen = QPen(QColor(appearance.theme.muted), 1.2)
        pen.setCosmetic(True)
        painter.setPen(pen)
        painter.setBrush(self.palette().color(QPalette.ColorRole.Base))
        painter.drawPath(self._outline)
        painter.restore()
        shown = [spot for spot in SPOTS if spot.side == side and spot.site in self.sites]
        for spot in sorted(shown, key=lambda spot: spot.site == self.next_site):
            self._draw_site(painter, spot, QPointF(x0 + scale * spot.x, scale * spot.y))

    def _draw_site(self, painter: QPainter, spot: Spot, at: QPointF) -> None:
        accent, good = QColor(appearance.theme.accent), QColor(appearance.theme.good)
        if spot.site == self.next_site:
            halo = QColor(accent)
            halo.setAlpha(70)
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(halo)
            painter.drawEllipse(at, 10.0, 10.0)
            painter.setBrush(accent)
            painter.drawEllipse(at, 5.5, 5.5)
        elif spot.site in self.finished:
            painter.setPen(QPen(good, 2.4, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap, Qt.PenJoinStyle.RoundJoin))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawPolyline([at + QPointF(-5.0, 0.0), at + QPointF(-1.5, 4.0), at + QPointF(5.5, -4.5)])
        else:
            painter.setPen(QPen(QColor(appearance.theme.muted), 1.5))
            painter.setBrush(self.palette().color(QPalette.ColorRole.Base))
            painter.drawEllipse(at, 4.0, 4.0)


_BUTTONS_IN_A_ROW = 250
"""Width from which the buttons are in one row, pixels."""


class StudyCard(QFrame):
    """Hidden without a study. Its buttons ask for the subject's data, a photograph, or the end of the sitting."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        styled(self, role="card")
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Maximum)
        self.heading = styled(ElidedLabel(), role="heading")
        self.progress_text = label("headline")
        self.site, self.test, self.condition = label("heading"), label(), label()
        self.remark = label("readout", level="check")
        self.map = SittingMap()
        self.bar = styled(QProgressBar(), name=_("Progress of the sitting"), text_visible=False)
        self.data = button(_("Subject…"), role="small", name=_("Demographic values of the subject"))
        self.photograph = button(_("Photograph…"), role="small", name=_("Add a photograph of the site"))
        leaving = _("What is recorded is kept; the sitting continues when it is opened again")
        self.leave = button(_("Leave"), role="small", name=_("Leave the sitting of the study"), tip=leaving)
        self.next_subject = button(_("Next subject…"), role="small", tip=_("Leave, and choose a subject of the study"))
        self.buttons = self.data, self.photograph, self.leave, self.next_subject
        texts = column(self.progress_text, self.site, self.test, self.condition, self.remark, None, spacing=2)
        holder = QWidget()
        fill(FoldingBox(_BUTTONS_IN_A_ROW, holder), *self.buttons)
        fill(QVBoxLayout(self), self.heading, row(self.map, (texts, 1), spacing=8), self.bar, holder, margins=(8,))
        self.hide()

    def show_state(self, state: SittingState, *, moved: bool) -> None:
        """Show where a sitting is and what comes next; ``moved`` is whether the probe goes to another site now."""
        step, protocol, total = state.step, state.protocol, state.total
        names = {"study": Verbatim(clean(protocol.name)), "subject": Verbatim(state.subject)}
        self.heading.setText(translated(Message("study.heading", "{study}: {subject}", **names)))
        finished = finished_sites(protocol, state.subject, step)
        self.map.show_sites([site.site for site in protocol.sites], step.site if step else "", finished)
        self.bar.setRange(0, total)
        self.bar.setValue(step.position - 1 if step else total)
        self.photograph.setVisible(protocol.photograph)
        self.next_subject.setVisible(step is None)
        if step is None:
            texts = [_("Complete"), Message("study.all", "All {total} tests are done.", total=total), "", "", ""]
        else:
            texts = [
                Message("study.place", "{place} of {total}", place=step.position, total=step.total),
                Verbatim(clean(step.site)),
                Message("study.repeat", "Test {repeat} of {count} here", repeat=step.repeat, count=step.repeats),
                step.condition.text,
                _("Again: the last test does not count.")
                if step.attempt > 1
                else _("Move the probe to this site.")
                if moved
                else "",
            ]
        shown = self.progress_text, self.site, self.test, self.condition, self.remark
        for part, text in zip(shown, texts, strict=True):
            part.setText(translated(text))
            part.setVisible(bool(text))
        self.show()

    def update_enabled(self, *, busy: bool) -> None:
        """Disable the buttons while a job runs."""
        for widget in self.buttons:
            widget.setEnabled(not busy)
