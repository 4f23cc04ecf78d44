"""What is said of an option that a specification refuses: one line, the same for engines, stimuli and rules."""

from __future__ import annotations

from collections.abc import Iterable

from pydantic import ValidationError


def refused(what: str, known: Iterable[str], error: ValidationError) -> str:
    """The first thing that does not hold, in a line; ``known`` are the options that ``what`` has."""
    first = error.errors()[0]
    option = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        return f"{what} has no option {option!r}: it has {', '.join(sorted(known))}"
    if first["type"] == "tuple_type":
        return f"{what}, option {option!r}: give a list, such as [1, 2, 3]"
    return f"{what}, option {option!r}: {reason(error)}"


def reason(error: ValidationError) -> str:
    """Why the first thing does not hold, in the words of this software."""
    first = error.errors(include_url=False, include_input=False)[0]
    if first["type"] == "extra_forbidden":
        return "nothing of that name belongs there"
    words = " ".join(str(first["msg"]).removeprefix("Value error, ").removeprefix("Assertion failed, ").split())
    if words.startswith("Input should be "):
        words = f"it must be {words.removeprefix('Input should be ')}"
    return words.replace("Field required", "it is missing")
