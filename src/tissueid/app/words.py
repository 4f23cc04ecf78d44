"""Errors and texts as sentences for the window."""

from __future__ import annotations

import traceback

from platformdirs import user_log_path

from tissueid.atomic_write import private_folder, write_private
from tissueid.errors import TissueIDError
from tissueid.language import marked
from tissueid.messages import Message, Verbatim, translated

RESEARCH_USE = marked("Research use only. Not a medical device.")


def sentence(text: str) -> str:
    """Return a text in one line with a capital letter and a full stop."""
    text = " ".join(text.split())
    if not text:
        return ""
    return text[0].upper() + text[1:] + ("" if text[-1] in ".!?" else ".")


def in_words(error: BaseException) -> str:
    """Return an error as a translated sentence. The traceback of a defect goes to a file, and the sentence names it."""
    if isinstance(error, TissueIDError):
        return sentence(translated(error.message))
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return sentence(f"{where}{error.strerror or error}")
    path = private_folder(user_log_path("tissueid", appauthor=False)) / "last-defect.txt"
    write_private(path, "".join(traceback.format_exception(error)))
    return translated(
        Message("window.defect", "This is a defect of the software; please report {path}", path=Verbatim(path))
    )
