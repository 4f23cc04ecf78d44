"""Messages: texts for people, each with a stable code, an English template and named values.

A ``Message`` is a ``str``: its English text. Files, JSON, logs and the command line use it as such. The window and the
reports call ``translated(message)``, which fills the translated template with the same values. Programs and tests read
``code`` and ``values``.

    Message("quality.overrange", "A converter was at the end of its range for {share}.", share=Quantity(3.4, "%", 1))

A template holds plain fields, ``{name}`` or ``{name:.2f}``: no attributes, no indices. A value is a number, a text, a
``Quantity``, an ``Action``, another message or a ``Listing`` of messages. Messages and texts of the catalogue among the
values are translated too; names and other data of a user, file or device are wrapped in ``Verbatim``, so that a column
called "Force" keeps its name.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Self

from tissueid.language import _, decimal

MISSING = "—"
"""Text of a number that is not finite."""
_FIELD = re.compile(r"\{([A-Za-z_]\w*)(?::((?:,)?(?:\.\d{1,2})?[fgde%]?))?\}")
_PARTS = "{parts}"
_DEEPEST = 8
_MOST_VALUES = 100
_LONGEST = 20_000
"""Limits of a message that is read from a file: nesting, values of a message, characters of a text."""


class Verbatim(str):
    """Text of a user, a file or a device, or a name to be typed: shown as it is, also if the catalogue has the same."""

    __slots__ = ()


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number in the unit in which it is shown, with its number of decimals."""

    value: float
    unit: str = ""
    decimals: int = 0

    def __str__(self) -> str:
        text = _number(self.value, f".{self.decimals}f")
        return f"{text} {self.unit}" if self.unit else text


@dataclass(frozen=True, slots=True)
class Listing:
    """Texts in one: "a, b and c". ``last`` stands before the last item and is translated, as are the items."""

    items: tuple[str, ...]
    last: str = ", "
    between: str = ", "

    def __str__(self) -> str:
        return self.said_by(str)

    def said_by(self, say: Callable[[Any], str]) -> str:
        """Return the list with each part turned into text by ``say``."""
        texts = [say(item) for item in self.items]
        if len(texts) < 2:
            return "".join(texts)
        return f"{self.between.join(texts[:-1])}{say(self.last)}{texts[-1]}"


@dataclass(frozen=True, slots=True)
class Action:
    """Something that the reader can do: a command in the shell, a place or a button in the window.

    ``str()`` is the command, for the command line, files and logs; ``translated`` gives the place in the window.
    """

    code: str
    command: str
    window_place: str

    def __str__(self) -> str:
        return f"'{self.command}'"


class Message(str):
    """A text for people: English as a ``str``, with ``code``, ``template`` and ``values``.

    Args:
        code: what the text says, independent of its wording: lower-case words and dots, such as ``link.silent``.
        template: the English text with fields in braces. It is the id of its translations.
        values: the values of the fields. A field without a value stays as it is.
    """

    code: str
    template: str
    values: Mapping[str, Any]

    def __new__(cls, code: str, template: str, /, **values: Any) -> Self:
        """Return the message; its English text is filled at once."""
        made = super().__new__(cls, _filled(template, values, str))
        made.code, made.template, made.values = code, template, values
        return made

    def __getnewargs_ex__(self) -> tuple[tuple[str, str], dict[str, Any]]:
        """Return what a copy in another process is made of."""
        return (self.code, self.template), dict(self.values)

    def as_dict(self) -> dict[str, Any]:
        """Return code, template and values for JSON."""
        return {
            "code": self.code,
            "template": self.template,
            "values": {name: _plain(value) for name, value in self.values.items()},
        }


def sentences(*parts: str) -> Message:
    """Return several texts as one, with spaces between them."""
    return Message("text.sentences", _PARTS, parts=Listing(tuple(part for part in parts if part), " ", " "))


def joined(parts: Iterable[str], between: str = ", ", last: str | None = None) -> Message:
    """Return several texts as one list, such as "a, b and c" with ``last=marked(" and ")``."""
    listing = Listing(tuple(parts), between if last is None else last, between)
    return Message("text.list", _PARTS, parts=listing)


def code_of(text: str) -> str:
    """Return the code of a message; "" for a text that is none."""
    return text.code if isinstance(text, Message) else ""


