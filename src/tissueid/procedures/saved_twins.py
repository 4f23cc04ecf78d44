"""Saved twins: one file, or those of a folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tissueid.errors import UnusableInputError
from tissueid.plan_options import Option, Plan

if TYPE_CHECKING:  # takes long to import
    from tissueid.instrument.twin_file import TwinFile


class TwinPlan(Plan):
    """A saved twin."""

    file: Annotated[Path, Option(argument=True, metavar="TWIN.toml", help="a saved twin")]


class TwinFolderPlan(Plan):
    """A folder with saved twins."""

    folder: Annotated[Path, Option(argument=True, metavar="DIR", help="folder; default: the current one")] = Path()


def saved_twin(plan: TwinPlan) -> TwinFile:
    """Read a twin.

    Raises:
        UnusableInputError: the file is not a twin.
    """
    from tissueid.instrument.twin_file import read_twin

    return read_twin(plan.file)


def saved_twins(plan: TwinFolderPlan) -> dict[Path, TwinFile]:
    """Read the twins of a folder, by file name; other files are left out.

    Raises:
        UnusableInputError: the folder does not exist.
    """
    from tissueid.instrument.twin_file import read_twin
    from tissueid.instrument.twin_list import SUFFIX

    if not plan.folder.is_dir():
        raise UnusableInputError("file.no_folder", "there is no folder {folder}", folder=str(plan.folder))
    found = {}
    for path in sorted(plan.folder.glob(f"*{SUFFIX}")):
        try:
            found[path] = read_twin(path)
        except UnusableInputError:
            continue
    return found
