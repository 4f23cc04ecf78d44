"""Export the selected tests to files for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tissueid.app.views.researcher.background_work import BackgroundWork
from tissueid.app.views.researcher.selected_test import SelectedTest
from tissueid.app.words import in_words, sentence
from tissueid.audit import AuditTrail
from tissueid.errors import CancelledError, TissueIDError
from tissueid.language import _, marked
from tissueid.messages import translated
from tissueid.procedures.import_export import ExportPlan, run_export

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
        self.problems += [sentence(translated(notice)) for notice in self.notices]
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
        self.check()
        folder = self._free_name(path.stem)
        plan = ExportPlan(session=path, out=folder, kind=self._kind, tests=tuple(numbers))
        run_export(plan, self, self._trail)
        self.written.append(folder)

    def progress(self, fraction: float | None, step: str) -> None:
        """Keep the completed share of all sessions."""
        super().progress(self._begun + (fraction or 0.0) / len(self._tests), step)

    def _free_name(self, stem: str) -> Path:
        """Return an unused folder."""
        folder = self._folder / f"{stem}-{self._kind}"
        count = 1
        while folder.exists():
            count += 1
            folder = self._folder / f"{stem}-{self._kind}-{count}"
        return folder


__all__ = ["EXPORTS", "SessionExport"]
