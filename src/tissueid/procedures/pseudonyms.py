"""The one rule for a subject: a pseudonym, and no name of a person."""

from __future__ import annotations

import re
from typing import Annotated

from tissueid.errors import UnusableInputError
from tissueid.formatting import clean
from tissueid.language import marked
from tissueid.messages import Action, Verbatim
from tissueid.plan_options import Option

PseudonymConfirmed = Annotated[
    bool, Option("--confirm-pseudonym", help="the subject is a pseudonym although it looks like a name")
]
"""Field of a plan with a subject."""
_CONFIRM = Action("subject.confirm", "--confirm-pseudonym", marked("“This is a pseudonym, not a name”"))
_WORD = re.compile(r"[^\W\d_]+(?:['’-][^\W\d_]+)*\.?")
_JOINT = re.compile(r",|_|(?<=[^\W\d_])\.(?=[^\W\d_]{2})")
"""What stands between two words: comma, low line, or a dot within a word; that of an initial stays."""
_PARTICLES = frozenset(
    {"de", "den", "der", "del", "di", "da", "du", "la", "le", "van", "von", "zu", "zur", "bin", "al"}
)
_TITLES = frozenset({"mr", "mrs", "ms", "dr", "prof", "herr", "frau"})
_SHORTEST_SHOUTED = 3
"""Letters of a word in capitals that may be a name; shorter ones are abbreviations."""
_MOST_WORDS = 6
_LONGEST = 80


def reads_like_name(text: str) -> bool:
    """Whether a pseudonym looks like a real name: two capitalised words and nothing else, as in "John Smith".

    Initials, titles, particles and the order "Smith, John" are known, also with dots or low lines between the words;
    anything with a digit in it is a code.
    """
    parts = _JOINT.sub(" ", text).split()
    if not 2 <= len(parts) <= _MOST_WORDS or not all(_WORD.fullmatch(part) for part in parts):
        return False
    words = [part for part in parts if part.lower() not in _PARTICLES]
    named = [word for word in words if word.lower().rstrip(".") not in _TITLES]
    titled = len(named) < len(words)
    full = [word for word in named if _capitalised(word)]
    initials = [word for word in named if len(word.rstrip(".")) == 1 and word[0].isupper()]
    return len(full) + len(initials) == len(named) and (len(named) >= 2 or titled) and bool(full)


def _capitalised(word: str) -> bool:
    letters = word.rstrip(".")
    if letters.isupper():
        return len(letters) >= _SHORTEST_SHOUTED
    return len(letters) > 1 and letters[0].isupper()


def check_subject(text: str, *, confirmed: bool) -> None:
    """Refuse a subject that looks like a person's name, unless a person confirmed that it is a pseudonym.

    Raises:
        UnusableInputError: it looks like a name.
    """
    if not confirmed and reads_like_name(text):
        raise UnusableInputError(
            "subject.name",
            "the subject '{text}' looks like a person's name: use a pseudonym such as P-001, or confirm that it is one "
            "with {option}",
            text=Verbatim(clean(text)[:_LONGEST]),
            option=_CONFIRM,
        )
