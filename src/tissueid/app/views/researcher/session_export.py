"""Export the selected tests to files for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tissueid.app.views.researcher.background_work import BackgroundWork
from tissueid.app.views.researcher.selected_test import SelectedTest
from tissueid.app.words import in_words
from tissueid.audit import AuditTrail
from tissueid.errors import CancelledError, TissueIDError
from tissueid.language import _, marked
from tissueid.sessions import read_session_head, read_test
from tissueid.sessions.imports import export_session

EXPORTS = {"csv": marked("CSV tables"), "mat": marked("MATLAB files"), "parquet": marked("Parquet tables")}


class SessionExport(BackgroundWork):
    """Writes a folder per session in ``folder``; a failing session is skipped."""

    def __init__(self, chosen: Sequence[SelectedTest], folder: Path, kind: str, trail: AuditTrail) -> None:
        super().__init__(_("Exporting"))
        self.written: list[Path] = []
        self.problems: list[str] = []
        self._folder = folder
        self._kind = kind
        self._trail = trail
        self._tests: dict[Path, list[int]] = {}
        for one in chosen:
            self._tests.setdefault(one.path, []).append(one.number)

    def run(self) -> SessionExport:
        """Export the sessions; a cancelled one leaves no files."""
        try:
            for done, (path, numbers) in enumerate(self._tests.items()):
                self._begun = done / len(self._tests)
                try:
                    self._export(path, numbers)
                except CancelledError:
                    raise
                except (TissueIDError, OSError) as error:
                    self.problems.append(in_words(error))
        except CancelledError:
            pass  # what is written stays
        return self

    @property
    def words_after(self) -> str:
        """Notice after the export."""
        count = len(self.written)
        said = []
        if count == 1:
            said.append(_("Exported into {path}.").format(path=self.written[0]))
        elif count:
            said.append(
                _("Exported {count} sessions into folders in {folder}.").format(count=count, folder=self._folder)
            )
        if self.cancelled():
            said.append(_("The export was stopped; the other sessions are not exported."))
        return " ".join([*said, *dict.fromkeys(self.problems)])

    def _export(self, path: Path, numbers: Sequence[int]) -> None:
        self.tell(self._begun)
        session = read_session_head(path)
        tests = []
        for number in numbers:
            tests.append(read_test(path, number))
            self.tell(self._begun)
        folder = self._free_name(path.stem)
        export_session(replace(session, tests=tuple(tests)), folder, self._kind, self._on_progress)
        self.written.append(folder)
        counts = {"tests": len(tests), "format": self._kind}
        self._trail.record("session.exported", subject=session.session_id, new=counts)

    def _on_progress(self, share: float) -> None:
        self.tell(self._begun + share / len(self._tests))

    def _free_name(self, stem: str) -> Path:
        """Return an unused folder."""
        folder = self._folder / f"{stem}-{self._kind}"
        count = 1
        while folder.exists():
            count += 1
            folder = self._folder / f"{stem}-{self._kind}-{count}"
        return folder


__all__ = ["EXPORTS", "SessionExport"]
