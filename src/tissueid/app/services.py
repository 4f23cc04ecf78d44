"""External services of the window; tests replace them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from platformdirs import user_config_path
from PySide6.QtCore import QSettings, QUrl
from PySide6.QtGui import QDesktopServices

from tissueid.app.emergency import EmergencyStop
from tissueid.app.user_files import default_folder
from tissueid.atomic_write import private_folder
from tissueid.audit import Role
from tissueid.procedures.instrument_access import InstrumentAccess

if TYPE_CHECKING:
    from tissueid.instrument.simulated import Wait


def _show_file(path: Path) -> bool:
    return QDesktopServices.openUrl(QUrl.fromLocalFile(str(path)))


def _settings() -> QSettings:
    path = private_folder(user_config_path("tissueid", appauthor=False)) / "window.ini"
    return QSettings(str(path), QSettings.Format.IniFormat)


@dataclass(frozen=True)
class AppServices(InstrumentAccess):
    """Instruments, files, clocks, settings and other programs.

    ``wait`` None runs simulations in real time. With ``separate_process`` another process identifies a running test.
    ``stop`` creates the emergency stop of one test; ``calibrations`` is the folder of new calibrations, None for the
    default folder. ``first_page`` is the name of the first page; empty means the last one shown. ``role`` None means
    the last role. ``settings`` opens the stored settings. ``language`` is a language code; empty means the stored one,
    else the system's, else English.
    """

    folder: Path = field(default_factory=default_folder)
    wait: Wait | None = None
    separate_process: bool = True
    now: Callable[[], datetime] = datetime.now
    show_file: Callable[[Path], bool] = _show_file
    stop: Callable[[], EmergencyStop] = EmergencyStop
    calibrations: Path | None = None
    role: Role | None = None
    first_page: str = ""
    settings: Callable[[], QSettings] = _settings
    language: str = ""
