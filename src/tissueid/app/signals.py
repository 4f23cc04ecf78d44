"""Voltage, force and position over time: of the running test, or of one that was recorded."""

from __future__ import annotations

import numpy as np
import pyqtgraph as pg
from PySide6.QtWidgets import QWidget

from tissueid.acquisition.stimulus_choice import PRELOAD_S
from tissueid.acquisition.surface_detection import PLACE_S
from tissueid.app import build
from tissueid.app.live_signals import Array, LinearRange, Snapshot, decimated, linear_region
from tissueid.app.plotting import PlotCard
from tissueid.configuration import has_depth
from tissueid.device import DeviceDescription
from tissueid.language import _, marked
from tissueid.procedures.test_plan import TestPlan
from tissueid.sessions import Test

MM = 1e3
_SLACK = 0.15
"""Share of its span by which an axis grows beyond the data, so that it seldom has to."""
_LEAST_SPAN = {"voltage": 4.0, "force": 2.0, "position": 1.0}
_ROLLING_S = 10.0
_VOLTAGE_EVERY = 4
"""Frames between two drawings of the voltage: it does not guide the hand, and frames stay as short as without it."""
_LONG_BEFORE_S, _LONG_AFTER_S = -1e3, 1e5
"""A shade reaches as far to both sides as any test."""
LINEAR = marked("shaded: linear")
OUTSIDE = marked("left the linear region")


