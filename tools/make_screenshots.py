"""Take the pictures of docs/images from the real window: run with the environment's Python, no display needed."""

from __future__ import annotations

import functools
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

from PIL import Image
from PySide6.QtCore import QEventLoop, QTimer
from PySide6.QtGui import QColor, QPalette
from PySide6.QtWidgets import QApplication

from tissueid.app.main_window import MainWindow
from tissueid.app.surroundings import Surroundings
from tissueid.audit import AuditLog
from tissueid.calibration import Calibration, calibrated, write_calibration
from tissueid.calibration.file import utc_date
from tissueid.instrument import Found, SimulatedInstrument

IMAGES = Path(__file__).parents[1] / "docs" / "images"
SIZE = (1280, 800)
COLOURS = 96
LONGEST_S = 120.0
"""How long the window may take for anything."""
HELD_AT_POLL = 430
"""Where the running test is held for its picture: a good half through its stimulus."""


class Pace:
    """Lets the simulation run at once to one moment, and on when it is told to."""

    def __init__(self) -> None:
        self.polls = 0
        self.held, self.go_on = threading.Event(), threading.Event()

    def wait(self, _seconds: float) -> None:
        """Hold the test at the moment of its picture."""
        self.polls += 1
        if self.polls == HELD_AT_POLL:
            self.held.set()
            self.go_on.wait()


def main() -> None:
    """Run one test and take a picture before, during and after, the last in dark colours too."""
    application = QApplication([])
    application.setStyle("Fusion")
    pace = Pace()
    with tempfile.TemporaryDirectory() as folder:
        around = Surroundings(
            finder=lambda probe: [Found("simulated://forearm", "simulation in this process", True)],
            calibrate=functools.partial(calibrated, folder=_calibrations(Path(folder))),
            audit=AuditLog(Path(folder) / "audit.jsonl"),
            folder=Path(folder) / "Documents" / "TissueID",
            wait=pace.wait,
            apart=False,
            now=lambda: datetime(2026, 1, 15, 10, 30),
        )
        window = MainWindow(around)
        window.resize(*SIZE)
        window.show()
        _take(window, "window-before")
        window.ui.form.site.setCurrentText("left forearm, posterior")
        window.ui.start.click()
        _until(pace.held.is_set, "the test to come to where it is held")
        _take(window, "window-during")
        pace.go_on.set()
        _until(lambda: window.findings is not None, "what was found in the test")
        _take(window, "window")
        dark = QPalette(QColor("#232a2f"), QColor("#1b2024"))
        dark.setColor(QPalette.ColorRole.WindowText, QColor("#e6eaec"))
        application.setPalette(dark)
        _take(window, "window-dark")
        window.close()
        _until(lambda: not window.isVisible(), "the window to close")


def _calibrations(folder: Path) -> Path:
    """A static calibration and a sweep of the simulated instrument, twelve days old."""
    device = SimulatedInstrument().device
    figures = {
        "static": {"coil_resistance_ohm": 12.0, "force_constant_n_per_a": 3.0},
        "sweep": {"linear_region_min_m": 0.004, "linear_region_max_m": 0.0275},
    }
    for kind, quantities in figures.items():
        made = Calibration.model_validate(
            {
                "kind": kind,
                "model": device.model,
                "serial_number": device.serial_number,
                "date": utc_date(datetime.now(UTC) - timedelta(days=12)),
                "software": "tissueid",
                "verdict": "passed",
                "quantities": {name: {"value": value} for name, value in quantities.items()},
            }
        )
        write_calibration(folder / f"{kind}.toml", made)
    return folder


def _until(done: Callable[[], bool], what: str) -> None:
    """Let the window go on until something is so.

    Raises:
        SystemExit: it never was; says what was waited for.
    """
    deadline = time.monotonic() + LONGEST_S
    while not done():
        if time.monotonic() > deadline:
            sys.stderr.write(f"make_screenshots: waited {LONGEST_S:g} s for {what}, in vain\n")
            sys.stderr.flush()
            os._exit(1)  # the test that is held for its picture would keep the program from ending
        _pass(20)


def _pass(milliseconds: int) -> None:
    loop = QEventLoop()
    QTimer.singleShot(milliseconds, loop.quit)
    loop.exec()


def _take(window: MainWindow, name: str) -> None:
    _pass(200)  # let a frame and a change of palette come through
    path = IMAGES / f"{name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    window.grab().save(str(path))
    with Image.open(path) as image:
        small = image.convert("RGB").quantize(COLOURS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    small.save(path, optimize=True)
    print(f"{path.name}: {path.stat().st_size // 1024} kB")


if __name__ == "__main__":
    main()
