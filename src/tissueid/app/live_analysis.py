"""Live identification next to the signals of a running test: response, curve, spectra and parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QSize, Qt
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QTabBar, QVBoxLayout, QWidget

from tissueid.app.build import fill, label, styled
from tissueid.app.live_signals import Array
from tissueid.app.plotting import PlotCard
from tissueid.app.small_window import FoldingBox
from tissueid.app.theme import appearance
from tissueid.app.words import sentence
from tissueid.audit import Role
from tissueid.device import SIMULATED_LINE
from tissueid.formatting import fixed, label_and_unit, value_and_rest
from tissueid.instrument.discovery import IN_PROCESS
from tissueid.language import _, marked
from tissueid.messages import MISSING, Message, Verbatim, translated
from tissueid.procedures.test_plan import LiveMethod, TestPlan

if TYPE_CHECKING:
    from tissueid.acquisition.live import LiveIdentification
    from tissueid.identification.live.live_view import LiveBode, LiveCourse, LiveCurve, LiveSpectra, LiveView
    from tissueid.identification.live.stopping import Parameter

MM = 1e3
MS = 1e3
PERCENT = 100.0
_NOTHING = np.zeros(0)
_FINE = 200
_WAITING = marked("No estimate yet: it comes during the stimulus.")
_ENDED = marked("The test ended before there was enough of it.")
_ORANGE = marked("Orange: mass, damping and stiffness")
_QUANTITIES: dict[Parameter, str] = {
    "mass": "mass_kg",
    "damping": "damping_n_s_per_m",
    "stiffness": "stiffness_n_per_m",
}
_ROLES: dict[Parameter, str] = {"mass": "good", "damping": "model", "stiffness": "measured"}
_LEAST = 1e-12
"""Magnitude below which a logarithm would say nothing, m/N."""

_CARD_WIDTH = 214
"""Least width of a plot, pixels: the longest heading fits."""
_SPACING = 8
_ROOM_FOR_ALL = 760
"""Height of the panel, pixels, from which all plots are shown at once; below it by tabs."""

_ABBREVIATED: dict[LiveMethod, str] = {"sliding": "LMS", "rls": "RLS", "als": "ALS"}
_PARTS = {
    "model": marked("Model"),
    "response": marked("Response"),
    "bode": marked("Bode"),
    "course": marked("Parameters"),
    "spectra": marked("Spectra"),
}
"""Titles of the tabs."""
_WIDE = {
    "model": ("impulse", "bode", "curve", "phase"),
    "spectra": ("coherence", "force_spectrum", "position_spectrum"),
    "course": ("course",),
}
_NARROW = {
    "response": ("impulse", "curve"),
    "bode": ("bode", "phase", "coherence"),
    "spectra": ("force_spectrum", "position_spectrum"),
    "course": ("course",),
}
"""Plots of each tab, most important first, where two plots fit next to each other and where one does."""
_PLAIN: dict[str, tuple[str, ...]] = {"course": ("course",)}
"""What a clinician sees: how mass, damping and stiffness settle. The other plots are for researchers."""

_FREQUENCY, _BOTH = marked("Frequency (Hz)"), ("bottom", "left")
_PLOTS: dict[str, tuple[str, str, str, tuple[str, ...]]] = {
    "impulse": (marked("Impulse response"), marked("Lag (ms)"), "mm/(N·s)", ()),
    "bode": (marked("Bode magnitude"), "", "mm/N", _BOTH),
    "curve": (marked("Static nonlinearity"), marked("Linear prediction (mm)"), "mm", ()),
    "phase": (marked("Bode phase"), _FREQUENCY, "°", ("bottom",)),
    "course": (marked("Change of the values"), marked("Time (s)"), "%", ()),
    "coherence": (marked("Coherence"), _FREQUENCY, "", ("bottom",)),
    "force_spectrum": (marked("Force spectrum"), _FREQUENCY, "N²/Hz", _BOTH),
    "position_spectrum": (marked("Position spectrum"), _FREQUENCY, "mm²/Hz", _BOTH),
}
"""Title, label of the abscissa, unit and logarithmic axes of each plot, two in a row."""
_OF_RESPONSE = marked("Of the impulse response"), _ORANGE
_OF_SPECTRUM = (marked("Power spectral density; flat parts at high frequency are noise of the sensor"),)
_TIPS: dict[str, tuple[str, ...]] = {
    "impulse": (marked("Band: one standard deviation to either side"), _ORANGE),
    "bode": _OF_RESPONSE,
    "phase": _OF_RESPONSE,
    "curve": (marked("Measured position against the linear prediction; a linear tissue lies on the dotted line"),),
    "course": (marked("Parameters against their newest value; bands: one standard deviation to either side"),),
    "coherence": (marked("Share of the motion that the force explains at each frequency; below the dotted line none"),),
    "force_spectrum": _OF_SPECTRUM,
    "position_spectrum": _OF_SPECTRUM,
}

_WIDEST_PERCENT = 30.0
"""Half of what the plot of the parameters shows at most, so that its first moments do not squeeze the rest."""


class LiveAnalysis(QWidget):
    """Numbers and plots, redrawn only for a new result. The plots are built for the first test.

    What does not fit is on tabs: the panel shows all plots where it is large, and few at a time where it is small.
    """

    cards: tuple[PlotCard, ...] = ()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.plots: dict[str, PlotCard] = {}
        self._shown: LiveView | None = None
        self._planned_s = 4.0
        self._plain = False
        self._parts: dict[str, tuple[str, ...]] = {}
        self._rows: list[FoldingBox] = []
        self.numbers = {name: _Figure(_(label_and_unit(_QUANTITIES[name])[0]), _ROLES[name]) for name in _QUANTITIES}
        explained = _("Variance accounted for (VAF): how much of the motion so far the impulse response explains")
        self.vaf = styled(_Figure(_("Explained, linear")), tip=explained)
        self.simulated, self.said = label("heading"), label("muted")
        self.simulated.setText(_(SIMULATED_LINE))
        self.tabs = styled(QTabBar(), name=_("Plots of the running test"), draw_base=False, expanding=False)
        self._arrange()
        self._offer(_WIDE)
        self.tabs.currentChanged.connect(self._show_part)
        self.hide()

    def show_role(self, role: Role) -> None:
        """Show a clinician the values alone, others how well they are known and the curves behind them."""
        self._plain = role == "clinician"
        self.vaf.setVisible(not self._plain)
        self._offer_for(self.size())

    def expect(self, plan: TestPlan) -> None:
        """Make room for a test that is about to begin."""
        self._build_plots()
        self._shown = None
        self._planned_s = plan.stimulus_s
        self.simulated.setVisible(plan.url.startswith(IN_PROCESS))
        for figure in (*self.numbers.values(), self.vaf):
            figure.fill(MISSING, "")
        for card in self.cards:
            card.say_missing(_(_WAITING))
        self._say("")
        self.show()

    def show_live(self, identification: LiveIdentification) -> None:
        """Draw the newest view, if there is one that is not drawn yet, and say what went wrong."""
        view = identification.latest()
        if view is not None and view is not self._shown:
            self._shown = view
            self.show_view(view)
        if identification.problem and self._plain:
            self._say(_("No values can be shown during this test. The test goes on."))
        elif identification.problem:
            self._say(
                translated(
                    Message(
                        "live.goes_on",
                        "{problem} The test goes on without it.",
                        problem=Verbatim(sentence(translated(identification.problem))),
                    )
                )
            )

    def clear(self) -> None:
        """The test is over: nothing waits for its stimulus any more."""
        if self._shown is None:
            self.hide()
            return
        missing = self._missing(self._shown) or _(_ENDED)
        self._show_curve(self._shown.curve, missing)
        self._show_course(self._shown.course, missing)

    def show_view(self, view: LiveView) -> None:
        """Draw one view."""
        self._build_plots()
        self._shown = view
        self._show_numbers(view)
        self._show_vaf(view)
        missing = self._missing(view)
        self._show_response(view, missing)
        self._show_bode(view, view.bode, missing)
        self._show_spectra(view.spectra, missing)
        self._show_curve(view.curve, missing)
        self._show_course(view.course, missing)

    def take_units(self) -> None:
        """Show the numbers in the units in force; the plots do it themselves."""
        if self._shown is not None:
            self._show_numbers(self._shown)

    # -- building -----------------------------------------------------------------------------------------

    def _arrange(self) -> None:
        numbers, figures = styled(QFrame(), role="card"), (*self.numbers.values(), self.vaf)
        fill(QHBoxLayout(numbers), *((figure, 1) for figure in figures), spacing=8, margins=(10, 5, 10, 5))
        self._layout = fill(QVBoxLayout(self), numbers, self.simulated, self.said, self.tabs, spacing=8)

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Show as many plots as there is room for."""
        super().resizeEvent(event)
        self._offer_for(event.size())

    def _offer_for(self, size: QSize) -> None:
        wide = size.width() >= 2 * _CARD_WIDTH + _SPACING
        several = {} if wide and size.height() >= _ROOM_FOR_ALL else _WIDE if wide else _NARROW
        self._offer(_PLAIN if self._plain else several)

    def _offer(self, parts: dict[str, tuple[str, ...]]) -> None:
        """Offer the plots on these tabs; {} shows all without tabs."""
        if parts == self._parts:
            return
        chosen = self.tabs.tabData(self.tabs.currentIndex())
        self._parts = parts
        self.tabs.blockSignals(True)
        while self.tabs.count():
            self.tabs.removeTab(0)
        for name in parts:
            self.tabs.setTabData(self.tabs.addTab(_(_PARTS[name])), name)
        self.tabs.setCurrentIndex(list(parts).index(chosen) if chosen in parts else 0)
        self.tabs.blockSignals(False)
        self.tabs.setVisible(len(parts) > 1)
        self._show_part()

    def _show_part(self) -> None:
        shown = self._parts.get(self.tabs.tabData(self.tabs.currentIndex()))
        for row, *pair in zip(self._rows, self.cards[::2], self.cards[1::2], strict=True):
            for card in pair:
                card.setVisible(shown is None or any(card is self.plots[name] for name in shown))
            self._layout.setStretchFactor(row, int(any(not card.isHidden() for card in pair)))

    def _build_plots(self) -> None:
        if self.cards:
            return
        for name, (title, below, unit, logarithmic) in _PLOTS.items():
            card = PlotCard(_(title), _(below) if below else "", unit, log_axes=logarithmic)
            self.plots[name] = styled(card, tip=". ".join(map(_, _TIPS[name])))
        self.cards = tuple(self.plots.values())
        self._response_band = self.plots["impulse"].band("measured")
        self._response = self.plots["impulse"].line("measured", width=2)
        self._response_fit = self.plots["impulse"].line("model")
        self._magnitude = self.plots["bode"].line("measured", width=2)
        self._magnitude_fit = self.plots["bode"].line("model")
        self._phase = self.plots["phase"].line("measured", width=2)
        self._phase_fit = self.plots["phase"].line("model")
        self._coherent = self.plots["coherence"].line("measured", width=2)
        self._floor = self.plots["coherence"].mark(upright=False)
        self.plots["coherence"].plot.getAxis("left").setTicks([[(0.0, "0"), (0.5, "0.5"), (1.0, "1")]])
        self.plots["coherence"].plot.setYRange(0.0, 1.0, padding=0.04)
        self._spectra = self.plots["force_spectrum"].line("measured"), self.plots["position_spectrum"].line("measured")
        self._diagonal = self.plots["curve"].line("muted")
        self._levels = self.plots["curve"].dots("measured", 6)
        self._fitted = self.plots["curve"].line("model", width=2)
        self._course_bands = {name: self.plots["course"].band(_ROLES[name]) for name in _QUANTITIES}
        self._courses = {name: self.plots["course"].line(_ROLES[name], width=2) for name in _QUANTITIES}
        for pair in zip(self.cards[::2], self.cards[1::2], strict=True):
            plots = FoldingBox(2 * _CARD_WIDTH + _SPACING)
            plots.setSpacing(_SPACING)
            for card in pair:
                card.setMinimumWidth(_CARD_WIDTH)
                plots.addWidget(card, 1)
            self._layout.addLayout(plots, 1)
            self._rows.append(plots)
        self._show_part()

    def _missing(self, view: LiveView) -> str:
        """Return why plots are missing; "" for a clinician, who does not see models."""
        return "" if self._plain else sentence(translated(view.missing))

    def _say(self, text: str) -> None:
        self.said.setText(text)
        self.said.setVisible(bool(text))

    # -- filling ------------------------------------------------------------------------------------------

    def _show_numbers(self, view: LiveView) -> None:
        for name, figure in self.numbers.items():
            estimate = view.parameters.get(name)
            unit = label_and_unit(_QUANTITIES[name])[1]
            figure.fill(*((MISSING, "") if estimate is None else value_and_rest(estimate, unit)))

    def _show_vaf(self, view: LiveView) -> None:
        value = MISSING if view.vaf_percent is None else fixed(view.vaf_percent, 1)
        self.vaf.rename(_("Explained, {method}").format(method=_ABBREVIATED[view.method]))
        self.vaf.fill(value, "%")

    def _show_response(self, view: LiveView, missing: str) -> None:
        response, std = MM * view.impulse_response, view.impulse_response_std
        self.plots["impulse"].say_missing("" if response.size else missing)
        if not response.size:
            return
        lag = MS * view.lag_s
        spread = np.zeros(response.size) if std is None else MM * std
        self._response.setData(lag, response)
        _fill(self._response_band, lag, response - spread, response + spread)
        if view.second_order is not None:
            fine = np.linspace(0.0, float(view.lag_s[-1]), _FINE)
            fitted = view.second_order.sign * view.second_order.system.impulse_response(fine)
            self._response_fit.setData(MS * fine, MM * fitted)
        self.plots["impulse"].plot.setXRange(0.0, float(lag[-1]), padding=0.02)

    def _show_bode(self, view: LiveView, bode: LiveBode | None, missing: str) -> None:
        there = bode is not None and bode.frequency_hz.size > 1
        self.plots["bode"].say_missing("" if there else missing)
        self.plots["phase"].say_missing("" if there else missing)
        self.plots["coherence"].say_missing("" if there else missing)
        if bode is None or not there:
            return
        frequency = np.log10(bode.frequency_hz)
        self._magnitude.setData(frequency, np.log10(MM * np.maximum(bode.magnitude, _LEAST)))
        self._phase.setData(frequency, np.degrees(bode.phase_rad))
        self._coherent.setData(frequency, bode.coherence)
        self._floor.setValue(bode.coherence_floor)
        self._floor.show()
        if view.second_order is not None:
            fitted = view.second_order.sign * view.second_order.system.frequency_response(bode.frequency_hz)
            self._magnitude_fit.setData(frequency, np.log10(MM * np.abs(fitted)))
            self._phase_fit.setData(frequency, np.degrees(np.unwrap(np.angle(fitted))))
        for card in (self.plots["bode"], self.plots["phase"], self.plots["coherence"]):
            card.plot.setXRange(float(frequency[0]), float(frequency[-1]), padding=0.02)

    def _show_spectra(self, spectra: LiveSpectra | None, missing: str) -> None:
        for card in (self.plots["force_spectrum"], self.plots["position_spectrum"]):
            card.say_missing("" if spectra is not None else missing)
        if spectra is None:
            return
        frequency = np.log10(spectra.frequency_hz)
        for line, density in zip(self._spectra, (spectra.input_psd, MM**2 * spectra.output_psd), strict=True):
            line.setData(frequency, np.log10(np.maximum(density, _LEAST * density.max())))

    def _show_curve(self, curve: LiveCurve | None, missing: str) -> None:
        self.plots["curve"].say_missing("" if curve is not None else missing or _(_WAITING))
        if curve is None:
            return
        ends = MM * curve.curve_x[[0, -1]]
        self._diagonal.setData(ends, ends)
        self._levels.setData(MM * curve.predicted, MM * curve.measured)
        self._fitted.setData(MM * curve.curve_x, MM * curve.curve_y)

    def _show_course(self, course: LiveCourse, missing: str) -> None:
        self.plots["course"].say_missing("" if course.seconds.size else missing or _(_WAITING))
        if not course.seconds.size:
            return
        widest = 0.0
        for column, name in enumerate(_QUANTITIES):
            newest = abs(course.values[-1, column])
            change = PERCENT * (course.values[:, column] - course.values[-1, column]) / newest
            spread = np.minimum(PERCENT * course.std[:, column] / newest, 2.0 * _WIDEST_PERCENT)
            self._courses[name].setData(course.seconds, change)
            _fill(self._course_bands[name], course.seconds, change - spread, change + spread)
            widest = max(widest, float(np.max(np.abs(change) + spread)))
        reach = min(_WIDEST_PERCENT, max(widest, 1.0))
        self.plots["course"].plot.setYRange(-reach, reach, padding=0.02)
        self.plots["course"].plot.setXRange(0.0, max(self._planned_s, float(course.seconds[-1])), padding=0.01)


