"""Calibrations, and the page Instrument on which they are shown, for its tests."""

import functools

import pytest
from app.benches import WAIT_MS
from app.test_window import idle
from PySide6.QtCore import QItemSelectionModel, Qt

from tissueid.app.views.technician.view import InstrumentView
from tissueid.audit import AuditLog
from tissueid.calibration import CalibratedQuantity, Calibration
from tissueid.calibration.active import activate_calibration
from tissueid.calibration.file import utc_date

HEALTH, CALIBRATIONS, FAULTS, AUDIT = range(4)
PLACES = tuple(0.002 * k for k in range(1, 16))


def sweep(share=1.0, date="", **changes):
    figures = {
        "force_constant_n_per_a": CalibratedQuantity(value=3.0 * share, std=0.015, unit="N/A"),
        "linear_region_min_m": CalibratedQuantity(value=0.004, std=5e-5, unit="m"),
        "linear_region_max_m": CalibratedQuantity(value=0.027, std=5e-5, unit="m"),
    }
    row = tuple(1.0 for _ in PLACES)
    tables = {
        "force_constant": {"position_m": PLACES, "value_n_per_a": tuple(3.0 * share for _ in PLACES)},
        "sweep": {"position_m": PLACES, "mass_kg": row, "damping_n_s_per_m": row, "stiffness_n_per_m": row},
    }
    fields = dict(
        kind="sweep",
        model="desktop indenter (in-process simulation)",
        serial_number="TWIN-3",
        date=date or utc_date(),
        software="t",
        verdict="passed",
        quantities=figures,
        tables=tables,
    )
    return Calibration(**(fields | changes))


def static(date="", resistance=12.0):
    figures = {
        "coil_resistance_ohm": CalibratedQuantity(value=resistance, std=0.003, unit="ohm"),
        "force_constant_n_per_a": CalibratedQuantity(value=3.01, std=0.001, unit="N/A"),
        "current_offset_a": CalibratedQuantity(value=0.001, std=1e-4, unit="A"),
    }
    tables = {"electrical": {"voltage_v": (-1.0, 0.0, 1.0), "residual_a": (1e-3, -2e-3, 1e-3)}}
    return sweep(date=date, kind="static", quantities=figures, tables=tables)


@pytest.fixture
def page(qtbot, open_window, host, bench, tmp_path, calibrations, audit_file):
    """Opens the page, in the ``whole`` window or in one of its own, and waits until what it reads by itself is read."""

    def make(tab=HEALTH, whole=False, **changes):
        services = {"calibrations": calibrations, "audit": AuditLog(audit_file)} | changes
        if whole:
            window = open_window(**({"first_page": "instrument", "role": "technician"} | services))
            view = window.ui.views["instrument"]
        else:
            calibrate = functools.partial(activate_calibration, folder=calibrations)
            services = {"opener": bench.open, "calibrate": calibrate} | services
            window, view = host(services.pop("folder", tmp_path), page=InstrumentView, **services)
        view.window_ = window
        rest(qtbot, view)
        choose(qtbot, view, tab)
        return view

    return make


def rest(qtbot, view):
    """Until the page has read what it wants to, and nothing goes on."""
    qtbot.waitUntil(
        lambda: idle(view.window_) and not view.refresh_timer.isActive() and not view.current.stale, timeout=WAIT_MS
    )


def choose(qtbot, view, tab):
    bar = view.tabs.tabBar()
    qtbot.mouseClick(bar, Qt.MouseButton.LeftButton, pos=bar.tabRect(tab).center())
    rest(qtbot, view)


def select(table, *rows):
    """Rows, as with Ctrl held down."""
    chosen = table.selectionModel()
    chosen.clearSelection()
    for row in rows:
        flags = QItemSelectionModel.SelectionFlag.Select | QItemSelectionModel.SelectionFlag.Rows
        chosen.select(table.model().index(row, 0), flags)


def column(model, number):
    return [model.data(model.index(row, number)) for row in range(model.rowCount())]
