"""The page ``instrument`` for technicians, and its first tab: health, calibrations, faults and the audit log."""

from __future__ import annotations

import functools
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from PySide6.QtCore import QPointF, Qt
from PySide6.QtGui import QColor, QPainter, QPaintEvent, QPen, QShowEvent
from PySide6.QtWidgets import QAbstractButton, QFrame, QLabel, QWidget

from tissueid.app import build
from tissueid.app.build import button, column, styled, timer
from tissueid.app.context import AppContext, View
from tissueid.app.jobs import PageJob
from tissueid.app.plotting import PlotCard
from tissueid.app.theme import appearance, faint
from tissueid.app.views.technician.calibrations import CalibrationsTab
from tissueid.app.views.technician.checkup import Background, LastTest, Light, background, light
from tissueid.app.views.technician.events import moment
from tissueid.app.views.technician.log_tabs import AuditTab, FaultsTab, SearchedTab
from tissueid.app.views.technician.tab import FactsCard, Tab
from tissueid.app.widgets import plain_tip, show_level
from tissueid.app.words import calibration_state
from tissueid.calibration.active import apply_calibrations
from tissueid.calibration.file import Calibration
from tissueid.device import DeviceDescription
from tissueid.formatting import clean, figure_text, fixed, grouped, number
from tissueid.language import _, marked
from tissueid.procedures.instruments import Checkup, LinkStatistics, run_checkup
from tissueid.units import unit_of

_LEVELS = ("poor", "check", "good")
_WORDS = {"poor": marked("red"), "check": marked("yellow"), "good": marked("green"), "": marked("dark")}
_RADIUS = 12.0
_STEP = 32.0


