"""Errors as sentences, and times as people say them."""

from __future__ import annotations

import traceback

from platformdirs import user_log_path

from tissueid.app.language import _, marked
from tissueid.errors import TissueIDError

QUANTITIES = (marked("Mass"), marked("Damping"), marked("Stiffness"))
"""What the core calls the parameters of a tissue."""
SAID_BY_CORE = (
    marked("Good test"),
    marked("Read this before you use the test"),
    marked("Do the test again"),
    marked("Good measurement"),
    marked("Look closer before use"),
    marked("Do not rely on this measurement"),
    marked("simulation in this process"),
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
        return sentence(str(error))
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return sentence(f"{where}{error.strerror or error}")
    path = user_log_path("tissueid", appauthor=False, ensure_exists=True) / "last-defect.txt"
    path.write_text("".join(traceback.format_exception(error)), encoding="utf-8")
    return _("This is a defect of the software; please report {path}").format(path=path)
