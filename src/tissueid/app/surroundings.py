"""What the window reaches out to; tests hand in their own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from platformdirs import user_config_path
from PySide6.QtCore import QSettings, QUrl
from PySide6.QtGui import QDesktopServices

from tissueid.app.emergency import EmergencyStop
from tissueid.app.pacing import Wait
from tissueid.app.plan import default_folder
from tissueid.audit import AuditLog, Role, default_path
from tissueid.calibration.in_force import calibrated
from tissueid.instrument import Found, Instrument, find_instruments, open_instrument
from tissueid.whole_file import private_folder


def _show_file(path: Path) -> bool:
    return QDesktopServices.openUrl(QUrl.fromLocalFile(str(path)))


def _settings() -> QSettings:
    path = private_folder(user_config_path("tissueid", appauthor=False)) / "window.ini"
    return QSettings(str(path), QSettings.Format.IniFormat)


@dataclass(frozen=True)
class Surroundings:
    """Instruments, files, clocks and what other programs do.

    ``wait`` None paces simulations by the clock. ``apart`` is whether a running test is looked at by another process.
    ``stop`` makes the emergency stop of one test; ``calibrate`` puts an instrument's newest calibration in force;
    ``calibrations`` is where new ones go, None for where those in force are looked for. ``first_page`` is shown at the
    start, by its name; where empty, the one of last time. ``role`` is who sits there, None for whoever did
    last time. ``settings`` are what is kept from one start to the next.
    ``language`` is the code of the window's; where empty, the kept one, else the system's, else English.
    """

    opener: Callable[[str], Instrument] = open_instrument
    finder: Callable[..., list[Found]] = find_instruments
    folder: Path = field(default_factory=default_folder)
    wait: Wait | None = None
    apart: bool = True
    now: Callable[[], datetime] = datetime.now
    show_file: Callable[[Path], bool] = _show_file
    stop: Callable[[], EmergencyStop] = EmergencyStop
    calibrate: Callable[[Instrument], object] = calibrated
    calibrations: Path | None = None
    role: Role | None = None
    first_page: str = ""
    settings: Callable[[], QSettings] = _settings
    language: str = ""
    audit: AuditLog = field(default_factory=lambda: AuditLog(default_path()))