class Lamps(QWidget):
    """Red above yellow above green; the lit one is full and has a ring, the others are outlines."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._level = ""
        self.setFixedSize(36, round(3 * _STEP + 4))
        self.show_level("")

    @property
    def level(self) -> str:
        """Level of the lit lamp."""
        return self._level

    def show_level(self, level: str) -> None:
        """Light a lamp, or none."""
        self._level = level
        build.styled(
            self,
            name=_("Traffic light: {colour}").format(colour=_(_WORDS[level])),
            tip=_("Traffic light: {colour}").format(colour=_(_WORDS[level])),
        )
        self.update()

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        """Draw the lamps."""
        super().paintEvent(event)
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        for row, level in enumerate(_LEVELS):
            centre = QPointF(0.5 * self.width(), (row + 0.5) * _STEP + 2.0)
            lit = level == self._level
            colour = QColor(getattr(appearance.theme, level))
            painter.setBrush(colour if lit else faint(appearance.theme.line, 120))
            painter.setPen(QPen(colour if lit else QColor(appearance.theme.edge), 1.0))
            painter.drawEllipse(centre, _RADIUS, _RADIUS)
            if lit:
                painter.setBrush(Qt.BrushStyle.NoBrush)
                painter.setPen(QPen(colour, 1.5))
                painter.drawEllipse(centre, _RADIUS + 3.0, _RADIUS + 3.0)
        painter.end()


_MOST_REASONS = 5
_FORCE = "force_constant_n_per_a"


class HealthTab(Tab):
    """Asks the chosen instrument, in a job; the calibrations and the newest test are read without asking."""

    def __init__(self, context: AppContext, page_job: PageJob, parent: QWidget | None = None) -> None:
        super().__init__(context, page_job, parent)
        self._answer: Checkup | None = None
        self._problem, self._failed_url = "", ""
        self._known = Background(None, ())
        self.lamps = Lamps()
        self.headline = build.label("headline")
        self.reasons = build.label()
        self.chosen = build.label("muted")
        self.ask = build.button(
            _("Check the instrument"),
            self.begin_asking,
            tip=_("Opens the chosen instrument, listens for a second, closes it; the coil stays free (F5)"),
        )
        self.identity = FactsCard(_("Instrument"))
        self.state = FactsCard(_("Active calibration"))
        self.link = FactsCard(_("Cable and samples"))
        self.trend = PlotCard(
            _("Force constant by date"),
            _("Days from today"),
            _("N per A"),
            key={_("static"): "measured", _("sweep"): "model"},
        )
        self._static = self.trend.dots("measured", 7)
        self._sweep = self.trend.dots("model", 7)
        build.column(
            self._make_verdict(),
            build.row(*[(card, 1) for card in (self.identity, self.state, self.link)], spacing=8),
            (self.trend, 1),
            spacing=8,
            margins=(0, 8, 0, 0),
            parent=self,
        )
        self._show()
        self._show_trend()

    def _make_verdict(self) -> QFrame:
        self.verdict = build.styled(QFrame(), role="verdict")
        build.row(
            self.lamps,
            (build.column(self.headline, self.reasons, None, self.chosen, spacing=3), 1),
            build.column(self.ask, None, spacing=14),
            spacing=14,
            margins=(12, 8, 12, 8),
            parent=self.verdict,
        )
        return self.verdict

    # -- work ---------------------------------------------------------------------------------------------

    def load(self) -> None:
        """Read the newest test and the calibrations."""
        services = self.context.services
        work = functools.partial(background, services.folder, services.calibrations, services.audit.path)
        self.read_files(_("Reading calibrations and the newest test…"), work)

    def _loaded(self, background: Background) -> None:
        self._known, self.read = background, True
        answer = self._answer
        if answer is not None and not background.problem:  # its calibration may be another one now
            device = apply_calibrations(answer.nominal, background.stored, datetime.now(UTC))
            self._answer = replace(answer, device=device)
        self.show_chosen()

    def begin_asking(self) -> None:
        """Ask the chosen instrument."""
        if self.context.busy:
            return
        url = self.context.instrument()
        if not url:
            self.context.say(_("Choose an instrument on the page Measure first."), problem=True)
            return
        services = self.context.services
        work = functools.partial(run_checkup, url, services.opener, services.calibrate)
        self.page_job.start(_("Asking {url}…").format(url=clean(url)[:60]), work, self._answered, self._unanswered)

    def _answered(self, checkup: Checkup) -> None:
        self._answer, self._problem = checkup, ""
        self.show_chosen()

    def _unanswered(self, message: str) -> None:
        if message:
            self._answer, self._problem, self._failed_url = None, message, self.context.instrument()
            self.show_chosen()

    @property
    def checkup(self) -> Checkup | None:
        """The answer of the chosen instrument; None where it was not asked."""
        answer = self._answer
        return answer if answer is not None and answer.url == self.context.instrument() else None

    # -- showing ------------------------------------------------------------------------------------------

    def update_enabled(self, *, busy: bool) -> None:
        """Asking is slow."""
        self.ask.setEnabled(not busy)
        self._name_chosen()

    def show_chosen(self) -> None:
        """Show what is known of the chosen instrument."""
        self._show()
        self._show_trend()

    def _name_chosen(self) -> None:
        url = clean(self.context.instrument())[:120]
        text = (
            _("Chosen on the page Measure: {url}").format(url=url)
            if url
            else _("No instrument is chosen on the page Measure.")
        )
        self.chosen.setText(text)

    @property
    def light(self) -> Light:
        """The traffic light of the instrument."""
        problem = self._problem if self._failed_url == self.context.instrument() else ""
        return light(self.checkup, problem, self._known.fault)

    def _show(self) -> None:
        light = self.light
        self.lamps.show_level(light.level)
        self.headline.setText(_(light.headline))
        reasons = [_(reason) for reason in light.reasons]
        more = len(reasons) - _MOST_REASONS
        lines = [*reasons[:_MOST_REASONS], *([_("… and {count} more.").format(count=more)] if more > 0 else [])]
        self.reasons.setText("\n".join(clean(line) for line in lines))
        self.reasons.setToolTip(plain_tip("\n".join(clean(line) for line in reasons[:40])))
        self.verdict.setAccessibleName(" ".join([_(light.headline), *reasons]))
        for widget in (self.verdict, self.headline):
            show_level(widget, light.level)
        self._name_chosen()
        self.identity.show_facts(_identity(self.checkup))
        self.state.show_facts(_calibration(self.checkup, self._known))
        self.link.show_facts(_link(self.checkup, self._known.last))

    def _show_trend(self) -> None:
        """The force constant of the asked instrument's calibrations; of the newest one's before it was asked."""
        passed = [item.calibration for item in self._known.stored if item.calibration is not None]
        passed = [item for item in passed if item.verdict == "passed" and _FORCE in item.quantities]
        serial = self.checkup.device.serial_number if self.checkup else passed[0].serial_number if passed else ""
        mine = [item for item in passed if item.serial_number == serial]
        whose = _(" of {serial}").format(serial=clean(serial)[:40]) if serial else ""
        self.trend.remark(clean(serial)[:40])
        if not mine:
            self.trend.say_missing(
                _(
                    "No calibration{whose} holds a force constant yet. “Calibrate…” under Calibrations makes one."
                ).format(whose=whose)
            )
            return
        self.trend.say_missing("")
        now = datetime.now(UTC)
        for dots, kind in ((self._static, "static"), (self._sweep, "sweep")):
            kept = [item for item in mine if item.kind == kind]
            dots.setData(*_dated(kept, now))
        x, y = _dated(mine, now)
        margin = max(0.02 * float(np.abs(y).max()), 0.15 * float(np.ptp(y)))
        self.trend.plot.setYRange(float(y.min()) - margin, float(y.max()) + margin, padding=0.0)
        self.trend.plot.setXRange(min(-1.0, 1.05 * float(x.min())), 0.02 * max(1.0, float(np.ptp(x))), padding=0.0)

    def take_units(self) -> None:
        """Show it in the units in force."""
        self._show()


def _dated(calibrations: list[Calibration], now: datetime) -> tuple[np.ndarray, np.ndarray]:
    days = np.array([-item.age_days(now) for item in calibrations], np.float64)
    return days, np.array([item.quantities[_FORCE].value for item in calibrations], np.float64)


def _identity(checkup: Checkup | None) -> dict[str, str]:
    if checkup is None:
        return {_("Model"): _("not checked")}
    device = checkup.device
    clinical, research = checkup.limits["clinical"], checkup.limits["research"]
    return {
        _("Model"): clean(device.model)[:80],
        _("Serial number"): clean(device.serial_number)[:60],
        _("Firmware"): clean(device.firmware_version)[:40] or _("not reported"),
        _("Protocol"): clean(device.protocol_version)[:20] or _("none, it is in this program"),
        _("Temperature"): f"{fixed(checkup.temperature_c, 1)} °C",
        _("Force limit"): _("{clinical} N clinical, {research} N research").format(
            clinical=number(clinical.max_force_n), research=number(research.max_force_n)
        ),
        _("Position limits"): _("{low} to {high} {unit}").format(
            low=figure_text("position", clinical.min_position_m),
            high=figure_text("position", clinical.max_position_m),
            unit=unit_of("position").symbol,
        ),
        _("Heat, time limit"): f"{number(clinical.max_temperature_c)} °C, {number(clinical.max_seconds)} s",
    }


def _calibration(checkup: Checkup | None, background: Background) -> dict[str, str]:
    facts: dict[str, str] = {}
    if background.problem:
        facts[_("Folder")] = background.problem
    else:
        facts[_("Calibrations in the folder")] = grouped(len(background.stored))
    if checkup is None:
        return {_("State"): _("not checked")} | facts
    device = checkup.device
    held = device.calibration
    facts = {_("State"): _(calibration_state(checkup.device).summary)} | facts
    for name, label in (("static", _("Static")), ("sweep", _("Sweep"))):
        if held.get(f"{name}_file"):
            facts[label] = f"{clean(str(held[f'{name}_file']))[:60]}, {clean(str(held.get(f'{name}_date', '')))[:10]}"
    facts[_("Force constant")] = _("{value} N per A").format(value=number(device.force_constant_n_per_a))
    facts[_("Resistance")] = f"{number(device.coil_resistance_ohm)} Ω"
    mass = unit_of("mass")
    facts[_("Moving mass")] = f"{number(mass.factor * device.moving_mass_kg)} {mass.symbol}"
    facts[_("Uncertainty of force")] = f"{number(100.0 * device.calibration_relative_uncertainty, 2)} %"
    return facts


def _link(checkup: Checkup | None, last: LastTest | None) -> dict[str, str]:
    facts: dict[str, str] = {}
    if checkup is None:
        facts[_("Now")] = _("not checked")
    else:
        facts[_("Samples")] = _("{samples}, {lost} of them lost").format(
            samples=grouped(checkup.samples), lost=grouped(checkup.lost)
        )
        facts[_("Current with the coil free")] = f"{fixed(1e3 * checkup.resting_a, 1)} mA"
        facts |= _cable(checkup.link)
    if last is None:
        return facts | {_("Newest test"): _("none in the folder of sessions")}
    share = f" ({fixed(100.0 * last.lost / last.samples, 2)} %)" if last.samples and last.lost else ""
    facts[_("Newest test")] = f"{moment(last.created)} UTC, {_(last.status)}"
    asked = None if checkup is None else (checkup.nominal.model, checkup.nominal.serial_number)
    other = asked is not None and (last.model, last.serial_number) != asked
    name = clean(", ".join(filter(None, (last.model, last.serial_number))))[:80]
    facts[_("– its instrument")] = _("another one: {name}").format(name=name) if other else name
    facts[_("– its samples")] = _("{samples}, {lost} lost{share}").format(
        samples=grouped(last.samples), lost=grouped(last.lost), share=share
    )
    facts[_("– its set-points")] = _("{late} blocks late, {held} samples held").format(
        late=grouped(last.late_blocks), held=grouped(last.held_samples)
    )
    return facts


def _cable(link: LinkStatistics | None) -> dict[str, str]:
    if link is None:
        return {_("Cable"): _("none: it is a simulation in this program")}
    trip = _("not measured") if link.round_trip_s is None else f"{fixed(1e3 * link.round_trip_s, 1)} ms"
    return {
        _("Frames"): _("{frames}, {damaged} damaged").format(
            frames=grouped(link.frames), damaged=grouped(link.damaged)
        ),
        _("Round trip"): trip,
        _("Requests repeated"): grouped(link.repeated),
    }


_TAB = "instrument/tab"
_TITLES = (marked("Health"), marked("Calibrations"), marked("Faults and events"), marked("Audit log"))


class InstrumentView(View):
    """The page ``instrument``. Each tab reads its files when it is first seen, and nothing else goes on."""

    name = "instrument"

    def __init__(self, context: AppContext, parent: QWidget | None = None) -> None:
        super().__init__(context, parent)
        self.page_job = PageJob(context.jobs, self)
        self._closing = self._busy = False
        self._answered: tuple[str, DeviceDescription] | None = None
        self.health = HealthTab(context, self.page_job)
        self.calibrations = CalibrationsTab(context, self.page_job)
        self.faults = FaultsTab(context, self.page_job)
        self.audit = AuditTab(context, self.page_job)
        self.all: tuple[Tab, ...] = (self.health, self.calibrations, self.faults, self.audit)
        self.doing = styled(QLabel(), role="muted", text_format=Qt.TextFormat.PlainText)
        ending = _("Ends what is being read or asked")
        self.give_up = button(_("Cancel"), self.page_job.cancel, role="small", tip=ending)
        self.tabs = build.tabs(_("Parts of the page Instrument"), *zip(self.all, map(_, _TITLES), strict=True))
        corner = build.row(self.doing, self.give_up, spacing=8, margins=(0, 0, 0, 2))
        self.tabs.setCornerWidget(build.holder(corner), Qt.Corner.TopRightCorner)
        column(self.tabs, margins=(12, 8, 12, 10), parent=self)
        self.refresh_timer = timer(self, 0, self._bring_up_to_date)
        build.restore_tab(self.tabs, context.settings.value(_TAB))
        self.tabs.currentChanged.connect(self._tab_changed)
        self.page_job.changed.connect(self._show_job)
        build.shortcut(self, "F5", self._again)
        build.shortcut(self, "Ctrl+F", self._search)
        self._show_job()

    def _again(self) -> None:
        """Handle F5: ask the instrument, or read the files of the tab again."""
        if self._busy:
            return
        if self.tabs.currentWidget() is self.health:
            self.health.begin_asking()
        else:
            self.current.load()

    def _search(self) -> None:
        tab = self.current
        if isinstance(tab, SearchedTab):
            tab.search.setFocus()
            tab.search.selectAll()

    @property
    def current(self) -> Tab:
        """The tab that is shown."""
        return self.all[self.tabs.currentIndex()]

    # -- what happens -------------------------------------------------------------------------------------

    def enter(self) -> None:
        """Mark the tabs as stale: files may have changed."""
        self._mark_stale()
        self.health.show_chosen()
        self._judge_chosen()
        self.refresh_timer.start()

    def showEvent(self, event: QShowEvent) -> None:  # noqa: N802
        """Read what is shown, once it is."""
        super().showEvent(event)
        self.refresh_timer.start()

    def _tab_changed(self) -> None:
        self.refresh_timer.start()

    def _bring_up_to_date(self) -> None:
        if self._closing or self._busy or self.context.busy or not self.isVisible():
            return
        if self.current.stale:
            self.current.load()

    def _show_job(self) -> None:
        """The words and the button of what goes on; the calibrations know of the instrument that has answered."""
        self.doing.setText(self.page_job.activity)
        self.give_up.setVisible(self.page_job.running)
        checkup = self.health.checkup
        if not self.page_job.running and checkup is not None:
            self._answered = checkup.url, checkup.nominal
            self.context.answered(checkup.url, checkup.device)
        self._judge_chosen()

    def _judge_chosen(self) -> None:
        """Judge the calibrations for the chosen instrument; for none, where another one answered last."""
        url, nominal = self._answered or ("", None)
        self.calibrations.tell_instrument(nominal if url == self.context.instrument() else None)

    def on_instrument_answered(self, url: str, nominal: DeviceDescription) -> None:
        """Take a calibration that was just made for an answer of its instrument."""
        self._answered = url, nominal
        self._mark_stale()
        self._judge_chosen()
        self.refresh_timer.start()

    def update_enabled(self, *, busy: bool, testing: bool) -> None:
        """Disable what starts a job while another one runs."""
        self._busy = busy or testing
        for tab in self.all:
            tab.update_enabled(busy=self._busy)
        if not self._busy:
            self.refresh_timer.start()

    def buttons(self) -> tuple[QAbstractButton, ...]:
        """Return the buttons that the command palette offers."""
        return self.health.ask, self.calibrations.calibrate, self.audit.verify, self.audit.export, self.give_up

    def on_session_saved(self, path: Path) -> None:
        """Mark the tabs as stale: a test was measured."""
        self._mark_stale()

    def _mark_stale(self) -> None:
        for tab in self.all:
            tab.stale = True

    def cancel(self) -> None:
        """The window closes."""
        self._closing = True
        self.page_job.cancel()

    def save_state(self) -> None:
        """Which tab is shown, and what each of them keeps."""
        self.context.settings.setValue(_TAB, self.tabs.currentIndex())
        for tab in self.all:
            tab.save_state()