class _Figure(QWidget):
    """One number that changes while one looks; ``role`` is that of the colour of its curve."""

    def __init__(self, label: str, role: str = "") -> None:
        super().__init__()
        self._label, self._role = label, role
        self._text, self._value = styled(QLabel(label), role="field"), styled(QLabel(), role="headline")
        self._rest = styled(QLabel(), role="muted")
        self._text.setTextFormat(Qt.TextFormat.RichText)
        for widget in (self._text, self._value, self._rest):
            widget.setMinimumWidth(1)
            widget.setWordWrap(widget is not self._value)
        fill(QVBoxLayout(self), self._text, self._value, self._rest, spacing=0)
        if role:
            appearance.follow(self._paint)

    def fill(self, value: str, rest: str) -> None:
        """Show a number and what stands after it."""
        self._value.setText(value)
        self._rest.setText(rest)
        self.setAccessibleName(f"{self._label}: {value} {rest}".strip())

    def rename(self, label: str) -> None:
        """Change the label of a number without a colour."""
        self._label = label
        self._text.setText(label)

    def _paint(self) -> None:
        colour = getattr(appearance.theme, self._role)
        self._text.setText(f'{self._label} <span style="color:{colour}">■</span>')

    @property
    def text(self) -> str:
        """The number as it is shown."""
        return f"{self._value.text()} {self._rest.text()}".strip()


def _fill(band: tuple[pg.PlotCurveItem, pg.PlotCurveItem], x: Array, low: Array, high: Array) -> None:
    for edge, values in zip(band, (low, high), strict=True):
        edge.setData(x, values)
