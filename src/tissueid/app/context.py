"""Interface of the pages of the window, what they can use of it, and the services that tests replace."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from platformdirs import user_config_path
from PySide6.QtCore import QObject, QSettings, QUrl, Signal
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import QAbstractButton, QWidget

from tissueid.app.emergency import EmergencyStop
from tissueid.app.jobs import Jobs
from tissueid.app.user_files import default_folder
from tissueid.app.widgets import show_disabled_reason
from tissueid.atomic_write import private_folder
from tissueid.audit import AuditTrail, Role
from tissueid.device import DeviceDescription
from tissueid.language import _
from tissueid.procedures.control import Control
from tissueid.procedures.instruments import InstrumentAccess

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


R = TypeVar("R")


class Say(Protocol):
    """Shows a notice."""

    def __call__(self, text: str, *, problem: bool = False) -> None:
        """Show ``text`` as information or as a problem."""


class AppState(QObject):
    """State of the window, which pages observe.

    ``testing`` is whether a coil can be energised, ``closing`` whether the window closes as soon as the running jobs
    end, ``answered`` address and description of the instrument that was calibrated last.
    """

    changed = Signal()
    """Sent when a job, a test or a calibration begins or ends, and when the window begins to close."""
    role_changed = Signal(str)
    session_saved = Signal(object)
    """Carries the path of a session that was recorded, recovered or imported."""
    instrument_answered = Signal(str, object)
    """Carries address and description, without a calibration, of an instrument that was calibrated."""
    cancelling = Signal()
    """Sent when the window is asked to close while jobs run."""
    leaving = Signal()
    """Sent when the window closes: what is kept between two starts is saved."""

    def __init__(self, jobs: Jobs, role: Role) -> None:
        super().__init__(jobs)
        self.jobs = jobs
        self.role: Role = role
        self.testing = self.closing = False
        self.answered: tuple[str, DeviceDescription] | None = None
        jobs.changed.connect(self.changed)
        self.instrument_answered.connect(self._keep_answered)

    @property
    def busy(self) -> bool:
        """Whether a job runs or the window closes: no other job may start."""
        return bool(self.jobs) or self.closing

    def take_role(self, role: Role) -> None:
        """Change the role."""
        self.role = role
        self.role_changed.emit(role)

    def _keep_answered(self, url: str, nominal: DeviceDescription) -> None:
        self.answered = url, nominal


@dataclass(frozen=True)
class AppContext:
    """What a page, or an object next to the window, can use of the window.

    ``settings`` are stored between two starts. ``go`` shows another page by its name. ``open_session`` analyses a file
    on the page Measure. ``prepare_test`` fills the form of that page (by the names of its fields), shows it with a
    notice; it starts nothing. ``show_file`` opens a document in another program. ``instrument`` returns the address of
    the instrument chosen on the page Measure. ``calibrate`` shows the page of calibrations with a notice; it starts
    nothing. ``begin_sitting`` opens the sitting of a subject in the folder of a study on the page Measure; it starts
    nothing. ``answered`` takes the address and description of an instrument that was asked, with its calibration.
    ``note`` adds a line to the log. ``show_idle`` shows what the window shows while nothing goes on.
    """

    services: AppServices
    state: AppState
    settings: QSettings
    say: Say
    go: Callable[[str], None]
    open_session: Callable[[Path], None]
    prepare_test: Callable[[Mapping[str, Any], str], None]
    show_file: Callable[[Path], None]
    instrument: Callable[[], str] = lambda: ""
    calibrate: Callable[[str], None] = lambda _words: None
    begin_sitting: Callable[[Path, str], None] = lambda _folder, _subject: None
    answered: Callable[[str, DeviceDescription], None] = lambda _url, _device: None
    note: Callable[[str], None] = lambda _words: None
    show_idle: Callable[[], None] = lambda: None

    @property
    def trail(self) -> AuditTrail:
        """The audit trail, in the current role."""
        return AuditTrail(self.services.audit, self.state.role)

    @property
    def jobs(self) -> Jobs:
        """The running jobs."""
        return self.state.jobs

    @property
    def busy(self) -> bool:
        """Whether a job runs or the window closes: no other job may start."""
        return self.state.busy

    @property
    def unread(self) -> str:
        """What stands in place of files that are not read yet, and why they are not."""
        return f"{_('Not read yet.')} {self.jobs.why}".strip()

    @property
    def no_work(self) -> bool:
        """Whether no long work can start: other work runs, a test runs, or the window closes."""
        return self.busy or self.jobs.working or self.state.testing

    def do_work(
        self,
        work: Callable[[Control], R],
        control: Control,
        done: Callable[[R], None],
        failed: Callable[[str], None],
        *,
        why: str,
        grace_s: float = 0.0,
    ) -> None:
        """Run long, picklable work on saved files in a process of low priority; one of the callbacks is called.

        ``why`` describes it and how to end it. Cancelled work has ``grace_s`` seconds to return what it has done.
        """

        def run() -> R:
            if not self.services.separate_process:
                return work(control)
            from tissueid.procedures.separate_process import run_in_process

            return run_in_process(work, control, grace_s)

        self.jobs.do(run, done, failed, why=why, long=True)

    def say_failed(self, message: str) -> None:
        """Show the error of a failed job, and what the window shows while nothing goes on."""
        self.show_idle()
        self.say(message, problem=True)


class View(QWidget):
    """A page. Slow work goes through ``context.jobs`` and can be cancelled; nothing here may block."""

    name = ""
    """Name of the page in settings, help (``app/help/NAME.md``) and other pages."""
    changed = Signal()
    """Sent when the enabled controls of the page may have changed."""

    def __init__(self, context: AppContext, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.context, state = context, context.state
        for signal, react in (
            (state.changed, self.apply_state),
            (state.role_changed, self.set_role),
            (state.session_saved, self.on_session_saved),
            (state.instrument_answered, self.on_instrument_answered),
            (state.cancelling, self.cancel),
            (state.leaving, self.save_state),
        ):
            signal.connect(react)

    def apply_state(self) -> None:
        """Enable the controls that make sense in the present state, and let the others say why they do not."""
        self.update_enabled(busy=self.context.busy, testing=self.context.state.testing)
        show_disabled_reason(self.waiting(), self.context.jobs.why_no_work)

    def enter(self) -> None:
        """Prepare the page: it is about to be shown."""

    def update_enabled(self, *, busy: bool, testing: bool) -> None:
        """Enable or disable controls; ``testing`` is true during a test or calibration."""

    def waiting(self) -> tuple[QWidget, ...]:
        """Return the controls that are disabled while another job runs; their tooltips name it."""
        return ()

    def buttons(self) -> tuple[QAbstractButton, ...]:
        """Return the buttons that the command palette offers."""
        return ()

    def set_role(self, role: Role) -> None:
        """Apply a new user role."""

    def on_session_saved(self, path: Path) -> None:
        """Handle a session that was recorded or recovered to ``path``."""

    def on_instrument_answered(self, url: str, nominal: DeviceDescription) -> None:
        """Handle an instrument at ``url`` that answered, ``nominal`` without a calibration."""

    def offer_files(self, paths: list[Path]) -> bool:
        """Open files that were dropped on this page; return False to leave them to the window."""
        del paths
        return False

    def show_new(self, path: Path) -> bool:
        """Show a session that was imported on this page; return False to leave it to the page Measure."""
        return self.offer_files([path])

    def cancel(self) -> None:
        """Cancel the job of this page: the window closes."""

    def save_state(self) -> None:
        """Save the state of the page to ``context.settings``."""