class SignalPlots(QWidget):
    """Voltage, force and position over one time axis, that of the session: zero is the start of the preload."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.voltage = PlotCard(_("Voltage"), "", "V")
        self.force = PlotCard(_("Force"), "", "N")
        self.position = PlotCard(_("Position"), _("Time from the start of the preload (s)"), "mm")
        for card in (self.voltage, self.force):
            card.plot.setXLink(self.position.plot)
        self.region_edges = self.position.band("good", alpha=30)
        self._region: LinearRange | None = None
        self._drawn: tuple[object, ...] = ()
        self._voltage_drawn: tuple[object, ...] = ()
        self._frame = 0
        self.curves = {
            name: card.line("measured") for name, card in zip(("voltage", "force", "position"), self.cards, strict=True)
        }
        self._starts = [card.mark() for card in self.cards for _ in range(2)]
        self.surface = self.position.mark(upright=False, text=_("surface"))
        self.level = self.position.mark(upright=False, text=_("where it began"))
        self._limits: dict[str, tuple[float, float]] = {}
        self._time = (-PLACE_S, 5.0)
        build.column(*[(card, share) for card, share in zip(self.cards, (7, 9, 10), strict=True)], parent=self)
        self.clear()

    @property
    def cards(self) -> tuple[PlotCard, PlotCard, PlotCard]:
        """The plots, from top to bottom."""
        return self.voltage, self.force, self.position

    def expect(self, plan: TestPlan) -> None:
        """Make room for a test that is about to begin."""
        self.clear()
        self._title(plan.configuration)
        self._show_times(-PLACE_S, plan.total_s, (0.0, PRELOAD_S))
        low_n, high_n = plan.force_range_n
        self._grow("force", min(-1.0, low_n), high_n)

    def show_live(self, snapshot: Snapshot) -> None:
        """Draw what a running test has recorded so far."""
        safety = snapshot.safety
        if snapshot.total_s is not None and snapshot.total_s != self._time[1]:
            self._show_times(-PLACE_S, snapshot.total_s, (0.0, PRELOAD_S))
        if safety is not None and safety.region != self._region:
            self.show_region(safety.region)
        self._draw(snapshot.time_s, snapshot.voltage_v, snapshot.force_n, snapshot.position_m)
        if safety is not None and safety.left_region:
            self.position.remark(_(OUTSIDE), "check")

    def show_rolling(self, snapshot: Snapshot) -> None:
        """Draw the newest seconds of something that has no known end."""
        if not snapshot.time_s.size:
            return
        now = float(snapshot.time_s[-1])
        self._show_times(max(0.0, now - _ROLLING_S), max(now, _ROLLING_S), ())
        recent = snapshot.time_s >= now - _ROLLING_S
        signals = snapshot.time_s, snapshot.voltage_v, snapshot.force_n, snapshot.position_m
        self._draw(*(values[recent] for values in signals))

    def show_test(self, test: Test, device: DeviceDescription) -> None:
        """Draw a recorded test, and where the coil that recorded it was linear."""
        self.clear()
        self._title(test.configuration)
        unknown = np.full(test.samples, np.nan)
        voltage, force, position = (test.signals.get(name, unknown) for name in ("voltage", "force", "position"))
        self.voltage.setVisible(bool(np.isfinite(voltage).any()))
        time_s = np.arange(test.samples) / test.sample_rate_hz
        self._show_times(0.0, test.samples / test.sample_rate_hz, (test.preload_s,) if test.preload_s else ())
        self._draw(time_s, voltage, force, position)
        self.show_region(linear_region(device))
        if self._region is not None and not self._region.holds(position):
            self.position.remark(_(OUTSIDE), "check")
        if np.isfinite(test.surface_position_m):
            mark = self.surface if has_depth(test.configuration) else self.level
            mark.setValue(MM * test.surface_position_m)
            mark.show()

    def show_region(self, region: LinearRange | None) -> None:
        """Shade the linear region of the coil; None takes the shade away."""
        self._region = region
        ends = (np.zeros(0),) * 2 if region is None else (np.full(2, MM * region.low_m), np.full(2, MM * region.high_m))
        times = np.zeros(0) if region is None else np.array([_LONG_BEFORE_S, _LONG_AFTER_S])
        for edge, values in zip(self.region_edges, ends, strict=True):
            edge.setData(times, values)
        self.position.setToolTip("" if region is None else _("Shaded: where the coil was found to be linear"))
        self.position.remark("" if region is None else _(LINEAR), "good")

    def clear(self) -> None:
        """Empty plots."""
        self._limits = {}
        for curve in self.curves.values():
            curve.setData(np.zeros(0), np.zeros(0))
        for mark in (*self._starts, self.surface, self.level):
            mark.hide()
        self.show_region(None)
        self._show_times(-PLACE_S, PRELOAD_S + 4.0, ())
        self._drawn = self._voltage_drawn = ()
        self._frame = 0
        self.voltage.show()
        self._grow("voltage", 0.0, 10.0)
        self._grow("force", 0.0, 10.0)
        self._grow("position", 0.0, 30.0)
        self._limits.clear()

    def _title(self, configuration: str) -> None:
        self.position.retitle(_("Position") if has_depth(configuration) else _("Displacement"), "mm")

    def _show_times(self, low_s: float, high_s: float, marks: tuple[float, ...]) -> None:
        self._time = (low_s, high_s)
        self.position.plot.setXRange(low_s, high_s, padding=0.01)
        for number, item in enumerate(self._starts):
            index = number % 2
            item.setVisible(index < len(marks))
            if index < len(marks):
                item.setValue(marks[index])

    def _draw(self, time_s: Array, voltage_v: Array, force_n: Array, position_m: Array) -> None:
        columns = max(1, int(self.position.plot.getViewBox().width()))  # the plots stand below each other
        drawn = (time_s.size, time_s[-1] if time_s.size else 0.0, columns, self._time)
        new, self._drawn = drawn != self._drawn, drawn
        signals = {"force": force_n, "position": MM * position_m} if new else {}
        if drawn != self._voltage_drawn and (not new or self._frame % _VOLTAGE_EVERY == 0):
            signals["voltage"], self._voltage_drawn = voltage_v, drawn
        self._frame += 1
        if not signals:
            return
        times_s, ends = decimated(time_s, np.stack(list(signals.values())), *self._time, columns)
        for name, values in zip(signals, ends, strict=True):
            finite = values[np.isfinite(values)]
            if finite.size:
                self._grow(name, float(finite.min()), float(finite.max()))
            self.curves[name].setData(times_s, values)

    def _grow(self, name: str, low: float, high: float) -> None:
        """Widen an axis when the data leave it; it never shrinks during a test, so that the eye can rest."""
        held = self._limits.get(name)
        if held is not None and held[0] <= low and high <= held[1]:
            return
        if held is not None:
            low, high = min(low, held[0]), max(high, held[1])
        spare = _SLACK * max(high - low, _LEAST_SPAN[name])
        self._limits[name] = low - spare, high + spare
        card: pg.PlotWidget = getattr(self, name).plot
        card.setYRange(low - spare, high + spare, padding=0.0)
