"""Messages about options that a pydantic model refuses; the same for engines, stimuli, rules and calibration files."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from pydantic import ValidationError

from tissueid.messages import Message, Verbatim, joined


def option_error(what: str, known: Iterable[str], error: ValidationError) -> Message:
    """Return a message about the first refused option.

    Args:
        what: the thing that has the options, such as "stimulus noise".
        known: names of all its options.
        error: raised by its model.
    """
    first = error.errors()[0]
    option = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        return Message(
            "option.unknown",
            "{what} has no option '{option}': it has {known}",
            what=what,
            option=Verbatim(option),
            known=joined(map(Verbatim, sorted(known))),
        )
    if first["type"] == "tuple_type":
        return Message(
            "option.list",
            "{what}, option '{option}': give a list, such as [1, 2, 3]",
            what=what,
            option=Verbatim(option),
        )
    return Message(
        "option.refused",
        "{what}, option '{option}': {reason}",
        what=what,
        option=Verbatim(option),
        reason=validation_reason(error),
    )


def validation_reason(error: ValidationError) -> str:
    """Return why the first value is refused: a message for the usual reasons, else the text of the model."""
    first = error.errors(include_url=False, include_input=False)[0]
    context: dict[str, Any] = first.get("ctx", {})
    cause = context.get("error")
    if isinstance(cause, Exception) and cause.args and isinstance(cause.args[0], Message):
        return cause.args[0]
    match first["type"]:
        case "extra_forbidden":
            return Message("option.extra", "no such name is known here")
        case "missing":
            return Message("option.missing", "it is missing")
        case "greater_than":
            return Message("option.greater", "it must be greater than {limit}", limit=_plain(context["gt"]))
        case "greater_than_equal":
            return Message("option.least", "it must be greater than or equal to {limit}", limit=_plain(context["ge"]))
        case "less_than":
            return Message("option.less", "it must be less than {limit}", limit=_plain(context["lt"]))
        case "less_than_equal":
            return Message("option.most", "it must be less than or equal to {limit}", limit=_plain(context["le"]))
        case "finite_number":
            return Message("option.finite", "it must be a finite number")
        case "float_type" | "float_parsing":
            return Message("option.number", "it must be a valid number")
        case "int_type" | "int_parsing" | "int_from_float" | "int_parsing_size":
            return Message("option.whole", "it must be a valid integer")
        case "bool_type" | "bool_parsing":
            return Message("option.switch", "it must be true or false")
        case "string_type":
            return Message("option.text", "it must be a text")
        case "literal_error":
            return Message("option.choice", "it must be {expected}", expected=Verbatim(context["expected"]))
        case "too_long" | "string_too_long":
            return Message("option.long", "it may have at most {limit} entries", limit=context["max_length"])
    text = " ".join(str(first["msg"]).removeprefix("Value error, ").removeprefix("Assertion failed, ").split())
    return text.replace("Input should be ", "it must be ", 1) if text.startswith("Input should be ") else text


def _plain(limit: float) -> float:
    """Return a limit as a whole number where it is one, so that it is shown without decimals."""
    return int(limit) if float(limit).is_integer() else limit
