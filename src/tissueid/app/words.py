"""Errors as sentences, and times as people say them."""

from __future__ import annotations

import traceback

from platformdirs import user_log_path

from tissueid.core_words import said_by_core
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

SAID_FOR_SHELL = (
    (
        "Run 'tissueid calibrate static', and 'tissueid calibrate sweep' where its date has passed.",
        marked("Calibrate on the page Instrument: static, and the sweep where its date has passed."),
    ),
    (
        "Run 'tissueid calibrate static' before the next test.",
        marked("Calibrate on the page Instrument before the next test."),
    ),
    (
        "Run 'tissueid calibrate static' before measurements that are to be compared.",
        marked("Calibrate on the page Instrument before measurements that are to be compared."),
    ),
    (
        "Check that the coil is connected, then run 'tissueid calibrate static'.",
        marked("Check that the coil is connected, then calibrate on the page Instrument."),
    ),
    (
        "there is no static calibration: run 'tissueid calibrate static'",
        marked("there is no static calibration: calibrate on the page Instrument"),
    ),
    (
        "the linear region is not known: run 'tissueid calibrate sweep'",
        marked("the linear region is not known: do a sweep on the page Instrument"),
    ),
    ("run 'tissueid calibrate static'", marked("calibrate on the page Instrument")),
    ("run 'tissueid calibrate sweep'", marked("do a sweep on the page Instrument")),
)
"""What the core advises to somebody at a shell, longest first, and what is to be done instead in the window."""


def for_window(text: str) -> str:
    """What the core says, without commands: what it is and what to do about it in the window, in its language."""
    text = said_by_core(text)
    for shell, window in SAID_FOR_SHELL:
        if "'tissueid calibrate" not in text:
            break
        text = text.replace(shell, _(window)).replace(_capital(shell), _capital(_(window)))
    return text


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


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
