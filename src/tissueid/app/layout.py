"""Layout of the main window and its tab order."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from itertools import pairwise
from pathlib import Path

from PySide6.QtCore import QSize, Qt, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import (
    QAbstractButton,
    QComboBox,
    QFrame,
    QLabel,
    QMainWindow,
    QPushButton,
    QScrollArea,
    QStackedWidget,
    QWidget,
)

from tissueid.app import build
from tissueid.app.calibration_page import CalibrationPage
from tissueid.app.context import AppState
from tissueid.app.form import PlanForm
from tissueid.app.guidance import Guidance
from tissueid.app.live_analysis import LiveAnalysis
from tissueid.app.navigation_bar import MEASURE, NavigationBar
from tissueid.app.notice import Notice, NoticeLine
from tissueid.app.panels import HelpPanel
from tissueid.app.quality_gate import QualityGatePanel
from tissueid.app.readouts import SafetyReadouts
from tissueid.app.result import ResultPage
from tissueid.app.signals import SignalPlots
from tissueid.app.small_window import FoldingBox, PageScroll
from tissueid.app.views.clinician.study_card import StudyCard
from tissueid.app.widgets import BigButton
from tissueid.app.window_state import RoleChooser
from tissueid.app.words import RESEARCH_USE
from tissueid.audit import Role
from tissueid.language import _

SMALLEST = 800, 400
"""Least size of the window: a screen of 1280x720 at 150 % (853x480), less its task bar and a title bar, pixels."""
SIDE_WIDTH = 330
_NARROW_SIDE_WIDTH = 284
_NARROW = 1000
"""Width of the window below which the side is narrow."""
_HELP_WIDTH = 320
_ROOM_FOR_HELP = 1100
"""Width of the window below which the help takes the place of the page: the widest page needs 700, pixels."""
_ANY_WIDTH = 16_777_215
"""Qt's bound of a width."""
_TITLE_BAR = 40
_LEAST_ROOM = 480, 256
_LEAST_TABS = 200
_LEAST_FORM = 20
_TWO_COLUMNS = 560


