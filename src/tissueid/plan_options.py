"""Options of a plan: declared once, on its fields, for the command line, the form and the files.

    class SweepPlan(Plan):
        seconds: Annotated[float, Option("--seconds", metavar="S", help="length of each test"), Field(gt=0.0)] = 4.0
        step_m: Annotated[float, Option("--step", metavar="MM", scale=1e-3, help="distance between positions")] = 2e-3

``tissueid.cli.plan_command.plan_command`` makes the parameters of a command from them. A field without an ``Option`` is
no option of the command line. The messages about options that a pydantic model refuses are those of engines, stimuli,
rules and calibration files, too.
"""

from __future__ import annotations

import contextlib
import json
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo

from tissueid.errors import UnusableInputError
from tissueid.messages import Message, Verbatim, joined


def option_error(what: str, names: Iterable[str], error: ValidationError) -> Message:
    """Return a message about the first refused option.

    Args:
        what: the thing that has the options, such as "stimulus noise".
        names: names of all its options.
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
            known=joined(map(Verbatim, sorted(names))),
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


@dataclass(frozen=True)
class Option:
    """Declaration of an option as an annotation of a field. Default and bounds are those of the field.

    Args:
        name: on the command line, such as "--seconds"; "" for the name of the field, with "--no-" for a switch.
        metavar: placeholder of the value in the help.
        help: one phrase in English for the command line; a form shows title and description of the field.
        scale: value of the field for 1 on the command line, such as 1e-3 for millimetres.
        read: returns the value of the field from the text on the command line; may raise UnusableInputError.
        argument: whether it is an argument by position.
        separator: of the values of a tuple that are given in one text, such as ","; "" where the option is repeated.
    """

    name: str = ""
    metavar: str | None = None
    help: str = ""
    scale: float = 1.0
    read: Callable[[str], Any] | None = None
    argument: bool = False
    separator: str = ""


class Plan(BaseModel):
    """What a procedure is to do: frozen, checked values in SI units."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            whole = not error.errors()[0]["loc"]
            fields = type(self).model_fields
            raise UnusableInputError(
                validation_reason(error) if whole else option_error("the plan", fields, error)
            ) from error


def named_values(plan: Plan, fields: Mapping[str, str]) -> dict[str, tuple[str, Any]]:
    """Return name on the command line and value of the fields of a plan that are not None.

    Args:
        plan: the plan.
        fields: field of the plan, by the key of the result.
    """
    named = {}
    for key, field in fields.items():
        option = option_of(type(plan).model_fields[field])
        if option is not None and (value := getattr(plan, field)) is not None:
            named[key] = option.name, value
    return named


def option_of(field: FieldInfo) -> Option | None:
    """Return the declaration of a field's option; None for a field without one."""
    return next((item for item in field.metadata if isinstance(item, Option)), None)


class OptionBounds(NamedTuple):
    """The least and greatest value of a field, None where it has no such bound; an open one is excluded itself."""

    least: float | None = None
    most: float | None = None
    least_open: bool = False
    most_open: bool = False


def bounds_of(field: FieldInfo) -> OptionBounds:
    """Return the bounds of a field: of ``ge``, ``gt``, ``le`` and ``lt``."""
    limits: dict[str, float] = {}
    for rule in field.metadata:
        named = {name: getattr(rule, name, None) for name in ("ge", "gt", "le", "lt")}
        limits |= {name: limit for name, limit in named.items() if limit is not None}
    return OptionBounds(
        limits.get("gt", limits.get("ge")), limits.get("lt", limits.get("le")), "gt" in limits, "lt" in limits
    )


def shell_options(plan: Plan) -> str:
    """Return the options of the command line that give a plan its values, without those of defaults and arguments."""
    arguments: list[str] = []
    for name, field in type(plan).model_fields.items():
        option, value = option_of(field), getattr(plan, name)
        if option is None or option.argument or value == field.get_default(call_default_factory=True):
            continue
        flag = option.name or f"--{name.replace('_', '-')}"
        if isinstance(value, bool):
            arguments.append(flag if value else flag.replace("--", "--no-", 1))
            continue
        texts = [_shell_text(item, option) for item in (value if isinstance(value, tuple) else (value,))]
        for text in [option.separator.join(texts)] if option.separator else texts:
            arguments += [flag, text]
    return shlex.join(arguments)


def _shell_text(value: Any, option: Option) -> str:
    if not isinstance(value, float):
        return str(value)
    text = f"{value / option.scale:.12g}"
    return text if option.scale != 1.0 or float(text) == value else repr(value)


def parse_options(options: Sequence[str]) -> dict[str, Any]:
    """Parse NAME=VALUE pairs; the last one of a name counts.

    Raises:
        UnusableInputError: a pair has no equals sign or no name.
    """
    return dict(map(name_and_value, options))


def name_and_value(text: str) -> tuple[str, Any]:
    """Read NAME=VALUE. The value is JSON (a number, true, a list with or without brackets) or otherwise text.

    Raises:
        UnusableInputError: there is no equals sign or no name.
    """
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise UnusableInputError(
            "option.pair", "an option must be {form}, got {text}", form="NAME=VALUE", text=Verbatim(repr(text))
        )
    for reading in (value, f"[{value}]") if "," in value else (value,):
        with contextlib.suppress(ValueError):
            return name, json.loads(reading)
    return name, value
