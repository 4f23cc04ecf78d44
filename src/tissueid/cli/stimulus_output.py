"""Output files and tables of ``tissueid stimulus``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from tissueid.acquisition.stimulus_file import check_new
from tissueid.cli.output import check_json, table
from tissueid.errors import UnusableInputError
from tissueid.procedures.output_files import check_output

if TYPE_CHECKING:
    from tissueid.reports.stimulus_report import StimulusReport

CSV_HEAD = "time_s,"


@dataclass(frozen=True, kw_only=True)
class Targets:
    """Files to write; None where not requested."""

    out: Path | None = None
    csv: Path | None = None
    plot: Path | None = None
    json: Path | None = None

    def check(self) -> None:
        """Check, before any work, that the files can be written.

        Raises:
            UnusableInputError: a file of another kind exists, a folder is missing, or two names are the same.
        """
        named = [path.absolute() for path in (self.out, self.csv, self.plot, self.json) if path and str(path) != "-"]
        if len(set(named)) < len(named):
            raise UnusableInputError("two output files have the same name")
        if str(self.csv) == "-" or str(self.plot) == "-":
            raise UnusableInputError("only JSON can go to standard output; name a file for samples and plots")
        check_json(self.json)
        check_output(self.csv, (CSV_HEAD,))
        if self.out is not None:
            check_new(self.out)
        if self.plot is not None:
            # imported here because it imports Matplotlib
            from tissueid.reports.stimulus_report import FORMS, output_suffix

            check_output(self.plot, FORMS[output_suffix(self.plot)])

    def print_files(self, out: Console) -> None:
        """Print the files that were written."""
        for label, path in (("saved", self.out), ("samples", self.csv), ("plot", self.plot)):
            if path is not None:
                out.print(f"{label}: {path}", markup=False)


def draw(path: Path, report: StimulusReport) -> None:
    """Write a report.

    Raises:
        UnusableInputError: the file cannot be written.
    """
    try:
        report.write(path)
    except OSError as error:
        raise UnusableInputError(f"cannot write {error.filename or path}: {error.strerror}") from error


def rows_table(title: str, rows: Sequence[tuple[str, str]]) -> Table:
    """Return a table of labels and values."""
    drawn = table(title, "quantity", "value")
    drawn.columns[1].justify = "left"
    for row in rows:
        drawn.add_row(*row)
    return drawn
