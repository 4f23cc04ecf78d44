"""What every page of the window is, and what it is given to work with."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from PySide6.QtCore import QSettings, Signal
from PySide6.QtWidgets import QAbstractButton, QWidget

from tissueid.app.jobs import Jobs
from tissueid.app.surroundings import Surroundings
from tissueid.app.theme import Theme
from tissueid.audit import Role, Trail


class Say(Protocol):
    """Shows a line in the strip that every page has."""

    def __call__(self, text: str, *, problem: bool = False) -> None:
        """Say it, as news or as a problem."""


@dataclass(frozen=True)
class Desk:
    """The window, as far as its pages have to do with it.

    ``settings`` are kept from one start to the next. ``role`` is who sits there now. ``go`` shows another page by its
    name. ``open_session`` analyses a file on the page of the guided test. ``prepare_test`` fills that page's form
    in (fields of ``Plan`` by their names), shows it and says the words; nothing is energised. ``measured`` are told of
    the file of every session that was recorded or recovered. ``show_file`` opens a document outside the window.
    ``instrument`` is the address of the instrument that is chosen on the page of the guided test. ``calibrate`` shows
    where a coil is calibrated, to a technician, and says the words; nothing is begun.
    """

    around: Surroundings
    jobs: Jobs
    settings: QSettings
    say: Say
    role: Callable[[], Role]
    go: Callable[[str], None]
    open_session: Callable[[Path], None]
    prepare_test: Callable[[Mapping[str, Any], str], None]
    show_file: Callable[[Path], None]
    instrument: Callable[[], str] = lambda: ""
    calibrate: Callable[[str], None] = lambda _words: None

    @property
    def trail(self) -> Trail:
        """Where what is done is logged, in the role of who does it."""
        return Trail(self.around.audit, self.role())

    @property
    def busy(self) -> bool:
        """Whether something goes on that nothing else may begin beside."""
        return bool(self.jobs)


class View(QWidget):
    """A page. Slow work goes through ``desk.jobs`` and can be cancelled; nothing here may block."""

    name = ""
    """By which settings, help (``app/help/NAME.md``) and other pages know it."""
    changed = Signal()
    """Sent when what the page could do next has changed."""

    def __init__(self, desk: Desk, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.desk = desk

    def enter(self) -> None:
        """The page is about to be shown."""

    def settle(self, *, busy: bool, testing: bool) -> None:
        """Enable what makes sense now: nothing that works beside a running test."""

    def waiting(self) -> tuple[QWidget, ...]:
        """The controls that are grey while something goes on elsewhere; on them it is said what that is."""
        return ()

    def buttons(self) -> tuple[QAbstractButton, ...]:
        """Return the buttons that the command palette offers."""
        return ()

    def take_role(self, role: Role) -> None:
        """Somebody else sits there now."""

    def heard_of(self, path: Path) -> None:
        """A session was recorded or recovered into this file."""

    def offer_files(self, paths: list[Path]) -> bool:
        """Take files that were dropped on this page; False leaves them to the window."""
        del paths
        return False

    def paint_with(self, theme: Theme) -> None:
        """Take on the colours of a theme."""

    def cancel(self) -> None:
        """End what this page began, soon: the window closes."""

    def save_state(self) -> None:
        """Write what is to be found again at the next start into ``desk.settings``."""


__all__ = ["Desk", "Say", "View"]