class _Room(QWidget):
    """What the window holds. ``resized`` carries the new width."""

    resized = Signal(int)

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Pass the new width on."""
        super().resizeEvent(event)
        self.resized.emit(event.size().width())


def _takes_tab(widget: QWidget) -> bool:
    """Return whether the tab key stops at a widget now."""
    stops = bool(widget.focusPolicy() & Qt.FocusPolicy.TabFocus) and widget.focusProxy() is None
    return stops and widget.isVisible() and widget.isEnabled()


class Layout:
    """The parts of the window."""

    def __init__(self, window: QMainWindow, folder: Path, now: Callable[[], datetime], state: AppState) -> None:
        self.state = state
        self._help: HelpPanel | None = None
        self.form = PlanForm(folder, now)
        self.study_card = StudyCard()
        self._side_frame = QFrame()
        self.role = RoleChooser(state.role)
        self.safety = SafetyReadouts()
        self.gate = QualityGatePanel()
        self._verdict = build.holder(build.column(self.gate))
        self.start = build.styled(BigButton(_("&Start test")), role="start")
        self.stop = build.styled(
            BigButton(_("STOP – release coil")),
            role="stop",
            name=_("STOP, release the coil"),
            tip=_("Escape and Space do the same"),
        )
        self.open = QPushButton(_("&Open session…"))
        self.report = QPushButton(_("Open &report"))
        self.notice = Notice()
        self.guidance = Guidance()
        self.signals = SignalPlots()
        self.analysis = LiveAnalysis()
        self.running = self._make_running()
        self.result = ResultPage()
        self.calibration = CalibrationPage()
        parts = (self.running, _("Sig&nals")), (self.result, _("Res&ult")), (self.calibration, _("Calibration"))
        self.pages = build.tabs(_("Signals and result"), *parts)
        build.single_tab_stop(self.pages)
        self.pages.setTabVisible(1, False)
        self.pages.currentChanged.connect(self._turn_tab)
        self.rail = NavigationBar()
        self.halt = build.button(
            _("STOP"),
            role="halt",
            name=_("STOP, release the coil, from any page"),
            tip=self.stop.toolTip(),
            hidden=True,
        )
        self.stack = QStackedWidget()
        self.views: dict[str, QWidget] = {}
        self.holders: dict[str, QWidget] = {}
        self.show_role(state.role)
        window.setMenuWidget(self._header())  # over the whole width, whatever is docked below it
        self._central = self._arrange()
        window.setCentralWidget(self._central)
        window.setMinimumSize(*SMALLEST)
        room = window.screen().availableSize() - QSize(0, _TITLE_BAR)
        window.resize(QSize(1280, 720).boundedTo(room))

    def _turn_tab(self, index: int) -> None:
        """Show the guidance of a calibration, or of a test with its verdict."""
        calibrating = self.pages.widget(index) is self.calibration
        self.guidance.turn_to_calibration(calibrating)
        self._verdict.setVisible(not calibrating)

    def show_role(self, role: Role) -> None:
        """Show the parts of a role."""
        for part in (self.form, self.gate, self.result, self.analysis):
            part.show_role(role)
        self.pages.setTabVisible(2, role == "technician")

    def order_tabs(self) -> None:
        """The order in which the tab key visits the guided test, once all pages stand."""
        gate, lamp, result = self.gate, self.guidance.lamp, self.result
        order: list[QWidget] = [
            *(*self.study_card.buttons, *self.form.fields, lamp.watch, lamp.arm, self.start, self.stop),
            *(self.role.choice, self.open, self.report, self.notice.offer, self.notice.dismiss),
            *(gate.more, gate.judge_now, gate.calibrate, gate.run_again),
            *(gate.repeats.repeat, gate.repeats.accept, gate.repeats.undo, self.pages.tabBar(), self.analysis.tabs),
            *(result, result.test, result.details, result.pdf, result.comparison.cancel),
            *(*self.calibration.fields, *self.rail.buttons.values(), *self.rail.feet),
        ]
        for before, after in pairwise(order):
            QWidget.setTabOrder(before, after)
        self.form.order_options()
        self.form.site.setFocus()

    def add_page(self, name: str, page: QWidget) -> None:
        """Add the page of a button of the navigation bar; the button may exist before it."""
        self.views[name] = page
        self.holders[name] = page if name == MEASURE else PageScroll(page)
        self.stack.addWidget(self.holders[name])

    def show_page(self, name: str) -> None:
        """Show a page. STOP stays visible while a coil can be energised."""
        self.stack.setCurrentWidget(self.holders[name])
        self._make_room()
        self.notice.turn_to(name)
        self.rail.show_chosen(name)
        self._show_halt()

    def focus_page(self) -> None:
        """Put the focus into the shown page: where it was there before, or to its first control."""
        page = self.holders[self.page]
        last: QWidget | None = page.focusWidget()
        if last is None or last in self.guarded or not _takes_tab(last):
            last = self.form.site if self.page == MEASURE else page.nextInFocusChain()
            while last is not None and last is not page and not (page.isAncestorOf(last) and _takes_tab(last)):
                last = last.nextInFocusChain()
        if last is not None and last is not page:
            last.setFocus(Qt.FocusReason.OtherFocusReason)

    def add_help(self, panel: HelpPanel) -> None:
        """Put the help, closed, to the right of the page, or in its place where the window is narrow."""
        panel.hide()
        self._help = panel
        build.splitter((self.stack, 1), (panel, 0), sizes=(_ANY_WIDTH, _HELP_WIDTH), made=self._beside)
        panel.turned.connect(self._make_room)

    @property
    def help_replaces(self) -> bool:
        """Whether the help is shown in place of the page."""
        return self._help is not None and not self._help.isHidden() and self._central.width() < _ROOM_FOR_HELP

    def make_way(self) -> None:
        """Close the help where it covers the page."""
        if self._help is not None and self.help_replaces:
            self._help.hide()

    def _make_room(self) -> None:
        """Hide what has no room next to the help; form, Start and STOP stay."""
        if self._help is None or not self.holders:
            return
        replaced, measuring = self.help_replaces, self.page == MEASURE
        self.main_scroll.setVisible(not replaced)
        self.stack.setMaximumWidth(self._side_frame.width() if replaced and measuring else _ANY_WIDTH)
        self.stack.setVisible(measuring or not replaced)

    @property
    def page(self) -> str:
        """The name of the page that is shown."""
        return next(name for name, page in self.holders.items() if page is self.stack.currentWidget())

    def _show_halt(self) -> None:
        self.halt.setVisible(self.state.testing and self.page != MEASURE)

    def update_enabled(self, *, has_result: bool) -> None:
        """Enable what makes sense: while a test runs that is STOP alone."""
        self._show_halt()
        self.form.setEnabled(not self.state.testing)
        self.calibration.update_enabled(busy=self.state.busy)
        self.report.setVisible(has_result)
        of_test = self.start, self.gate.run_again, self.gate.judge_now, self.form.instrument.refresh
        for part in (*of_test, self.role, self.open, self.report, self.result.test, self.notice.offer):
            part.setEnabled(not self.state.busy)

    @property
    def waiting(self) -> tuple[QWidget, ...]:
        """What is grey while something goes on elsewhere: on these it is said what that is."""
        of_test = self.start, self.guidance.lamp.watch, self.form.instrument.refresh, self.gate.run_again
        of_result = self.open, self.report, self.result.pdf, self.result.test
        of_sitting = self.gate.repeats.repeat, self.gate.repeats.accept, self.gate.repeats.undo, self.gate.judge_now
        return *of_test, *of_result, *of_sitting, *self.calibration.begin.values()

    @property
    def energising(self) -> tuple[QAbstractButton, ...]:
        """The buttons of the page Measure that start something that energises a coil."""
        return self.start, self.gate.run_again, self.gate.repeats.repeat, *self.calibration.begin.values()

    @property
    def guarded(self) -> tuple[QAbstractButton, ...]:
        """What energises a coil, or allows a button of the instrument to: a key that is typed must not press it."""
        return *self.energising, self.calibration.done, self.guidance.lamp.watch, self.guidance.lamp.arm

    @property
    def harmless(self) -> tuple[QAbstractButton, ...]:
        """The other buttons of that page that the command palette offers."""
        of_form = self.form.instrument.refresh, self.form.map
        return self.gate.repeats.accept, self.guidance.lamp.watch, *of_form, self.result.pdf, *self.study_card.buttons

    def _arrange(self) -> QWidget:
        page = _Room()
        page.resized.connect(self._fold)
        page.setMinimumSize(*_LEAST_ROOM)  # next to the docks
        line = NoticeLine(self.notice)
        self._beside = build.splitter((self.stack, 1))
        columns = build.row(self.rail, (build.column(line, (self._beside, 1), spacing=0), 1), spacing=0)
        build.column((columns, 1), spacing=0, parent=page)
        self.notice.setParent(page)
        return page

    def test_page(self) -> QWidget:
        """Create the page of the guided test: the form at the side, signals and result next to it."""
        self.pages.setMinimumHeight(_LEAST_TABS)
        content = build.column(self.guidance, self._verdict, (self.pages, 1), spacing=8, margins=(12, 10, 12, 10))
        self.main_scroll = PageScroll(build.holder(content))
        return build.holder(build.row(self._side(), (self.main_scroll, 1), spacing=0))

    def show_part(self, part: QWidget) -> None:
        """Show a tab of the guided test from its top: the signals, the result or the calibration."""
        self.pages.setTabVisible(self.pages.indexOf(part), True)
        self.pages.setCurrentWidget(part)
        self.main_scroll.verticalScrollBar().setValue(0)

    def _make_running(self) -> QWidget:
        """Signals and live estimates, below each other where there is no room for two columns."""
        plots = build.fill(FoldingBox(_TWO_COLUMNS), (self.signals, 3), (self.analysis, 4), spacing=8)
        return PageScroll(build.holder(plots))

    def _fold(self, width: int) -> None:
        """Give the page more of a narrow window."""
        narrow = width < _NARROW
        self._research.setWordWrap(narrow)
        self._side_frame.setFixedWidth(_NARROW_SIDE_WIDTH if narrow else SIDE_WIDTH)
        self._make_room()

    def _header(self) -> QWidget:
        header = build.styled(QFrame(), role="header")
        title = build.styled(QLabel("TissueID"), role="title")
        self._research = build.styled(QLabel(_(RESEARCH_USE)), role="research")
        parts = title, self._research, None, self.halt, self.role, self.open, self.report
        build.row(*parts, spacing=10, margins=(14, 7, 12, 7), parent=header)
        return header

    def _side(self) -> QWidget:
        """The form, scrolled where it does not fit, above what is always there: how things stand, and two buttons."""
        scroll = build.styled(
            QScrollArea(),
            widget=build.holder(build.column(self.study_card, self.form, spacing=10, margins=(14, 10, 14, 10))),
            widget_resizable=True,
            frame_shape=QFrame.Shape.NoFrame,
            focus_policy=Qt.FocusPolicy.NoFocus,
            minimum_height=_LEAST_FORM,
        )
        for choice in self.form.findChildren(QComboBox):  # or the longest entry decides how wide the form is
            choice.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        below = [build.row(part, spacing=None, margins=(14, 0, 14, 0)) for part in (self.safety, self.start, self.stop)]
        side = build.styled(self._side_frame, role="side", fixed_width=SIDE_WIDTH)
        build.column((scroll, 1), *below, spacing=8, margins=(0, 0, 0, 12), parent=side)
        return side
