"""Checks of errors and messages by their code and values, in place of their sentences."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from string import Formatter
from typing import Any

import pytest

from tissueid import messages
from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.language import ENGLISH, _, current_language, set_language
from tissueid.messages import Message, code_of, messages_in, translated


class _Check:
    """A check of an error, called by its code: names of tests have to be the same in every process."""

    def __init__(self, code: str, check: Callable[[BaseException], bool]) -> None:
        self._code, self._check = code, check

    def __call__(self, error: BaseException) -> bool:
        return self._check(error)

    def __repr__(self) -> str:
        return self._code


def coded(code: str, /, **values: Any) -> Callable[[BaseException], bool]:
    """Return a check for ``pytest.raises(Error, check=coded("session.exists", path=...))``."""

    def check(error: BaseException) -> bool:
        assert isinstance(error, TissueIDError), repr(error)
        return says(error.message, code, **values)

    return _Check(code, check)


def says(text: str, code: str, /, **values: Any) -> bool:
    """Return whether a text is the message of this code with these values; fail with both where it is not.

    A message among the values is given as such or by its code.
    """
    assert isinstance(text, Message), f"no message: {text!r}"
    found = {name: _comparable(text.values.get(name), expected) for name, expected in values.items()}
    assert (text.code, found) == (code, values), str(text)
    return True


def _comparable(value: Any, expected: Any) -> Any:
    """Return a message among the values as its code where a code is expected."""
    return code_of(value) if isinstance(value, Message) and value != expected else value


def codes(texts: Iterable[str]) -> list[str]:
    """Return the codes of messages, in their order; "" for a text without one."""
    return [code_of(text) for text in texts]


def message(texts: Iterable[str], code: str) -> Message:
    """Return the first message of this code; fail with all texts where there is none."""
    found = list(texts)
    for text in found:
        if isinstance(text, Message) and text.code == code:
            return text
    raise AssertionError(f"no message {code!r} in {found}")


def is_german(text: str) -> bool:
    """Return whether a message in German differs from its English text; the language is English afterwards."""
    set_language("de")
    try:
        return translated(text) != str(text)
    finally:
        set_language("en")


class Refusal:
    """A code and values that an error must have, as a parameter of a test."""

    def __init__(self, code: str, /, **values: Any) -> None:
        self.check = coded(code, **values)


def holding(code: str, /, **values: Any) -> Callable[[BaseException], bool]:
    """Return a check that an error's message, or a message among its values, has this code and these values."""

    def check(error: BaseException) -> bool:
        assert isinstance(error, TissueIDError), repr(error)
        part = part_of(error.message, code)
        return says(part, code, **values)

    return _Check(code, check)


def part_of(text: Any, code: str) -> Message:
    """Return the message with this code: the text itself or one among its values; fail where there is none."""
    parts = list(messages_in(text))
    found = next((part for part in parts if part.code == code), None)
    assert found is not None, f"{code} is not among {[part.code for part in parts]}"
    return found


@cache
def templates() -> dict[str, dict[str, set[str]]]:
    """Return the templates in the source by code and module."""
    found: dict[str, dict[str, set[str]]] = {}
    for path in sorted(Path(messages.__file__).parents[1].rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and len(node.args) > 1:
                code, template = (part.value if isinstance(part, ast.Constant) else None for part in node.args[:2])
                if node.func.id.endswith(("Message", "Error")) and isinstance(code, str) and isinstance(template, str):
                    found.setdefault(code, {}).setdefault(path.name, set()).add(template)
    return found


def shows(text: str, code: str, /, **values: Any) -> bool:
    """Return whether a printed or drawn text has the message of this code with these values, wrapped or not.

    The message is looked for in the active language. A number is given as the message has it, or as the text that it
    has there. Fail with the text where it has not.
    """
    return _found(re.search, text, code, values)


def reads(text: str, code: str, /, **values: Any) -> bool:
    """Return whether a text is the message of this code and nothing else, also as a sentence; see ``shows``."""
    return _found(re.fullmatch, text, code, values)


def begins(text: str, code: str, /, **values: Any) -> bool:
    """Return whether a text begins with the message of this code; see ``shows``."""
    return _found(re.match, text, code, values)


def _found(look: Callable[[str, str], Any], text: str, code: str, values: dict[str, Any]) -> bool:
    every = set().union(*templates()[code].values())
    wanted = [one for one in every if {name for _text, name, _spec, _kind in Formatter().parse(one)} >= set(values)]
    assert wanted, f"{code} has not all of {set(values)}"
    for template in wanted:
        said = _(template)
        has_words = re.search(r"[a-z]{2}", re.sub(r"\{.*?\}", "", template))
        assert current_language() == ENGLISH or not has_words or said != template, f"not translated: {template!r}"
        pattern = ""
        for literal, name, spec, _conversion in Formatter().parse(said):
            pattern += _wrapped(literal)
            if name in values:
                field = f"{{{name}:{spec}}}" if spec else f"{{{name}}}"
                pattern += _wrapped(translated(Message(code, field, **{name: values[name]})))
            elif name is not None:
                pattern += r"[\s\S]+?"
        first = pattern[:1]
        if look(f"[{first.lower()}{first.upper()}]{pattern[1:]}[.]?" if first.isalpha() else f"{pattern}[.]?", text):
            return True
    raise AssertionError(f"{wanted} with {values} is not in: {text[:2000]}")


def _wrapped(text: str) -> str:
    """Return a pattern of a text that may be broken into lines."""
    return r"\s+".join(re.escape(part) for part in re.split(r"\s+", text))


def made(code: str, /, **values: Any) -> Message:
    """Return the message of this code with these values, as the source would make it: a value of another message."""
    (template,) = (
        template
        for template in set().union(*templates()[code].values())
        if {name for _literal, name, _spec, _conversion in Formatter().parse(template) if name} == set(values)
    )
    return Message(code, template, **values)


def refused(call: Callable[[], object], code: str, /, **values: Any) -> None:
    """Assert that a call raises ``UnusableInputError`` with this code and, among others, these values."""
    with pytest.raises(UnusableInputError, check=coded(code, **values)):
        call()
