"""Interface of the pages of the window."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QAbstractButton, QWidget

from tissueid.app.context import AppContext
from tissueid.app.theme import Theme
from tissueid.audit import Role


class View(QWidget):
    """A page. Slow work goes through ``context.jobs`` and can be cancelled; nothing here may block."""

    name = ""
    """Name of the page in settings, help (``app/help/NAME.md``) and other pages."""
    changed = Signal()
    """Sent when the enabled controls of the page may have changed."""

    def __init__(self, context: AppContext, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.context = context

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

    def offer_files(self, paths: list[Path]) -> bool:
        """Open files that were dropped on this page; return False to leave them to the window."""
        del paths
        return False

    def show_new(self, path: Path) -> bool:
        """Show a session that was imported on this page; return False to leave it to the page Measure."""
        return self.offer_files([path])

    def apply_theme(self, theme: Theme) -> None:
        """Apply a theme."""

    def cancel(self) -> None:
        """Cancel the job of this page: the window closes."""

    def save_state(self) -> None:
        """Save the state of the page to ``context.settings``."""
