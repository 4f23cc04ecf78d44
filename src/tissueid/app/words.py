"""Errors as sentences, and times as people say them."""

from __future__ import annotations

import traceback

from platformdirs import user_log_path

from tissueid.core_words import for_window
from tissueid.errors import TissueIDError
from tissueid.language import _, marked
from tissueid.whole_file import private_folder, write_private

QUANTITIES = (marked("Mass"), marked("Damping"), marked("Stiffness"))
"""What the core calls the parameters of a tissue."""
SAID_BY_CORE = (
    marked("Good test"),
    marked("Read this before you use the test"),
    marked("Do the test again"),
    marked("Do not rely on this measurement"),
    marked("simulation in this process"),
    marked("Simulated instrument: not a measurement of a person."),
)
"""Verdicts and names that the core says in always the same words; whoever shows them looks them up."""


def sentence(text: str) -> str:
    """Text with a capital and a full stop."""
    text = " ".join(text.split())
    if not text:
        return ""
    return text[0].upper() + text[1:] + ("" if text[-1] in ".!?" else ".")


def in_words(error: BaseException) -> str:
    """What went wrong, for the person in front of the window; a defect's details go to a file that is named."""
    if isinstance(error, TissueIDError):
        return sentence(for_window(str(error)))
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return sentence(f"{where}{error.strerror or error}")
    path = private_folder(user_log_path("tissueid", appauthor=False)) / "last-defect.txt"
    write_private(path, "".join(traceback.format_exception(error)))
    return _("This is a defect of the software; please report {path}").format(path=path)