def messages_in(text: Any) -> Iterator[Message]:
    """Yield a message and the messages among its values, the message itself first."""
    if isinstance(text, Message):
        yield text
    parts = text.items if isinstance(text, Listing) else text.values.values() if isinstance(text, Message) else ()
    for part in parts:
        yield from messages_in(part)


def codes_in(text: str) -> frozenset[str]:
    """Return the codes of a message and of the messages among its values; empty for a text that is none."""
    return frozenset(message.code for message in messages_in(text))


def stored(text: str | None) -> dict[str, Any] | None:
    """Return code, template and values of a message for JSON; None for a text that is none."""
    return text.as_dict() if isinstance(text, Message) else None


def translated(text: Any) -> str:
    """Return a text, message or value of a message in the active language."""
    if isinstance(text, Message):
        return _filled(_(text.template), text.values, translated)
    if isinstance(text, Listing):
        return text.said_by(translated)
    if isinstance(text, Action):
        return _(text.window_place)
    if isinstance(text, Verbatim):
        return str(text)
    return _(text) if isinstance(text, str) else str(text)


def message_from(stored: Any, text: str = "") -> str:
    """Return the message that ``as_dict`` stored; ``text`` where ``stored`` is no such dictionary or is too large."""
    try:
        return _message(stored, 0)
    except (AttributeError, TypeError, ValueError, KeyError, OverflowError):
        return text


def signed(number: str) -> str:
    """Return a number with a minus sign (U+2212) instead of a hyphen, and without a sign where all digits are zero."""
    if not number.startswith("-"):
        return number
    return f"−{number[1:]}" if any(digit in number for digit in "123456789") else number[1:]


def _filled(template: str, values: Mapping[str, Any], say: Callable[[Any], str]) -> str:
    def fill(field: re.Match[str]) -> str:
        name, form = field.groups()
        if name not in values:
            return field[0]
        value = values[name]
        if not (form and isinstance(value, int | float)):
            return say(value)
        return decimal(_number(value, form)) if say is translated else _number(value, form)

    return _FIELD.sub(fill, template)


def _number(value: float, form: str) -> str:
    return signed(format(value, form)) if math.isfinite(value) else MISSING


def _plain(value: Any) -> Any:
    if isinstance(value, Message):
        return value.as_dict()
    if isinstance(value, Verbatim):
        return {"verbatim": str(value)}
    if isinstance(value, Quantity):
        finite = value.value if math.isfinite(value.value) else None
        return {"value": finite, "unit": value.unit, "decimals": value.decimals}
    if isinstance(value, Action):
        return {"action": value.code, "command": value.command, "place": value.window_place}
    if isinstance(value, Listing):
        return {"items": [_plain(item) for item in value.items], "last": value.last, "between": value.between}
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if isinstance(value, str | int | float | bool | None) else str(value)


def _message(stored: Any, depth: int) -> Message:
    template = _text(stored["template"])
    if depth > _DEEPEST or max(len(stored["values"]), template.count("{")) > _MOST_VALUES:
        raise ValueError
    values = {_text(name): _value(value, depth + 1) for name, value in stored["values"].items()}
    made = Message(_text(stored["code"]), template, **values)
    _text(str(made))
    return made


def _value(stored: Any, depth: int) -> Any:
    if isinstance(stored, str):
        return _text(stored)
    if stored is None:
        return math.nan
    if isinstance(stored, bool | int | float):
        return stored
    if "template" in stored:
        return _message(stored, depth)
    if "items" in stored:
        if depth > _DEEPEST or len(stored["items"]) > _MOST_VALUES:
            raise ValueError
        items = tuple(_value(item, depth + 1) for item in stored["items"])
        return Listing(items, _text(stored["last"]), _text(stored["between"]))
    if "verbatim" in stored:
        return Verbatim(_text(stored["verbatim"]))
    if "action" in stored:
        return Action(_text(stored["action"]), _text(stored["command"]), _text(stored["place"]))
    value, decimals = stored["value"], stored["decimals"]
    if type(decimals) is not int or not 0 <= decimals <= 12:
        raise ValueError
    return Quantity(math.nan if value is None else float(value), _text(stored["unit"]), decimals)


def _text(stored: Any) -> str:
    if not isinstance(stored, str) or len(stored) > _LONGEST:
        raise ValueError
    return stored
