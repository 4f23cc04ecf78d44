"""The files that ``tissueid stimulus`` makes, and how it prints what it found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from tissueid.acquisition.stimulus_file import check_new
from tissueid.cli.output import check_json, check_output, table
from tissueid.errors import UnusableInputError

if TYPE_CHECKING:
    from tissueid.reports.stimulus_report import StimulusReport

CSV_HEAD = "time_s,"


@dataclass(frozen=True, kw_only=True)
class Targets:
    """Files to be made; None where not asked for."""

    out: Path | None = None
    csv: Path | None = None
    plot: Path | None = None
    json: Path | None = None

    def check(self) -> None:
        """Refuse, before any work, what cannot be written.

        Raises:
            UnusableInputError: a file of another kind is there, a folder is missing, or two names are the same.
        """
        named = [path.absolute() for path in (self.out, self.csv, self.plot, self.json) if path and str(path) != "-"]
        if len(set(named)) < len(named):
            raise UnusableInputError("two of the files to be written have the same name")
        if str(self.csv) == "-" or str(self.plot) == "-":
            raise UnusableInputError("only JSON goes to standard output; name a file for samples and plots")
        check_json(self.json)
        check_output(self.csv, (CSV_HEAD,))
        if self.out is not None:
            check_new(self.out)
        if self.plot is not None:
            # Imported where it is needed: it brings Matplotlib with it.
            from tissueid.reports.stimulus_report import FORMS, form_of

            check_output(self.plot, FORMS[form_of(self.plot)])

    def tell(self, people: Console) -> None:
        """Say what was written."""
        for label, path in (("saved", self.out), ("samples", self.csv), ("plot", self.plot)):
            if path is not None:
                people.print(f"{label}: {path}", markup=False)


def draw(path: Path, report: StimulusReport) -> None:
    """Write a report.

    Raises:
        UnusableInputError: it cannot be written.
    """
    try:
        report.write(path)
    except OSError as error:
        raise UnusableInputError(f"cannot write {error.filename or path}: {error.strerror}") from error


def rows_table(title: str, rows: Sequence[tuple[str, str]]) -> Table:
    """Labels and values as people read them."""
    drawn = table(title, "quantity", "value")
    drawn.columns[1].justify = "left"
    for row in rows:
        drawn.add_row(*row)
    return drawn
